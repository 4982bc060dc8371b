"""The pool on a backend whose time is computed: attempts, sizes of batches, priorities, withdrawal."""

from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.support.fake_backend import Behaviour, FakeBackend
from tests.support.pooled import MemoryLeases, cells, drain
from tests.support.setups import bare as setup

from drivecal.contracts.work import Cell
from drivecal.execution.pool import WorkPool
from drivecal.execution.scheduling.in_flight import Completed, Work
from drivecal.execution.scheduling.scheduler import ATTEMPTS


def test_a_poison_cell_costs_three_attempts_and_none_of_its_neighbours() -> None:
    for poison, cause in ((Behaviour.CRASH, "crash"), (Behaviour.HANG, "hang"), (Behaviour.MEMORY, "memory")):
        backend = FakeBackend()
        pool = WorkPool(backend, MemoryLeases())
        pool.submit(Work(setup(), cells([Behaviour.WELL] * 300)), tag="a")
        pool.submit(Work(setup("S2"), cells([Behaviour.WELL] * 20 + [poison] + [Behaviour.WELL] * 279, first=1001)), tag="a")
        completed = drain(pool)
        assert len(completed) == 600
        [failed] = [entry for entry in completed if entry.result.breakdown is not None]
        assert (failed.result.id, failed.result.breakdown, failed.attempts) == (1021, cause, ATTEMPTS)
        assert backend.attempts[1021] == ATTEMPTS
        assert max(count for cell, count in backend.attempts.items() if cell != 1021) <= ATTEMPTS


def test_batches_take_half_a_second_whatever_a_cell_costs() -> None:
    backend = FakeBackend(seconds_per_cell={"S1": 0.007, "S2": 0.1, "S3": 3.0, "S4": 0.0001})
    pool = WorkPool(backend, MemoryLeases())
    for index, scenario in enumerate(("S1", "S2", "S3", "S4")):
        count = 40 if scenario == "S3" else 1000
        pool.submit(Work(setup(scenario), cells([Behaviour.WELL] * count, first=1 + 10_000 * index)), tag="a")
    drain(pool)
    typical = {
        scenario: Counter(size for _, name, size in backend.sizes if name == scenario).most_common(1)[0][0]
        for scenario in ("S1", "S2", "S3")
    }
    assert typical["S1"] in range(60, 81)
    assert typical["S2"] == 4
    assert typical["S3"] == 1
    assert max(size for _, name, size in backend.sizes if name == "S4") == 128
    assert next(size for _, name, size in backend.sizes if name == "S1") == 1  # a probe: nothing was known


def test_the_setups_of_a_generation_are_spread_over_the_workers() -> None:
    backend = FakeBackend(3)
    pool = WorkPool(backend, MemoryLeases())
    for generation in range(3):
        begun = len(backend.sizes)
        works = [
            Work(setup(scenario), cells([Behaviour.WELL] * 300, first=1 + 1000 * (3 * generation + index)))
            for index, scenario in enumerate(("S1", "S2", "S3"))
        ]
        pool.submit(*works, tag="a")
        assert {scenario for _, scenario, _ in backend.sizes[begun : begun + 3]} == {"S1", "S2", "S3"}
        drain(pool)


def test_a_cell_cannot_be_in_flight_twice() -> None:
    pool = WorkPool(FakeBackend(), leases := MemoryLeases())
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 3)), tag="a")
    with pytest.raises(ValueError, match=r"\[1\]"):
        pool.submit(Work(setup("S2"), cells([Behaviour.WELL])), tag="a")
    with pytest.raises(ValueError, match=r"\[9, 9\]"):
        pool.submit(Work(setup(), [Cell(9, {}), Cell(9, {})]), tag="a")
    assert len(drain(pool)) == 3
    leases.held.clear()
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 3)), tag="a")
    assert len(drain(pool)) == 3


_step = st.one_of(
    st.tuples(
        st.just("submit"),
        st.lists(st.sampled_from(Behaviour), min_size=1, max_size=80),
        st.sampled_from(["S1", "S2", "S3"]),
        st.sampled_from(["a", "b"]),
        st.integers(0, 1),
    ),
    st.tuples(st.just("poll"), st.floats(0.0, 3.0)),
    st.tuples(st.just("kill"), st.integers(0, 7)),
    st.tuples(st.just("repeat"), st.integers(1, 60)),
    st.tuples(st.just("withdraw"), st.sampled_from(["a", "b"])),
    st.tuples(st.just("spoil"), st.integers(1, 5)),
    st.tuples(st.just("refuse"), st.integers(1, 5)),
)


@given(st.integers(1, 5), st.lists(_step, max_size=30))
@settings(max_examples=examples(120), deadline=None)
def test_every_cell_comes_back_exactly_once_whatever_happens(workers: int, steps: list[tuple[object, ...]]) -> None:
    backend = FakeBackend(workers, {"S1": 0.007, "S2": 0.5})
    pool = WorkPool(backend, MemoryLeases(), clock=lambda: backend.now)
    submitted: dict[int, Behaviour] = {}
    tags: dict[int, str] = {}
    completed: list[Completed] = []
    kills, withdrawn = 0, set()
    for step in steps:
        match step:
            case ("submit", list(behaviours), str(scenario), str(tag), int(priority)):
                new = cells(behaviours, first=len(submitted) + 1)
                submitted |= {cell.id: behaviour for cell, behaviour in zip(new, behaviours, strict=True)}
                tags |= {cell.id: tag for cell in new}
                pool.submit(Work(setup(scenario), new), tag=tag, priority=priority)
            case ("poll", float(timeout)):
                completed += pool.poll(timeout)
            case ("kill", int(index)):
                backend.kill(index)
                kills += 1
            case ("repeat", int(batch_id)):
                backend.repeat(batch_id)
            case ("withdraw", str(tag)):
                held = pool.held(tag)
                running = pool.withdraw(tag)
                assert pool.held(tag) == running <= held
                withdrawn |= {cell for cell, its in tags.items() if its == tag}
            case ("spoil", int(place)):
                backend.bad.add(place)
            case ("refuse", int(place)):
                backend.refusing[place] = "it has another version"
    if len(backend.refusing.keys() & set(range(1, workers + 1))) == workers:
        backend.refusing.clear()
    completed += drain(pool)
    ids = [entry.result.id for entry in completed]
    assert len(set(ids)) == len(ids), "a cell came back twice"
    assert set(submitted) - set(ids) <= withdrawn, "a cell was lost"
    assert max(backend.attempts.values(), default=0) <= ATTEMPTS + kills
    causes = {None: Behaviour.WELL, "crash": Behaviour.CRASH, "hang": Behaviour.HANG}
    causes |= {"error": Behaviour.ERROR, "memory": Behaviour.MEMORY}
    for entry in completed:
        if kills == 0 and not backend.bad:
            assert causes[entry.result.breakdown] is submitted[entry.result.id]
        elif submitted[entry.result.id] is not Behaviour.WELL:
            assert entry.result.breakdown is not None
