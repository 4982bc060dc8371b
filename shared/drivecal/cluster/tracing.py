"""Traces in the format of OpenTelemetry, if `OTEL_EXPORTER_OTLP_ENDPOINT` is set: requests, campaigns, batches and runs.

A campaign's id is the id of its trace, and begins with the id of its first span: every process knows both, whatever ends and starts again.
Contexts are texts of W3C's `traceparent`; without the variable there are none, and nothing is imported.
"""

import atexit
import logging
import os
import re
import secrets
import time
from importlib import import_module
from typing import Any

ENDPOINTS = "OTEL_EXPORTER_OTLP_ENDPOINT", "OTEL_EXPORTER_OTLP_TRACES_ENDPOINT"
PACKAGES = "opentelemetry-sdk", "opentelemetry-exporter-otlp-proto-http"
_CONTEXT = re.compile(r"00-(?P<trace>[0-9a-f]{32})-(?P<span>[0-9a-f]{16})-[0-9a-f]{2}")

log = logging.getLogger(__name__)
_recorders: list["_Recorder"] = []
"""The recorder of this process, if it has one."""


def configure(process: str) -> None:
    """Begins to record in this process: `api`, `dispatcher` or `worker`. Without OpenTelemetry it logs a warning instead."""
    off = os.environ.get("OTEL_SDK_DISABLED", "").lower() == "true" or os.environ.get("OTEL_TRACES_EXPORTER") == "none"
    if _recorders or off or not any(map(os.environ.get, ENDPOINTS)):
        return
    try:
        _recorders.append(_Recorder(process))
    except ImportError as error:
        log.warning("%s is set, but no traces are sent: %s; pip install %s", ENDPOINTS[0], error, " ".join(PACKAGES))


def root(campaign: str) -> str | None:
    """Returns the context of a campaign, None if nothing is recorded."""
    return f"00-{campaign}-{campaign[:16]}-01" if _recorders else None


def child(parent: str | None) -> str | None:
    """Returns a new context below another one, or in a trace of its own if that is none; None if nothing is recorded."""
    known = _CONTEXT.fullmatch(parent or "")
    trace = secrets.token_hex(16) if known is None else known["trace"]
    return f"00-{trace}-{secrets.token_hex(8)}-01" if _recorders else None


def campaign_of(context: str | None) -> str:
    """Returns the campaign whose trace a context is in."""
    known = _CONTEXT.fullmatch(context or "")
    return "" if known is None else known["trace"]


def record(name: str, context: str | None, begin: int, parent: str | None = None, **attributes: str | int | None) -> None:
    """Records a span that ends now.

    Args:
        name: `request`, `campaign`, `batch` or `run`.
        context: Its own context; without one, nothing is recorded.
        begin: Its begin, ns since 1970.
        parent: The context above it.
        attributes: Further values, which get the prefix `drivecal.`; None is left out.
    """
    if _recorders and context is not None:
        given = {f"drivecal.{key}": value for key, value in attributes.items() if value is not None}
        _recorders[0].record(name, context, parent, begin, given)


class _Recorder:
    """Sends spans to the receiver from a thread of its own. Raises ImportError: the packages are the user's, and no dependency."""

    def __init__(self, process: str) -> None:
        named = {} if "OTEL_SERVICE_NAME" in os.environ else {"service.name": "drivecal"}
        resources, self._sdk, export = (
            import_module(f"opentelemetry.sdk.{part}") for part in ("resources", "trace", "trace.export")
        )
        self._trace = import_module("opentelemetry.trace")
        exporter = import_module("opentelemetry.exporter.otlp.proto.http.trace_exporter").OTLPSpanExporter()
        self._resource = resources.Resource.create({"drivecal.process": process} | named)
        self._processor = export.BatchSpanProcessor(exporter)
        atexit.register(self._processor.shutdown)

    def record(self, name: str, context: str, parent: str | None, begin: int, attributes: dict[str, str | int]) -> None:
        ids, above = self._context(context), self._context(parent)
        span = self._sdk.ReadableSpan(name, ids, above, self._resource, attributes, start_time=begin, end_time=time.time_ns())
        self._processor.on_end(span)

    def _context(self, text: str | None) -> Any:
        known = _CONTEXT.fullmatch(text or "")
        ids = None if known is None else (int(known["trace"], 16), int(known["span"], 16))
        return None if ids is None else self._trace.SpanContext(*ids, is_remote=False, trace_flags=self._trace.TraceFlags(1))
