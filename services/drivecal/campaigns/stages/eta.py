"""The pace of a stage, and its remaining time."""

from collections.abc import Callable

from drivecal.contracts.campaign import Progress

SECONDS_TO_JUDGE = 3.0
"""The pace is unknown while workers start."""
SHARE_TO_JUDGE = 0.01


class EtaEstimate:
    """Estimates a stage's remaining time, since this process resumed it with `done` cells; `clock` returns seconds."""

    def __init__(self, clock: Callable[[], float], done: int) -> None:
        self._clock = clock
        self._started, self._done_before = clock(), done

    def progress(self, done: int, total: int) -> Progress:
        """`done` of `total` cells, with the remaining time once there is enough data."""
        seconds, gained = self._clock() - self._started, done - self._done_before
        judged = gained > 0 and seconds >= SECONDS_TO_JUDGE and gained >= SHARE_TO_JUDGE * (total - self._done_before)
        return Progress(done=done, total=total, eta_seconds=seconds / gained * (total - done) if judged else None)
