"""Commands about the results of a campaign."""

import json
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, BinaryIO, Literal

import typer

from drivecal.cli.application import CampaignArgument, JsonOption, UrlOption, app, connect, full_id, tell
from drivecal.cli.views.output import print_json, print_solutions
from drivecal.client.client import Client
from drivecal.contracts.assignments import assignments
from drivecal.contracts.tables import TableName
from drivecal.domain.errors import InvalidInputError, Problem

Format = Literal["csv", "parquet", "json"]


@app.command()
def solutions(
    identifier: CampaignArgument,
    weights: Annotated[
        str | None,
        typer.Option(metavar="S1=2,S2=1", help="Rank by these weights instead; simulates nothing. Not named means weight 1."),
    ] = None,
    limit: Annotated[int, typer.Option(min=1, max=1000, help="How many at most, best first.")] = 20,
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the best parameter sets of a campaign."""
    if weights is not None:
        assignments(weights.split(","), "--weights")
    with connect(url) as client:
        campaign_id = full_id(client, identifier)
        page = client.solutions(campaign_id, weights, limit)
        spec = client.campaign(campaign_id).spec
    if as_json:
        print_json(page)
    else:
        print_solutions(page.items, spec)


@app.command()
def export(
    identifier: CampaignArgument,
    table: Annotated[TableName, typer.Option(help="Which table.")] = "evaluations",
    form: Annotated[Format, typer.Option("--format", help="In which format.")] = "csv",
    output: Annotated[str, typer.Option("--output", "-o", metavar="FILE", help="Where to; - is standard output.")] = "-",
    where: Annotated[
        list[str] | None,
        typer.Option(
            metavar="CONDITION", help="Only such rows: COLUMN=VALUE, COLUMN>=NUMBER or COLUMN<=NUMBER; can be given again."
        ),
    ] = None,
    weights: Annotated[
        str | None, typer.Option(metavar="S1=2,S2=1", help="Of the table solutions: ranked under these weights.")
    ] = None,
    url: UrlOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="The same as --format json.")] = False,
) -> None:
    """Write a whole table of a campaign to a file."""
    form = "json" if as_json else form
    if weights is not None and table != "solutions":
        raise typer.BadParameter("--weights needs --table solutions")
    query = {name: value for name, value in (("where", where), ("weights", weights)) if value}
    with connect(url) as client:
        pieces = _pieces(client, full_id(client, identifier), table, form, query)
        if output == "-":
            if form == "parquet" and sys.stdout.isatty():
                raise InvalidInputError(Problem("--output", "Parquet is no text for a terminal", "give -o FILE"))
            for piece in pieces:
                sys.stdout.buffer.write(piece)
            sys.stdout.buffer.flush()
            return
        size = 0
        with _whole_or_not_at_all(Path(output)) as stream:
            for piece in pieces:
                size += stream.write(piece)
    tell(f"{output}: {size:,} bytes")


def _pieces(client: Client, identifier: str, table: TableName, form: Format, query: Mapping[str, Any]) -> Iterator[bytes]:
    if form != "json":
        yield from client.table(identifier, table, form, **query)
        return
    separator = "["
    for row in client.rows(identifier, table, **query):
        yield f"{separator}\n{json.dumps(row, ensure_ascii=False)}".encode()
        separator = ","
    yield b"\n]\n" if separator == "," else b"[]\n"


@contextmanager
def _whole_or_not_at_all(path: Path) -> Iterator[BinaryIO]:
    """Opens a file that appears under its name only when it is complete."""
    unfinished = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with unfinished.open("wb") as stream:
            yield stream
        unfinished.replace(path)
    except OSError as error:
        raise InvalidInputError(Problem(str(path), f"it cannot be written: {error.strerror}", "give another file")) from error
    finally:
        unfinished.unlink(missing_ok=True)
