"""`drivecal influence` and `drivecal influence-maps`: influential bounds of campaigns and maps, and stored maps."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Annotated, Any

import typer

from drivecal.cli.application import app
from drivecal.cli.views.output import Asked, asking, print_columns, print_page, when
from drivecal.cli.views.sections import fixed
from drivecal.client.client import Client
from drivecal.configuration.documents import opened_document
from drivecal.contracts.inventory import InfluenceMapAnswer
from drivecal.contracts.tables import InfluenceRow
from drivecal.domain.errors import ConflictError, NotFoundError
from drivecal.sensitivity.agreement import Agreement, agreement
from drivecal.sensitivity.thresholds import caveats


@dataclass(frozen=True)
class Described:
    """Rows, the title of their source, the basis of its analysis (None for a posted map), and the rows of the map in its own space."""

    title: str
    rows: Sequence[InfluenceRow]
    basis: Mapping[str, Any] | None
    in_map: Sequence[InfluenceRow]


@app.command()
@asking
def influence(
    client: Client,
    identifier: Annotated[str, typer.Argument(metavar="ID", help="A campaign's or an influence map's id, or its beginning.")],
    compare: Annotated[
        str | None, typer.Option(metavar="ID", help="Another campaign or map: list the pairs on which they disagree.")
    ] = None,
) -> Asked:
    """Show where each parameter can change the score of each scenario, or compare that with another campaign's or map's."""
    first = _described(client, identifier)
    if compare is not None:
        return _compared(first, _described(client, compare))

    def show() -> None:
        typer.echo(first.title)
        print_influence(first.rows, first.basis)

    return first.rows, show


def print_influence(rows: Sequence[InfluenceRow], basis: Mapping[str, Any] | None) -> None:
    """Prints a table per scenario, and the analysis behind the rows."""
    if not rows:
        typer.echo("no rows: no influence map is in use yet, or it lists nothing; `sensitivity: {}` asks for an analysis")
        return
    measured = any(row.s_rel_intervals is not None for row in rows)
    header = ["parameter", "influential", "lower", "upper", "unit"]
    header += ["mu", "sigma", "mu*", "largest s_rel"] if measured else []
    decided = any(row.decided_by for row in rows)
    header += ["decided by"] if decided else []
    for scenario, listed in by_scenario(rows).items():
        nothing_known = all(row.unknown and row.s_rel_intervals is not None for row in listed)
        unknown = "  unknown: no feasible run was better than a failed one, so everything counts" if nothing_known else ""
        typer.echo(f"\n{scenario}{unknown}")
        print_columns(header, [_line(row, measured, decided) for row in listed])
    if basis is not None:
        typer.echo(f"\n{_rests_on(basis)}")
        for line in caveats(basis["sensitivity"]):
            typer.echo(line)
        typer.echo("\nThe smallest s_rel that is not 0; a threshold below it means any change at all:\n")
        parts = ("intervals", "overall")
        smallest = basis["smallest_s_rel"].items()
        lines = [[scenario, *(fixed(least[part], 3) or "all are 0" for part in parts)] for scenario, least in smallest]
        print_columns(["scenario", *parts], lines)


def bounds_text(row: InfluenceRow) -> str:
    """Returns influential bounds as `0.2 .. 0.8`, `everywhere` without any, or `nowhere`."""
    if not row.influential:
        return "nowhere"
    ends = ["its bound" if bound is None else f"{bound:g}" for bound in (row.lower, row.upper)]
    known = "everywhere" if row.lower is row.upper is None else " .. ".join(ends)
    return known + (" (unknown)" if row.unknown else "")


def _line(row: InfluenceRow, measured: bool, decided: bool) -> list[object]:
    answer = "unknown" if row.unknown else "yes" if row.influential else "no"
    line: list[object] = [row.parameter, answer, row.lower, row.upper, row.unit]
    if measured:
        largest = max((value for value in row.s_rel_intervals or [] if value is not None), default=None)
        line += [fixed(value, 3) for value in (row.mu, row.sigma, row.mu_star, largest)]
    return [*line, row.decided_by] if decided else line


def _rests_on(basis: Mapping[str, Any]) -> str:
    settings = basis["sensitivity"]
    threshold = settings["threshold"]
    if isinstance(threshold, dict):
        threshold = ", ".join(f"{name} {value:g}" for name, value in threshold.items())
    return (
        f"design {settings['design']}, {settings['intervals']} intervals, {settings['samples']} samples, threshold {threshold}, "
        f"seed {settings['seed']}: {basis['runs']:,} runs asked for, {basis['simulated']:,} simulated for it"
    )


def _described(client: Client, identifier: str) -> Described:
    """Returns a campaign's map within the campaign's bounds, or a map by its own id. Raises NotFoundError."""
    try:
        campaign = client.campaign(identifier)
    except NotFoundError:
        try:
            stored = client.influence_map(identifier)
        except NotFoundError as error:
            raise NotFoundError("campaign or influence map", identifier) from error
        return Described(f"influence map {stored.id}  {stored.name}", stored.rows or [], stored.basis, stored.rows or [])
    used = client.map_of(campaign)
    basis, in_map = (None, []) if used is None else (used.basis, used.rows or [])
    return Described(f"campaign {campaign.id}  {campaign.name}", client.influence(campaign.id), basis, in_map)


def _compared(first: Described, second: Described) -> Asked:
    for source in (first, second):
        if not source.rows:
            raise ConflictError(f"{source.title} has no influence map to compare (yet)")
    compared = agreement(first.rows, second.rows, first.in_map, second.in_map)
    sources = {"first": first.title, "second": second.title}
    return {**sources, **compared.document()}, lambda: _print_agreement(compared, **sources)


def _print_agreement(agreement: Agreement, first: str, second: str) -> None:
    typer.echo(f"first   {first}\nsecond  {second}\n")
    if agreement.share is None:
        typer.echo("they have no scenario and parameter in common")
    else:
        typer.echo(f"{agreement.agreeing} of {agreement.pairs} pairs agree within an interval ({100 * agreement.share:.1f} %)")
    if agreement.differences:
        typer.echo("")
        header = ["scenario", "parameter", "first", "second"]
        rows = [[pair[0].scenario, pair[0].parameter, *map(bounds_text, pair)] for pair in agreement.differences]
        print_columns(header, rows)
    for name, pairs in (("first", agreement.only_first), ("second", agreement.only_second)):
        if pairs:
            groups = groupby(pairs, key=lambda pair: pair[0])
            known = (f"{scenario} {', '.join(parameter for _, parameter in group)}" for scenario, group in groups)
            typer.echo(f"only the {name} knows {'; '.join(known)}")


maps = typer.Typer(no_args_is_help=True, help="Influence maps: where a parameter can change a scenario's score, and where not.")
app.add_typer(maps, name="influence-maps")


@maps.command("list")
@asking
def list_maps(
    client: Client, limit: Annotated[int, typer.Option(min=1, max=1000, help="How many at most, newest first.")] = 20
) -> Asked:
    """List the influence maps, newest first. The source is the campaign whose analysis made it, or `expert`."""
    page = client.influence_maps(limit=limit)
    rows = [[item.id, when(item.created_at), item.source, item.driving_function, item.name] for item in page.items]
    return page, lambda: print_page(page, ["id", "created", "source", "driving function", "name"], rows, limit)


@maps.command("show")
@asking
def show_map(
    client: Client,
    identifier: Annotated[str, typer.Argument(metavar="ID", help="The map's id, or at least its first four characters.")],
) -> Asked:
    """Show one influence map."""
    return _map(client.influence_map(identifier))


@maps.command("post")
@asking
def post_map(
    client: Client,
    file: Annotated[str, typer.Argument(metavar="FILE", help="An influence map, YAML or JSON; - is standard input.")],
) -> Asked:
    """Store an influence map, so that campaigns can name it in `sensitivity: {map: ID}`."""
    with opened_document(file) as specification:
        return _map(client.post_influence_map(specification))


def _map(influence_map: InfluenceMapAnswer) -> Asked:
    def show() -> None:
        typer.echo(f"influence map {influence_map.id}  {influence_map.name}  ({influence_map.source})")
        print_influence(influence_map.rows or [], influence_map.basis)

    return influence_map, show


def by_scenario(rows: Iterable[InfluenceRow]) -> dict[str, list[InfluenceRow]]:
    """Returns the rows of each scenario, in order."""
    return {scenario: list(members) for scenario, members in groupby(rows, key=lambda row: row.scenario)}
