"""`drivecal db`: maintenance of the database."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drivecal.cli.application import ExitCode, JsonOption, app, say
from drivecal.cli.views.output import print_answer, print_columns, print_json
from drivecal.configuration.settings import load_settings
from drivecal.domain.errors import DatabaseError

if TYPE_CHECKING:  # half a second that only these commands need, when they run
    from drivecal.storage.engine.database import Database
    from drivecal.storage.maintenance.backup import Copied

TOLD_SECONDS = 2.0
"""Between two lines about how far a copy is."""

database = typer.Typer(no_args_is_help=True, help="The database. These commands open it themselves and need no server.")
app.add_typer(database, name="db")

DatabaseOption = Annotated[
    str | None,
    typer.Option("--database-url", help="SQLAlchemy URL; else DRIVECAL_DATABASE_URL, else the file under DRIVECAL_HOME."),
]


@database.command()
def upgrade(database_url: DatabaseOption = None, as_json: JsonOption = False) -> None:
    """Create the database or bring it to this drivecal's revision. Stop its server first, unless it has that revision."""
    from drivecal.storage.engine import server_lock

    with _opened(database_url) as (url, opened):
        try:
            opened.check()
        except DatabaseError:
            with server_lock.hold(url):
                opened.upgrade()
            opened.check()
        name = opened.name
    print_answer({"database": name, "current": True}, as_json, lambda: typer.echo(f"{name} is current"))


@database.command()
def check(database_url: DatabaseOption = None, as_json: JsonOption = False) -> None:
    """Say whether the database is current and whole. Only reads, and may do so while a server runs; exit status 1 if not."""
    with _opened(database_url) as (_, opened):
        opened.check()
        report = _verified(opened)
    _print_verified(report, as_json)


@database.command()
def backup(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The backup: one new SQLite file.", show_default=False)],
    database_url: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """Copy the database, SQLite or PostgreSQL, into one checked file, while a server may work on it."""
    from drivecal.storage.maintenance.backup import write

    started = time.monotonic()
    with _opened(database_url) as (_, opened):
        copied = write(opened, file, _Telling())
        report = _copied(file, opened, copied, started)
    text = f"{file} holds {_rows(copied)} of {report['database']}, revision {copied.revision}"
    print_answer({**report, "bytes": file.stat().st_size}, as_json, lambda: typer.echo(text))


@database.command()
def restore(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="What `drivecal db backup` made.", show_default=False)],
    database_url: DatabaseOption = None,
    as_json: JsonOption = False,
) -> None:
    """Fill an empty database, SQLite or PostgreSQL, from a backup, and check it. Refused while a server works on it."""
    from drivecal.storage.engine import server_lock
    from drivecal.storage.maintenance import backup as backups

    started = time.monotonic()
    with _opened(database_url) as (url, opened):
        with server_lock.hold(url):
            copied = backups.restore(file, opened, _Telling())
        report = _copied(file, opened, copied, started)
        verified = _verified(opened)
    if not as_json:
        typer.echo(f"{report['database']} holds {_rows(copied)} of {file}")
    _print_verified(report | verified, as_json)


@contextmanager
def _opened(database_url: str | None) -> Iterator[tuple[str, Database]]:
    from drivecal.storage.engine.database import Database

    url = load_settings(database_url=database_url).database_url
    opened = Database.open(url)
    try:
        yield url, opened
    finally:
        opened.dispose()


class _Telling:
    """Prints the progress of a copy to stderr now and then."""

    def __init__(self) -> None:
        self._next = time.monotonic() + TOLD_SECONDS

    def __call__(self, table: str, done: int, total: int) -> None:
        if time.monotonic() >= self._next:
            say(f"{table}: {done:,} of {total:,}")
            self._next = time.monotonic() + TOLD_SECONDS


def _rows(copied: Copied) -> str:
    return f"{sum(copied.rows.values()):,} rows ({copied.rows.get('campaigns', 0):,} campaigns, {copied.rows.get('runs', 0):,} runs)"


def _copied(file: Path, opened: Database, copied: Copied, started: float) -> dict[str, Any]:
    seconds = round(time.monotonic() - started, 3)
    return {"file": str(file), "database": opened.name, "revision": copied.revision, "rows": copied.rows, "seconds": seconds}


def _verified(opened: Database) -> dict[str, Any]:
    """Returns the results of all checks; prints problems to stderr at once."""
    from drivecal.storage.maintenance.consistency import verify

    checks: list[dict[str, Any]] = []
    for verdict in verify(opened):
        for problem in verdict.problems:
            say(f"{verdict.name}: {problem}")
        checks.append({"name": verdict.name, "problems": verdict.problems, "seconds": round(verdict.seconds, 3)})
    whole = not any(check["problems"] for check in checks)
    return {"database": opened.name, "current": True, "whole": whole, "checks": checks}


def _print_verified(report: dict[str, Any], as_json: bool) -> None:
    """Prints the checks. Exits with status 1 if one found a problem."""
    if as_json:
        print_json(report)
    else:
        rows = [[each["name"], "broken" if each["problems"] else "well", f"{each['seconds']:.1f}"] for each in report["checks"]]
        print_columns(["check", "result", "wall s"], rows)
        typer.echo(f"{report['database']} is current and {'whole' if report['whole'] else 'broken'}")
    if not report["whole"]:
        say("what is broken stays broken: restore a backup into an empty database")
        raise typer.Exit(ExitCode.FAILED)
