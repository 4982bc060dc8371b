"""Commands about influence maps."""

from typing import Annotated

import typer

from drivecal.cli.application import JsonOption, UrlOption, app, connect, full_map_id
from drivecal.cli.commands.influence import print_influence
from drivecal.cli.views.output import print_answer, print_page, when
from drivecal.client.documents import read_document
from drivecal.contracts.inventory import InfluenceMapAnswer

maps = typer.Typer(
    no_args_is_help=True, help="Influence maps: where a parameter can change the score of a scenario, and where not."
)
app.add_typer(maps, name="influence-maps")


@maps.command("list")
def list_maps(
    limit: Annotated[int, typer.Option(min=1, max=1000, help="How many at most, newest first.")] = 20,
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """List the influence maps, newest first. The source is the campaign whose analysis made it, or `expert`."""
    with connect(url) as client:
        page = client.influence_maps(limit=limit)
    rows = [[item.id, when(item.created_at), item.source, item.driving_function, item.name] for item in page.items]
    print_page(page, as_json, ["id", "created", "source", "driving function", "name"], rows, limit)


@maps.command("show")
def show_map(
    identifier: Annotated[str, typer.Argument(metavar="ID", help="The map's id, or the first characters of it.")],
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show one influence map."""
    with connect(url) as client:
        print_answer(client.influence_map(full_map_id(client, identifier)), as_json, _print)


@maps.command("post")
def post_map(
    file: Annotated[str, typer.Argument(metavar="FILE", help="An influence map, YAML or JSON; - is standard input.")],
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Store an influence map, so that campaigns can name it in `sensitivity: {map: ID}`."""
    specification = read_document(file)
    with connect(url) as client:
        print_answer(client.post_influence_map(specification), as_json, _print)


def _print(influence_map: InfluenceMapAnswer) -> None:
    typer.echo(f"influence map {influence_map.id}  {influence_map.name}  ({influence_map.source})")
    print_influence(influence_map.rows or [], influence_map.basis)
