"""Failed cells of a user's problem: causes with counts, scores without a value, campaigns without a result; and simulators that wait."""

import re
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast

import pytest
from tests.support.computed import ComputedBackend
from tests.support.problems import RANDOM, scored, store, submit_checked
from tests.support.runs import dispatcher, finish, told_of
from tests.support.values import COST

from drivecal.analysis.goals import CellValue
from drivecal.analysis.savings import account
from drivecal.campaigns.cells.cell_tracker import ScoreFaults
from drivecal.campaigns.results.failures import causes_of
from drivecal.campaigns.stages.stage import ALL_FAILED
from drivecal.contracts.evaluation import FailureCause
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.evaluations import Outcome
from drivecal.domain.events import EventKind
from drivecal.storage import campaigns, evaluations, events, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance.consistency import check_counters
from drivecal.storage.references import runs

MANIFEST = scored("mine", {"x": {"lower": 0, "upper": 1}}, "1/max(y, 0)")


@dataclass
class Simulated:
    """Answers of a simulator: cells with x below `broken` have no result, and at first below `flaky`; above `undefined` a negative y, above
    `collides` a failure."""

    broken: float = 0.0
    undefined: float = 2.0
    collides: float = 2.0
    flaky: float = 0.0
    runs: int = field(default=0)
    tried: set[int] = field(default_factory=set)

    def __call__(self, scenario: str, cell: Cell) -> CellResult:
        del scenario
        self.runs += 1
        x = float(cell.parameters["x"])
        if x < self.broken or (x < self.flaky and cell.id not in self.tried):
            self.tried.add(cell.id)
            detail = f"it ended with exit code 3; its last messages: no licence after {x:.3f} s"
            return CellResult(cell.id, None, None, {}, None, 7.0, "crash", detail, contained=True)
        if x > self.collides:
            return CellResult(cell.id, None, None, {}, "collision", 7.0)
        return CellResult(cell.id, None, None, {"y": -1.0 if x > self.undefined else 1 + x}, None, 7.0)


@pytest.fixture(autouse=True)
def _pushed(database: Database) -> None:
    store(database, MANIFEST)


def submit(database: Database, **changes: Any) -> StoredCampaign:
    return submit_checked(database, RANDOM | changes)


def run(database: Database, campaign: StoredCampaign, simulated: Simulated) -> StoredCampaign:
    return finish(database, campaign, dispatcher(database, ComputedBackend(answer=simulated)))


def causes(database: Database, campaign: StoredCampaign) -> list[FailureCause]:
    with database.read() as connection:
        return causes_of(connection, campaigns.get(connection, campaign.id))


def test_every_failed_cell_is_counted_under_its_cause(database: Database) -> None:
    ended = run(database, submit(database), Simulated(broken=0.2, undefined=0.6, collides=0.8, flaky=0.4))
    assert ended.state is CampaignState.SUCCEEDED
    result = {(cause.kind, cause.cause): cause for cause in causes(database, ended)}
    assert sorted(kind for kind, _ in result) == ["failed", "no_result", "retried", "unscored"]
    crash = result["no_result", "crash"]
    assert crash.cells == ended.cells.failed > 1
    assert "no licence" in (crash.detail or "")
    assert result["retried", "crash"].cells > 1
    assert "no licence" in (result["retried", "crash"].detail or "")
    assert set(crash.scenarios) == {"city", "road"}
    [undefined] = [cause for cause in result.values() if cause.kind == "unscored"]
    assert "division by zero" in undefined.cause
    assert undefined.cells == ended.cells.unscored > 1
    assert sum(cause.cells for cause in result.values()) < ended.cells.requested
    with database.read() as connection:
        assert list(check_counters(connection)) == []
        told = [event for event in events.since(connection, ended.sequence, 0, 1_000) if "no licence" in str(event.data)]
        assert [("crash" in event.data["text"], event.kind) for event in told] == [(True, EventKind.NOTE)]
        named = re.search(r"\(evaluation (\d+), x=([0-9.e-]+)\)$", told[0].data["text"])
        assert named is not None
        cell = results.by_id(connection, int(named[1]))
    assert cell.outcome is Outcome.FAILED
    assert cell.parameters.floats["x"] == pytest.approx(float(named[2]), rel=1e-5)


def test_scores_without_a_value_are_noted_and_told_once(database: Database) -> None:
    campaign = submit(database)
    ended = run(database, campaign, Simulated(undefined=0.5))
    assert any(f"{ended.cells.unscored}" in note and "no value" in note for note in ended.notes)
    assert sum("division by zero" in str(each.data) for each in told_of(database, campaign)) == 1
    again = run(database, submit(database), Simulated())
    assert (again.cells.unscored, again.cells.simulated) == (ended.cells.unscored, 0)
    assert [cause.kind for cause in causes(database, again)] == ["unscored"], "the causes are those of all cells"


def test_scores_that_are_cut_off_are_counted_noted_and_told_once(database: Database) -> None:
    score = {"formula": "y", "direction": "minimise", "range": [0, 1.5]}
    store(database, MANIFEST | {"scores": {"cost": score}})
    ended = run(database, submit(database), Simulated())
    assert 0 < ended.cells.cut < ended.cells.simulated
    assert any(f"{ended.cells.cut}" in note and "`failed`" in note for note in ended.notes)
    told = [event.data["text"].split(": ")[1] for event in told_of(database, ended) if "1.5, the worth" in str(event.data)]
    assert told in (["city"], ["road"])
    with database.read() as connection:
        assert list(check_counters(connection)) == []
    store(database, MANIFEST | {"scores": {"cost": score | {"failed": 2.5}}})
    assert run(database, submit(database), Simulated()).cells.cut == 0


def test_scores_of_further_objectives_are_counted_as_well() -> None:
    counts, bench = {"cut": 0, "unscored": 0}, SimpleNamespace(scale=COST)
    faults = ScoreFaults(cast("Any", SimpleNamespace(bench=bench, scores=[CellValue(COST, "1/y")])), counts)
    for y, failure in ((0.001, None), (0.0, None), (1.0, None), (0.001, "collision")):
        faults.note("S1", None, {"y": y}, failure)
    assert (counts, (faults.cut or "")[:20]) == ({"cut": 1, "unscored": 1}, "S1: cost is 1000 and")


def test_a_campaign_without_failures_has_no_cause(database: Database) -> None:
    assert causes(database, run(database, submit(database), Simulated())) == []


@pytest.mark.parametrize("sensitivity", [None, {"intervals": 4, "samples": 8, "threshold": 0.02}])
def test_a_campaign_whose_cells_all_fail_ends_early(database: Database, sensitivity: dict[str, Any] | None) -> None:
    optimizer = {"kind": "random", "population": 400, "iterations": 5, "seed": 1}
    simulated = Simulated(broken=2.0)
    ended = run(database, submit(database, optimizer=optimizer, sensitivity=sensitivity), simulated)
    assert ended.state is CampaignState.FAILED
    assert "no licence" in (ended.error or "")
    assert "crash" in (ended.error or "")
    assert simulated.runs < 3 * 800, "each cell of the first generation would be tried three times"


def test_a_few_results_keep_a_campaign_going(database: Database) -> None:
    ended = run(database, submit(database), Simulated(broken=0.7))
    assert (ended.state, ended.cells.failed > ALL_FAILED) == (CampaignState.SUCCEEDED, True)


class Sleeping(Simulated):
    """Takes 90 s for 5 ms of CPU time."""

    def __call__(self, scenario: str, cell: Cell) -> CellResult:
        del scenario
        y = 1.0 + float(cell.parameters["x"])
        return CellResult(cell.id, None, None, {"y": y}, None, 5.0, wall_milliseconds=90_000.0)


def test_a_sleeping_simulator_saves_the_workers_time(database: Database) -> None:
    first = run(database, submit(database), Sleeping())
    again = run(database, submit(database), Sleeping())
    assert (first.cells.repeated, again.cells.simulated) == (0, 0)
    with database.read() as connection:
        accounts = [
            account(each.id, ["city", "road"], evaluations.costs_by_outcome(connection, each.sequence), None)
            for each in (first, again)
        ]
        setups = (campaigns.get(connection, first.id).resolution or {})["setups"]
        expected = runs.recent_milliseconds(connection, list(setups.values()))
        occupied, _ = evaluations.occupied(connection, again.sequence, after=0)
    assert [each.clock for each in accounts] == ["wall", "wall"]
    assert sum(scenario.simulated_seconds for scenario in accounts[0].scenarios) == 90 * first.cells.simulated
    assert accounts[1].saved_seconds == 90 * again.cells.repeated
    assert abs(first.simulating_seconds - 0.005 * first.cells.simulated) < 1e-9, "CPU time stays CPU time"
    assert expected == 90_000.0
    assert {name: seconds / cells for name, (cells, seconds) in occupied.items()} == {"city": 90e6, "road": 90e6}
