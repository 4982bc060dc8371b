"""`drivecal workers`: the workers and their current batches."""

from datetime import UTC, datetime, timedelta

from drivecal.cli.application import JsonOption, UrlOption, app, connect, tell
from drivecal.cli.views.output import duration, print_answer, print_columns
from drivecal.contracts.inventory import WorkerAnswer, WorkerPage
from drivecal.report.rows import fixed


@app.command()
def workers(url: UrlOption = None, as_json: JsonOption = False) -> None:
    """Show the workers with their activity and speed."""
    with connect(url) as client:
        print_answer(client.workers(), as_json, _print)


def _print(page: WorkerPage) -> None:
    now = datetime.now(UTC)
    header = ["worker", "node", "state", "cells", "cells/s", "remembers", "simulates"]
    rows = [
        [item.id, item.node, item.state, item.cells, fixed(item.cells_per_second, 1), remembering(item), doing(item, now)]
        for item in page.items
    ]
    print_columns(header, rows)
    for line in remarks(page, now):
        tell(line)


def doing(worker: WorkerAnswer, now: datetime) -> str | None:
    """Returns the running scenario of a worker, and the time of its batch."""
    if worker.scenario is None or worker.since is None:
        return worker.scenario
    return f"{worker.scenario} for {duration(max(0.0, (now - worker.since) / timedelta(seconds=1)))}"


def remembering(worker: WorkerAnswer) -> str | None:
    """Returns a worker's memory for certificates."""
    if worker.states is None or worker.state_mb is None or worker.state_mb_at_most is None:
        return None
    return f"{worker.states:,} states, {worker.state_mb:.0f} of {worker.state_mb_at_most:.0f} MB"


def remarks(page: WorkerPage, now: datetime) -> list[str]:
    """Returns remarks on the table."""
    lines = [f"degraded: {page.degraded}"] if page.degraded else []
    if not page.fresh and page.items and page.dispatcher_seen_at is not None:
        age = duration((now - page.dispatcher_seen_at) / timedelta(seconds=1))
        lines.append(f"this is what the dispatcher said {age} ago, before it fell silent")
    return lines
