"""The client against a server that answers what the test wants."""

from __future__ import annotations

import io
import json
import re
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pyarrow as pa
import pytest
from pyarrow import parquet

from drivecal.cli.views.traces import save
from drivecal.client import Client, DownloadedTable, following
from drivecal.contracts.campaign import Campaign, CampaignPage
from drivecal.contracts.evaluation import SeriesAnswer
from drivecal.contracts.specification import CampaignSpecification
from drivecal.domain.errors import (
    ConflictError,
    DrivecalError,
    InvalidInputError,
    NotAuthorisedError,
    NotFoundError,
    Problem,
    UnavailableError,
)

Answer = tuple[int, dict[str, str], bytes]
"""Status, headers, body."""


@dataclass
class Script:
    """The answers to give, one after the other, and the requests that came."""

    answers: list[Answer]
    requests: list[tuple[str, str, dict[str, str], bytes]] = field(default_factory=list)


@contextmanager
def server(*answers: Answer) -> Iterator[tuple[Client, Script]]:
    script = Script(list(answers))

    class Handler(BaseHTTPRequestHandler):
        def reply(self) -> None:
            body = self.rfile.read(int(self.headers.get("content-length", 0)))
            headers = {name.lower(): value for name, value in self.headers.items()}
            script.requests.append((self.command, self.path, headers, body))
            status, wanted, content = script.answers.pop(0)
            self.send_response(status)
            for name, value in wanted.items():
                self.send_header(name, value)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        do_GET = do_POST = reply  # noqa: N815  # the base class asks for these names

        def log_message(self, *_: Any) -> None:
            return None

    http = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        with Client(f"http://127.0.0.1:{http.server_port}/") as client:
            yield client, script
    finally:
        http.shutdown()
        thread.join()
        http.server_close()


def problem(status: int, detail: str = "it does not fit", errors: list[dict[str, str]] | None = None) -> Answer:
    document = {"type": "about:blank", "title": "x", "status": status, "detail": detail, "errors": errors or []}
    return status, {"Content-Type": "application/problem+json"}, json.dumps(document).encode()


def campaign(state: str, **headers: str) -> Answer:
    return 200, headers, Campaign(id="0" * 32, name="mine", state=state).model_dump_json().encode()


def test_fields_and_remedies_come_back_as_they_were() -> None:
    with server(problem(422, errors=[{"field": "weights.S1", "message": "-1", "remedy": "give 1"}])) as (client, _):
        with pytest.raises(InvalidInputError) as caught:
            client.submit({})
        assert caught.value.problems == (Problem("weights.S1", "-1", "give 1"),)


@pytest.mark.parametrize(
    ("answer", "error", "said"),
    [
        (problem(404), NotFoundError, "'abc'"),
        (problem(409), ConflictError, "it does not fit"),
        (problem(413), InvalidInputError, "it does not fit"),
        (problem(503, "the database is gone"), UnavailableError, "the database is gone"),
        (problem(500), DrivecalError, "failed: it does not fit"),
        ((404, {}, b"<html>"), UnavailableError, "404"),
        ((200, {}, b"<html>"), UnavailableError, "does not know"),
        ((200, {}, b'{"id": 5}'), UnavailableError, "does not know"),
        ((302, {"Location": "/login"}, b""), UnavailableError, "302"),
    ],
)
def test_every_other_answer_is_an_error_of_drivecal(answer: Answer, error: type[DrivecalError], said: str) -> None:
    with server(answer) as (client, _), pytest.raises(error) as caught:
        client.campaign("abc")
    assert said in str(caught.value)


def test_each_submission_has_a_key_of_its_own_unless_one_is_given() -> None:
    with server(campaign("queued"), campaign("queued"), campaign("queued")) as (client, script):
        client.submit({})
        client.submit({})
        client.submit({}, key="mine")
    keys = [headers["idempotency-key"] for _, _, headers, _ in script.requests]
    assert len(set(keys)) == 3
    assert keys[2] == "mine"


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    found: list[float] = []
    monkeypatch.setattr(time, "sleep", found.append)
    return found


BUSY = (429, {"Retry-After": "7"}, problem(429, "the queue is full")[2])
AWAY = (503, {"Retry-After": "5"}, problem(503, "the database is away")[2])
BROKEN = (200, {"Transfer-Encoding": "chunked"}, b"zz")


def test_a_busy_server_is_asked_again_when_it_says_and_with_the_same_key(waits: list[float]) -> None:
    with server(BUSY, AWAY, campaign("queued")) as (client, script):
        assert client.submit({}).state == "queued"
    assert waits == [7.0, 5.0]
    assert len({headers["idempotency-key"] for _, _, headers, _ in script.requests}) == 1


def test_patience_has_an_end(waits: list[float]) -> None:
    with server(*[BUSY] * 6) as (client, _), pytest.raises(UnavailableError, match="the queue is full"):
        client.submit({})
    assert waits == [7.0] * 4


@pytest.mark.parametrize("header", ["", "soon", "-1", "1e9", "9" * 400, "Wed, 21 Oct 2026 07:28:00 GMT"])
def test_a_server_that_names_no_seconds_is_not_asked_again(header: str, waits: list[float]) -> None:
    with server((503, {"Retry-After": header}, problem(503)[2])) as (client, _), pytest.raises(UnavailableError):
        client.workers()
    assert waits == []


def test_an_answer_that_breaks_off_is_asked_for_again(waits: list[float]) -> None:
    with server(BROKEN, campaign("queued")) as (client, script):
        client.submit({})
    assert waits == [1.0]
    assert len(script.requests) == 2
    with server(*[BROKEN] * 3) as (client, script), pytest.raises(UnavailableError):
        client.workers()
    assert len(script.requests) == 3


def test_what_would_be_done_twice_is_not_asked_for_again(waits: list[float]) -> None:
    for answer in (AWAY, BUSY, BROKEN):
        with server(answer) as (client, script), pytest.raises(UnavailableError):
            client.post_influence_map({"scenarios": {"S1": {}}})
        assert len(script.requests) == 1
    assert waits == []


def test_a_token_is_shown_with_every_call_and_never_told() -> None:
    with server(problem(401), problem(401), problem(403, "the token of x may only read")) as (anonymous, script):
        with pytest.raises(NotAuthorisedError, match="DRIVECAL_TOKEN"):
            anonymous.workers()
        with Client(anonymous.url, token="secret-0123456789") as client:
            with pytest.raises(NotAuthorisedError) as caught:
                client.workers()
            assert "secret" not in str(caught.value) + repr(vars(client))
            with pytest.raises(NotAuthorisedError, match="may only read"):
                client.workers()
    assert [headers.get("authorization") for _, _, headers, _ in script.requests] == [None, *["Bearer secret-0123456789"] * 2]


def test_an_id_cannot_leave_its_path() -> None:
    with server(problem(404)) as (client, script), pytest.raises(NotFoundError):
        client.campaign("../workers?x=1")
    assert script.requests[0][1] == "/api/v1/campaigns/..%2Fworkers%3Fx%3D1"


def stream(*events: tuple[str, str, dict[str, Any]], broken: bool = False) -> Answer:
    """An event stream that ends, or breaks off; each event is (id, kind, document)."""
    lines = [
        f"event: {kind}\n" + (f"id: {number}\n" if number else "") + f"data: {json.dumps(document)}\n\n"
        for number, kind, document in events
    ]
    body = "".join(lines).encode()
    if broken:
        return 200, {"Transfer-Encoding": "chunked"}, f"{len(body):x}\r\n".encode() + body + b"\r\nzz"
    return 200, {"Content-Type": "text/event-stream"}, body


def event(number: str, kind: str, **data: Any) -> tuple[str, str, dict[str, Any]]:
    return number, kind, {"kind": kind, "campaign": "0" * 32, "at": "2026-01-01T00:00:00Z", "data": data}


def test_watching_resumes_its_stream_where_it_broke_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "sleep", lambda _: None)
    progress = ("", "progress", {"state": "running", "cells": {"requested": 5}})
    answers = [
        campaign("queued", ETag='"a"'),
        stream(event("7", "queued"), event("9", "running"), progress, broken=True),
        (304, {"ETag": '"a"'}, b""),
        stream(event("", "degraded", reason="x"), event("12", "succeeded"), ("", "progress", {"state": "succeeded"})),
        campaign("succeeded", ETag='"b"'),
    ]
    told: list[tuple[int | None, str]] = []
    with server(*answers) as (client, script):
        seen = [
            (one.state, one.cells.requested) for one in client.watch("0" * 32, told=lambda one: told.append((one.id, one.kind)))
        ]
    assert seen == [("queued", 0), ("running", 5), ("succeeded", 0), ("succeeded", 0)]
    assert told == [(7, "queued"), (9, "running"), (None, "degraded"), (12, "succeeded")]
    streams = [headers.get("last-event-id") for _, path, headers, _ in script.requests if path.endswith("/events")]
    assert streams == [None, "9"]


@pytest.mark.parametrize("refusal", [problem(429), problem(404), (404, {}, b"<html>"), problem(405)])
def test_watching_asks_only_for_what_is_new_where_there_is_no_stream(monkeypatch: pytest.MonkeyPatch, refusal: Answer) -> None:
    monkeypatch.setattr(time, "sleep", lambda _: None)
    unchanged: Answer = (304, {"ETag": '"a"', "Retry-After": "1"}, b"")
    retried = [unchanged, refusal] if refusal[2].startswith(b"<") else []  # that may be a proxy, in between
    answers = [campaign("queued", ETag='"a"', **{"Retry-After": "1"}), refusal, *retried, unchanged, problem(503)]
    with server(*answers, campaign("succeeded", ETag='"b"')) as (client, script):
        assert [one.state for one in client.watch("0" * 32)] == ["queued", "succeeded"]
    asked = [headers.get("if-none-match") for _, path, headers, _ in script.requests if not path.endswith("/events")]
    assert asked == [None, *['"a"'] * (len(asked) - 1)]


def test_watching_gives_up_on_a_server_that_stays_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "sleep", lambda _: None)
    monkeypatch.setattr(following, "SILENCE_SECONDS", 0.0)
    answers = [campaign("running", ETag='"a"'), problem(503), problem(503), problem(503)]
    with server(*answers) as (client, _), pytest.raises(UnavailableError):
        list(client.watch("0" * 32))


@pytest.mark.parametrize("content", ["no JSON", "[]", '{"kind": 5}', "{}"])
def test_a_stream_of_another_version_is_no_stream(monkeypatch: pytest.MonkeyPatch, content: str) -> None:
    monkeypatch.setattr(time, "sleep", lambda _: None)
    strange: Answer = (200, {"Content-Type": "text/event-stream"}, f"event: best\nid: 1\ndata: {content}\n\n".encode())
    with server(strange) as (client, _), pytest.raises(UnavailableError):
        list(client.events("0" * 32))


def test_watching_a_server_that_never_answered_gives_up_at_once() -> None:
    with server(problem(503)) as (client, _), pytest.raises(UnavailableError):
        next(client.watch("0" * 32))


def test_watching_ends_at_its_deadline() -> None:
    with server(campaign("running", ETag='"a"')) as (client, _), pytest.raises(TimeoutError):
        list(client.watch("0" * 32, deadline=0.0))


def test_rows_come_from_all_pages() -> None:
    pages = [json.dumps({"items": [{"id": 1}], "next_cursor": "x"}), json.dumps({"items": [{"id": 2}], "next_cursor": None})]
    with server(*((200, {}, page.encode()) for page in pages)) as (client, script):
        assert [row["id"] for row in client.rows("abc", "evaluations")] == [1, 2]
    assert script.requests[1][1].endswith("limit=1000&cursor=x")


def test_a_table_that_breaks_off_is_an_error() -> None:
    broken = (200, {"Transfer-Encoding": "chunked"}, b"5\r\nabcde\r\nzz")
    with server(broken) as (client, _), pytest.raises(UnavailableError):
        list(client.table("abc", "evaluations", "csv"))


@pytest.mark.parametrize("url", ["http://127.0.0.1:1", "http://nothing.invalid", "http://[", "http://127.0.0.1:99999"])
def test_an_address_where_nothing_answers_is_named(url: str) -> None:
    with pytest.raises(UnavailableError, match="drivecal serve"), Client(url) as client:
        client.workers()


def test_the_server_and_the_token_come_from_the_settings(monkeypatch: pytest.MonkeyPatch) -> None:
    with server(campaign("queued")) as (given, script):
        monkeypatch.setenv("DRIVECAL_URL", given.url)
        monkeypatch.setenv("DRIVECAL_TOKEN", "secret-0123456789")
        with Client() as client:
            client.campaign("c1")
    assert script.requests[0][2]["authorization"] == "Bearer secret-0123456789"


def test_a_specification_may_be_plain_data_a_model_or_a_file(tmp_path: Path) -> None:
    specification = CampaignSpecification(name="mine", weights={"S1": 2})
    file = tmp_path / "campaign.yaml"
    file.write_text("name: mine\nweights: {S1: 2}\n")
    document = {"name": "mine", "weights": {"S1": 2}}
    with server(*[campaign("queued")] * 4) as (client, script):
        for form in (document, specification, file, str(file)):
            client.submit(form)
    assert [json.loads(body) for *_, body in script.requests] == [document] * 4


def test_waiting_returns_the_ended_campaign() -> None:
    with server(campaign("succeeded")) as (client, _):
        assert client.wait("c1", timeout=10).state == "succeeded"


@pytest.fixture
def downloaded() -> tuple[DownloadedTable, str]:
    """A table of which no cell of the second row has a value, and the path of its request."""
    content = io.BytesIO()
    columns = {"id": pa.array([7, None], pa.int64()), "agrees": pa.array([True, None]), "rating": pa.array([6.5, None])}
    parquet.write_table(pa.table(columns), content)
    with server((200, {}, content.getvalue())) as (client, script):
        table = client.evaluations("c1", scenario="S1")
    return table, script.requests[0][1]


def test_a_table_comes_whole_and_filtered(downloaded: tuple[DownloadedTable, str]) -> None:
    table, path = downloaded
    assert path == "/api/v1/campaigns/c1/evaluations?scenario=S1&format=parquet"
    assert table.to_arrow().to_pylist() == [{"id": 7, "agrees": True, "rating": 6.5}, dict.fromkeys(("id", "agrees", "rating"))]


def test_frames_of_pandas_keep_the_types_of_columns_with_missing_values(downloaded: tuple[DownloadedTable, str]) -> None:
    pytest.importorskip("pandas")
    frame = downloaded[0].to_pandas()
    assert frame.dtypes.map(str).to_dict() == {"id": "Int64", "agrees": "boolean", "rating": "float64"}
    assert frame["id"][0] == 7


def test_polars_reads_the_downloaded_file(downloaded: tuple[DownloadedTable, str], monkeypatch: pytest.MonkeyPatch) -> None:
    read = SimpleNamespace(read_parquet=lambda file: parquet.read_table(file).num_rows)
    monkeypatch.setitem(sys.modules, "polars", read)
    assert downloaded[0].to_polars() == 2


def test_a_missing_package_is_named(downloaded: tuple[DownloadedTable, str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "polars", None)
    with pytest.raises(ImportError, match="polars"):
        downloaded[0].to_polars()


def test_the_python_of_the_readme_runs(monkeypatch: pytest.MonkeyPatch, downloaded: tuple[DownloadedTable, str]) -> None:
    text = (Path(__file__).parents[3] / "README.md").read_text()
    (source,) = re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    middle = dict(
        zip([f"P{number}" for number in range(1, 12)], [-0.5, 1, 100, 1000, 750, 0.5, 100, 1000, 5, 10, 100], strict=True)
    )
    best = SimpleNamespace(items=[SimpleNamespace(parameters=middle)])
    monkeypatch.chdir(Path(__file__).parents[3])
    monkeypatch.setattr(Client, "solutions", lambda *_, **__: best)
    pytest.importorskip("pandas")
    with server(campaign("queued"), campaign("succeeded"), (200, {}, downloaded[0].content)) as (given, script):
        monkeypatch.setenv("DRIVECAL_URL", given.url)
        names: dict[str, Any] = {}
        exec(source, names)  # the documentation's own code
    assert len(names["evaluations"]) == 2
    assert names["result"].scores["S1"] is not None
    assert not script.answers


def test_time_series_of_a_bundle_are_those_of_its_simulator() -> None:
    body = {"measures": {"cost": 2.0, "gap": None}, "failure": "collision", "series": {"v": [1.0, 2.0], "gap": [3.0]}}
    with server((200, {"Content-Type": "application/json"}, json.dumps(body).encode())) as (client, _):
        trace = client.trace("7")
    assert isinstance(trace, SeriesAnswer)
    assert (trace.failure, trace.measures, trace.series["v"]) == ("collision", {"cost": 2.0, "gap": None}, [1.0, 2.0])


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".json"])
def test_series_of_different_lengths_are_saved(tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"series{suffix}"
    save(SeriesAnswer(measures={}, failure=None, series={"v": [1.0, 2.0], "gap": [3.0]}), file)
    if suffix == ".csv":
        assert file.read_text().splitlines() == ["v,gap", "1.0,3.0", "2.0,"]
    elif suffix == ".parquet":
        assert parquet.read_table(file).to_pydict() == {"v": [1.0, 2.0], "gap": [3.0, None]}
    else:
        assert json.loads(file.read_text())["series"] == {"v": [1.0, 2.0], "gap": [3.0]}


FULL = "5050a77ddf5e42199c25aff35a3b4568"
OTHER = "5050b77ddf5e42199c25aff35a3b4568"


def listed(*identifiers: str, following: str | None = None, **fields: str) -> Answer:
    items = [{"id": identifier, "name": "one", "state": "succeeded"} | fields for identifier in identifiers]
    return 200, {"Content-Type": "application/json"}, json.dumps({"items": items, "next_cursor": following}).encode()


def test_the_first_characters_of_an_id_are_enough_and_looked_up_once() -> None:
    with server(listed(FULL, OTHER), campaign("running"), listed(), listed()) as (client, script):
        client.campaign("5050a")
        client.solutions("5050a", weights={"S1": 2, "S2": 0.5})
        list(client.rows("5050a", "evaluations"))
    paths = [path for _, path, _, _ in script.requests]
    assert paths[0].startswith("/api/v1/campaigns?")
    assert paths[1:] == [
        f"/api/v1/campaigns/{FULL}",
        f"/api/v1/campaigns/{FULL}/solutions?weights=S1%3D2%2CS2%3D0.5",
        f"/api/v1/campaigns/{FULL}/evaluations?limit=1000",
    ]


def test_an_ambiguous_beginning_of_an_id_is_refused() -> None:
    with server(listed(FULL, OTHER)) as (client, _), pytest.raises(NotFoundError):
        client.campaign("5050")


def test_an_id_is_looked_up_among_all_campaigns() -> None:
    """An abbreviation of an old campaign must not hit a newer one."""
    with server(listed(OTHER, following="more"), listed(FULL)) as (client, _), pytest.raises(NotFoundError):
        client.act("5050", "cancel")
    with server(listed(OTHER, following="more"), listed(FULL), campaign("running")) as (client, script):
        client.campaign("5050a")
    assert script.requests[-1][1] == f"/api/v1/campaigns/{FULL}"


def test_ids_in_a_submitted_campaign_may_be_abbreviated() -> None:
    with server(listed(OTHER, source="expert", driving_function="frenet"), listed(FULL), campaign("queued")) as (
        client,
        script,
    ):
        client.submit({"robustness": {"of": "5050a"}, "sensitivity": {"map": "5050b"}, "optimizer": None})
    sent = json.loads(script.requests[-1][3])
    assert sent == {"robustness": {"of": FULL}, "sensitivity": {"map": OTHER}, "optimizer": None}


def test_answers_show_themselves_as_tables_in_notebooks(
    downloaded: tuple[DownloadedTable, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    shown = Campaign.model_validate({"id": FULL, "name": "<one>", "state": "running", "best": None})._repr_html_()
    assert "&lt;one&gt;" in shown
    assert FULL in shown
    page = CampaignPage.model_validate({"items": [{"id": FULL, "name": "one", "state": "running"}] * 30})
    assert page._repr_html_().count("<tr>") == 21
    assert "10 more rows" in page._repr_html_()
    assert "<table>" in str(downloaded[0]._repr_html_())
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    assert downloaded[0]._repr_html_() is None
