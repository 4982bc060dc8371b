"""What the tries of a worker may take together, and what they forget where that is too little. Light: no compiled code."""

from __future__ import annotations

import os
from typing import Protocol
from weakref import WeakSet

import numpy as np
import numpy.typing as npt

MOST_BY_DEFAULT = 1024
"""Megabytes."""


def megabytes_by_default() -> int:
    """What a worker may take where nobody says how much: a quarter of the memory that the machine has for each CPU, 1 GB at most."""
    machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") // 2**20
    return max(1, min(MOST_BY_DEFAULT, machine // (4 * (os.cpu_count() or 1))))


class Kept(Protocol):
    """A trie, as its memory sees it."""

    @property
    def bytes(self) -> int:
        """In use."""

    @property
    def visited(self) -> npt.NDArray[np.int64]:
        """When each of its states was visited last, by the memory's clock, shape (states,). A state is visited whenever one below it is."""

    def forget_until(self, clock: int) -> None:
        """Forgets the states, but the first, that were not visited after this."""


class Memory:
    """Of a process. Above its limit, all tries forget what was visited for longest, until half of the limit is free."""

    def __init__(self, megabytes: int | None = None) -> None:
        self.limit = (megabytes or megabytes_by_default()) * 2**20
        """Bytes."""
        self.clock = 0
        """Counts visits."""
        self._tries: WeakSet[Kept] = WeakSet()

    @property
    def bytes(self) -> int:
        """In use by all tries."""
        return sum(trie.bytes for trie in self._tries)

    @property
    def states(self) -> int:
        """Planning states that are kept, of all setups."""
        return sum(len(trie.visited) for trie in self._tries)

    def join(self, trie: Kept) -> None:
        """A trie that counts from now on, as long as somebody holds it."""
        self._tries.add(trie)

    def settle(self) -> None:
        """Forgets what there is no room for. No run may be recording: states get new numbers."""
        if self.bytes <= self.limit:
            return
        while self.bytes > self.limit // 2 and any(len(trie.visited) > 1 for trie in self._tries):
            # of those that can go: the first of each trie stays, and among many of these no progress would be made
            middle = int(np.median(np.concatenate([trie.visited[1:] for trie in self._tries])))
            for trie in list(self._tries):
                trie.forget_until(middle)
