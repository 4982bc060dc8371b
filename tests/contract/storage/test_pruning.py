"""Pruning on both databases: groups of old campaigns go whole, and the others answer as before."""

from datetime import timedelta
from typing import Any

import pytest
from sqlalchemy import text
from tests.support.pruning import SPACE, answers, problems, set_column
from tests.support.runs import get, nothing_matters, post_map, run, submit

from drivecal.domain.errors import ConflictError
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now
from drivecal.storage.retention.deletion import delete_campaign, remove_cells
from drivecal.storage.retention.pruning import PruningPlan, carry_out, plan

LONG = timedelta(days=200)
SMALL: dict[str, Any] = {
    "parameters": SPACE,
    "catalogue": ["S1"],
    "optimizer": {"kind": "genetic", "population": 8, "iterations": 2, "seed": 1},
}
OTHER = SMALL | {"catalogue": ["S2"]}
"""On another setup."""
TABLES = ("campaigns", "evaluations", "runs", "ratings", "reference_keys", "reference_indexes", "influence_maps", "events")


def planned(database: Database) -> PruningPlan:
    return plan(database, now() - LONG / 2)


def aged(database: Database, campaign: StoredCampaign) -> StoredCampaign:
    set_column(database, campaign, "ended_at", (now() - LONG).strftime("%Y-%m-%d %H:%M:%S.%f+00"))
    return get(database, campaign)


def going(pruning: PruningPlan) -> set[str]:
    return {each.id for group in pruning.groups for each in group.campaigns}


def left(database: Database) -> list[int]:
    with database.read() as connection:
        return [connection.execute(text(f"SELECT count(*) FROM {table}")).scalar_one() for table in TABLES]


def test_a_group_goes_whole_and_the_others_answer_as_before(database: Database) -> None:
    maps = post_map(database, nothing_matters())
    young = run(database, submit(database, **OTHER))
    before = left(database)
    old = aged(database, run(database, submit(database, stored_map=maps, **SMALL)))
    copied = aged(database, run(database, submit(database, stored_map=maps, **SMALL | {"name": "again"})))
    assert copied.cells.simulated == 0
    known = answers(database, young)
    pruning = planned(database)
    assert going(pruning) == {old.id, copied.id}
    assert (
        pruning.cells == {each.sequence: each.cells.requested + each.cells.carried_over for each in (old, copied)}
        or pruning.runs
    )
    carry_out(database, pruning)
    assert left(database) == before
    assert answers(database, young) == known
    assert problems(database) == []
    assert planned(database).groups == []


@pytest.mark.parametrize("link", ["setup", "rerun_of", "spec"])
def test_an_old_campaign_stays_while_a_younger_one_is_linked_to_it(database: Database, link: str) -> None:
    old = aged(database, run(database, submit(database, **SMALL)))
    younger = run(database, submit(database, **SMALL if link == "setup" else OTHER))
    if link == "rerun_of":
        set_column(database, younger, "rerun_of", old.id)
    elif link == "spec":
        with database.transaction() as connection:
            statement = text("UPDATE campaigns SET spec = replace(CAST(spec AS TEXT), '\"S2\"', :id) WHERE sequence = :number")
            if connection.dialect.name == "postgresql":
                statement = text(
                    "UPDATE campaigns SET spec = CAST(replace(CAST(spec AS TEXT), '\"S2\"', :id) AS JSON) WHERE sequence = :number"
                )
            connection.execute(statement, {"id": f'"{old.id}"', "number": younger.sequence})
    pruning = planned(database)
    assert pruning.groups == []
    assert [(each.id, other.id) for each, other in pruning.spared] == [(old.id, younger.id)]


def test_a_campaign_that_comes_after_the_plan_keeps_what_it_may_use(database: Database) -> None:
    old = aged(database, run(database, submit(database, **SMALL)))
    pruning = planned(database)
    run(database, submit(database, **SMALL))
    known = answers(database, old)
    with pytest.raises(ConflictError):
        carry_out(database, pruning)
    assert answers(database, old) == known


def test_a_campaign_that_is_starting_is_waited_for(database: Database) -> None:
    aged(database, run(database, submit(database, **SMALL)))
    starting = submit(database, **OTHER)
    set_column(database, starting, "started_at", now().strftime("%Y-%m-%d %H:%M:%S.%f+00"))
    with pytest.raises(ConflictError, match=starting.id):
        planned(database)


def test_what_a_deleted_campaign_left_goes_with_its_group(database: Database) -> None:
    empty = left(database)
    first = aged(database, run(database, submit(database, **SMALL)))
    with database.transaction() as connection:
        number = delete_campaign(connection, first.id)
    remove_cells(database, number)
    carry_out(database, planned(database))
    assert left(database) == empty
