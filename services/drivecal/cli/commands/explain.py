"""Why a cell was reused, or why it was not."""

from __future__ import annotations

from typing import Annotated

import typer

from drivecal.cli.application import CampaignArgument, JsonOption, UrlOption, app, connect, full_id
from drivecal.cli.views.output import print_columns, print_json
from drivecal.contracts.explanation import Difference, Explanation
from drivecal.domain.errors import NotFoundError


@app.command()
def explain(
    identifier: CampaignArgument,
    evaluation: Annotated[
        str, typer.Argument(metavar="EVALUATION", help="The number of a cell: the column `id` of the table `evaluations`.")
    ],
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Say why a cell was answered without a simulation, or what was in the way."""
    with connect(url) as client:
        campaign = client.campaign(full_id(client, identifier)).id
        found = client.explanation(evaluation)
    if found.campaign != campaign:
        raise NotFoundError(f"evaluation of campaign {campaign}", str(evaluation), f"it is of campaign {found.campaign}")
    if as_json:
        print_json(found)
    else:
        print_explanation(found)


def print_explanation(found: Explanation) -> None:
    """Prints the answer in a sentence, the stored set it speaks of, and the parameters in which the two differ."""
    where = f"{found.stage}, iteration {found.iteration}, individual {found.individual}, {found.scenario}"
    result = found.outcome or "pending"
    if found.score is not None:
        result += f", score {found.score}"
    if found.failure:
        result += f" ({found.failure})"
    typer.echo(f"evaluation {found.evaluation}: {where}\n{result}\n\n{found.sentence}")
    if found.reference is not None:
        one = found.reference
        score = "no score yet" if one.score is None else f"score {one.score}"
        at = f"{one.stage}, iteration {one.iteration}, individual {one.individual}"
        typer.echo(f"\nstored set: evaluation {one.evaluation} of campaign {one.campaign} ({at}), {score}")
    if found.differences:
        typer.echo("")
        header = ["parameter", "this cell", "stored set", "influential", "this lies", "that lies", "in the way"]
        rows = [_line(difference) for difference in found.differences]
        if found.reason == "certified":  # the map would not have allowed it, and was not asked
            header, rows = header[:-1], [row[:-1] for row in rows]
        print_columns(header, rows)
    if found.distance is not None:
        typer.echo(f"\ndistance {found.distance:.4f} of the parameters' ranges")
    if found.stored is not None:
        typer.echo(f"searched {found.stored:,} stored results of the same setup")


def _line(one: Difference) -> list[object]:
    if "anywhere" in (one.region, one.reference_region):
        bounds = "nowhere"
    elif one.lower is None and one.upper is None:
        bounds = "everywhere"
    elif one.lower is None:
        bounds = f"up to {one.upper:g}"
    else:
        bounds = f"from {one.lower:g}" if one.upper is None else f"{one.lower:g} .. {one.upper:g}"
    return [
        one.parameter,
        one.value,
        one.reference_value,
        bounds,
        one.region,
        one.reference_region,
        "yes" if one.blocks else "no",
    ]
