"""Fronts on the terminal."""

import pytest

from drivecal.cli.views.fronts import front_blocks, front_lines, shown_of_front
from drivecal.cli.views.output import print_blocks
from drivecal.contracts.results import FrontBaseline, FrontObjective, FrontSummary
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
            name="jerk", unit="m/s3", direction="minimise", aggregate="max", scenarios={"S1": 1}, tolerance=0, best=6, worst=8.9,
        )
    ],
    constraints=[], evaluated=400, feasible=390, size=SIZE, copied=0, knee=KNEE, growth=[],
)  # fmt: skip


@pytest.mark.parametrize(("limit", "ranks"), [(4, [1, 2, KNEE, SIZE]), (1, [1, KNEE, SIZE]), (99, list(range(1, SIZE + 1)))])
def test_knee_extremes_and_the_first_others_are_shown(limit: int, ranks: list[int]) -> None:
    assert [kept.rank for kept in shown_of_front(ROWS, limit)] == ranks


def test_as_many_sets_are_listed_as_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    print_blocks(front_blocks(ROWS, SUMMARY, 4))
    printed = capsys.readouterr().out
    assert [int(line.split()[0]) for line in printed.splitlines()[-4:]] == [1, 2, KNEE, SIZE]
    assert f"4 of {SIZE}" in printed


def test_a_baseline_with_undecided_rates_breaks_nothing_by_a_figure() -> None:
    undecided = FrontBaseline(objectives={"jerk": 7}, violation=0.0009, undecided=True, rank=None)
    (line,) = (line for line in front_lines(SUMMARY.model_copy(update={"baseline": undecided})) if line.startswith("baseline"))
    assert "%" not in line
