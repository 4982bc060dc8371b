"""The log of the server's processes: one line per record on standard error, as text to read or as JSON (`DRIVECAL_LOG_FORMAT`).

Modules log by the standard library (`logging.getLogger(__name__)`), as their libraries do; everything goes through the one handler that
`configure` installs. Each line has its time (UTC), level, process and message, and what is known of its context:

    with logs.about(campaign=campaign.id, campaign_name=campaign.name, stage=campaign.stage):
        log.info("starts")                      # ... info dispatcher starts  campaign=9f... campaign_name='highway comfort' stage=...
    logs.note(token="ci")                       # until the end of the request, of all lines that follow in it

Context follows `contextvars`: into threads and tasks that are started inside, and never into another request. An exception is one field.
Passwords in URLs and bearer tokens are masked, control characters escaped, so that no user's text can forge a line.
"""

import logging
import os
import re
import sys
import threading
from collections.abc import Mapping, MutableMapping
from contextlib import AbstractContextManager
from datetime import UTC, datetime
from functools import partial
from types import TracebackType
from typing import Any, Literal, TextIO

import structlog
from structlog.stdlib import ExtraAdder, ProcessorFormatter

from drivecal.configuration.settings import Settings

Process = Literal["api", "dispatcher", "server"]
Value = str | int | float | None
_Line = MutableMapping[str, Any]

_ALWAYS = ("time", "level", "process", "message")
_OURS = ("drivecal", "__main__")
_INTERNAL = ("event", "_record", "_from_structlog", "_ray_timestamp_ns")
_SECRETS = ((re.compile(r"(\w://[^\s:/@]*):[^\s@]+@"), r"\1:***@"), (re.compile(r"(?i)\b(bearer\s+)[\w.~+/=-]+"), r"\1***"))
_CONTROLS = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")
_COLOURS = {"warning": "\x1b[33m", "error": "\x1b[31m", "critical": "\x1b[31m"}
_PLAIN = "\x1b[0m"
_TOLD_BETTER = "Exception in ASGI application"
"""Uvicorn's message of an error that the API has logged with the same traceback."""

_log = logging.getLogger("drivecal")


def configure(process: Process, settings: Settings, stream: TextIO | None = None) -> None:
    """Sends everything that this process logs to `stream` (standard error), Python's warnings and uncaught exceptions included.

    drivecal's own records are shown at `settings.log_level` and above, records of libraries at `warning` and above, or `info` while
    debugging.
    """
    target = stream or sys.stderr
    handler = logging.StreamHandler(target)
    colours = _COLOURS if target.isatty() and "NO_COLOR" not in os.environ else {}
    text, document = partial(_text, colours), structlog.processors.JSONRenderer(default=str)
    render: structlog.typing.Processor = document if settings.log_format == "json" else text
    shared: list[structlog.typing.Processor] = [structlog.contextvars.merge_contextvars, ExtraAdder()]
    formatting: list[structlog.typing.Processor] = [
        partial(_finish, process),
        structlog.processors.format_exc_info,
        _mask,
        render,
    ]
    handler.setFormatter(ProcessorFormatter(processors=formatting, foreign_pre_chain=shared))
    handler.addFilter(lambda record: not str(record.msg).startswith(_TOLD_BETTER))
    level = logging.getLevelNamesMapping()[settings.log_level.upper()]
    root = logging.getLogger()
    root.handlers = [handler]
    root.setLevel(max(level, logging.WARNING) if level > logging.DEBUG else logging.INFO)
    for ours in _OURS:
        logging.getLogger(ours).setLevel(level)
    structlog.configure(  # for plug-ins that use structlog themselves: it would write to standard output
        processors=[shared[0], structlog.stdlib.add_log_level, ProcessorFormatter.wrap_for_formatter],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
    )
    logging.captureWarnings(capture=True)
    sys.excepthook = _uncaught
    threading.excepthook = lambda args: _uncaught(args.exc_type, args.exc_value, args.exc_traceback)


def about(**known: Value) -> AbstractContextManager[None]:
    """Adds fields to everything that is logged inside the block: `campaign` (its id), `campaign_name`, `stage`, `iteration`, `worker`.

    Fields that are None are left out.
    """
    return structlog.contextvars.bound_contextvars(**{name: value for name, value in known.items() if value is not None})


def note(**known: Value) -> None:
    """Adds fields, like `about`, until the end of the request."""
    structlog.contextvars.bind_contextvars(**{name: value for name, value in known.items() if value is not None})


def begin(**known: Value) -> None:
    """Begins a request: forgets the fields of the previous one."""
    structlog.contextvars.clear_contextvars()
    note(**known)


def _finish(process: Process, _logger: object, _method: str, line: _Line) -> _Line:
    """Orders the fields of a line: common fields first, the rest by name."""
    record: logging.LogRecord = line["_record"]
    moment = datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    always = {"time": moment, "level": record.levelname.lower(), "process": process, "message": str(line["event"])}
    rest = {name: line[name] for name in sorted(line) if name not in {*_ALWAYS, *_INTERNAL}}
    if record.name.partition(".")[0] not in _OURS:
        rest["logger"] = record.name
    return always | rest


def _mask(_logger: object, _method: str, line: _Line) -> _Line:
    for name, value in line.items():
        if isinstance(value, str):
            for pattern, shown in _SECRETS:
                value = pattern.sub(shown, value)
            line[name] = value
    return line


def _text(colours: Mapping[str, str], _logger: object, _method: str, line: _Line) -> str:
    """Returns `time level process message  name=value ...`, with an exception on indented lines behind it."""
    moment, level, process, message = (str(line.pop(name)) for name in _ALWAYS)
    exception = line.pop("exception", "")
    colour, plain = (colours[level], _PLAIN) if level in colours else ("", "")
    words = "\n    ".join(_escaped(part) for part in message.splitlines())
    known = "".join(f" {name}={_value(value)}" for name, value in line.items())
    text = f"{moment} {colour}{level:<7}{plain} {process:<10} {words}{known and ' '}{known}"
    return text + "".join(f"\n    {_escaped(part)}" for part in exception.splitlines())


def _value(value: object) -> str:
    text = str(value)
    return text if re.fullmatch(r"[\w.:/+-]+", text) else repr(text)


def _escaped(text: str) -> str:
    return _CONTROLS.sub(lambda match: match.group().encode("unicode_escape").decode(), text)


def _uncaught(kind: type[BaseException], error: BaseException | None, traceback: TracebackType | None) -> None:
    if error is None or issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error or kind(), traceback)
        return
    _log.critical("uncaught %s: the process or one of its threads ends", kind.__name__, exc_info=(kind, error, traceback))
