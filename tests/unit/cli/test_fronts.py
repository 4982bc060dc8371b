"""Fronts on the terminal."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivecal.cli.views.fronts import front_blocks, shown_of_front
from drivecal.cli.views.output import print_blocks
from drivecal.contracts.results import FrontObjective, FrontSummary
from drivecal.contracts.tables import FrontRow

SIZE, KNEE = 30, 25


def row(rank: int) -> FrontRow:
    ends = {1: ["comfort"], SIZE: ["jerk"]}
    return FrontRow(
        rank=rank, objectives={"comfort": 7 - rank / 10, "jerk": 9 - rank / 10}, violation=0, knee=rank == KNEE,
        best_in=ends.get(rank, []), wins=None, weights=None, alternatives=1, degree=None, scores={"S1": 5}, reused=[],
        parameters={"P1": rank}, iteration=0, individual=rank,
    )  # fmt: skip


ROWS = [row(rank) for rank in range(1, SIZE + 1)]
SUMMARY = FrontSummary(
    objectives=[
        FrontObjective(
            name="jerk", unit="m/s3", direction="minimise", aggregate="max", scenarios={"S1": 1}, tolerance=0, reference=20, best=6,
            worst=8.9,
        )
    ],
    constraints=[], evaluated=400, feasible=390, size=SIZE, copied=0, knee=KNEE, hypervolume=None, growth=[],
)  # fmt: skip


@pytest.mark.parametrize(("limit", "ranks"), [(4, [1, 13, KNEE, SIZE]), (1, [1, KNEE, SIZE]), (99, list(range(1, SIZE + 1)))])
def test_knee_extremes_and_sets_spread_over_the_front_are_shown(limit: int, ranks: list[int]) -> None:
    assert [kept.rank for kept in shown_of_front(ROWS, limit)] == ranks


def test_under_weights_the_first_sets_are_shown() -> None:
    weighted = [each.model_copy(update={"weighted": 1 - each.rank / 100}) for each in ROWS]
    assert [kept.rank for kept in shown_of_front(weighted, 5)] == [1, 2, 3, KNEE, SIZE]


@given(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)), max_size=25), st.integers(1, 30))
def test_as_many_different_sets_as_asked_for_are_shown(points: list[tuple[float, float]], limit: int) -> None:
    rows = [
        row(rank).model_copy(update={"objectives": {"a": a, "b": b}, "knee": False, "best_in": []})
        for rank, (a, b) in enumerate(points, 1)
    ]
    ranks = [kept.rank for kept in shown_of_front(rows, limit)]
    assert ranks == sorted(set(ranks))
    assert len(ranks) == min(limit, len(rows))


def test_as_many_sets_are_listed_as_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    print_blocks(front_blocks(ROWS, SUMMARY, 4))
    printed = capsys.readouterr().out
    assert [int(line.split()[0]) for line in printed.splitlines()[-4:]] == [1, 13, KNEE, SIZE]
    assert f"4 of {SIZE}" in printed
