"""Follows a campaign: a progress bar on a terminal, now and then a line elsewhere. Ctrl-C detaches and cancels nothing."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Column

from drivecal.cli.application import ExitCode, WaitTimedOutError, say
from drivecal.cli.views.output import by_outcome, duration, troubles
from drivecal.cli.views.sections import judged_text
from drivecal.client.client import Client
from drivecal.contracts.campaign import Campaign, CampaignEvent

SECONDS_BETWEEN_LINES = 5.0
SHOWN = frozenset({"queued", "running", "generation", "succeeded", "failed", "cancelled"})
"""Kinds of events that the progress or the final state shows as well."""


class Bar:
    """A progress bar on a terminal."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._task = self._progress.add_task("waiting", total=None, detail="")

    def show(self, campaign: Campaign) -> None:
        """Moves the bar."""
        self._progress.update(
            self._task,
            description=stage_text(campaign),
            completed=campaign.progress.done,
            total=campaign.progress.total or None,
            detail=escape(_detail(campaign)),
        )

    def say(self, text: str) -> None:
        """Writes the line above the bar."""
        self._progress.console.print(text, markup=False, highlight=False)


class Lines:
    """A line every few seconds, and for each change of state or stage."""

    def __init__(self) -> None:
        self._last: tuple[str, str | None] | None = None
        self._at = 0.0

    def show(self, campaign: Campaign) -> None:
        """Writes a line if one is due."""
        now, kind = time.monotonic(), (campaign.state, campaign.stage)
        if kind == self._last and now - self._at < SECONDS_BETWEEN_LINES:
            return
        self._last, self._at = kind, now
        progress = campaign.progress
        done = f"  {progress.done:,}/{progress.total:,} cells" if progress.total else ""
        typer.echo(f"{stage_text(campaign)}{done}  {_detail(campaign)}".rstrip(), err=True)

    def say(self, text: str) -> None:
        """Writes the line."""
        typer.echo(text, err=True)


@contextmanager
def reporter() -> Iterator[Bar | Lines]:
    """Yields the reporter for stderr."""
    if not sys.stderr.isatty():
        yield Lines()
        return
    with progress_line(Console(stderr=True)) as progress:
        yield Bar(progress)


def progress_line(console: Console) -> Progress:
    """Returns a progress of one line in any width: its details give way to stage, bar and count."""
    rest = Column(ratio=1, no_wrap=True, overflow="ellipsis")
    columns = (TextColumn("{task.description}"), BarColumn(bar_width=24), MofNCompleteColumn())
    detail = TextColumn("{task.fields[detail]}", table_column=rest)
    return Progress(*columns, detail, console=console, transient=True, expand=True)


def follow(client: Client, identifier: str, timeout: float | None = None, *, from_beginning: bool = True) -> Campaign:
    """Shows a campaign's progress and events until it has ended, and returns it.

    Raises WaitTimedOutError after `timeout` seconds. Ctrl-C ends the command, not the campaign.
    """
    come_back = f"the campaign goes on; `drivecal watch {identifier}` comes back, `drivecal cancel {identifier}` ends it"
    with attached(come_back, timeout):
        deadline = None if timeout is None else time.monotonic() + timeout
        return show_until_ended(client, identifier, deadline, from_beginning=from_beginning)


@contextmanager
def attached(come_back: str, timeout: float | None) -> Iterator[None]:
    """Says how to `come_back` to what goes on, after Ctrl-C, which ends the command, and after a TimeoutError (as WaitTimedOutError)."""
    try:
        yield
    except KeyboardInterrupt as error:
        say(f"detached: {come_back}")
        raise typer.Exit(ExitCode.INTERRUPTED) from error
    except TimeoutError as error:
        raise WaitTimedOutError(f"not ended after {duration(timeout or 0)}: {come_back}") from error


def pauses(seconds: float, timeout: float | None) -> Iterator[None]:
    """Pauses for `seconds` before each question. Raises TimeoutError after `timeout` seconds."""
    deadline = None if timeout is None else time.monotonic() + timeout
    while deadline is None or time.monotonic() <= deadline:
        time.sleep(seconds)
        yield
    raise TimeoutError


def show_until_ended(
    client: Client, identifier: str, deadline: float | None = None, *, from_beginning: bool = True
) -> Campaign:
    """Shows a campaign's progress until it has ended, and returns it. `from_beginning`: shows earlier events as well.

    Raises TimeoutError when the monotonic clock passes `deadline`.
    """
    said: str | None = None
    with reporter() as report:

        def show_event(event: CampaignEvent) -> None:
            nonlocal said
            if event.text != said and event.kind not in SHOWN:  # stream and dispatcher may both report the same trouble
                report.say(event.text)
                said = event.text

        for campaign in client.watch(identifier, deadline, show_event, from_beginning=from_beginning):
            report.show(campaign)
    return campaign


def stage_text(campaign: Campaign) -> str:
    """Returns the stage of a running campaign, with the iteration of its search, or the state of another one."""
    if campaign.state != "running" or campaign.stage is None:
        return campaign.state
    iterations = (campaign.spec.get("optimizer") or {}).get("iterations")
    if campaign.stage != "calibration" or campaign.iteration is None or iterations is None:
        return campaign.stage
    if campaign.iteration >= iterations:
        return f"{campaign.stage}, confirming"
    return f"{campaign.stage} {campaign.iteration + 1}/{iterations}"


def _detail(campaign: Campaign) -> str:
    cells = campaign.stages.get(campaign.stage or "", campaign.cells)
    parts = [f"{name} {count:,}" for name, count in by_outcome(cells).items() if count]
    if campaign.best:
        has_several = campaign.best.standard_error is not None and campaign.state == "running"  # in the end some report it
        parts.append(f"best {judged_text(campaign.best)}{f' by {campaign.best.replicates} seeds' if has_several else ''}")
    if campaign.progress.eta_seconds is not None and campaign.state == "running":
        parts.append(f"{duration(campaign.progress.eta_seconds)} left")
    return "  ".join([*parts, *troubles(campaign)])
