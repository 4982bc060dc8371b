import threading
from collections.abc import Callable

import pytest
from tests.support.serve import until

from drivecal.execution.ray import cluster
from drivecal.execution.ray.cluster import GIVEN_UP_AFTER, PATIENCE_SECONDS, ClusterWatch, StartedAnewError


@pytest.fixture(autouse=True)
def _often(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "EVERY_SECONDS", 0.02)


class Store:
    """The watched store: it answers, is silent, or has lost its data. Tests set its time."""

    def __init__(self) -> None:
        self.error: Exception | None = None
        self.asked = threading.Semaphore(0)
        self.now = 0.0

    def ask(self) -> None:
        self.asked.release()
        if self.error is not None:
            raise self.error


def watched(use: Callable[[Store, ClusterWatch], None]) -> None:
    store = Store()
    watching = ClusterWatch("the Ray cluster at home", store.ask, clock=lambda: store.now)
    try:
        use(store, watching)
    finally:
        watching.stop()


def asked_again(store: Store) -> None:
    """Waits until it was asked once more, with whatever it answers now."""
    while store.asked.acquire(blocking=False):
        pass
    for _ in range(2):  # the first of them may have begun before
        assert store.asked.acquire(timeout=300)


def test_silence_is_told_after_a_while_and_forgotten_with_an_answer() -> None:
    def use(store: Store, watching: ClusterWatch) -> None:
        asked_again(store)
        assert watching.trouble() is None
        store.error = TimeoutError("Deadline Exceeded")
        asked_again(store)
        store.now += PATIENCE_SECONDS + 0.1
        assert (watching.trouble() or "").startswith("the Ray cluster at home has not answered since ")
        assert watching.trouble() == watching.trouble(), "words that change every second would be told as news every second"
        assert watching.lost() is None
        store.error = None
        asked_again(store)
        assert watching.trouble() is None

    watched(use)


def test_who_is_silent_for_long_is_given_up() -> None:
    def use(store: Store, watching: ClusterWatch) -> None:
        store.error = TimeoutError()
        asked_again(store)
        store.now += GIVEN_UP_AFTER + 0.1
        assert "has not answered since" in (watching.lost() or "")

    watched(use)


def test_a_store_that_began_anew_is_lost_at_once() -> None:
    def use(store: Store, watching: ClusterWatch) -> None:
        store.error = StartedAnewError("was restarted")
        until(lambda: watching.lost() is not None, "the loss of the cluster", 30)
        assert watching.lost() == "the Ray cluster at home was restarted"

    watched(use)


def test_an_answer_counts_for_what_was_before_it() -> None:
    def use(store: Store, watching: ClusterWatch) -> None:
        store.now = 10.0
        asked_again(store)
        assert watching.answered_since(5.0)
        store.error = TimeoutError()
        asked_again(store)
        store.now = 20.0
        asked_again(store)
        assert not watching.answered_since(15.0)

    watched(use)
