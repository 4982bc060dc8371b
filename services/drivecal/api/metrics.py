"""Metrics for Prometheus at `/metrics`: requests to this process, the database, and the dispatcher through its heartbeat.

If the database does not answer, its metrics are left out and `drivecal_database_up` is 0. Counters from the database continue with a new
process. Counters of the dispatcher's and the API's own memory begin at 0 with their process, as Prometheus expects.
"""

from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, Metric, ProcessCollector, disable_created_metrics
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily
from prometheus_client.registry import Collector
from sqlalchemy.exc import SQLAlchemyError

from drivecal.api.live.dispatcher_health import judge, silent_seconds
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import DrivecalError
from drivecal.domain.evaluations import Outcome
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.maintenance import statistics
from drivecal.storage.maintenance.statistics import Statistics
from drivecal.storage.processes import StoredProcess

WORKER_STATES = ("starting", "idle", "busy")


class Meters:
    """Metrics of an API, with a registry of its own, so that several may live in one process."""

    def __init__(self, database: Database) -> None:
        disable_created_metrics()  # type: ignore[no-untyped-call]  # a second, unused series for each
        self.registry = CollectorRegistry()
        self.requests = Counter(
            "drivecal_http_requests",
            "Answered requests; route is the template, or none if nothing is or the request was refused before",
            ["route", "method", "status"],
            registry=self.registry,
        )
        self.request_seconds = Histogram(
            "drivecal_http_request_seconds",
            "Duration of requests from their head to the end of the answer, event streams excepted",
            ["route", "method"],
            registry=self.registry,
        )
        self.event_streams = Gauge("drivecal_http_event_streams", "Open event streams", registry=self.registry)
        ProcessCollector(registry=self.registry)
        self.registry.register(ServiceCollector(database))


class ServiceCollector(Collector):
    """Metrics that are read at the moment of the scrape, in one short transaction."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def collect(self) -> Iterator[Any]:
        """Yields the metrics; see the table in `docs/pages/reference/metrics.md`."""
        yield InfoMetricFamily("drivecal_build", "The version of drivecal", {"version": version("drivecal")})
        try:
            totals = self._database.query(statistics.read)
        except (DrivecalError, SQLAlchemyError):
            yield GaugeMetricFamily("drivecal_database_up", _UP, 0)
            yield GaugeMetricFamily("drivecal_ready", _READY, 0)
            return
        yield GaugeMetricFamily("drivecal_database_up", _UP, 1)
        yield from _of_database(totals)
        yield from _of_dispatcher(totals.dispatcher)


_READY = "1 where campaigns are carried out, as /readyz says"
_UP = "1 if the database answers; else 0, and other metrics read from it are left out"


def _of_database(totals: Statistics) -> Iterator[Any]:
    campaigns = GaugeMetricFamily("drivecal_campaigns", "Campaigns and single evaluations by state", labels=["kind", "state"])
    for kind in ("calibration", "evaluation"):
        for state in CampaignState:
            campaigns.add_metric([kind, state.value], totals.campaigns[kind, state])
    yield campaigns
    cells = CounterMetricFamily("drivecal_cells", "Answered cells of all campaigns", labels=["stage", "outcome"])
    pending = GaugeMetricFamily("drivecal_cells_pending", "Cells of open campaigns without an answer", labels=["stage"])
    for stage in (*StageName, "evaluation"):
        for outcome in Outcome:
            cells.add_metric([stage, outcome.value], totals.cells[stage, outcome])
        pending.add_metric([stage], totals.pending[stage])
    yield cells
    yield pending
    waiting = GaugeMetricFamily("drivecal_campaigns_waiting", "Campaigns that wait, by what they wait for", labels=["for"])
    for awaited in ("place", "cells", "sets"):
        waiting.add_metric([awaited], totals.waiting.get(awaited, 0))
    yield waiting
    yield GaugeMetricFamily("drivecal_leases", "Cells that are at workers", totals.leases)
    newest = "Number of the newest run in the reference table: how many there are, or on PostgreSQL a little more"
    yield GaugeMetricFamily("drivecal_reference_runs", newest, totals.largest_run)
    yield CounterMetricFamily("drivecal_simulating_seconds", "CPU time of all simulations", totals.simulating_seconds)


def _of_dispatcher(dispatcher: StoredProcess | None) -> Iterator[Any]:
    readiness = judge(dispatcher, now())
    yield GaugeMetricFamily("drivecal_ready", _READY, float(readiness.ready))
    degraded = "1 if something is wrong and less work is done than could be"
    yield GaugeMetricFamily("drivecal_degraded", degraded, float(bool(readiness.problems)))
    if dispatcher is None:
        return
    silent = silent_seconds(dispatcher, now())
    yield GaugeMetricFamily("drivecal_dispatcher_heartbeat_age_seconds", "Since the dispatcher was last heard of", silent)
    yield CounterMetricFamily("drivecal_dispatcher_elections", "How many dispatchers this database has had", dispatcher.term)
    workers = GaugeMetricFamily("drivecal_workers", "Workers by state; none if the dispatcher is silent", labels=["state"])
    states = [] if readiness.silent else [worker.get("state") for worker in dispatcher.detail.get("workers", [])]
    for state in WORKER_STATES:
        workers.add_metric([state], states.count(state))
    yield workers
    uses = [] if readiness.silent else dispatcher.detail.get("resources", [])
    total = GaugeMetricFamily("drivecal_resources", "How many there are of a resource, such as licences", labels=["resource"])
    held = GaugeMetricFamily("drivecal_resources_held", "How many of a resource are held", labels=["resource"])
    for use in uses:
        total.add_metric([use["name"]], use["total"])
        held.add_metric([use["name"]], use["held"])
    yield total
    yield held
    for name, documentation, kind, samples in dispatcher.detail.get("measures", ()):
        family = Metric(name, documentation, kind)
        for ending, labels, value in samples:
            family.add_sample(name + ending, labels, value)
        yield family
