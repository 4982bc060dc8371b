"""Fronts over HTTP, by the client and on the command line."""

import csv
import io
import json
import os
import stat
import subprocess
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from tests.integration.test_objectives import JERK, TWO, backend
from tests.support.command import command
from tests.support.runs import SMALL, run_posted
from tests.support.server import RunningApi, serving
from tests.support.several import SEARCH, installed
from tests.support.values import present

from drivecal.cli.commands.check import _set
from drivecal.client import Client

SPEC = SMALL | {"objectives": TWO, "optimizer": SEARCH, "reduction": {"mode": "exact"}}


@dataclass(frozen=True)
class Ended:
    api: RunningApi
    first: str
    second: str
    """Another seed on the same space."""
    plain: str
    """Without objectives."""


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ended]:
    with installed(), serving(f"sqlite:///{tmp_path_factory.mktemp('front') / 'drivecal.db'}") as api:
        changes: list[dict[str, Any]] = [
            {"baseline": {f"P{i}": 0.5 for i in range(1, 12)}},
            {"optimizer": SEARCH | {"seed": 9}},
            {"objectives": None, "optimizer": SMALL["optimizer"]},
        ]
        yield Ended(api, *(run_posted(api, SPEC | change, backend()) for change in changes))


def rows_of(ended: Ended, campaign: str, **query: Any) -> list[dict[str, Any]]:
    answer = ended.api.http.get(f"/api/v1/campaigns/{campaign}/front", params=query).raise_for_status()
    return list(answer.json()["items"])


def test_rows_are_ranked_marked_and_win_everywhere_together(ended: Ended) -> None:
    rows = rows_of(ended, ended.first)
    assert [row["rank"] for row in rows] == list(range(1, len(rows) + 1))
    assert rows[0]["best_in"] == ["comfort"]
    assert rows[-1]["best_in"] == [JERK]
    assert sum(row["wins"] for row in rows) == pytest.approx(1.0)
    assert sum(row["knee"] for row in rows) <= 1
    assert all(row["violation"] == 0 and row["iteration"] is not None for row in rows)


def test_weights_order_the_front_and_agree_with_who_wins(ended: Ended) -> None:
    by_rank = {json.dumps(row["parameters"]): row for row in rows_of(ended, ended.first)}
    for weight in (0.0, 0.2, 0.5, 1.0):
        rows = rows_of(ended, ended.first, weights=f"comfort={weight},{JERK}={1 - weight}")
        assert [row["weighted"] for row in rows] == sorted((row["weighted"] for row in rows), reverse=True)
        corners = [first for first, _ in by_rank[json.dumps(rows[0]["parameters"])]["weights"]]
        assert min(corners) - 1e-9 <= weight <= max(corners) + 1e-9


def test_the_summary_tells_the_whole(ended: Ended) -> None:
    with Client(ended.api.url) as client:
        summary, rows = client.front_summary(ended.first), client.front(ended.first)
    assert [(each.name, each.direction, each.aggregate) for each in summary.objectives] == [
        ("comfort", "maximise", "mean"),
        (JERK, "minimise", "max"),
    ]
    assert (summary.size, summary.extremes) == (len(rows), {"comfort": 1, JERK: len(rows)})
    assert summary.knee == next((row.rank for row in rows if row.knee), None)
    assert summary.growth[0].new == summary.growth[0].size
    assert summary.growth[-1].size == len({tuple(row.objectives.values()) for row in rows})


def test_a_campaign_without_objectives_has_a_front_of_its_best(ended: Ended) -> None:
    with Client(ended.api.url) as client:
        (row,), best = client.front(ended.plain), client.campaign(ended.plain).best
    assert row.objectives["comfort"] == pytest.approx(present(best).objective)
    assert row.alternatives == present(best).alternatives


def test_every_evaluated_set_is_listed_by_its_objectives(ended: Ended) -> None:
    query = f"/api/v1/campaigns/{ended.first}/front/evaluated"
    listed = ended.api.http.get(query, params={"limit": 1000}).json()["items"]
    with Client(ended.api.url) as client:
        summary, rows = client.front_summary(ended.first), client.front(ended.first)
        sets, frame = client.evaluated_sets(ended.first[:12]), client.frame(ended.first, "front/evaluated")
    assert len(listed) == summary.evaluated
    front = [each["objectives"] for each in listed if each["on_front"]]
    assert len(front) == sum(row.alternatives for row in rows)
    assert all(row.objectives in front for row in rows)
    assert [each.model_dump() for each in sets] == listed
    assert frame.to_arrow().num_rows == len(listed)
    exported = ended.api.http.get(query, params={"format": "csv", "where": "on_front=true"}).text
    assert len(list(csv.DictReader(io.StringIO(exported)))) == len(front)


def test_the_summary_has_the_baseline_as_it_was_evaluated(ended: Ended) -> None:
    with Client(ended.api.url) as client:
        baseline, own = client.front_summary(ended.first).baseline, client.campaign(ended.first).baseline
        listed = ended.api.http.get(f"/api/v1/campaigns/{ended.first}/front/evaluated", params={"limit": 1000}).json()["items"]
        assert client.front_summary(ended.plain).baseline is None
        trust = client.results(ended.first).trust
    assert baseline is not None
    assert baseline.objectives[JERK] == max(baseline.values[f"{JERK}@{name}"] for name in present(own).scores)
    assert baseline.objectives["comfort"] == present(own).objective
    assert present(own).parameters == {f"P{i}": 0.5 for i in range(1, 12)}
    own_light = next(each.light for each in trust.verdicts if each.code in {"front_beats_baseline", "front_not_better"})
    assert (own_light == "amber") is (baseline.rank is not None)
    [first] = [each for each in listed if (each["iteration"], each["individual"]) == (0, 0)]
    assert (first["objectives"], first["on_front"]) == (baseline.objectives, baseline.rank is not None)


def test_rows_say_how_each_scenario_was_answered(ended: Ended) -> None:
    with Client(ended.api.url) as client:
        rows = client.front(ended.first)
        evaluations = list(client.rows(ended.first, "evaluations"))

    def place(values: Mapping[str, Any]) -> tuple[Any, ...]:
        return tuple(values[f"P{i}"] for i in range(1, 12))

    asked = {(place(each), each["scenario"]): each["outcome"] for each in reversed(evaluations)}
    for row in rows:
        assert row.answers == {name: asked[place(row.parameters), name] for name in row.scores}


def test_the_command_prints_the_front(ended: Ended, tmp_path: Path) -> None:
    shown = command("front", ended.first, "--url", ended.api.url)
    assert shown.exit_code == 0, shown.stderr
    assert f"best {JERK}" in shown.stdout
    with Client(ended.api.url) as client:
        baseline = client.front_summary(ended.first).baseline
    (line,) = (line for line in shown.stdout.splitlines() if line.strip().startswith("baseline:"))
    assert all(f"{name} {amount:.6g}" in line for name, amount in present(baseline).objectives.items())
    answer = json.loads(command("front", ended.first, "--url", ended.api.url, "--json").stdout)
    assert answer["summary"]["size"] == len(answer["items"])
    target = tmp_path / "front.parquet"
    done = command("export", ended.first, "--table", "front", "--format", "parquet", "-o", str(target), "--url", ended.api.url)
    assert done.exit_code == 0, done.stderr
    assert target.stat().st_size > 0
    pipe, received = tmp_path / "pipe", tmp_path / "received"
    os.mkfifo(pipe)
    with received.open("wb") as stream, subprocess.Popen(["cat", str(pipe)], stdout=stream) as reader:
        piped = command("export", ended.first, "--table", "front", "-o", str(pipe), "--url", ended.api.url)
        assert piped.exit_code == 0, piped.stderr
        assert reader.wait(60) == 0
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert received.stat().st_size > 0
    whole = command("export", ended.first, "--table", "front", "--json", "--url", ended.api.url)
    assert json.loads(whole.stdout) == rows_of(ended, ended.first, limit=1000)
    url = ("--format", "dcm", "--url", ended.api.url)
    one, first = (command("export", ended.first, *given, *url).stdout for given in ((), ("--table", "front")))
    assert "rank on the front: 1\n" in one
    assert one == first
    with Client(ended.api.url) as client:
        fronts = [row.parameters for row in client.front(ended.first)]
        assert [_set(client, f"{ended.first}#{rank}", None).parameters for rank in (1, len(fronts))] == [fronts[0], fronts[-1]]
