"""The sensitivity stage through database and dispatcher, with a formula of known influence in the place of the simulation."""

from typing import Any

from tests.support.computed import ComputedBackend
from tests.support.runs import WITH_ANALYSIS, dispatcher

from drivecal.campaigns.resolve.maps import map_from_document
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Cell, CellResult
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.evaluations import Outcome
from drivecal.domain.influence import InfluenceMap
from drivecal.storage import campaigns, results
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps


def _answer(scenario: str, cell: Cell) -> CellResult:
    """S1 depends on P1 everywhere and on P2 up to 0.5; S2 depends on P3 from 0.4 on; P4 matters nowhere."""
    p = cell.parameters
    rating = 6.4 * p["P1"] * (1 - min(p["P2"], 0.5)) if scenario == "S1" else 1 + 9 * max(p["P3"] - 0.4, 0)
    return CellResult(cell.id, rating, round(rating), {"rating": rating}, None, 7.0)


def _submit(database: Database, **changes: Any) -> StoredCampaign:
    specification = CampaignSpecification.model_validate(WITH_ANALYSIS | changes)
    with database.transaction() as connection:
        return campaigns.insert(connection, name="test", spec=specification.model_dump(mode="json"))


def _get(database: Database, campaign: StoredCampaign) -> StoredCampaign:
    with database.read() as connection:
        result = campaigns.get(connection, campaign.id)
    counts = result.counts(StageName.SENSITIVITY)
    assert counts.proposed == counts.pending + counts.requested
    assert counts.requested == counts.repeated + counts.simulated + counts.failed
    return result


def _run(database: Database, campaign: StoredCampaign, backend: ComputedBackend | None = None) -> StoredCampaign:
    working = dispatcher(database, backend or ComputedBackend(answer=_answer))
    while not _get(database, campaign).state.ended:
        working.step()
    return _get(database, campaign)


def _map(database: Database, campaign: StoredCampaign) -> InfluenceMap:
    with database.read() as connection:
        return map_from_document(influence_maps.get(connection, campaign.influence_map_id or "none").scenarios)


def test_the_stage_finds_where_parameters_matter_and_the_calibration_uses_it(database: Database) -> None:
    ended = _run(database, _submit(database))
    assert (ended.state, ended.error) == (CampaignState.SUCCEEDED, None)
    result = _map(database, ended)
    assert result.influence("S1", "P1").influential
    assert not result.influence("S1", "P3").influential
    assert not result.influence("S1", "P4").influential
    assert not result.influence("S2", "P1").influential
    p2, p3 = result.influence("S1", "P2"), result.influence("S2", "P3")
    assert p2.upper is not None
    assert 0.5 <= float(p2.upper) <= 0.7
    assert p3.lower is not None
    assert 0.2 <= float(p3.lower) <= 0.4
    assert ended.cells.reused > 0
    assert ended.counts(StageName.SENSITIVITY).simulated > 0
    assert ended.cells.simulated < ended.counts(StageName.SENSITIVITY).simulated
    assert set(ended.error_rate) == {"S1", "S2"}
    for rate in ended.error_rate.values():
        assert rate.audited > 0
        assert rate.wrong == 0


def test_the_runs_of_the_analysis_are_references_from_the_first_population_on(database: Database) -> None:
    ended = _run(database, _submit(database))
    with database.read() as connection:
        rows = {row.id: row for row in results.stream(connection, ended.sequence)}
    stages = {row.id: row.stage for row in rows.values()}
    first = [row for row in rows.values() if row.stage is StageName.CALIBRATION and row.iteration == 0]
    assert any(row.outcome is Outcome.REUSED and stages[row.reference or 0] is StageName.SENSITIVITY for row in first)


def test_an_analysis_of_its_own_ends_with_a_map_that_a_later_campaign_names(database: Database) -> None:
    alone = _run(database, _submit(database, optimizer=None))
    assert alone.state is CampaignState.SUCCEEDED
    assert alone.cells.proposed == 0
    assert alone.influence_map_id is not None
    named = CampaignSpecification.model_validate(WITH_ANALYSIS | {"sensitivity": {"map": alone.influence_map_id}})
    with database.transaction() as connection:
        later = campaigns.insert(
            connection, name="later", spec=named.model_dump(mode="json"), influence_map_id=alone.influence_map_id
        )
    ended = _run(database, later)
    assert ended.counts(StageName.SENSITIVITY).requested == 0
    assert ended.cells.reused > 0
    together = _run(database, _submit(database))
    assert together.counts(StageName.SENSITIVITY).simulated == 0, "the same analysis repeats what is stored"
    assert together.best == ended.best
