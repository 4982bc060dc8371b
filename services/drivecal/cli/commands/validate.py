"""`drivecal validate`: shows a campaign's validation study, and makes a missing study."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import typer

from drivecal.cli.application import CampaignArgument, JsonOption, UrlOption, app, connect
from drivecal.cli.commands.studies import known, make, wanted_of
from drivecal.cli.views.output import dumped, print_columns, print_json
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.tables import ValidationRow
from drivecal.domain.errors import ConflictError
from drivecal.domain.scales import COMFORT, Scale
from drivecal.report.rows import PREDICTIONS, errors_text, interval_text, percent, predictions, totals

ALL = 1_000_000
"""More than a scenario's released predictions."""


@app.command()
def validate(
    identifier: CampaignArgument,
    predicted: Annotated[bool, typer.Option("--predicted", help="Simulate released predictions instead.")] = False,
    samples: Annotated[
        int | None, typer.Option(min=1, help="Sets of the first Latin hypercube, else 200; predictions by scenario, else all.")
    ] = None,
    references: Annotated[int | None, typer.Option(min=1, max=1000, help="Variants of each set; else 30.")] = None,
    largest: Annotated[int | None, typer.Option(min=1, help="Sets of the largest Latin hypercube; else 20000.")] = None,
    again: Annotated[bool, typer.Option("--again", help="Repeat the study even if one exists.")] = False,
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check by simulation whether a campaign's influence map is right where it says that a parameter does not matter.

    With `--predicted`: whether the predictions that the campaign released are right.
    """
    with connect(url) as client:
        campaign = client.campaign(client.full_id(identifier))
        given = {"samples": samples or ALL} if predicted else {"samples": samples, "references": references, "largest": largest}
        wanted = wanted_of(campaign, "validation", given)
        wanted = replace(wanted, settings={**wanted.settings, "of": campaign.id if predicted else None})
        maker = None if again else known(client, campaign, wanted)
        if maker is None:
            stages = {"sensitivity": None if predicted else _map_of(campaign), "validation": dict(wanted.settings)}
            maker = make(client, campaign, "validation", stages)
        rows = client.validation(maker.id)
    if as_json:
        print_json(dumped(rows))
    elif predicted:
        print_released(rows, campaign.scale)
    else:
        print_validation(rows, campaign.scale)


def _map_of(campaign: Campaign) -> dict[str, str]:
    link = campaign.links.get("influence_map")
    if link is None:
        raise ConflictError(f"campaign {campaign.id} has no influence map to validate; `--predicted` checks its predictions")
    return {"map": link.rpartition("/")[2]}


def print_released(rows: Sequence[ValidationRow], scale: Scale = COMFORT) -> None:
    """Prints how many released predictions are right."""
    print_columns(PREDICTIONS, predictions(rows))
    compared, different, wrong = totals(rows, "compared", "different", "wrong")
    if compared:
        typer.echo(errors_text("predictions", compared, different, wrong, scale))


def print_validation(rows: Sequence[ValidationRow], scale: Scale = COMFORT) -> None:
    """Prints Tables 1 and 2 of the paper for this map."""
    print_columns(
        ["scenario", "n", "n*_LHS", "n_ref", "compared", "different", "wrong", "R_err", "95 % interval", "effects covered"],
        [
            [
                *(row.scenario, row.reducible, row.bases, row.references, row.compared, row.different, row.wrong),
                percent(row.error_rate, 3),
                None if row.lower_95 is None or row.upper_95 is None else f"{row.lower_95:.3%} to {row.upper_95:.3%}",
                f"{row.covered} of {row.effects}",
            ]
            for row in rows
        ],
    )
    compared, different, wrong = totals(rows, "compared", "different", "wrong")
    if compared:
        typer.echo(errors_text("variants", compared, different, wrong, scale))
        typer.echo(interval_text(rows))
    nothing = [row.scenario for row in rows if not row.compared]
    if nothing:
        typer.echo(f"nothing to validate in {', '.join(nothing)}: no parameter has a region in which it does not matter")
