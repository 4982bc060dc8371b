"""Errors, repetitions, tokens, submissions and harmless answers of the client."""

import json
import math
import time
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.scripted import Answer, campaign, problem, server
from tests.support.values import faults_of

from drivecal.client import Client, transport
from drivecal.client.transport import harmless
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


def test_fields_and_remedies_come_back_as_they_were() -> None:
    with server(problem(422, errors=[{"field": "weights.S1", "message": "-1", "remedy": "give 1"}])) as (client, _):
        assert faults_of(client.submit, {}) == (Problem("weights.S1", "-1", "give 1"),)


@pytest.mark.parametrize(
    ("answer", "error", "said"),
    [
        (problem(404), NotFoundError, "'abc'"),
        (problem(404, "there is no set 'zz'; ask for another"), NotFoundError, "no set 'zz'; ask for another"),
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
    seconds: list[float] = []
    clock = SimpleNamespace(sleep=seconds.append, monotonic=time.monotonic)  # of this module alone: other threads sleep on
    monkeypatch.setattr(transport, "time", clock)
    return seconds


BUSY = (429, {"Retry-After": "7"}, problem(429, "the queue is full")[2])
AWAY = (503, {"Retry-After": "5"}, problem(503, "the database is away")[2])
BROKEN = (200, {"Transfer-Encoding": "chunked"}, b"zz")


def test_a_busy_server_is_asked_again_when_it_says_and_with_the_same_key(waits: list[float]) -> None:
    with server(BUSY, AWAY, campaign("queued")) as (client, script):
        assert client.submit({}).state == "queued"
    assert waits == [7.0, 5.0]
    assert len({headers["idempotency-key"] for _, _, headers, _ in script.requests}) == 1


def test_results_from_elsewhere_are_sent_again(waits: list[float]) -> None:
    with server(AWAY, (200, {}, b'{"stored": 1, "known": 0, "notes": []}')) as (client, _):
        assert client.import_results([{}], problem="p", source="bench", date="2026-11-20") == 1
    assert waits == [5.0]


def test_patience_has_an_end(waits: list[float]) -> None:
    with server(*[BUSY] * 6) as (client, _), pytest.raises(UnavailableError, match="the queue is full"):
        client.submit({})
    assert waits == [7.0] * 4


@pytest.mark.parametrize("header", ["", "soon", "-1", "1e9", "9" * 400, "Wed, 21 Oct 2026 07:28:00 GMT"])
def test_a_server_that_names_no_seconds_is_not_asked_again(header: str, waits: list[float]) -> None:
    _, headers, document = problem(503)
    with server((503, headers | {"Retry-After": header}, document)) as (client, _), pytest.raises(UnavailableError):
        client.workers()
    assert waits == []


def test_a_proxy_that_refuses_a_large_body_is_named() -> None:
    with server((413, {"Content-Type": "text/html"}, b"<html>")) as (client, _), pytest.raises(InvalidInputError) as caught:
        client.submit({})
    (refused,) = caught.value.problems
    assert "proxy" in refused.message
    assert "client_max_body_size" in refused.remedy


GAVE_UP: Answer = (504, {"Content-Type": "text/html"}, b"<html>")
OFF: Answer = (502, {"Content-Type": "text/html"}, b"<html>")


def test_a_proxy_that_gave_up_on_a_whole_table_is_not_asked_again(waits: list[float]) -> None:
    with server(GAVE_UP) as (client, script):
        with pytest.raises(UnavailableError, match="gave up after 0 s; raise its read timeout"):
            list(client.table("a" * 32, "evaluations", "csv"))
        assert len(script.requests) == 1
    assert waits == []


def test_a_proxy_is_asked_again_unless_it_gave_up_late(waits: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    with server(OFF, GAVE_UP, campaign("queued")) as (client, script):
        assert client.submit({}).state == "queued"
        assert waits == [1.0, 1.0]
        minutes = count(0.0, 60.0)
        monkeypatch.setattr(transport, "time", SimpleNamespace(sleep=waits.append, monotonic=lambda: next(minutes)))
        script.answers += [GAVE_UP] * 2
        with pytest.raises(UnavailableError, match="read timeout"):
            client.workers()
        assert len(script.answers) == 1


def test_a_lost_answer_is_asked_for_until_the_server_is_back(waits: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    refused = httpx.ConnectError("refused")
    with server(campaign("queued")) as (client, script):
        errors: list[httpx.TransportError] = [httpx.ReadError("reset"), *[refused] * 12]
        ask = httpx.Client.request

        def request(*arguments: Any, **options: Any) -> httpx.Response:
            if errors:
                raise errors.pop(0)
            return ask(*arguments, **options)

        monkeypatch.setattr(httpx.Client, "request", request)
        assert client.submit({}).state == "queued"
        assert len(script.requests) == 1
        errors += [*[refused] * 12]
        script.answers.append(campaign("running"))
        assert client.campaign("abc").state == "running", "it answered a moment ago"
        errors += [httpx.ReadError("reset"), *[refused] * 500]
        with pytest.raises(UnavailableError, match="drivecal list"):
            client.submit({})
    assert sum(waits) > 30


def test_a_network_that_is_gone_is_not_waited_for(waits: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    with server() as (client, _):
        errors: list[httpx.TransportError] = [httpx.ReadError("reset"), httpx.ConnectTimeout("timed out")]

        def request(*_: Any, **__: Any) -> httpx.Response:
            raise errors.pop(0)

        monkeypatch.setattr(httpx.Client, "request", request)
        with pytest.raises(UnavailableError):
            client.submit({})
    assert (errors, waits) == ([], [1.0])


@pytest.mark.parametrize("proxy", ["socks5://127.0.0.1:1", "socks://127.0.0.1:1"])
def test_a_proxy_that_cannot_be_used_is_named(proxy: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ALL_PROXY", proxy)
    Client("http://127.0.0.1:1").__exit__()
    with pytest.raises(InvalidInputError, check=lambda error: "ALL_PROXY" in error.problems[0].field):
        Client("http://drivecal.example:1")


def test_a_table_of_a_busy_server_is_asked_for_again(waits: list[float]) -> None:
    with server(BUSY, (200, {}, b"id\n1\n")) as (client, _):
        assert b"".join(client.table("c1", "evaluations", "csv")) == b"id\n1\n"
    assert waits == [7.0]


@pytest.mark.parametrize("token", ["secret\n", "se cret", "secr\xfct"])
def test_a_token_that_no_header_can_hold_is_refused_without_being_shown(token: str) -> None:
    with pytest.raises(InvalidInputError) as refused:
        Client("http://127.0.0.1:1", token)
    assert [problem.field for problem in refused.value.problems] == ["token"]
    assert "secr" not in str(refused.value)


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


def test_a_deletion_names_the_whole_id_so_that_it_can_be_asked_for_again() -> None:
    known = campaign("succeeded")
    with server(known, (204, {}, b"")) as (client, script):
        client.delete("abc")
        assert script.requests[1][1].endswith(json.loads(known[2])["id"])


@pytest.mark.parametrize("number", [math.nan, math.inf])
def test_numbers_that_json_does_not_have_are_refused(number: float) -> None:
    with server() as (client, _):
        assert [fault.field for fault in faults_of(client.expected_runs, {"weights": {"S1": number}})] == ["weights.S1"]


def test_an_id_cannot_leave_its_path() -> None:
    with server(problem(404, "there is nothing at /x; see /docs")) as (client, script), pytest.raises(NotFoundError):
        client.campaign("../workers?x=1")
    assert script.requests[0][1] == "/api/v1/campaigns/..%2Fworkers%3Fx%3D1"


@pytest.mark.usefixtures("waits")
def test_an_address_that_is_none_is_refused_without_its_password() -> None:
    for address in ("http://me:s3cret@[::1", "http://me:s3cret/@[::1"):
        with pytest.raises(UnavailableError) as refused:
            Client(address)
        assert "s3cret" not in str(refused.value)
    for status in (200, 401, 500, 502):
        answers = httpx.MockTransport(lambda _, status=status: httpx.Response(status, content=problem(status)[2]))
        with Client("http://me:s3cret@host", transport=answers) as client, pytest.raises(DrivecalError) as strange:
            client.workers()
        assert "s3cret" not in str(strange.value)


def test_rows_come_from_all_pages() -> None:
    pages = [json.dumps({"items": [{"id": 1}], "next_cursor": "x"}), json.dumps({"items": [{"id": 2}], "next_cursor": None})]
    with server(*((200, {}, page.encode()) for page in pages)) as (client, script):
        assert [row["id"] for row in client.rows("abc", "solutions", weights={"S1": 0.1 + 0.2})] == [1, 2]
    assert script.requests[1][1].endswith("limit=1000&weights=S1%3D0.30000000000000004&cursor=x")


def test_a_table_that_breaks_off_is_an_error() -> None:
    broken = (200, {"Transfer-Encoding": "chunked"}, b"5\r\nabcde\r\nzz")
    with server(broken) as (client, _), pytest.raises(UnavailableError):
        list(client.table("abc", "evaluations", "csv"))


@pytest.mark.parametrize("url", ["http://127.0.0.1:1", "http://nothing.invalid", "http://[", "http://127.0.0.1:99999"])
def test_an_address_where_nothing_answers_is_named_and_not_waited_for(url: str, waits: list[float]) -> None:
    for ask in (Client.workers, lambda client: client.submit({})):
        with pytest.raises(UnavailableError, match="drivecal serve"), Client(url) as client:
            ask(client)
        assert sum(waits) < 1
        waits.clear()


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


STEERING = ["\x1b]0;owned\x07", "\x9b31m", "\u202egnp.exe", "\u2066", "\x7f", "\r", "\x00", "\u200f"]


@pytest.mark.parametrize("text", STEERING)
@pytest.mark.parametrize("ascii_only", [True, False])
def test_what_steers_a_terminal_is_replaced_escaped_or_not(text: str, ascii_only: bool) -> None:
    content = json.dumps({"name": f"a{text}b"}, ensure_ascii=ascii_only).encode()
    shown = json.loads(harmless(content))["name"]
    assert shown != f"a{text}b" or text == "\r"
    assert not any(character in shown for character in "\x00\x1b\x07\x7f\x9b\u202e\u2066\u200f")


def test_a_refusal_of_the_server_is_harmless_too() -> None:
    with server(problem(409, "\x1b[2Jgone")) as (client, _), pytest.raises(ConflictError) as caught:
        client.submit({})
    assert str(caught.value) == "\ufffd[2Jgone"


@given(
    st.dictionaries(st.text(), st.text(st.characters(exclude_categories=["Cc", "Cf", "Cs"])) | st.just("back\\u001bslash\n"))
)
def test_every_other_text_stays_as_it_is(texts: dict[str, str]) -> None:
    plain = {f"k{number}": text for number, text in enumerate(texts.values())}
    for ascii_only in (True, False):
        assert json.loads(harmless(json.dumps(plain, ensure_ascii=ascii_only).encode())) == plain


@given(st.text())
def test_a_json_text_stays_one(text: str) -> None:
    assert isinstance(json.loads(harmless(json.dumps(text).encode())), str)


def test_a_page_in_the_place_of_a_file_or_rows_is_refused() -> None:
    page: Answer = (200, {"Content-Type": "text/html"}, b"<html>sign in")
    for asks in (
        lambda client: list(client.table("abc", "solutions", "csv")),
        lambda client: client.calibration_file("abc", "dcm"),
        lambda client: list(client.rows("abc", "solutions")),
    ):
        with server(page) as (client, _), pytest.raises(UnavailableError):
            asks(client)
