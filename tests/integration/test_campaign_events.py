"""Events of a whole campaign, from its submission to its end."""

from typing import Any

import pytest
from tests.support.computed import ComputedBackend
from tests.support.runs import SHORT, WITH_ANALYSIS, dispatcher, get, influenced, rows_of, run, told_of
from tests.support.values import present

from drivecal.contracts.specification import CampaignSpecification
from drivecal.domain.campaigns import StageName
from drivecal.storage import campaigns, generations
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database


def analysed(database: Database, settings: dict[str, Any] = SHORT) -> StoredCampaign:
    """A campaign with a sensitivity stage and a baseline."""
    document = settings | {"baseline": {"P1": 0.5, "P2": 0.5, "P3": 0.5, "P4": 0.5}, "weights": {"S2": 0.5}}
    specification = CampaignSpecification.model_validate(document)
    with database.transaction() as connection:
        return campaigns.insert(connection, name="analysed", spec=specification.model_dump(mode="json"))


@pytest.mark.slow
def test_a_campaign_tells_its_stages_its_generations_and_every_better_set(database: Database) -> None:
    campaign = analysed(database, WITH_ANALYSIS)
    ended = run(database, campaign, ComputedBackend(answer=influenced))
    kinds = [event.kind for event in told_of(database, campaign)]
    by_kind: dict[str, list[dict[str, Any]]] = {}
    for event in told_of(database, campaign):
        by_kind.setdefault(event.kind, []).append(dict(event.data))
    assert kinds[:3] == ["queued", "running", "stage"]
    after = kinds[len(kinds) - kinds[::-1].index("generation") :]
    assert [kind for kind in after if kind != "note"] == ["succeeded"], "the best set may have been confirmed"
    assert [entry["stage"] for entry in by_kind["stage"]] == ["sensitivity", "calibration"]
    assert kinds.index("phase") < kinds.index("influence_map") < len(kinds) - 1 - kinds[::-1].index("stage")
    assert [element["phase"] for element in by_kind["phase"]] == list(range(len(by_kind["phase"])))
    assert by_kind["phase"][-1]["requested"] == ended.counts(StageName.SENSITIVITY).requested
    assert by_kind["influence_map"][0]["id"] == ended.influence_map_id
    assert "P4" not in by_kind["influence_map"][0]["influential"]["S1"]
    with database.read() as connection:
        figures, _ = generations.page(connection, ended.sequence)
    assert [(member["iteration"], member["best"], member["simulated"]) for member in by_kind["generation"]] == [
        (each.iteration, each.best, each.simulated) for each in figures
    ]
    objectives = [item["objective"] for item in by_kind["best"]]
    assert objectives == sorted(set(objectives))
    assert by_kind["best"][-1]["objective"] == present(ended.best).objective
    assert by_kind["baseline"] == [present(ended.baseline).model_dump()]
    assert len(kinds) <= 30


def test_a_phase_counts_no_cell_of_the_next_one_that_is_answered_at_once(database: Database) -> None:
    run(database, analysed(database), ComputedBackend(answer=influenced))
    again = run(database, analysed(database), ComputedBackend(answer=influenced))
    first = next(event.data for event in told_of(database, again) if event.kind == "phase")
    cells = [row for row in rows_of(database, again) if (row.stage, row.iteration) == (StageName.SENSITIVITY, 0)]
    assert first["requested"] == len(cells)


def test_the_revision_changes_with_whatever_happens(database: Database) -> None:
    campaign, working = analysed(database), dispatcher(database, ComputedBackend(answer=influenced))
    before = get(database, campaign)
    events_before = len(told_of(database, campaign))
    for _ in range(5_000):
        working.step()
        after, events_after = get(database, campaign), len(told_of(database, campaign))
        if (after, events_after) != (before, events_before):
            assert after.revision > before.revision
        before, events_before = after, events_after
        if after.state.ended:
            return
    raise AssertionError("the campaign did not end")
