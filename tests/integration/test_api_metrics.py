"""`/metrics` over real HTTP, read as Prometheus reads it."""

import re
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from prometheus_client import Metric, parser
from prometheus_client.openmetrics import parser as openmetrics
from sqlalchemy import text, update
from tests.support.server import RunningApi, new_database, serving

from drivecal.execution.measures import BOUNDS, Measures
from drivecal.storage import processes
from drivecal.storage.engine.tables import processes as process_table
from drivecal.storage.engine.types import now

OPEN = {"Accept": "application/openmetrics-text; version=1.0.0; charset=utf-8"}
UNITS = ("_seconds", "_bytes")
UNITLESS = {
    *("drivecal_build", "drivecal_database_up", "drivecal_campaigns", "drivecal_campaigns_waiting", "drivecal_resources"),
    *("drivecal_resources_held", "drivecal_busy_answers", "drivecal_cells", "drivecal_cells_pending", "drivecal_leases"),
    *("drivecal_reference_runs", "drivecal_ready", "drivecal_degraded", "drivecal_dispatcher_elections", "drivecal_workers"),
    *("drivecal_breakdowns", "drivecal_retries", "drivecal_late_results", "drivecal_http_requests"),
    *("drivecal_http_event_streams",),
}
"""Metrics without a unit: counts and truth values."""


@pytest.fixture(scope="module", params=["sqlite", "postgresql"])
def api(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningApi]:
    url = new_database(request, request.param, tmp_path_factory.mktemp("metrics"))
    with serving(url) as running:
        yield running


def metrics(api: RunningApi) -> dict[str, Metric]:
    """By name, of the scrape in either format: they have to agree where nothing happens in between."""
    response = api.http.get("/metrics", headers=OPEN)
    assert response.status_code == 200
    assert response.headers["content-type"].startswith("application/openmetrics-text; version=1.0.0")
    families = openmetrics.text_string_to_metric_families(response.text)  # type: ignore[no-untyped-call]  # it has no types
    return {family.name: family for family in families}


def samples(metric: Metric) -> dict[tuple[str, ...], float]:
    """By the values of their labels, in the order of the labels' names."""
    return {tuple(value for _, value in sorted(sample.labels.items())): sample.value for sample in metric.samples}


def value(found: dict[str, Metric], name: str, **labels: str) -> float:
    (one,) = (sample for sample in found[name].samples if sample.labels == labels)
    return one.value


def busy(api: RunningApi) -> Measures:
    """A dispatcher that has done something."""
    measures = Measures()
    for seconds in (0.004, 0.2, 0.2, 90.0):
        measures.lookup.observe(seconds)
    measures.breakdowns.labels("crash").inc(2)
    measures.late_results.inc()
    states = ("idle", "busy", "busy", "starting")
    workers = [{"id": f"worker-{n}", "node": "here", "state": state, "cells": 0} for n, state in enumerate(states)]
    use = {"name": "carmaker", "total": 4, "held": 3, "settling": 1}
    detail = {"workers": workers, "resources": [use], "degraded": "one worker is missing", "measures": measures.snapshot()}
    with api.database.transaction() as connection:
        processes.heartbeat(connection, processes.DISPATCHER, 1, now(), detail)
    return measures


def test_the_dispatchers_measures_come_through(api: RunningApi) -> None:
    began = time.time()
    busy(api)
    result = metrics(api)
    assert samples(result["drivecal_workers"]) == {("starting",): 1, ("idle",): 1, ("busy",): 2}
    assert (
        value(result, "drivecal_resources", resource="carmaker"),
        value(result, "drivecal_resources_held", resource="carmaker"),
    ) == (4, 3)
    assert (value(result, "drivecal_ready"), value(result, "drivecal_degraded")) == (1, 1)
    assert 0 <= value(result, "drivecal_dispatcher_heartbeat_age_seconds") <= time.time() - began
    assert value(result, "drivecal_breakdowns", kind="crash") == 2
    assert value(result, "drivecal_breakdowns", kind="hang") == 0
    assert value(result, "drivecal_late_results") == 1
    lookup = {(sample.name, sample.labels.get("le")): sample.value for sample in result["drivecal_lookup_seconds"].samples}
    buckets = [lookup["drivecal_lookup_seconds_bucket", le] for le in (*map(str, BOUNDS), "+Inf")]
    assert buckets == sorted(buckets)
    assert lookup["drivecal_lookup_seconds_bucket", "0.005"] == 1
    assert lookup["drivecal_lookup_seconds_bucket", "60.0"] == 3
    assert buckets[-1] == lookup["drivecal_lookup_seconds_count", None] == 4
    assert lookup["drivecal_lookup_seconds_sum", None] == pytest.approx(90.404)


def test_both_formats_are_what_a_linter_wants(api: RunningApi) -> None:
    """As `promtool check metrics`: help and type once, names with units, counters that end in _total, and nothing twice."""
    busy(api)
    metrics(api)
    plain = api.http.get("/metrics")
    assert plain.headers["content-type"] == "text/plain; version=0.0.4; charset=utf-8"
    lines = plain.text.splitlines()
    for word in ("HELP", "TYPE"):
        names = [line.split()[2] for line in lines if line.startswith(f"# {word} ")]
        assert len(names) == len(set(names))
    families = list(parser.text_string_to_metric_families(plain.text))
    for family in families:
        assert family.documentation, family.name
        assert family.type in {"counter", "gauge", "histogram"}, family.name
        assert re.fullmatch(r"(drivecal|process)_[a-z_]+", family.name)
        assert not family.name.endswith(("_total", "_count", "_sum", "_bucket", "_info")) or family.type == "gauge"
        if family.name.startswith("drivecal_"):
            assert family.name.endswith(UNITS) or family.name.removesuffix("_info") in UNITLESS, family.name
        for sample in family.samples:
            assert sample.name.endswith("_total") or family.type != "counter", sample.name
            assert not sample.name.endswith("_created")
    seen = Counter((item.name, tuple(sorted(item.labels.items()))) for family in families for item in family.samples)
    assert seen.most_common(1)[0][1] == 1
    assert {name.removesuffix("_info") for name in {family.name for family in families}} == set(metrics(api))


def test_every_metric_is_in_the_documentation(api: RunningApi) -> None:
    busy(api)
    page = (Path(__file__).parents[2] / "docs" / "pages" / "reference" / "metrics.md").read_text()
    documented = set(re.findall(r"^\| `(drivecal_[a-z_]+)", page, re.MULTILINE))
    shown = {re.sub(r"_(bucket|sum|count)$", "", sample.name) for metric in metrics(api).values() for sample in metric.samples}
    assert {name for name in shown if name.startswith("drivecal_")} == documented


def test_a_database_that_fails_is_said_to_be_down(tmp_path: Path) -> None:
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as api:
        busy(api)
        assert value(metrics(api), "drivecal_database_up") == 1
        with api.database.transaction() as connection:
            connection.execute(text("ALTER TABLE campaigns RENAME TO gone"))
        result = metrics(api)
        assert value(result, "drivecal_database_up") == 0
        assert "drivecal_workers" not in result
        assert "drivecal_http_requests" in result


def test_the_workers_of_a_silent_dispatcher_are_none(tmp_path: Path) -> None:
    with serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as api:
        busy(api)
        with api.database.transaction() as connection:
            connection.execute(update(process_table).values(heartbeat_at=now().replace(year=2020)))
        result = metrics(api)
        assert set(samples(result["drivecal_workers"]).values()) == {0}
        assert value(result, "drivecal_ready") == 0
        assert value(result, "drivecal_dispatcher_heartbeat_age_seconds") > 1e6
        assert value(result, "drivecal_breakdowns", kind="crash") == 2
