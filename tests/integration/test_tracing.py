"""Traces reach an OTLP receiver: requests, campaigns, batches and runs, under the id of their campaign."""

import logging
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

import pytest
from tests.support.scripted import Answer, Request, listening
from tests.support.serve import serving

from drivecal.client import Client
from drivecal.cluster import tracing


def test_without_opentelemetry_the_log_says_so(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setitem(sys.modules, "opentelemetry.sdk.resources", None)
    with caplog.at_level(logging.WARNING):
        tracing.configure("api")
        assert not caplog.records, "no receiver is named"
        monkeypatch.setenv("OTEL_EXPORTER_OTLP_ENDPOINT", "http://127.0.0.1:1")
        tracing.configure("api")
    assert "opentelemetry-sdk" in caplog.text
    assert (tracing.root("0" * 32), tracing.child(None)) == (None, None)


@contextmanager
def receiver() -> Iterator[tuple[str, list[bytes]]]:
    """An OTLP receiver over HTTP: its address, and what was posted to it."""
    received: list[bytes] = []

    def answer(request: Request) -> Answer:
        assert request[1] == "/v1/traces"
        received.append(request[-1])
        return 200, {}, b""

    with listening(answer) as address:
        yield address, received


@pytest.mark.packages
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("backend", ["processes", "ray"])
def test_spans_have_their_campaigns_id(backend: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    packages = tmp_path / "packages"
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", "--target", packages, *tracing.PACKAGES], check=True)
    monkeypatch.syspath_prepend(str(packages))
    with receiver() as (address, received):
        settings = {"OTEL_EXPORTER_OTLP_ENDPOINT": address, "OTEL_BSP_SCHEDULE_DELAY": "100", "PYTHONPATH": str(packages)}
        with serving(tmp_path, 2, 0, DRIVECAL_BACKEND=backend, **settings) as server, Client(server.url) as client:
            small = {"kind": "random", "population": 10, "iterations": 1}
            campaign = client.wait(client.submit({"catalogue": ["S3"], "optimizer": small}).id)
    by_name = spans(received)
    assert set(by_name) == {"request", "campaign", "batch", "run"}
    [whole] = by_name["campaign"]
    assert whole["trace"] == campaign.id
    assert whole["drivecal.state"] == "succeeded"
    batches = {batch["span"]: batch for batch in by_name["batch"]}
    assert {batch["parent"] for batch in batches.values()} == {whole["span"]}
    assert len(by_name["run"]) == campaign.cells.runs
    for run in by_name["run"]:
        assert {run[name] for name in ("trace", "drivecal.campaign")} == {campaign.id}
        assert run["drivecal.scenario"] == "S3"
        assert batches[run["parent"]]["drivecal.worker"] == run["drivecal.worker"]
    assert any(request.get("drivecal.campaign") == campaign.id for request in by_name["request"])


def spans(received: list[bytes]) -> dict[str, list[dict[str, str]]]:
    """Spans by name: their ids, the id of the span above, and attributes."""
    messages = import_module("opentelemetry.proto.collector.trace.v1.trace_service_pb2")  # installed a moment ago
    by_name: dict[str, list[dict[str, str]]] = {}
    for body in received:
        for resource in messages.ExportTraceServiceRequest.FromString(body).resource_spans:
            for span in [span for scope in resource.scope_spans for span in scope.spans]:
                ids = {"trace": span.trace_id.hex(), "span": span.span_id.hex(), "parent": span.parent_span_id.hex()}
                own = {attribute.key: attribute.value.string_value for attribute in span.attributes}
                by_name.setdefault(span.name, []).append(ids | own)
    return by_name
