"""Campaigns run to their end by a dispatcher on a computed backend."""

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from sqlalchemy import select
from tests.support.computed import ComputedBackend
from tests.support.server import RunningApi
from tests.support.values import present

from drivecal.campaigns.resolve.maps import resolve_map
from drivecal.campaigns.resolve.workbench import stored_bundles
from drivecal.contracts.campaign import CellCounts
from drivecal.contracts.specification import CampaignSpecification, InfluenceMapSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.dispatch.dispatcher import Dispatcher
from drivecal.dispatch.heartbeat import Leadership
from drivecal.domain.campaigns import Action, StageName
from drivecal.domain.evaluations import Outcome
from drivecal.execution.backend import Backend
from drivecal.execution.pool import Leases, WorkPool
from drivecal.storage import campaigns, events, generations, lots, results, studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine import tables
from drivecal.storage.engine.database import Database
from drivecal.storage.events import StoredEvent
from drivecal.storage.lots import StoredLot
from drivecal.storage.references import influence_maps
from drivecal.storage.results import StoredEvaluation

EXPERT_SPACE: list[dict[str, Any]] = [{"name": f"P{i}", "lower": 0, "upper": 1, "step": 0.5} for i in range(1, 12)]
SMALL: dict[str, Any] = {
    "sensitivity": None,
    "parameters": EXPERT_SPACE,
    "catalogue": ["S1", "S2", "S3"],
    "driving_function": "frenet",
    "vehicle": {"model": "single_track"},
    "optimizer": {"kind": "genetic", "population": 24, "iterations": 6, "seed": 3},
    "reduction": {"mode": "influence", "max_error": 1},
}
"""By references without lots, where a campaign reuses."""
WITH_ANALYSIS: dict[str, Any] = {
    "catalogue": ["S1", "S2"],
    "parameters": [{"name": f"P{i}", "lower": 0, "upper": 1, "step": 0.05} for i in range(1, 5)],
    "fixed": {f"P{i}": 0.5 for i in range(5, 12)},
    "sensitivity": {"intervals": 5, "samples": 8, "threshold": 0.02},
    "optimizer": {"kind": "genetic", "population": 40, "iterations": 5, "seed": 2},
    "reduction": {"mode": "influence", "audit": 0.1, "max_error": 1},
}
SHORT: dict[str, Any] = WITH_ANALYSIS | {
    "sensitivity": {"intervals": 2, "samples": 3, "threshold": 0.02},
    "optimizer": {"kind": "genetic", "population": 10, "iterations": 3, "seed": 2},
}
"""All stages in a few cells."""
MOST_STEPS = 5_000


def influenced(scenario: str, cell: Cell) -> CellResult:
    """S1 depends on P1 everywhere and on P2 up to 0.5; S2 depends on P3 from 0.4 on, and fails beyond 0.95; P4 matters nowhere."""
    p = cell.parameters
    rating = 6.4 * p["P1"] * (1 - min(p["P2"], 0.5)) if scenario == "S1" else 1 + 9 * max(p["P3"] - 0.4, 0)
    if scenario == "S2" and p["P3"] > 0.95:
        return CellResult(cell.id, 0.0, 0, {"comfort": rating}, "collision", 7.0)
    return CellResult(cell.id, rating, round(rating), {"comfort": rating, "undefined": float("nan")}, None, 7.0)


@contextmanager
def working(database: Database, backend: Backend) -> Iterator[None]:
    """A dispatcher carries out what is submitted, in a thread of its own, as long as the block lasts."""
    over = threading.Event()
    carrying_out = dispatcher(database, backend)

    def work() -> None:
        while not over.wait(0.005):
            carrying_out.step()

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def nothing_matters() -> dict[str, Any]:
    """A map that says that no parameter influences anything."""
    return {scenario: {f"P{i}": {"influential": False} for i in range(1, 12)} for scenario in ("S1", "S2", "S3")}


def post_map(database: Database, scenarios: dict[str, Any], problem: str | None = None) -> str:
    """Stores a map as a user would post it; gives its id."""
    document = {"scenarios": scenarios} | ({"parameters": EXPERT_SPACE} if problem is None else {"problem": problem})
    posted = resolve_map(InfluenceMapSpecification.model_validate(document), stored_bundles(database))
    with database.transaction() as connection:
        return influence_maps.insert(connection, **posted).id


def submit(database: Database, *, stored_map: str | None = None, likeness: str | None = None, **changes: Any) -> StoredCampaign:
    """Queues `SMALL` with changes, on a stored map where one is given."""
    document = SMALL | changes
    document["reduction"] = {**SMALL["reduction"], **document["reduction"]}
    if stored_map is not None:
        document["sensitivity"] = {"map": stored_map}
    specification = CampaignSpecification.model_validate(document)
    with database.transaction() as connection:
        return campaigns.insert(
            connection, name="test", spec=specification.model_dump(mode="json"), influence_map_id=stored_map, likeness=likeness
        )


def get(database: Database, campaign: StoredCampaign) -> StoredCampaign:
    """A campaign as it is now."""
    with database.read() as connection:
        return campaigns.get(connection, campaign.id)


def request(database: Database, campaign: StoredCampaign, action: Action) -> None:
    """Asks for an action as the API does."""
    with database.transaction() as connection:
        campaigns.request_action(connection, campaign.id, action)


def everything(database: Database, campaign: StoredCampaign) -> tuple[Any, ...]:
    """All that a campaign found, without what may differ between machines and runs: ids, times, workers, attempts, starts."""
    rows = rows_of(database, campaign)
    with database.read() as connection:
        figures, _ = generations.page(connection, campaign.sequence, limit=1_000)
    numbered = {row.id: (row.iteration, row.individual, row.scenario) for row in rows}
    cells = [
        (
            *(row.iteration, row.individual, row.scenario, tuple(row.parameters.floats.values()), row.outcome, row.score),
            *(row.rating, row.failure, row.purpose, row.agrees),
            None if row.reference is None else numbered.get(row.reference, "earlier"),
        )
        for row in rows
    ]
    ended = get(database, campaign)
    return cells, figures, without_starts(ended.cells), ended.best, ended.error_rate, ended.notes


def without_starts(cells: CellCounts) -> CellCounts:
    """Returns counts of cells without the starts of the simulator: kills make more of them, and other campaigns' runs replace some."""
    return cells.model_copy(update={"runs": 0, "lost": 0, "shared": 0})


def dispatcher(database: Database, backend: Backend | None = None, **settings: Any) -> Dispatcher:
    """A newly elected one, that looks and reports in every step. Those before write nothing any more."""
    ticks = iter(range(10**9))
    own = database.fenced(Leadership.begin(database).fence)
    pool = WorkPool(backend or ComputedBackend(), Leases(own))
    return Dispatcher(own, pool, clock=lambda: float(next(ticks)), **settings)


def run(database: Database, campaign: StoredCampaign, backend: ComputedBackend | None = None) -> StoredCampaign:
    """Runs a campaign to its end, without an error."""
    ended = finish(database, campaign, dispatcher(database, backend))
    assert ended.error is None, ended.error
    return ended


def finish(database: Database, campaign: StoredCampaign, working: Dispatcher) -> StoredCampaign:
    """Works until a campaign has ended, successfully or not."""
    ended = select(tables.campaigns.c.ended_at.is_not(None)).where(tables.campaigns.c.id == campaign.id)
    for _ in range(MOST_STEPS):
        with database.read() as connection:
            if connection.scalar(ended):
                return campaigns.get(connection, campaign.id)
        working.step()
    raise AssertionError(f"the campaign did not end: {get(database, campaign)}")


def run_posted(api: RunningApi, document: Mapping[str, Any], backend: ComputedBackend) -> str:
    """Posts a campaign and runs it to its end; returns its id."""
    submitted = api.http.post("/api/v1/campaigns", json=document)
    assert submitted.status_code == 202, submitted.text
    identifier: str = submitted.json()["id"]
    with api.database.read() as connection:
        campaign = campaigns.get(connection, identifier)
    run(api.database, campaign, backend)
    return identifier


def rows_of(database: Database, campaign: StoredCampaign) -> list[StoredEvaluation]:
    """All cells of a campaign."""
    with database.read() as connection:
        return list(results.stream(connection, campaign.sequence))


def told_of(database: Database, campaign: StoredCampaign) -> list[StoredEvent]:
    """All events of a campaign."""
    with database.read() as connection:
        return events.since(connection, campaign.sequence, 0, 1_000)


def study_of(database: Database, campaign: StoredCampaign, stage: StageName = StageName.ROBUSTNESS) -> dict[str, Any]:
    """The result of a study of a campaign, which there has to be."""
    with database.read() as connection:
        return present(studies.get(connection, campaign.sequence, stage))


def lots_of(database: Database, campaign: StoredCampaign, kind: Outcome | None = None) -> list[StoredLot]:
    """The lots of a campaign, all or of a kind."""
    with database.read() as connection:
        return lots.of_campaign(connection, campaign.sequence, kind)


def step_until(database: Database, campaign: StoredCampaign, iteration: int, working: Dispatcher) -> None:
    """Works until an iteration of the calibration was asked for."""
    for _ in range(MOST_STEPS):
        with database.read() as connection:
            if results.is_requested(connection, campaign.sequence, StageName.CALIBRATION, iteration):
                return
        working.step()
    raise AssertionError(f"iteration {iteration} was never asked for")
