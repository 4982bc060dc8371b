"""Commands about influence maps."""

from __future__ import annotations

from typing import Annotated

import typer

from drivecal.cli.commands import JsonOption, UrlOption, app, connect
from drivecal.cli.documents import read_document
from drivecal.cli.output import print_columns, print_json, when
from drivecal.contracts.inventory import InfluenceMapAnswer

maps = typer.Typer(
    no_args_is_help=True, help="Influence maps: where a parameter can change the score of a scenario, and where not."
)
app.add_typer(maps, name="influence-maps")


@maps.command("list")
def list_maps(url: UrlOption = None, as_json: JsonOption = False) -> None:
    """List the influence maps, newest first."""
    with connect(url) as client:
        page = client.influence_maps()
    if as_json:
        print_json(page)
        return
    rows = [[one.id, when(one.created_at), one.source, one.driving_function, one.name] for one in page.items]
    print_columns(["id", "created", "source", "driving function", "name"], rows)


@maps.command("show")
def show_map(
    identifier: Annotated[str, typer.Argument(metavar="ID", help="The map's id.")],
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show one influence map."""
    with connect(url) as client:
        _print(client.influence_map(identifier), as_json)


@maps.command("post")
def post_map(
    file: Annotated[str, typer.Argument(metavar="FILE", help="An influence map, YAML or JSON; - is standard input.")],
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Store an influence map, so that campaigns can name it in `sensitivity: {map: ID}`."""
    specification = read_document(file)
    with connect(url) as client:
        _print(client.post_influence_map(specification), as_json)


def _print(influence_map: InfluenceMapAnswer, as_json: bool) -> None:
    if as_json:
        print_json(influence_map)
        return
    typer.echo(f"influence map {influence_map.id}  {influence_map.name}  ({influence_map.source})")
    rows = [
        [row.scenario, row.parameter, "yes" if row.influential else "no", row.lower, row.upper]
        for row in influence_map.rows or []
    ]
    print_columns(["scenario", "parameter", "influential", "lower", "upper"], rows)
