"""How fast a stage gets on, and so how long it will take."""

from __future__ import annotations

from collections.abc import Callable

from drivecal.contracts.campaign import Progress

SECONDS_TO_JUDGE = 3.0
"""Workers that are still starting say nothing about the pace."""
SHARE_TO_JUDGE = 0.01


class EtaEstimate:
    """Of a stage since this process took it up with `done` cells; `clock` gives seconds."""

    def __init__(self, clock: Callable[[], float], done: int) -> None:
        self._clock = clock
        self._started, self._done_before = clock(), done

    def progress(self, done: int, total: int) -> Progress:
        """`done` of `total` cells, with the time left once there is enough to judge by."""
        seconds, gained = self._clock() - self._started, done - self._done_before
        judged = gained > 0 and seconds >= SECONDS_TO_JUDGE and gained >= SHARE_TO_JUDGE * (total - self._done_before)
        return Progress(done=done, total=total, eta_seconds=seconds / gained * (total - done) if judged else None)
