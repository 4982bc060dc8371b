import asyncio
import io
import json
import logging
import re
import sys
import threading
import warnings
from collections.abc import Iterator
from typing import Any

import pytest
import structlog
from tests.support.command import log_left_as_it_was

from drivecal.configuration import logs
from drivecal.configuration.settings import load_settings

log = logging.getLogger("drivecal.somewhere")


@pytest.fixture(autouse=True)
def _left_as_it_was() -> Iterator[None]:
    """`configure` changes the process, and so all other tests: the fixture restores it."""
    with log_left_as_it_was():
        yield


def configured(form: str = "json", level: str = "info") -> io.StringIO:
    stream = io.StringIO()
    logs.configure("dispatcher", load_settings(log_format=form, log_level=level), stream)
    return stream


def documents(stream: io.StringIO) -> list[dict[str, Any]]:
    return [json.loads(line) for line in stream.getvalue().splitlines()]


def test_every_line_says_when_how_bad_where_and_what() -> None:
    stream = configured()
    log.warning("%d workers are %s", 3, "lost", extra={"node": "here"})
    (line,) = documents(stream)
    assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", line.pop("time"))
    assert line == {"level": "warning", "process": "dispatcher", "message": "3 workers are lost", "node": "here"}


def test_lines_about_a_campaign_carry_its_id_and_no_others_do() -> None:
    stream = configured()
    with logs.about(campaign="c1", campaign_name="comfort", stage=None):
        log.info("starts")
        with logs.about(campaign="c2"):
            log.info("starts")
        log.info("ends")
    log.info("idle")
    result = documents(stream)
    assert [line.get("campaign") for line in result] == ["c1", "c2", "c1", None]
    assert result[0]["campaign_name"] == "comfort"
    assert "stage" not in result[0]


def test_requests_at_the_same_time_do_not_see_each_others_context() -> None:
    stream = configured()

    async def request(number: int) -> None:
        logs.begin(request=str(number))
        await asyncio.sleep(0)
        logs.note(token=f"token {number}")
        await asyncio.to_thread(log.info, "done %d", number)

    async def both() -> None:
        await asyncio.gather(request(1), request(2))

    asyncio.run(both())
    for line in documents(stream):
        number = line["message"][-1]
        assert (line["request"], line["token"]) == (number, f"token {number}")
    assert structlog.contextvars.get_contextvars() == {}


def test_an_exception_is_one_field_of_one_line() -> None:
    stream = configured()
    try:
        raise ValueError("two\nlines")
    except ValueError:
        log.exception("it failed")
    (line,) = documents(stream)
    assert line["message"] == "it failed"
    assert line["exception"].startswith("Traceback")
    assert "ValueError: two\nlines" in line["exception"]


def test_what_nobody_catches_is_logged() -> None:
    stream = configured()
    thread = threading.Thread(target=lambda: 1 / 0)
    thread.start()
    thread.join()
    error = RuntimeError("the end")
    sys.excepthook(RuntimeError, error, None)
    result = documents(stream)
    assert [line["level"] for line in result] == ["critical", "critical"]
    assert "ZeroDivisionError" in result[0]["exception"]
    assert "the end" in result[1]["exception"]


def test_libraries_and_warnings_go_the_same_way() -> None:
    stream = configured()
    logging.getLogger("alembic.runtime.migration").info("Context impl SQLiteImpl.")
    logging.getLogger("uvicorn.error").error("cannot listen")
    logging.getLogger("uvicorn.error").error("Exception in ASGI application\n")
    warnings.warn("old", FutureWarning, stacklevel=1)
    structlog.get_logger("plug-in").warning("hello", worker="w1")
    uvicorn, warned, plug_in = documents(stream)
    assert (uvicorn["message"], uvicorn["logger"]) == ("cannot listen", "uvicorn.error")
    assert (warned["logger"], "FutureWarning: old" in warned["message"]) == ("py.warnings", True)
    assert (plug_in["message"], plug_in["worker"], plug_in["level"]) == ("hello", "w1", "warning")


@pytest.mark.parametrize(("level", "shown"), [("debug", 4), ("info", 3), ("warning", 2), ("error", 1)])
def test_the_level_can_be_set(level: str, shown: int) -> None:
    stream = configured(level=level)
    for speak in (log.debug, log.info, log.warning, log.error):
        speak("words")
    assert len(documents(stream)) == shown


@pytest.mark.parametrize("form", ["json", "text"])
def test_no_secret_gets_into_a_line(form: str) -> None:
    stream = configured(form)
    log.info("connecting to postgresql://user:geheim@host/db", extra={"header": "Bearer geheim"})
    try:
        raise OSError("authorization: bearer geheim, ray://me:geheim:x@head:10001")
    except OSError:
        log.exception("refused")
    assert "geheim" not in stream.getvalue()
    assert "postgresql://user:***@host/db" in stream.getvalue()


def test_text_is_for_reading() -> None:
    stream = configured("text")
    with logs.about(campaign="c1", campaign_name="highway comfort"):
        log.info("starts")
    line = stream.getvalue()
    assert re.fullmatch(r"\S+Z info    dispatcher starts  campaign=c1 campaign_name='highway comfort'\n", line), line


def test_nobody_can_forge_a_line_by_a_name() -> None:
    stream = configured("text")
    with logs.about(campaign_name="x\n2026-01-01T00:00:00.000Z info    api        all is well"):
        log.warning("campaign %s fails", "\x1b[2Jy\r\n2026-01-01T00:00:00.000Z info    api        all is well")
    assert sum(line.startswith("20") for line in stream.getvalue().splitlines()) == 1
    assert "\x1b" not in stream.getvalue()
    assert "\r" not in stream.getvalue()
