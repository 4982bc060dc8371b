"""Commands for those who run a server."""

from __future__ import annotations

from typing import Annotated

import typer

from drivecal.cli.commands import JsonOption, UrlOption, app, connect, tell
from drivecal.cli.output import print_columns, print_json, when
from drivecal.configuration.settings import load_settings

database = typer.Typer(no_args_is_help=True, help="The database. These commands open it themselves and need no server.")
app.add_typer(database, name="db")

DatabaseOption = Annotated[
    str | None,
    typer.Option(
        "--database-url", help="SQLAlchemy URL; else DRIVECAL_DATABASE_URL, else the SQLite file under DRIVECAL_HOME."
    ),
]


@app.command()
def workers(url: UrlOption = None, as_json: JsonOption = False) -> None:
    """Show the workers."""
    with connect(url) as client:
        page = client.workers()
    if as_json:
        print_json(page)
        return
    print_columns(["worker", "node", "state", "cells"], [[one.id, one.node, one.state, one.cells] for one in page.items])
    if page.degraded:
        tell(f"degraded: {page.degraded}")
    elif not page.items:
        seen = when(page.dispatcher_seen_at)
        tell(f"no workers; the dispatcher was last heard of {seen}" if seen else "no workers: no dispatcher has started yet")


@database.command()
def upgrade(database_url: DatabaseOption = None, as_json: JsonOption = False) -> None:
    """Create the database or bring it to this drivecal's revision. Refused while a server works on it."""
    _with_database(database_url, as_json, upgrade_first=True)


@database.command()
def check(database_url: DatabaseOption = None, as_json: JsonOption = False) -> None:
    """Say whether drivecal can work with the database as it is."""
    _with_database(database_url, as_json, upgrade_first=False)


def _with_database(database_url: str | None, as_json: bool, *, upgrade_first: bool) -> None:
    from drivecal.storage import locks  # half a second that only these commands need
    from drivecal.storage.database import Database

    url = load_settings(database_url=database_url).database_url
    opened = Database.open(url)
    try:
        if upgrade_first:
            with locks.hold(url):
                opened.upgrade()
        opened.check()
    finally:
        opened.dispose()
    if as_json:
        print_json({"database": opened.name, "current": True})
    else:
        typer.echo(f"{opened.name} is current")
