"""The sensitivity stage through database and dispatcher, with a formula of known influence in the place of the simulation."""

from typing import Any

from tests.support.computed import ComputedBackend
from tests.support.runs import SHORT, WITH_ANALYSIS, influenced, rows_of, run, submit
from tests.support.values import present

from drivecal.campaigns.resolve.maps import map_from_document
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.evaluations import Outcome
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps


def _run(database: Database, **changes: Any) -> StoredCampaign:
    return run(database, submit(database, **WITH_ANALYSIS | changes), ComputedBackend(answer=influenced))


def test_the_stage_finds_where_parameters_matter_and_the_calibration_uses_it(database: Database) -> None:
    ended = _run(database)
    assert ended.state is CampaignState.SUCCEEDED
    counts = ended.counts(StageName.SENSITIVITY)
    assert counts.proposed == counts.requested == counts.repeated + counts.simulated + counts.failed
    with database.read() as connection:
        result = map_from_document(influence_maps.get(connection, present(ended.influence_map_id)).scenarios)
    assert result.influence("S1", "P1").influential
    assert not result.influence("S1", "P3").influential
    assert not result.influence("S1", "P4").influential
    assert not result.influence("S2", "P1").influential
    p2, p3 = result.influence("S1", "P2"), result.influence("S2", "P3")
    assert 0.5 <= float(present(p2.upper)) <= 0.7
    assert 0.2 <= float(present(p3.lower)) <= 0.4
    assert ended.cells.reused > 0
    assert ended.counts(StageName.SENSITIVITY).simulated > 0
    assert ended.cells.simulated < ended.counts(StageName.SENSITIVITY).simulated
    assert set(ended.error_rate) == {"S1", "S2"}
    for rate in ended.error_rate.values():
        assert rate.audited > 0
        assert rate.wrong == 0


def test_the_runs_of_the_analysis_are_references_from_the_first_population_on(database: Database) -> None:
    ended = _run(database)
    rows = {row.id: row for row in rows_of(database, ended)}
    stages = {row.id: row.stage for row in rows.values()}
    first = [row for row in rows.values() if row.stage is StageName.CALIBRATION and row.iteration == 0]
    assert any(row.outcome is Outcome.REUSED and stages[row.reference or 0] is StageName.SENSITIVITY for row in first)


def test_an_analysis_of_its_own_ends_with_a_map_that_a_later_campaign_names(database: Database) -> None:
    alone = _run(database, **SHORT | {"optimizer": None})
    assert alone.state is CampaignState.SUCCEEDED
    assert alone.cells.proposed == 0
    ended = _run(database, **SHORT, stored_map=present(alone.influence_map_id))
    assert ended.counts(StageName.SENSITIVITY).requested == 0
    assert ended.cells.reused > 0
    together = _run(database, **SHORT)
    assert together.counts(StageName.SENSITIVITY).simulated == 0, "the same analysis repeats what is stored"
    assert together.best == ended.best
