"""Windows of time with the work of each worker, from the stored runs."""

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta

from sqlalchemy import Connection

from drivecal.contracts.inventory import WorkerAnswer, WorkerTime, WorkerWindow
from drivecal.storage.references.runs import Worked, newest_work

PARTS = 60
"""Parts of a window."""
MOST_RUNS = 20_000
"""Newest runs that a window is made of."""
RUNNING, DELETED = 0, "deleted"
"""Number of the campaign of a batch that runs now; id that stands for all deleted campaigns."""


class RecentWork:
    """The newest runs of a database. Reads each once: one dispatcher at a time stores runs, so their numbers only grow."""

    def __init__(self) -> None:
        self._work: list[Worked] = []

    def read(self, connection: Connection) -> list[Worked]:
        """Returns at most `MOST_RUNS`, the newest first."""
        known = self._work
        newer = newest_work(connection, MOST_RUNS, after=known[0].id if known else 0)
        self._work = work = [*newer, *known][:MOST_RUNS] if newer else known
        return work


def running(workers: Sequence[WorkerAnswer], until: datetime) -> list[Worked]:
    """Returns the batches that workers simulate now, as far as they got, without a campaign."""
    return [
        Worked(worker.id, RUNNING, until, (until - worker.since) / timedelta(seconds=1))
        for worker in workers
        if worker.since is not None
    ]


def window(work: Sequence[Worked], until: datetime, minutes: int, campaigns: Mapping[int, tuple[str, str]]) -> WorkerWindow:
    """Returns the window of the last `minutes`. Results are stored some at a time, so runs of a worker lie end to end before that moment.

    Args:
        work: the batches that run now, without a campaign; then the newest runs, the newest first, at most `MOST_RUNS`.
        until: the end of the window.
        minutes: its length.
        campaigns: ids and names by number.
    """
    since, part = until - timedelta(minutes=minutes), minutes * 60 / PARTS
    complete_since = max(since, work[-1].created_at) if len(work) >= MOST_RUNS else since
    begin = (complete_since - since) / timedelta(seconds=1)
    free: dict[str, float] = {}
    runs = Counter[str]()
    seconds: dict[str, list[dict[int, float]]] = defaultdict(lambda: [defaultdict(float) for _ in range(PARTS)])
    for run in work:
        end = min((run.created_at - since) / timedelta(seconds=1), free.get(run.worker, PARTS * part))
        start = free[run.worker] = end - run.seconds
        if end <= begin:
            continue
        runs[run.worker] += run.campaign_sequence != RUNNING
        start = max(start, begin)
        for place in range(int(start // part), min(PARTS - 1, int(end // part)) + 1):
            seconds[run.worker][place][run.campaign_sequence] += min(end, (place + 1) * part) - max(start, place * part)
    ids = {RUNNING: None} | {number: identity for number, (identity, _) in campaigns.items()}
    times = [
        WorkerTime(
            worker=worker,
            runs=runs[worker],
            busy=[round(sum(each.values()), 3) for each in parts],
            campaigns=[ids.get(max(each, key=each.__getitem__), DELETED) if each else None for each in parts],
        )
        for worker, parts in sorted(seconds.items())
    ]
    return WorkerWindow(
        since=since,
        until=until,
        part_seconds=part,
        complete_since=complete_since,
        workers=times,
        names=dict(campaigns.values()),
    )
