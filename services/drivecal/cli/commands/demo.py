"""`drivecal demo`: a campaign, its result, and the cost of a rerun with other weights."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

import typer

from drivecal.cli.application import ExitCode, JsonOption, app, say
from drivecal.cli.views.output import cells_text, duration, print_answer, print_blocks, print_columns, print_solutions, saved
from drivecal.cli.views.progress import show_until_ended
from drivecal.cli.views.sections import trust_blocks
from drivecal.client.client import Client
from drivecal.configuration.settings import load_settings
from drivecal.contracts.campaign import Campaign
from drivecal.domain.errors import ConflictError, DrivecalError

SECONDS_TO_START = 600.0
"""Ray needs some seconds, compiling the kernels for the first time half a minute on a slow machine, and many times that on a busy one."""
SECONDS_TO_STOP = 20.0
ANNOUNCEMENT = "serve.json"
"""File with the address of the ready coordinator."""
LOG = "serve.log"
SECONDS_BETWEEN_SIGNS = 15.0
"""Longest silence while the workers start."""


@contextmanager
def fresh_folder(folder: Path) -> Iterator[None]:
    """Empties `folder` and keeps other demos out of it.

    Raises ConflictError if a demo is running there, and DatabaseError if a server uses the last demo's database.
    """
    from drivecal.storage.engine import server_lock

    folder.parent.mkdir(parents=True, exist_ok=True)
    with folder.with_suffix(".lock").open("w") as lock:
        if not server_lock.try_lock(lock):
            raise ConflictError(f"another demo is running in {folder}; wait for it or stop it")
        with server_lock.hold(_database_url(folder), "set DRIVECAL_HOME to another folder: a new demo empties this one"):
            shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(exist_ok=True)
        yield


def _database_url(folder: Path) -> str:
    return f"sqlite:///{quote(str(folder / 'drivecal.db'))}"


@contextmanager
def coordinator(home: Path, say: Callable[[str], None] = lambda _: None) -> Iterator[Client]:
    """Runs a coordinator with its files in `home` until the block is left, and yields a client of it once its workers are ready.

    Calls `say` with what it waits for. Raises DrivecalError with the end of the log if it does not start.
    """
    settings = load_settings(home=str(home), database_url=_database_url(home)).environment
    environment = {name: value for name, value in (os.environ | settings).items() if name != "DRIVECAL_TOKENS_FILE"}
    # The guardian ends the server, whatever becomes of the demo: it notices when our end of its standard input is gone.
    guardian = [sys.executable, "-P", "-m", "drivecal.server.guardian", str(SECONDS_TO_STOP), ""]
    serve = [sys.executable, "-P", "-m", "drivecal.cli", "serve", "--host", "127.0.0.1", "--port", "0", "--json"]
    with (home / ANNOUNCEMENT).open("wb") as announcement, (home / LOG).open("wb") as log:
        # In a session of its own: Ctrl-C reaches the demo alone, which then stops the server as it should be stopped.
        process = subprocess.Popen(  # noqa: S603  # our own command
            [*guardian, *serve],
            env=environment,
            cwd=home,  # where no config file is: a demo on loopback asks for no token, whatever the user's own server does
            stdin=subprocess.PIPE,
            stdout=announcement,
            stderr=log,
            start_new_session=True,
        )
    try:
        with _interrupted_by_sigterm(), Client(url_when_ready(process, home, say), token="") as client:
            yield client
    finally:
        process.terminate()
        process.wait()


@contextmanager
def _interrupted_by_sigterm() -> Iterator[None]:
    """Turns SIGTERM into KeyboardInterrupt, as Ctrl-C does, so that everything is cleaned up."""
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def url_when_ready(process: subprocess.Popen[bytes], home: Path, say: Callable[[str], None]) -> str:
    """Returns the address once the workers are ready. Reports how long the server has been starting."""
    began = last_sign = time.monotonic()
    while (now := time.monotonic()) < began + SECONDS_TO_START:
        line, newline, _ = (home / ANNOUNCEMENT).read_text().partition("\n")
        if newline:
            url = str(json.loads(line)["url"])
            say(f"the workers are ready after {now - began:.0f} s; watch the campaign at {url}")
            return url
        if process.poll() is not None:
            raise DrivecalError(f"the coordinator did not start (exit status {process.returncode}):\n{_end_of(home / LOG)}")
        if now >= last_sign + SECONDS_BETWEEN_SIGNS:
            say(f"the server and its workers are still starting ({now - began:.0f} s)")
            last_sign = now
        time.sleep(0.1)
    raise DrivecalError(
        f"the coordinator is not ready after {SECONDS_TO_START:.0f} s; if the machine was busy, try again:\n{_end_of(home / LOG)}"
    )


def _end_of(log: Path) -> str:
    return "\n".join(log.read_text(errors="replace").splitlines()[-15:])


MIDDLES = (0, 1, 100, 1000, 750, 0.5, 100, 1000, 5, 10, 100)
BASELINE: dict[str, float] = {f"P{number}": middle for number, middle in enumerate(MIDDLES, 1)}
"""The middle of every range, as a first guess."""
CAMPAIGN: Mapping[str, Any] = {
    "name": "demo: comfort in six motorway scenarios",
    "baseline": BASELINE,
    "budget": {"simulations": 600},
}
PAPER: Mapping[str, Any] = {
    "optimizer": {"kind": "genetic", "population": 1000, "iterations": 20},
    "reduction": {"mode": "exact"},
}
"""The paper's search, for its cost."""
RERUN: Mapping[str, Any] = {"simulations": 150}
"""Budget of the second campaign, which begins with what the first has simulated."""
MARKS = (50, 100, 200, 300, 450, 600)
"""Simulations after which the course of the search is shown."""
OTHER_WEIGHTS = {"S1": 3, "S2": 3}
SHOWN = 5
"""Number of printed solutions."""


@app.command()
def demo(as_json: JsonOption = False) -> None:
    """Calibrate the motorway planner in six SUMO scenarios on this machine, then again with other weights. Takes some minutes."""
    started = time.monotonic()
    folder = load_settings().home / "demo"
    try:
        say(f"starting a server with a database and workers of its own in {_short(folder)}")
        say("the first start on a machine compiles the simulation, once; this takes up to some minutes")
        with fresh_folder(folder):
            with coordinator(folder, say) as client:
                campaign = _first(client, as_json)
                rerun = _second(client, campaign, as_json)
            summary = {
                "campaign": campaign.model_dump(mode="json"),
                "rerun": rerun.model_dump(mode="json"),
                "wall_seconds": round(time.monotonic() - started, 3),
            }
            (folder / "summary.json").write_text(json.dumps(summary, indent=2) + "\n")
    except KeyboardInterrupt as error:
        say("interrupted; the coordinator has been stopped")
        raise typer.Exit(ExitCode.INTERRUPTED) from error
    print_answer(summary, as_json, lambda: _print_end(campaign, folder, time.monotonic() - started))


def _first(client: Client, as_json: bool) -> Campaign:
    paper = client.expected_runs(PAPER)
    say(
        f"submitting a campaign with a budget of {CAMPAIGN['budget']['simulations']} simulations, of a parameter set in one of six"
        f" scenarios each; the paper's search requests at most {paper.calibration_at_most:,} such cells"
    )
    campaign = _carried_out(client, client.submit(CAMPAIGN))
    if not as_json:
        _print_best(client, campaign, "The best parameter sets, with the comfort score (0 to 7) in each scenario")
        _print_course(client, campaign)
        results = client.results(campaign.id)
        _print_answers("How its cells were answered", campaign=campaign)
        print_blocks(trust_blocks(results.trust))
        if results.accounting is not None:
            typer.echo(f"\nWhat that saved and cost: {results.accounting.sentence}")
    return campaign


def _second(client: Client, first: Campaign, as_json: bool) -> Campaign:
    say("running it again with lane changes (S1, S2) weighing three times as much")
    campaign = _carried_out(client, client.rerun(first.id, {"weights": OTHER_WEIGHTS, "budget": dict(RERUN)}))
    if not as_json:
        _print_best(client, campaign, "The best sets when lane changes weigh three times as much")
        _print_answers("The second search began with what the first had simulated", campaign=first, rerun=campaign)
    return campaign


def _print_best(client: Client, campaign: Campaign, title: str) -> None:
    seconds = campaign.seconds
    spent = f"{duration(seconds.wall)} ({duration(seconds.simulating)} of simulation, {100 * saved(campaign.cells):.1f} % of cells saved)"
    typer.echo(f"\n{title}, after {spent}:\n")
    print_solutions(client.solutions(campaign.id, limit=SHOWN).items, {})


def _print_answers(title: str, **campaigns: Campaign) -> None:
    typer.echo(f"\n{title}:\n")
    for name, campaign in campaigns.items():
        typer.echo(f"{name}: {cells_text(campaign.cells)}")


def _carried_out(client: Client, campaign: Campaign) -> Campaign:
    ended = show_until_ended(client, campaign.id)
    if ended.state != "succeeded":
        raise DrivecalError(f"the campaign ended as {ended.state}: {ended.error or 'it was cancelled'}")
    return ended


def _print_course(client: Client, campaign: Campaign) -> None:
    """Prints the best objective after some numbers of simulations."""
    simulated, rows = 0, dict[int, float | None]()
    for row in client.rows(campaign.id, "generations"):
        simulated += row["simulated"] + row["failed"]
        rows |= {mark: row["best"] for mark in MARKS if simulated >= mark and mark not in rows}
    typer.echo("\nThe course of the search:\n")
    print_columns(["simulations", "best"], [(mark, "-" if best is None else f"{best:.3f}") for mark, best in rows.items()])


def _print_end(campaign: Campaign, folder: Path, seconds: float) -> None:
    called = Path(sys.argv[0])
    command = "drivecal" if shutil.which("drivecal") == shutil.which(called) else _short(called.absolute())
    typer.echo(
        f"\nDone in {duration(seconds)}. Everything is kept in {_short(folder)}; look at it with\n\n"
        f"  DRIVECAL_HOME={_short(folder)} {command} serve        # leave it running, and in another terminal:\n"
        f"  {command} list\n"
        f"  {command} show {campaign.id[:8]}\n"
        f"  {command} solutions {campaign.id[:8]} --weights S1=3,S5=0\n"
        f"  {command} report {campaign.id[:8]} -o report                 # one page that needs no server, and tables\n"
        f"  {command} export {campaign.id[:8]} --table evaluations --format csv -o evaluations.csv\n"
        f"  {command} submit deploy/examples/highway.yaml --wait"
    )


def _short(path: Path) -> str:
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)
