"""The robustness and the validation stage through database and dispatcher, with formulas in the place of the simulation."""

from pathlib import Path
from typing import Any

import pytest
from tests.support.computed import ComputedBackend
from tests.support.deaths import ends_in_spite_of_deaths
from tests.support.effort import tries
from tests.support.problems import MANIFEST
from tests.support.runs import (
    SMALL,
    WITH_ANALYSIS,
    everything,
    get,
    influenced,
    nothing_matters,
    post_map,
    rows_of,
    run,
    study_of,
    submit,
    without_starts,
)
from tests.support.values import faults_of, present

from drivecal.bundles.checks import checked
from drivecal.bundles.installed import Bundle
from drivecal.campaigns.resolve.problem import resolve
from drivecal.campaigns.results.explanation import explain
from drivecal.campaigns.stages.robustness import check_source
from drivecal.contracts.specification import CampaignSpecification
from drivecal.contracts.work import Cell, CellResult, SetupRequest
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import InvalidInputError
from drivecal.domain.evaluations import Outcome
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.references import influence_maps

ROBUST: dict[str, Any] = {"delta": 0.05, "steps": 6, "samples": 8, "solutions": 5}
STUDIES = (StageName.ROBUSTNESS, StageName.VALIDATION)
STRIDE = tries(160, 30)
NOMINAL_MASS, MASS_RANGE = 2060.0, 1400.0


def heavy(setup: SetupRequest, cell: Cell) -> CellResult:
    """A score of 6, which falls by 2 where the mass is off by more than P1 (0, 0.5 or 1) / 5 of its range."""
    away = abs(setup.varied["mass"] - NOMINAL_MASS) / MASS_RANGE
    rating = 6.0 if away <= cell.parameters["P1"] / 5 else 4.0
    return CellResult(cell.id, rating, int(rating), {"rating": rating}, None, 5.0)


def test_sets_are_ranked_by_what_vehicles_they_bear(database: Database) -> None:
    named = [{f"P{i}": (share if i == 1 else 0.5) for i in range(1, 12)} for share in (0.0, 0.5, 1.0)]
    campaign = submit(database, optimizer=None, robustness={**ROBUST, "sets": named})
    ended = run(database, campaign, ComputedBackend(driven=heavy))
    result = study_of(database, ended)
    assert result["complete"]
    assert [row["parameters"]["P1"] for row in result["items"]] == [1.0, 0.5, 0.0]
    assert [row["degree"] for row in result["items"]] == [4, 2, 0]
    assert [row["rank"] for row in result["items"]] == [1, 2, 3]
    assert [row["recommended"] for row in result["items"]] == [True, False, False]
    assert "the largest degree of robustness (4)" in result["items"][0]["reason"]
    assert result["items"][0]["scores"] == {"S1": 6, "S2": 6, "S3": 6}
    failing = result["items"][0]["trials"][-1]
    assert not failing["holds"]
    assert failing["deviations"] == {"S1": 2.0, "S2": 2.0, "S3": 2.0}
    # nominal runs, then 5, 3 and 1 boxes
    assert ended.counts(StageName.ROBUSTNESS).requested == 3 * 3 + (5 + 3 + 1) * 8 * 3
    assert ended.cells.requested == 0
    first_vehicle = next(row for row in rows_of(database, ended) if row.iteration == 1)
    with database.read() as connection:
        assert explain(connection, first_vehicle.id).stored == 0, "the nominal vehicle's runs are of another setup"


@pytest.mark.slow
def test_the_best_sets_of_a_calibration_are_examined_one_of_each_region_first(database: Database) -> None:
    campaign = submit(database, robustness=ROBUST)
    ended = run(database, campaign, ComputedBackend(driven=heavy))
    result = study_of(database, ended)["items"]
    assert len(result) == 5
    assert {row["objective"] for row in result} == {present(ended.best).objective}
    assert max(row["region"] for row in result) >= 1
    assert ended.stage is StageName.ROBUSTNESS


def test_scores_that_were_references_are_simulated_in_the_nominal_vehicle_first(database: Database) -> None:
    stored_map = post_map(database, nothing_matters())
    campaign = submit(database, stored_map=stored_map, robustness={**ROBUST, "steps": 1}, reduction={"audit": 0.0})
    ended = run(database, campaign, ComputedBackend(driven=heavy))
    first = [row for row in rows_of(database, ended) if row.stage is StageName.ROBUSTNESS and row.iteration == 0]
    assert {row.outcome for row in first} == {Outcome.SIMULATED, Outcome.REPEATED}


def test_a_study_of_another_campaign_chooses_its_sets_by_scores_that_simulations_corrected(database: Database) -> None:
    blind = {scenario: {f"P{i}": {"influential": False} for i in range(2, 12)} for scenario in ("S1", "S2", "S3")}
    searched = run(
        database,
        submit(database, stored_map=post_map(database, blind), reduction={"audit": 0.0, "confirm": 0}),
        ComputedBackend(answer=influenced),
    )
    robust = {"of": searched.id, "delta": 0.05, "steps": 1, "samples": 2, "solutions": 5}
    first, second = (
        study_of(
            database, run(database, submit(database, optimizer=None, robustness=robust), ComputedBackend(answer=influenced))
        )
        for _ in range(2)
    )
    believed = present(searched.best)
    wrong = [row["parameters"] for row in first["items"] if row["objective"] < believed.objective - 1e-9]
    assert wrong
    assert not any(row["parameters"] in wrong for row in second["items"])


def test_a_source_of_other_parameters_or_scenarios_is_refused(database: Database) -> None:
    searched = run(database, submit(database, catalogue=["S1"]))
    study_of = {"optimizer": None, "robustness": {"of": searched.id}}
    varied = {"slope": {"nominal": 0, "lower": -1, "upper": 1}}
    own = Bundle("d", "f", checked(MANIFEST | {"varied": varied}))
    others = resolve(CampaignSpecification.model_validate({"problem": "heater", **study_of}), lambda _: own)
    more = resolve(CampaignSpecification.model_validate(SMALL | study_of))
    for problem, named in ((others, "P11"), (more, "S2, S3")):
        with database.read() as connection, pytest.raises(InvalidInputError) as refused:
            check_source(connection, problem)
        (fault,) = refused.value.problems
        assert (fault.field, named in fault.message) == ("robustness.of", True)


def test_a_vehicle_without_a_result_ends_the_growing_of_boxes(database: Database) -> None:
    def fragile(setup: SetupRequest, cell: Cell) -> CellResult:
        if setup.varied["mass"] > NOMINAL_MASS + 0.12 * MASS_RANGE:
            return CellResult(cell.id, None, None, {}, None, 5.0, "error", "it tipped over")
        return CellResult(cell.id, 5.0, 5, {}, None, 5.0)

    named = [dict.fromkeys((f"P{i}" for i in range(1, 12)), 0.5)]
    campaign = submit(database, optimizer=None, catalogue=["S1"], robustness={**ROBUST, "sets": named})
    ended = run(database, campaign, ComputedBackend(driven=fragile))
    row = study_of(database, ended)["items"][0]
    assert row["degree"] == 2
    assert row["trials"][-1]["deviations"] == {"S1": None}
    assert ended.counts(StageName.ROBUSTNESS).failed > 0


@pytest.mark.slow
def test_a_dispatcher_killed_at_any_moment_of_analysis_and_studies_changes_nothing(tmp_path: Path) -> None:
    def begin(database: Database) -> StoredCampaign:
        return submit(database, **WITH_ANALYSIS, robustness=ROBUST, validation={"samples": 10, "references": 3})

    def find(database: Database, campaign: StoredCampaign) -> tuple[Any, ...]:
        ended = get(database, campaign)
        assert ended.error is None
        with database.read() as connection:
            influences = influence_maps.get(connection, ended.influence_map_id or "none").scenarios
        own = [(row.stage, row.iteration, row.individual) for row in rows_of(database, campaign)]
        counts = [without_starts(ended.counts(stage)) for stage in (StageName.SENSITIVITY, *STUDIES)]
        return everything(database, campaign), own, counts, influences, [study_of(database, ended, stage) for stage in STUDIES]

    ends = ends_in_spite_of_deaths(tmp_path, begin, lambda moment: ComputedBackend(moment, answer=influenced), find, STRIDE)
    assert len(ends) > tries(3, 10)
    assert all(end == ends[0] for end in ends)


def test_validation_counts_variants_that_differ_where_the_map_says_that_they_cannot(database: Database) -> None:
    """The formula of S1 depends on P1 and P2, that of S2 on P3: a map that denies P2 and P3 is wrong, and is shown to be."""
    scenarios = nothing_matters()
    scenarios["S1"]["P1"] = scenarios["S2"]["P3"] = {"influential": True}
    campaign = submit(
        database,
        stored_map=post_map(database, scenarios),
        catalogue=["S1", "S2"],
        optimizer=None,
        validation={"samples": 20, "references": 5},
    )
    ended = run(database, campaign, ComputedBackend(answer=influenced))
    one, two = study_of(database, ended, StageName.VALIDATION)["items"]
    assert (one["scenario"], two["scenario"]) == ("S1", "S2")
    assert one["reducible"] == 10
    assert one["covered"] == one["effects"] == 2**10 - 1
    assert one["compared"] == one["bases"] * 5 == sum(one["histogram"].values())
    assert one["different"] > 0
    assert two["different"] == two["wrong"] == 0
    assert two["error_rate"] == 0.0
    assert two["histogram"] == {"0": two["compared"]}
    assert two["upper_95"] == pytest.approx(1 - 0.025 ** (1 / two["bases"])), "the bases count, not their variants"
    assert ended.counts(StageName.VALIDATION).requested == sum(row["bases"] * 6 for row in (one, two))


def test_where_everything_matters_there_is_nothing_to_validate(database: Database) -> None:
    stored_map = post_map(database, {"S1": {"P1": {"influential": True}}})
    campaign = submit(database, stored_map=stored_map, optimizer=None, validation={"samples": 20})
    ended = run(database, campaign)
    document = study_of(database, ended, StageName.VALIDATION)
    assert ended.state is CampaignState.SUCCEEDED
    assert [row["scenario"] in note for row, note in zip(document["items"], document["notes"], strict=True)] == [True] * 3
    assert all(row["compared"] == 0 and row["error_rate"] is None for row in document["items"])


@pytest.mark.parametrize(
    ("changes", "field", "words"),
    [
        ({"optimizer": None, "robustness": ROBUST}, "robustness", "there are no solutions to examine"),
        ({"robustness": {**ROBUST, "solutions": 0}}, "robustness.solutions", "0 examines no set"),
        ({"robustness": {**ROBUST, "sets": [{"P1": 0.5}]}}, "robustness.sets[0]", "P2"),
        ({"validation": {"samples": 10}}, "validation", "there is no influence map to validate"),
        ({"validation": {"of": "a"}}, "validation.of", "this campaign searches its own solutions"),
        (
            {"sensitivity": {"map": "a"}, "validation": {"samples": 10, "largest": 5}},
            "validation.largest",
            "less than the first",
        ),
    ],
)
def test_studies_that_cannot_be_made_are_refused_at_their_field(changes: dict[str, Any], field: str, words: str) -> None:
    refused = faults_of(resolve, CampaignSpecification.model_validate(SMALL | changes))
    assert refused[0].field == field
    assert words in str(refused[0])


def test_the_expected_runs_hold_the_studies() -> None:
    document = SMALL | {"robustness": ROBUST, "sensitivity": {"map": "a"}, "validation": {"samples": 10, "references": 4}}
    expected = resolve(CampaignSpecification.model_validate(document)).expected_runs()
    assert expected.robustness == 5 * 3 * (1 + 6 * 8)
    assert expected.validation == 10 * 5 * 3
