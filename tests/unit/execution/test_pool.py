from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from tests.support.fake_backend import Behaviour, FakeBackend

from drivecal.contracts.work import Cell, DriveRequest
from drivecal.execution.pool import PATIENCE_WITH_REFUSALS, WorkPool
from drivecal.execution.scheduling.in_flight import WITNESSES, Work
from drivecal.execution.scheduling.scheduler import ATTEMPTS, Completed
from drivecal.execution.scheduling.worker_health import BATCHES_WITHOUT_RESULT


def setup(scenario: str = "S1") -> DriveRequest:
    return DriveRequest("highway", scenario, "frenet", "single_track", {}, "reference", f"fingerprint of {scenario}")


def cells(behaviours: Sequence[Behaviour], first: int = 1) -> list[Cell]:
    """No two are identical: they would be simulated once."""
    return [
        Cell(first + index, {"behaviour": float(one), "number": float(first + index)}) for index, one in enumerate(behaviours)
    ]


TAGS = ("a", "b", "c", "others", "campaign-7")
"""All that these tests use."""


def drain(pool: WorkPool, patience: int = 100_000) -> list[Completed]:
    completed: list[Completed] = []
    for _ in range(patience):
        if not any(pool.held(tag) for tag in TAGS):
            return completed
        completed += pool.poll(1.0)
    raise AssertionError(f"cells never came back: { ({tag: pool.held(tag) for tag in TAGS}) }")


def test_every_cell_comes_back_with_its_own_result() -> None:
    pool = WorkPool(FakeBackend())
    pool.submit(Work(setup(), [Cell(index, {"value": index / 10}) for index in range(50)]), tag="a")
    found = {completed.result.id: completed.result.rating for completed in drain(pool)}
    assert found == {index: index / 10 for index in range(50)}


def test_a_poison_cell_costs_three_attempts_and_none_of_its_neighbours() -> None:
    for poison, cause in ((Behaviour.CRASH, "crash"), (Behaviour.HANG, "hang"), (Behaviour.MEMORY, "memory")):
        backend = FakeBackend()
        pool = WorkPool(backend)
        pool.submit(Work(setup(), cells([Behaviour.WELL] * 300)), tag="a")
        pool.submit(Work(setup("S2"), cells([Behaviour.WELL] * 20 + [poison] + [Behaviour.WELL] * 279, first=1001)), tag="a")
        completed = drain(pool)
        assert len(completed) == 600
        [failed] = [one for one in completed if one.result.breakdown is not None]
        assert (failed.result.id, failed.result.breakdown, failed.attempts) == (1021, cause, ATTEMPTS)
        assert backend.attempts[1021] == ATTEMPTS
        assert max(count for cell, count in backend.attempts.items() if cell != 1021) <= ATTEMPTS


def test_only_the_first_death_puts_others_under_suspicion() -> None:
    backend = FakeBackend()
    pool = WorkPool(backend)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 10 + [Behaviour.CRASH] + [Behaviour.WELL] * 989)), tag="a")
    completed = drain(pool)
    suspects = [one for one in completed if one.attempts > 1]
    assert len(suspects) <= 2 * 72  # what one worker held: two batches of half a second
    assert all(one.attempts == 2 for one in suspects if one.result.id != 11)


def test_an_exception_is_tried_once_more_alone_on_another_worker(caplog: pytest.LogCaptureFixture) -> None:
    backend = FakeBackend()
    pool = WorkPool(backend)
    pool.submit(Work(setup(), cells([Behaviour.WELL, Behaviour.ERROR, Behaviour.WELL])), tag="campaign-7")
    [failed] = [one for one in drain(pool) if one.result.breakdown is not None]
    assert (failed.result.id, failed.result.breakdown, failed.attempts) == (2, "error", WITNESSES)
    assert failed.result.detail == "ValueError: as asked for"
    assert backend.replaced == []
    [(line, campaign)] = [(record.getMessage(), record.__dict__["campaign"]) for record in caplog.records]
    assert campaign == "campaign-7"
    assert line.startswith("cell 2 has no result after 2 attempts (error, at last on worker-")
    assert line.endswith("; failure 1 of this campaign): ValueError: as asked for")


def test_the_only_worker_is_replaced_once_before_its_exceptions_count() -> None:
    backend = FakeBackend(1)
    pool = WorkPool(backend)
    behaviours = [Behaviour.WELL] * 500
    for index in (3, 77, 200, 431):
        behaviours[index] = Behaviour.ERROR
    pool.submit(Work(setup(), cells(behaviours)), tag="a")
    failed = {one.result.id: one for one in drain(pool) if one.result.breakdown is not None}
    assert sorted(failed) == [4, 78, 201, 432]
    assert {one.worker for one in failed.values()} == {"worker-1.2"}
    assert backend.replaced == [("worker-1", None)]
    assert pool.trouble() is None


def test_exceptions_at_the_only_worker_are_settled_while_others_keep_it_busy() -> None:
    backend = FakeBackend(1)
    pool = WorkPool(backend)
    pool.submit(Work(setup(), cells([Behaviour.ERROR])), tag="a")
    first, settled_after = 2, None
    while settled_after is None:
        assert first < 50_000, "the suspect starves"
        if sum(pool.held(tag) for tag in TAGS) < 1000:
            pool.submit(Work(setup("S2"), cells([Behaviour.WELL] * 1000, first=first)), tag="b")
            first += 1000
        settled_after = next((backend.now for one in pool.poll(1.0) if one.tag == "a"), None)
    assert settled_after < 120.0


@pytest.mark.parametrize(("workers", "bad"), [(4, {1}), (4, {2, 3}), (4, {1, 2, 4}), (2, {2})])
def test_bad_workers_cost_no_good_cell(workers: int, bad: set[int]) -> None:
    backend = FakeBackend(workers, bad=bad)
    pool = WorkPool(backend)
    behaviours = [Behaviour.WELL] * 6000
    behaviours[1234] = Behaviour.ERROR
    pool.submit(Work(setup(), cells(behaviours)), tag="a")
    completed = drain(pool)
    assert len(completed) == 6000
    assert [one.result.id for one in completed if one.result.breakdown is not None] == [1235]
    assert {worker.split("-")[1].split(".")[0] for worker, _ in backend.replaced} == {str(place) for place in bad}
    for _, fault in backend.replaced:
        count, words = (fault or "").split(maxsplit=1)
        assert int(count) in {BATCHES_WITHOUT_RESULT, BATCHES_WITHOUT_RESULT + 1}
        assert words.endswith(": SUMO is gone")
    spoilt = sum(count - 1 for count in backend.attempts.values())
    assert spoilt < 1500, "bad workers are given little"


def test_a_worker_that_is_spoilt_comes_back_to_life_by_its_replacement() -> None:
    backend = FakeBackend(1)
    pool = WorkPool(backend)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 1000)), tag="a")
    completed = pool.poll(1.0)
    backend.bad = {1}
    while not backend.replaced:
        completed += pool.poll(1.0)
    assert "SUMO is gone" in (pool.trouble() or "")
    backend.bad = set()
    completed += drain(pool)
    assert len(completed) == 1000
    assert all(one.result.breakdown is None for one in completed)
    assert pool.trouble() is None


def test_a_campaign_of_errors_comes_to_its_end_and_costs_few_workers_and_words(caplog: pytest.LogCaptureFixture) -> None:
    backend = FakeBackend(4)
    pool = WorkPool(backend)
    pool.submit(Work(setup(), cells([Behaviour.ERROR] * 1000)), tag="a")
    completed = drain(pool)
    assert len(completed) == 1000
    assert {(one.result.breakdown, one.attempts) for one in completed} == {("error", WITNESSES)}
    assert len(backend.replaced) <= 8
    assert len(caplog.records) < 40


def test_refusals_are_no_attempts_and_leave_the_work_to_those_who_can() -> None:
    backend = FakeBackend(3, refusing={1: "it has no frenet", 3: "it has no frenet"})
    pool = WorkPool(backend, clock=lambda: backend.now)
    pool.submit(Work(setup(), cells([Behaviour.ERROR, *[Behaviour.WELL] * 99, Behaviour.CRASH])), tag="a")
    completed = pool.poll(0.0)
    while "2 workers refuse" not in (pool.trouble() or ""):
        completed += pool.poll(0.01)
    assert pool.trouble() == "2 workers refuse S1: it has no frenet"
    completed += drain(pool)
    assert sorted(one.result.id for one in completed) == list(range(1, 102))
    failed = {one.result.id: one.attempts for one in completed if one.result.breakdown is not None}
    assert failed == {1: WITNESSES, 101: ATTEMPTS}
    assert {one.worker.split(".")[0] for one in completed} == {"worker-2"}
    assert pool.trouble() is None


def test_cells_that_every_worker_refuses_wait_until_one_is_mended(caplog: pytest.LogCaptureFixture) -> None:
    backend = FakeBackend(2, refusing={1: "it has version 2", 2: "it has version 2"})
    pool = WorkPool(backend, clock=lambda: backend.now)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 50)), tag="a")
    pool.submit(Work(setup("S2"), cells([Behaviour.WELL] * 50, first=101)), tag="b")
    troubles = set()
    while backend.now < 5 * PATIENCE_WITH_REFUSALS:
        assert pool.poll(1.0) == []
        if backend.now > 1.0:
            troubles.add(pool.trouble())
    assert pool.held("a") == 50
    assert troubles == {f"{number} workers refuse S1, S2: it has version 2" for number in (2, 3, 4)} & troubles
    assert "worker-1 refuses: it has version 2" in caplog.text
    assert pool.withdraw("b") == 0
    backend.refusing.clear()
    completed = drain(pool)
    assert len(completed) == 50
    assert {one.attempts for one in completed} == {1}
    assert pool.trouble() is None
    assert backend.now < 7 * PATIENCE_WITH_REFUSALS


def test_a_refusal_of_long_ago_does_not_replace_a_worker_at_another_one(caplog: pytest.LogCaptureFixture) -> None:
    backend = FakeBackend(1, refusing={1: "it has version 2"})
    pool = WorkPool(backend, clock=lambda: backend.now)
    pool.submit(Work(setup(), cells([Behaviour.WELL])), tag="a")
    while pool.trouble() is None:
        pool.poll(1.0)
    pool.withdraw("a")
    while backend.now < 3 * PATIENCE_WITH_REFUSALS:
        pool.poll(1.0)
    backend.refusing[1] = "it has no model"
    begin = backend.now
    pool.submit(Work(setup("S2"), cells([Behaviour.WELL])), tag="b")
    while backend.now < begin + 0.9 * PATIENCE_WITH_REFUSALS:
        pool.poll(1.0)
    assert backend.replaced == []
    assert "worker-1 refuses: it has no model" in caplog.text
    while not backend.replaced:
        assert backend.now < begin + 2 * PATIENCE_WITH_REFUSALS
        pool.poll(1.0)


@pytest.mark.parametrize("behaviour", [Behaviour.ERROR, Behaviour.CRASH])
@pytest.mark.parametrize("workers", [1, 2, 12])
def test_where_everything_fails_the_first_sets_fail_first_in_all_scenarios(workers: int, behaviour: Behaviour) -> None:
    backend = FakeBackend(workers)
    pool = WorkPool(backend, clock=lambda: backend.now)
    work = [
        Work(
            setup(f"S{scenario}"),
            [Cell(100 * scenario + number, {"behaviour": behaviour, "x": number}) for number in range(50)],
        )
        for scenario in range(1, 7)
    ]
    pool.submit(*work, tag="a")
    completed: list[int] = []
    while len(completed) < 60:
        completed += [entry.result.id for entry in pool.poll(0.002)]
    assert {100 * scenario + number for scenario in range(1, 7) for number in range(5)} <= set(completed)


def test_batches_take_half_a_second_whatever_a_cell_costs() -> None:
    backend = FakeBackend(seconds_per_cell={"S1": 0.007, "S2": 0.1, "S3": 3.0, "S4": 0.0001})
    pool = WorkPool(backend)
    for index, scenario in enumerate(("S1", "S2", "S3", "S4")):
        count = 40 if scenario == "S3" else 1000
        pool.submit(Work(setup(scenario), cells([Behaviour.WELL] * count, first=1 + 10_000 * index)), tag="a")
    drain(pool)
    typical = {
        scenario: Counter(size for _, one, size in backend.sizes if one == scenario).most_common(1)[0][0]
        for scenario in ("S1", "S2", "S3")
    }
    assert typical["S1"] in range(60, 81)
    assert typical["S2"] == 4
    assert typical["S3"] == 1
    assert max(size for _, one, size in backend.sizes if one == "S4") == 128
    assert next(size for _, one, size in backend.sizes if one == "S1") == 1  # a probe: nothing was known


@pytest.mark.parametrize("workers", [1, 2, 4, 16])
def test_workers_finish_together(workers: int) -> None:
    backend = FakeBackend(workers, {"S1": 0.0071, "S2": 0.0043})
    pool = WorkPool(backend)
    pool.submit(Work(setup("S1"), cells([Behaviour.WELL] * 250 * workers)), tag="a")
    pool.submit(Work(setup("S2"), cells([Behaviour.WELL] * 250 * workers, first=100_001)), tag="a")
    drain(pool)
    work = 250 * workers * (0.0071 + 0.0043)
    assert work / (backend.now * workers) >= 0.97


def test_the_setups_of_a_generation_are_spread_over_the_workers() -> None:
    backend = FakeBackend(3)
    pool = WorkPool(backend)
    for generation in range(3):
        begun = len(backend.sizes)
        works = [
            Work(setup(scenario), cells([Behaviour.WELL] * 300, first=1 + 1000 * (3 * generation + index)))
            for index, scenario in enumerate(("S1", "S2", "S3"))
        ]
        pool.submit(*works, tag="a")
        assert {scenario for _, scenario, _ in backend.sizes[begun : begun + 3]} == {"S1", "S2", "S3"}
        drain(pool)


def test_higher_priorities_go_first() -> None:
    backend = FakeBackend()
    pool = WorkPool(backend)
    pool.submit(Work(setup("S1"), cells([Behaviour.WELL] * 100)), tag="a")
    pool.submit(Work(setup("S3"), cells([Behaviour.WELL], first=301)), tag="c", priority=1)
    drain(pool)
    order = [scenario for _, scenario, _ in backend.sizes]
    assert order.index("S3") <= 4  # after those that were under way


def test_a_cell_cannot_be_in_flight_twice() -> None:
    pool = WorkPool(FakeBackend())
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 3)), tag="a")
    with pytest.raises(ValueError, match=r"\[1\]"):
        pool.submit(Work(setup("S2"), cells([Behaviour.WELL])), tag="a")
    with pytest.raises(ValueError, match=r"\[9, 9\]"):
        pool.submit(Work(setup(), [Cell(9, {}), Cell(9, {})]), tag="a")
    assert len(drain(pool)) == 3
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 3)), tag="a")
    assert len(drain(pool)) == 3


def test_withdrawn_cells_are_dropped_but_those_under_way_come_back() -> None:
    pool = WorkPool(FakeBackend())
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 300)), tag="a")
    pool.submit(Work(setup("S2"), cells([Behaviour.WELL] * 300, first=301)), tag="b")
    completed = pool.poll(1.0)
    running = pool.withdraw("a")
    assert 0 < running < 300
    assert pool.held("a") == running
    completed += drain(pool)
    assert Counter(one.tag for one in completed)["b"] == 300
    assert pool.held("a") == 0
    assert len({one.result.id for one in completed}) == len(completed) < 600


def test_a_withdrawn_cell_whose_worker_dies_is_not_called_failed() -> None:
    backend = FakeBackend()
    pool = WorkPool(backend)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 10)), tag="a")
    assert pool.withdraw("a") > 0
    backend.kill(0)
    backend.kill(1)
    assert drain(pool) == []
    assert pool.held("a") == 0


def test_results_of_a_batch_that_was_given_up_change_nothing() -> None:
    backend = FakeBackend()
    pool = WorkPool(backend)
    pool.submit(Work(setup(), cells([Behaviour.WELL] * 2)), tag="a")
    backend.kill(0)
    completed = pool.poll(0.0)
    backend.repeat(0)
    completed += pool.poll(0.0)
    backend.repeat(0)
    completed += drain(pool)
    assert sorted(one.result.id for one in completed) == [1, 2]
    assert "ghost" not in {one.worker for one in completed}


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
@settings(max_examples=examples(300), deadline=None)
def test_every_cell_comes_back_exactly_once_whatever_happens(workers: int, steps: list[tuple[object, ...]]) -> None:
    backend = FakeBackend(workers, {"S1": 0.007, "S2": 0.5})
    pool = WorkPool(backend, clock=lambda: backend.now)
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
    ids = [one.result.id for one in completed]
    assert len(set(ids)) == len(ids), "a cell came back twice"
    assert set(submitted) - set(ids) <= withdrawn, "a cell was lost"
    assert max(backend.attempts.values(), default=0) <= ATTEMPTS
    causes = {None: Behaviour.WELL, "crash": Behaviour.CRASH, "hang": Behaviour.HANG}
    causes |= {"error": Behaviour.ERROR, "memory": Behaviour.MEMORY}
    for one in completed:
        if kills == 0 and not backend.bad:
            assert causes[one.result.breakdown] is submitted[one.result.id]
        elif submitted[one.result.id] is not Behaviour.WELL:
            assert one.result.breakdown is not None
