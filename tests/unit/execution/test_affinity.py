"""Assignment of setups to workers: a worker keeps its setup while it has work, and no worker waits for that."""

from hypothesis import given
from hypothesis import strategies as st

from drivecal.contracts.work import SetupKey
from drivecal.execution.scheduling.affinity import SetupAffinity

A, B, C, D = ((f"fingerprint {name}", "highway", name, "reference") for name in "ABCD")


def loaded(*pairs: tuple[str, SetupKey]) -> SetupAffinity:
    setups = SetupAffinity()
    for worker, setup in pairs:
        setups.load(worker, setup)
    return setups


def test_a_worker_comes_back_to_the_setups_that_it_was_the_first_to_take() -> None:
    setups = loaded(("one", A), ("two", B), ("one", C), ("two", D))
    assert setups.choose("one", {A: 1.0, B: 9.0}) == A
    assert setups.choose("two", {A: 9.0, B: 1.0}) == B
    assert setups.choose("one", {A: 1.0, B: 9.0, C: 2.0, D: 9.0}) == C


def test_who_has_nothing_of_its_own_to_do_helps_where_most_is_left() -> None:
    setups = loaded(("one", A), ("two", B), ("two", C))
    assert setups.choose("one", {B: 1.0, C: 5.0}) == B  # no worker runs B now
    setups.load("one", B)
    assert setups.choose("three", {B: 1.0, C: 5.0}) == C


def test_a_setup_without_a_home_is_taken_by_whoever_comes() -> None:
    setups = loaded(("one", A), ("two", B))
    assert setups.choose("two", {A: 9.0, D: 1.0}) == D


def test_the_home_of_a_worker_that_is_gone_is_free_again() -> None:
    setups = loaded(("one", A), ("two", B))
    setups.meet(["two"])
    assert setups.choose("two", {A: 1.0}) == A
    setups.load("two", A)
    setups.load("two", D)
    setups.meet(["two", "three"])
    assert setups.choose("three", {A: 1.0, C: 0.1}) == C


@given(st.lists(st.tuples(st.sampled_from(["one", "two", "three"]), st.sampled_from([A, B, C, D]))))
def test_no_worker_is_idle_while_something_waits(history: list[tuple[str, SetupKey]]) -> None:
    setups = loaded()
    for worker, setup in history:
        setups.load(worker, setup)
    for setup in (A, B, C, D):
        assert setups.choose("one", {setup: 1.0}) == setup
    assert setups.choose("one", {}) is None
