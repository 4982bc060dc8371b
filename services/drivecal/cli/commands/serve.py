"""`drivecal serve`: the coordinator in one command."""

import json
import logging
import os
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from importlib.util import find_spec
from typing import Annotated, Literal

import typer

from drivecal.cli.application import JsonOption, app, exit_code, say
from drivecal.cli.views.output import Asked, asking, duration, print_columns
from drivecal.cli.views.sections import fixed, percent
from drivecal.client.client import Client
from drivecal.configuration.settings import Settings, load_settings
from drivecal.configuration.tokens import TokenFile, check_exposure
from drivecal.contracts.inventory import WorkerAnswer, WorkerPage
from drivecal.domain.errors import DrivecalError

log = logging.getLogger(__name__)


@app.command()
def serve(
    host: Annotated[str, typer.Option(help="The address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="The port to listen on; 0 takes any free one.", min=0, max=65535)] = 8000,
    workers: Annotated[int | None, typer.Option(help="Simulations at a time; else DRIVECAL_WORKERS, else one per CPU.")] = None,
    backend: Annotated[
        Literal["ray", "processes"] | None,
        typer.Option(help="What workers run on; else DRIVECAL_BACKEND, else Ray if it is installed."),
    ] = None,
    ray_address: Annotated[
        str | None, typer.Option(help="A Ray cluster; else DRIVECAL_RAY_ADDRESS, else a local Ray is started.")
    ] = None,
    database_url: Annotated[
        str | None, typer.Option(help="SQLAlchemy URL; else DRIVECAL_DATABASE_URL, else SQLite in the home folder.")
    ] = None,
    home: Annotated[str | None, typer.Option(help="Folder of drivecal's files; else DRIVECAL_HOME, else .drivecal.")] = None,
    resources: Annotated[
        str | None,
        typer.Option(help="Licences and other scarce things, such as carmaker=4,vtd=2; else DRIVECAL_RESOURCES, else none."),
    ] = None,
    tokens_file: Annotated[
        str | None,
        typer.Option(
            help="Who may use the server, a line each: NAME read|write|author|admin TOKEN; else DRIVECAL_TOKENS_FILE, else this machine."
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Run the server: the API and the dispatcher with its workers. Ctrl-C or SIGTERM stops it; campaigns continue at the next start."""
    from drivecal.configuration import logs  # half a second, for this command only

    settings = load_settings(
        workers=workers,
        backend=backend,
        ray_address=ray_address,
        database_url=database_url,
        home=home,
        resources=resources,
        tokens_file=tokens_file,
    )
    logs.configure("server", settings)
    try:
        code = _serve(settings, host, port, as_json=as_json)
    except DrivecalError as error:
        if settings.log_format != "json":
            raise
        log.error("%s", error)  # noqa: TRY400  # the sentence says it all; a traceback would bury it
        code = exit_code(error)
    raise typer.Exit(code)


def _serve(settings: Settings, host: str, port: int, *, as_json: bool) -> int:
    from drivecal.server import serving  # and the database's half a second

    if (settings.backend == "ray" or settings.ray_address is not None) and find_spec("ray") is None:
        raise ModuleNotFoundError("Ray is not installed", name="ray")  # the command line names its extra
    with serving.listen(host, port) as listener:
        url = serving.url_of(listener, host)
        check_exposure(listener.getsockname()[0], settings)
        if settings.tokens_file is None:
            log.info("no token is asked for: only this machine can connect")
        else:
            tokens = TokenFile(settings.tokens_file).tokens
            reading = sum(not token.may_write for token in tokens)
            log.info("a token is asked for: %d in %s, %d of them may only read", len(tokens), settings.tokens_file, reading)
        database = serving.prepare_database(settings)
        database.dispose()
        log.info("starting at %s; the database is %s", url, database.name)

        def ready() -> None:
            with suppress(OSError):  # of a full disk or a closed pipe: the server works all the same
                ready_as = {"url": url, "pid": os.getpid(), "database": database.name}
                typer.echo(json.dumps(ready_as) if as_json else f"drivecal is ready at {url} (Ctrl-C stops it)")

        return serving.run_server(settings, listener, url, ready)


@app.command()
@asking
def workers(client: Client) -> Asked:
    """Show the workers with their activity and speed, and their share of busy time in the last 15 minutes."""
    page = client.workers(minutes=15)
    return page, lambda: _print(page)


def _print(page: WorkerPage) -> None:
    now = datetime.now(UTC)
    done, seconds = page.window, timedelta(seconds=1)
    known = (done.until - done.complete_since) / seconds if done else 0.0
    busy = {time.worker: sum(time.busy) / known for time in done.workers} if done and known else {}
    header = ["worker", "node", "state", "cells", "cells/s", "busy, 15 min", "simulates"]
    rows = [
        [
            *(item.id, item.node, item.state, item.cells, fixed(item.cells_per_second, 1)),
            *(percent(busy.get(item.id, 0.0), 0), doing(item, now)),
        ]
        for item in page.items
    ]
    print_columns(header, rows)
    for line in remarks(page, now):
        say(line)


def doing(worker: WorkerAnswer, now: datetime) -> str | None:
    """Returns the running scenario of a worker, and the time of its batch."""
    if worker.scenario is None or worker.since is None:
        return worker.scenario
    return f"{worker.scenario} for {duration(max(0.0, (now - worker.since) / timedelta(seconds=1)))}"


def remarks(page: WorkerPage, now: datetime) -> list[str]:
    """Returns remarks on the table."""
    late = {use.name: f", {use.settling} of them by runs of lost workers" if use.settling else "" for use in page.resources}
    uses = [f"{use.name}: {use.held} of {use.total} in use{late[use.name]}" for use in page.resources]
    waits = [f"{each.name} ({each.id[:8]}) waits: {each.reason}" for each in page.waiting]
    lines = [*uses, *waits, *([f"degraded: {page.degraded}"] if page.degraded else [])]
    if not page.fresh and page.items and page.dispatcher_seen_at is not None:
        age = duration((now - page.dispatcher_seen_at) / timedelta(seconds=1))
        lines.append(f"this is what the dispatcher said {age} ago, before it fell silent")
    return lines
