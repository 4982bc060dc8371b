"""Labels, lists and deletion, on both databases."""

from itertools import pairwise
from typing import Any

import pytest
from sqlalchemy import Connection, func, select
from tests.support.computed import ComputedBackend
from tests.support.runs import SHORT, get, influenced, run, submit
from tests.support.storage import EVALUATOR, campaign, cell, new_run, sample_set_ids, setup_id
from tests.support.values import faults_of

from drivecal.contracts.specification import CampaignChanges
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import ConflictError, NotFoundError
from drivecal.storage import campaigns, evaluations, studies
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine import tables
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance import deletion
from drivecal.storage.maintenance.consistency import verify
from drivecal.storage.maintenance.deletion import delete_campaign
from drivecal.storage.references import influence_maps, reference_keys
from drivecal.storage.references import runs as runs_of


def carried_out(database: Database, **changes: Any) -> StoredCampaign:
    return run(database, submit(database, **SHORT | changes), ComputedBackend(answer=influenced))


def deleted(database: Database, stored: StoredCampaign) -> None:
    with database.transaction() as connection:
        delete_campaign(connection, stored.id)
    assert all(deletion.removal(database))


def listed(connection: Connection, *tags: str) -> list[str]:
    page, _ = campaigns.page(connection, conditions=campaigns.having(tags))
    return [stored.name for stored in page]


def cells(database: Database, stored: StoredCampaign) -> int:
    with database.read() as connection:
        query = select(func.count()).where(tables.evaluations.c.campaign_sequence == stored.sequence)
        return connection.scalar(query) or 0


def runs(database: Database) -> int:
    with database.read() as connection:
        return connection.scalar(select(func.count()).select_from(tables.runs)) or 0


def test_labels_are_changed_one_by_one_and_again_without_effect(connection: Connection) -> None:
    first = campaign(connection, "first")
    changed = campaigns.change_labels(connection, first.id, CampaignChanges(tags=["b", "a", "b"]))
    again = campaigns.change_labels(connection, first.id, CampaignChanges(tags=["a", "b"]))
    renamed = campaigns.change_labels(connection, first.id, CampaignChanges(name="other"))
    assert (changed.tags, changed.name) == (("a", "b"), "first")
    assert again == changed
    assert (renamed.name, renamed.tags, renamed.revision) == ("other", ("a", "b"), changed.revision + 1)


def test_tags_are_added_and_removed_beside_those_of_others(connection: Connection) -> None:
    first = campaigns.change_labels(connection, campaign(connection).id, CampaignChanges(tags=["theirs", "old"]))
    changed = campaigns.change_labels(
        connection, first.id, CampaignChanges(add_tags=["mine", "both"], remove_tags=["old", "both", "never"])
    )
    assert changed.tags == ("mine", "theirs")
    assert campaigns.change_labels(connection, first.id, CampaignChanges(add_tags=["mine"], remove_tags=["old"])) == changed
    many = [f"tag-{number}" for number in range(campaigns.MOST_TAGS - 1)]
    assert faults_of(campaigns.change_labels, connection, first.id, CampaignChanges(add_tags=many))[0].field == "add_tags"
    assert campaigns.change_labels(connection, first.id, CampaignChanges(add_tags=many, remove_tags=["mine"])).tags == tuple(
        sorted([*many, "theirs"])
    )


def test_tags_are_told_apart_by_case(connection: Connection) -> None:
    for name, tag in {"one": "Good", "two": "good"}.items():
        campaigns.change_labels(connection, campaign(connection, name).id, CampaignChanges(tags=[tag]))
    assert (listed(connection, "good"), listed(connection, "Good"), listed(connection, "GOOD")) == (["two"], ["one"], [])


def test_lists_take_campaigns_with_all_tags(connection: Connection) -> None:
    for name, tags in {"one": ["new", "a_b"], "two": ["new"], "three": ["ä"], "four": ["a%b", 'a"', 'b"x']}.items():
        campaigns.change_labels(connection, campaign(connection, name).id, CampaignChanges(tags=tags))
    assert listed(connection) == ["four", "three", "two", "one"]
    assert listed(connection, "new") == ["two", "one"]
    assert listed(connection, "new", "a_b") == ["one"]
    assert [listed(connection, tag) for tag in ("ä", "a%b", 'a"', 'b"x')] == [["three"], ["four"], ["four"], ["four"]]
    assert [listed(connection, tag) for tag in ("%", "ne", "axb", "x")] == [[], [], [], []]


def test_only_ended_campaigns_are_deleted(connection: Connection) -> None:
    queued = campaign(connection)
    with pytest.raises(ConflictError):
        delete_campaign(connection, queued.id)
    with pytest.raises(NotFoundError):
        delete_campaign(connection, "0" * 32)
    assert listed(connection) == ["campaign"]


@pytest.mark.slow
def test_runs_of_a_deleted_campaign_answer_others(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(deletion, "SLICE", 7)
    first = carried_out(database)
    stock = runs(database)
    simulated = sum(counts.simulated for counts in (first.counts(stage) for stage in first.stages))
    deleted(database, first)
    deleted(database, first)
    with database.read() as connection:
        assert listed(connection) == []
        with pytest.raises(NotFoundError):
            campaigns.get(connection, first.id)
    assert runs(database) == stock
    assert 0 < cells(database, first) <= simulated
    assert [problem for check in verify(database) for problem in check.problems] == []
    again = carried_out(database)
    assert runs(database) == stock
    assert get(database, again).best == first.best
    assert [problem for check in verify(database) for problem in check.problems] == []


@pytest.mark.parametrize("use", ["rerun", "robustness", "validation", "map"])
def test_a_campaign_that_others_refer_to_is_not_deleted(connection: Connection, use: str) -> None:
    first = campaigns.request_action(connection, campaign(connection).id, "cancel")
    common: dict[str, Any] = {"name": "map", "driving_function": "frenet", "parameters": [], "scenarios": {}}
    made = influence_maps.insert(connection, source=first.id, **common)
    uses: dict[str, tuple[str, dict[str, Any]]] = {
        "rerun": ("rerun of it", {"rerun_of": first.id}),
        "robustness": ("study of it", {"spec": {"robustness": {"of": first.id}}}),
        "validation": ("study of it", {"spec": {"validation": {"of": first.id}}}),
        "map": ("use of its influence map", {"influence_map_id": made.id}),
    }
    said, columns = uses[use]
    other = campaigns.insert(connection, **({"name": "other", "spec": {}} | columns))
    assert deletion.references(connection, first) == {other.id: said}
    with pytest.raises(ConflictError, match=other.id):
        delete_campaign(connection, first.id)
    campaigns.request_action(connection, other.id, "cancel")
    delete_campaign(connection, other.id)
    delete_campaign(connection, first.id)
    with pytest.raises(NotFoundError):
        influence_maps.get(connection, made.id)
    assert listed(connection) == []


def test_an_interrupted_deletion_goes_on(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    with database.transaction() as connection:
        first = campaigns.insert(connection, name="first", spec={})
        setup, sets = setup_id(connection), sample_set_ids(connection, 3)
        evaluations.insert(connection, first.sequence, [cell(n, setup, one) for n, one in enumerate(sets)])
        campaigns.end(connection, first.sequence, CampaignState.CANCELLED)
        studies.save(connection, first.sequence, StageName.ROBUSTNESS, {"items": []})
        delete_campaign(connection, first.id)
        assert listed(connection) == []
        assert studies.about(connection, first.id, first.sequence, None) == []
    monkeypatch.setattr(deletion, "SLICE", 2)
    assert next(deletion.removal(database))
    assert cells(database, first) == 1
    assert all(deletion.removal(database))
    assert cells(database, first) == 0
    assert not list(deletion.removal(database))


def test_keys_under_a_deleted_map_are_unused_and_go_in_slices(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(deletion, "KEYS", 2)
    with database.transaction() as connection:
        first = campaigns.request_action(connection, campaign(connection).id, "cancel")
        common: dict[str, Any] = {"name": "map", "driving_function": "frenet", "parameters": [], "scenarios": {}}
        made = influence_maps.insert(connection, source=first.id, **common)
        setup, sets = setup_id(connection), sample_set_ids(connection, 5)
        number = evaluations.insert(connection, first.sequence, [cell(n, setup, one) for n, one in enumerate(sets)])
        runs_of.insert_results(connection, [new_run(setup, one, evaluation=n) for one, n in zip(sets, number, strict=True)])
    for under in (made.sequence, made.sequence + 1):
        reference_keys.sync(
            database, under, setup, EVALUATOR, 10**9, lambda _, values: [n.to_bytes(16, "big") for n in range(len(values))]
        )
    with database.transaction() as connection:
        delete_campaign(connection, first.id)

    def keys() -> int:
        with database.read() as connection:
            return connection.execute(select(func.count()).select_from(tables.reference_keys)).scalar_one()

    left = [keys(), *(keys() for _ in deletion.removal(database)), keys()]
    assert left[0] == 10
    assert left[-1] == 5
    assert all(before - after <= 3 for before, after in pairwise(left))
