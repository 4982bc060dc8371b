"""Recorded runs on their way between workers that own the same setup. Pure.

A worker gets with its next batch what others recorded meanwhile. Only workers on one node share: on other processors a run may
differ in its last bits. What is not delivered is lost, which costs simulations and no result.
"""

from collections import deque
from collections.abc import Mapping, Sequence

from drivecal.contracts.work import RecordedRun, SetupKey
from drivecal.execution.scheduling.affinity import SetupAffinity

MOST_BYTES = 8 * 2**20
"""Planning states that wait for a worker in one setup; the oldest runs are dropped."""
MOST_BYTES_IN_ALL = 128 * 2**20
"""Planning states that wait in all setups; those that have waited for longest are dropped."""
MOST_SENT = 4 * 2**20
"""Planning states with a batch."""
MOST_SENT_IN_ALL = 60 * 2**20
"""Planning states at a time in Ray's object store, which has 80 MB, with two batches and a result for each worker."""


class SharedRuns:
    """Runs to deliver, by worker and setup."""

    def __init__(self, affinity: SetupAffinity) -> None:
        self._affinity = affinity
        self._nodes: Mapping[str, str] = {}
        self._inboxes: dict[tuple[str, SetupKey], deque[RecordedRun]] = {}
        self._sizes: dict[tuple[str, SetupKey], int] = {}
        """Size of each recording, bytes."""

    def meet(self, nodes: Mapping[str, str]) -> None:
        """Notes the node of each worker that lives, and forgets the other workers."""
        gone = self._nodes.keys() - nodes.keys()
        for place in [place for place in self._inboxes if place[0] in gone]:
            self._drop(place)
        self._nodes = dict(nodes)

    @property
    def room(self) -> int:
        """Bytes of runs that go with a batch or its results."""
        return min(MOST_SENT, MOST_SENT_IN_ALL // (3 * max(len(self._nodes), 1)))

    def readers(self, worker: str, setup: SetupKey) -> list[str]:
        """Returns the workers that want this worker's runs."""
        node = self._nodes.get(worker)
        if node is None:
            return []
        return [owner for owner in self._affinity.owners(setup) if owner != worker and self._nodes.get(owner) == node]

    def take(self, worker: str, setup: SetupKey, runs: Sequence[RecordedRun]) -> None:
        """Takes the runs that a worker recorded."""
        for reader in self.readers(worker, setup) if runs else ():
            inbox = self._inboxes.setdefault((reader, setup), deque())
            inbox.extend(runs)
            size = self._sizes.pop((reader, setup), 0) + sum(len(run.states) for run in runs)
            while size > MOST_BYTES:
                size -= len(inbox.popleft().states)
            self._sizes[reader, setup] = size
        while sum(self._sizes.values()) > MOST_BYTES_IN_ALL:
            self._drop(next(iter(self._inboxes)))

    def give(self, worker: str, setup: SetupKey) -> tuple[RecordedRun, ...]:
        """Returns the newest runs that a worker has not got yet, each once, at most `room` bytes."""
        place, room, given = (worker, setup), self.room, []
        inbox = self._inboxes.get(place, deque())
        while inbox and len(inbox[-1].states) <= room:
            given.append(inbox.pop())
            room -= len(given[-1].states)
            self._sizes[place] -= len(given[-1].states)
        if not inbox:
            self._drop(place)
        return tuple(given)

    def _drop(self, place: tuple[str, SetupKey]) -> None:
        self._sizes.pop(place, None)
        self._inboxes.pop(place, None)
