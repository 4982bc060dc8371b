"""Memory limit of all tries of a worker, and the choice of what they forget. Light: no compiled code."""

from typing import Protocol
from weakref import WeakSet

import numpy as np
import numpy.typing as npt

from drivecal.cluster.machine import cpus, memory_bytes

LARGEST_DEFAULT = 1024
"""Megabytes."""


def default_megabytes() -> int:
    """Returns the default limit of a worker: a quarter of the machine's or container's memory per CPU, 1 GB at most."""
    return max(1, min(LARGEST_DEFAULT, memory_bytes() // 2**20 // (4 * cpus())))


class Evictable(Protocol):
    """A trie, as seen by the memory."""

    @property
    def bytes(self) -> int:
        """Memory in use."""

    @property
    def visited(self) -> npt.NDArray[np.int64]:
        """Time of the last visit of each state, by the memory's clock, shape (states,). Visiting a state visits all states above it."""

    def forget_until(self, clock: int) -> None:
        """Forgets all states except the first whose last visit is not after `clock`."""


class Memory:
    """Memory of a process for certificates. Above the limit, all tries forget their least recently visited states until half is free."""

    def __init__(self, megabytes: int | None = None) -> None:
        self.limit = (megabytes or default_megabytes()) * 2**20
        """Limit in bytes."""
        self.clock = 0
        """Number of visits so far."""
        self._tries: WeakSet[Evictable] = WeakSet()

    @property
    def bytes(self) -> int:
        """Memory in use by all tries."""
        return sum(trie.bytes for trie in self._tries)

    @property
    def states(self) -> int:
        """Number of stored planning states of all setups."""
        return sum(len(trie.visited) for trie in self._tries)

    def join(self, trie: Evictable) -> None:
        """Counts a trie from now on, for as long as it is referenced."""
        self._tries.add(trie)

    def evict(self) -> None:
        """Forgets states if the limit is exceeded. No run may be recording: the remaining states get new numbers."""
        if self.bytes <= self.limit:
            return
        while self.bytes > self.limit // 2 and any(len(trie.visited) > 1 for trie in self._tries):
            # The first state of each trie always stays; a median that included many of them could prevent progress.
            median = int(np.median(np.concatenate([trie.visited[1:] for trie in self._tries])))
            for trie in list(self._tries):
                trie.forget_until(median)
