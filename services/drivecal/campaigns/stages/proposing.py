"""Computations of optimizers, in threads beside the dispatcher's loop: a slow optimizer keeps no other campaign waiting.

A computation depends only on stored rows and gives all that is stored of it, so that a process that dies repeats it with the same result.
"""

import threading
import weakref
from collections.abc import Callable
from concurrent.futures import Future, wait
from dataclasses import dataclass
from typing import Any

from drivecal.optimizers.replayed import abandon_when
from drivecal.plugins.ports import Floats, Optimizer, Proposal

PATIENCE_SECONDS = 0.1
"""Time for which the first check of a computation waits: most proposals take milliseconds and need no further round of the dispatcher."""


@dataclass(frozen=True, slots=True)
class Computed:
    """An optimizer after its computation. `proposal` and `state`: of its next population, None if it was not asked for one."""

    optimizer: Optimizer
    proposal: Proposal | None = None
    state: dict[str, Any] | None = None


class Computation:
    """Creates or restores an optimizer, passes it answers and asks for its next population, in a thread of its own.

    When the last reference to this object is gone, nothing waits for the result: see `optimizers.replayed.stop_if_abandoned`.
    """

    def __init__(self, obtain: Callable[[], Optimizer], answers: tuple[Floats, Floats] | None, *, asks: bool) -> None:
        """`obtain` and what it refers to must not refer to this object. `answers`: to pass on first; see `Optimizer.tell`."""
        self._patience = PATIENCE_SECONDS
        self._outcome: Future[Computed] = Future()
        abandoned = threading.Event()
        weakref.finalize(self, abandoned.set)
        arguments = (self._outcome, abandoned, obtain, answers, asks)
        # A daemon: a process that ends waits for no optimizer.
        threading.Thread(target=_compute, args=arguments, name="optimizer", daemon=True).start()

    @property
    def is_done(self) -> bool:
        """Whether the result is there; only the first check waits for it, `PATIENCE_SECONDS` at most."""
        wait([self._outcome], self._patience)
        self._patience = 0.0
        return self._outcome.done()

    def result(self) -> Computed:
        """Returns the result; raises what the optimizer raised. Waits for it unless it `is_done`."""
        return self._outcome.result()


def _compute(
    outcome: Future[Computed],
    abandoned: threading.Event,
    obtain: Callable[[], Optimizer],
    answers: tuple[Floats, Floats] | None,
    asks: bool,  # noqa: FBT001  # a thread's arguments are positional
) -> None:
    abandon_when(abandoned.is_set)
    try:
        optimizer = obtain()
        if answers is not None:
            optimizer.tell(*answers)
        if asks:
            proposal = optimizer.ask()
            outcome.set_result(Computed(optimizer, proposal, optimizer.state()))
        else:
            outcome.set_result(Computed(optimizer))
    except BaseException as error:  # noqa: BLE001  # `result` raises it in the dispatcher's thread
        outcome.set_exception(error)
