"""After a contradicted certificate nothing is certified in its setup, and certified answers beside it are simulated instead."""

from __future__ import annotations

from tests.support.computed import ComputedBackend, rating_of

from drivecal.contracts.work import Cell, CellResult, DriveRequest, Probe
from drivecal.execution.pool import WorkPool
from drivecal.execution.scheduling.dispatches import Completed
from drivecal.execution.scheduling.in_flight import Work


def setup(scenario: str) -> DriveRequest:
    return DriveRequest("highway", scenario, "frenet", "single_track", {}, "reference", f"fingerprint of {scenario}")


def rated(scenario: str, cell: Cell) -> CellResult:
    return CellResult(cell.id, rating_of(scenario, cell), 1, {}, None, 7.0)


def drain(pool: WorkPool, tag: str) -> list[Completed]:
    completed: list[Completed] = []
    while pool.held(tag):
        completed += pool.poll(1.0)
    return completed


def cells(first: int, count: int, *, check: int | None = None) -> list[Cell]:
    return [
        Cell(number, {"P1": number / 7}, certify=True, check=number == check, probes=(Probe(1000, {"P1": 0.0}),))
        for number in range(first, first + count)
    ]


def test_cells_of_the_setup_are_simulated_from_then_on_and_those_of_others_still_certified() -> None:
    pool = WorkPool(ComputedBackend(answer=rated, class_of=lambda scenario, _: scenario))
    pool.submit(Work(setup("S1"), cells(1, 8)), tag="a")
    pool.submit(Work(setup("S2"), cells(101, 8)), tag="a")
    assert sum(entry.result.proven_by is not None for entry in drain(pool, "a")) == 14
    pool.submit(Work(setup("S1"), cells(11, 1, check=11)), tag="a")
    [contradiction] = drain(pool, "a")
    assert contradiction.result.agrees is False
    pool.submit(Work(setup("S1"), cells(21, 8)), tag="b")
    pool.submit(Work(setup("S2"), cells(121, 8)), tag="b")
    answers = {entry.result.id: entry.result for entry in drain(pool, "b")}
    assert {number for number, answer in answers.items() if answer.proven_by is not None} == set(range(121, 129))
    assert {answer.probed for number, answer in answers.items() if number < 100} == {()}
    assert {number: answers[number].rating for number in range(21, 29)} == {
        cell.id: rating_of("S1", cell) for cell in cells(21, 8)
    }


def test_certified_answers_that_arrive_with_the_contradiction_are_simulated_instead() -> None:
    for seed in range(20):
        pool = WorkPool(ComputedBackend(answer=rated, class_of=lambda scenario, _: scenario, seed=seed))
        pool.submit(Work(setup("S1"), cells(1, 1)), tag="a")
        drain(pool, "a")
        pool.submit(Work(setup("S1"), cells(11, 8, check=18)), tag="a")
        completed: list[Completed] = []
        while not any(entry.result.agrees is False for entry in completed):
            completed = pool.poll(1.0)
        assert [entry.result.proven_by for entry in completed if entry.result.agrees is None] == [None] * (len(completed) - 1)
        assert {entry.result.probed for entry in completed} == {()}
        assert all(entry.result.proven_by is None for entry in drain(pool, "a"))
