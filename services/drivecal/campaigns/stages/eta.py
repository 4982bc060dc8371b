"""The remaining time of a stage, estimated by its pace. Pure."""

from collections.abc import Callable

from drivecal.contracts.campaign import Progress

SECONDS_TO_JUDGE = 5.0
"""The pace is unknown while workers start."""
SHARE_TO_JUDGE = 0.01
ANSWERS_TO_JUDGE = 10
MOST_MOMENTS = 500


class EtaEstimate:
    """Estimates a stage's remaining time by the pace of the newer half of the workers' answers since this process resumed the
    stage. Answers without a simulation come at once: they count as answered together with the worker's answer before them."""

    def __init__(self, clock: Callable[[], float], done: int, worked: int) -> None:
        """Begins with `done` cells, `worked` of them by workers; `clock` returns seconds."""
        self._clock = clock
        self._seen = [(clock(), done, worked)]
        """Moments with the counts then; every second one is dropped if there are many."""

    def progress(self, done: int, total: int, worked: int) -> Progress:
        """`done` of `total` cells, with the remaining time once there is enough data."""
        now = self._clock()
        if worked > self._seen[-1][2]:
            self._seen.append((now, done, worked))
        else:
            self._seen[-1] = (self._seen[-1][0], done, self._seen[-1][2])
        if len(self._seen) > MOST_MOMENTS:
            self._seen = self._seen[::2]
        begin, done_before, worked_before = self._seen[0]
        answers = worked - worked_before
        known = now - begin >= SECONDS_TO_JUDGE and done - done_before >= SHARE_TO_JUDGE * (total - done_before)
        needed = max(ANSWERS_TO_JUDGE, answers / 2)
        since = next((each for each in reversed(self._seen) if worked - each[2] >= needed), None) if known else None
        seconds = None if since is None else (now - since[0]) / max(1, done - since[1]) * max(0, total - done)
        return Progress(done=done, total=total, eta_seconds=seconds)
