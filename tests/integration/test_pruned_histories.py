"""Histories of campaigns, pruned and killed on the way: the rest stays whole and answers as before."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from sqlalchemy import Connection
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.effort import examples
from tests.support.pruning import CUTOFF, SPACE, answers, carry_out, dangling, planned, problems, set_column
from tests.support.runs import get, influenced, nothing_matters, post_map, run, submit

from drivecal.api.tables.ranking import ranking
from drivecal.campaigns import retention
from drivecal.campaigns.resolve.resolved_spec import resolved_spec
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.types import now

KINDS = ("exact", "influence", "predicted", "off")


@dataclass(frozen=True)
class Told:
    """A campaign of a history."""

    kind: str
    seed: int
    old: bool
    reruns: int | None
    """Position of the campaign that it names as its first, if there is such a position."""


campaigns_of_a_history = st.builds(
    Told, kind=st.sampled_from(KINDS), seed=st.integers(1, 2), old=st.booleans(), reruns=st.none() | st.integers(0, 3)
)


class KilledError(Exception):
    """Stands for the end of the process."""


@contextmanager
def fresh() -> Iterator[Database]:
    with tempfile.TemporaryDirectory() as folder:
        opened = migrated(f"sqlite:///{Path(folder) / 'drivecal.db'}")
        yield opened
        opened.dispose()


def tell(database: Database, history: list[Told]) -> list[StoredCampaign]:
    """Carries a history out, one campaign after the other; old ones ended 200 days ago."""
    stored = post_map(database, nothing_matters())
    made: list[StoredCampaign] = []
    for one in history:
        search = {"kind": "genetic", "population": 60 if one.kind == "predicted" else 8, "iterations": 2, "seed": one.seed}
        backend = ComputedBackend(answer=influenced)
        campaign = submit(
            database,
            stored_map=stored if one.kind == "influence" else None,
            parameters=SPACE,
            catalogue=["S1", "S2"],
            optimizer=search,
            reduction={"mode": one.kind},
        )
        if one.reruns is not None and one.reruns < len(made):
            set_column(database, campaign, "rerun_of", made[one.reruns].id)
        run(database, campaign, backend)
        if one.old:
            set_column(database, campaign, "ended_at", (now() - 2 * CUTOFF).strftime("%Y-%m-%d %H:%M:%S.%f"))
        made.append(get(database, campaign))
    return made


@settings(max_examples=examples(2))
@example([Told("influence", 1, True, None), Told("influence", 2, True, None), Told("exact", 1, False, None)], 1, 3)
@given(
    history=st.lists(campaigns_of_a_history, min_size=2, max_size=3),
    keep_best=st.integers(0, 3),
    killed_after=st.none() | st.integers(1, 12),
)
def test_whatever_is_pruned_and_killed_the_rest_is_whole_and_answers_as_before(
    history: list[Told], keep_best: int, killed_after: int | None
) -> None:
    with fresh() as database:
        prune_a_history(database, history, keep_best, killed_after)


def prune_a_history(
    database: Database, history: list[Told], keep_best: int, killed_after: int | None, *, is_killed: bool = False
) -> int:
    """Carries a history out and prunes it, in small portions, killed once unless it has too few (`is_killed`: it has not); everything
    that stays has to answer as before. Returns the number of cells that the first plan removes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(retention, "SLICE", 7)
        patch.setattr(retention, "CAMPAIGNS", 1)
        made = tell(database, history)
        plan = planned(database, keep_best)
        doomed: int = plan.doomed.cells
        prunable = {campaign.sequence for campaign in plan.selection.prunable}
        assert prunable <= {campaign.sequence for campaign, one in zip(made, history, strict=True) if one.old}
        kept = {campaign.sequence: answers(database, campaign) for campaign in made if campaign.sequence not in prunable}
        best = {
            campaign.sequence: ranking(database, campaign, resolved_spec(campaign), None).solutions(0, keep_best)
            for campaign in made
            if campaign.sequence in prunable
        }
        if killed_after is not None:
            with pytest.raises(KilledError) if is_killed else suppress(KilledError):
                carry_out(dying(database, killed_after), plan)
            assert problems(database) == []
            plan = planned(database, keep_best)
            assert not is_killed or 0 < plan.doomed.cells < doomed, "it was killed among the cells"
        carry_out(database, plan)
        assert problems(database) == []
        with database.read() as connection:
            assert dangling(connection) == 0
        for campaign in made:
            if campaign.sequence in kept:
                assert answers(database, campaign) == kept[campaign.sequence]
            else:
                left = ranking(database, campaign, resolved_spec(campaign), None).solutions(0, keep_best)
                assert left == best[campaign.sequence]
        assert planned(database, keep_best).doomed.cells == 0
    return doomed


def dying(database: Database, transactions: int) -> Database:
    """The same database for a process that is killed in the middle of its transaction of this number."""
    left = iter(range(transactions))

    class Dying(Database):
        @contextmanager
        def transaction(self) -> Iterator[Connection]:
            with super().transaction() as connection:
                yield connection
                if next(left, None) is None:
                    raise KilledError

    return Dying(database.url, database._engine)  # the same pool
