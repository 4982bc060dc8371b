"""`drivecal robustness` and `drivecal validate`: studies of what a campaign found, shown where they are made, else made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import typer

from drivecal.cli import compared
from drivecal.cli.commands import CampaignArgument, JsonOption, UrlOption, app, code_of_state, connect, full_id, tell
from drivecal.cli.output import parameters_text, print_columns, print_json
from drivecal.cli.watching import follow
from drivecal.client.client import Client
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.studies import RobustnessRow, ValidationRow
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import ConflictError

STAGES = ("optimizer", "sensitivity", "robustness", "validation")
AgainOption = Annotated[bool, typer.Option("--again", help="Make the study anew, even where the campaign has one.")]


@app.command()
def robustness(
    identifier: CampaignArgument,
    solutions: Annotated[int, typer.Option(min=1, max=1000, help="The most sets that are examined.")] = 20,
    delta: Annotated[float, typer.Option(help="Half the width of the first box, in shares of the vehicle's ranges.")] = 0.01,
    steps: Annotated[int, typer.Option(min=1, max=100, help="Boxes.")] = 10,
    samples: Annotated[int, typer.Option(min=1, max=10_000, help="Vehicles in each box.")] = 30,
    eta: Annotated[float, typer.Option(help="What the condition allows.")] = 1.0,
    condition: Annotated[str, typer.Option(help="max, mean or per_factor.")] = "max",
    refinements: Annotated[int, typer.Option(min=0, max=30, help="Halvings of the last step.")] = 0,
    vehicle: Annotated[
        str | None, typer.Option(help="Make the study in this vehicle model too, and show what changes.")
    ] = None,
    compare: Annotated[str | None, typer.Option(help="Another campaign's study: show what changes.")] = None,
    again: AgainOption = False,
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Rank the best sets of a campaign by how far the vehicle may differ; drives them in other vehicles where that was not done yet."""
    if vehicle is not None and compare is not None:
        raise typer.BadParameter("name a vehicle model or another campaign, not both")
    wanted = {
        "solutions": solutions,
        "delta": delta,
        "steps": steps,
        "samples": samples,
        "eta": eta,
        "condition": condition,
        "refinements": refinements,
    }
    with connect(url) as client:
        campaign = client.campaign(full_id(client, identifier))
        rows = [] if again else client.robustness(campaign.id)
        if not rows:
            made = _make(client, campaign, "robustness", {"robustness": wanted | {"of": campaign.id}})
            rows = client.robustness(made.id)
        elif campaign.spec.get("robustness"):
            wanted = campaign.spec["robustness"]
        others = None
        if vehicle is not None:
            driven = {"vehicle": campaign.spec["vehicle"] | {"model": vehicle}, "robustness": wanted | {"of": campaign.id}}
            others = client.robustness(_make(client, campaign, f"robustness in {vehicle}", driven).id)
        elif compare is not None:
            others = client.robustness(full_id(client, compare))
    if as_json:
        print_json([row.model_dump(mode="json") for row in rows] if others is None else compared.document(rows, others))
    elif others is None:
        print_robustness(rows)
    else:
        compared.print_difference(rows, others)


@app.command()
def validate(
    identifier: CampaignArgument,
    samples: Annotated[int, typer.Option(min=1, help="Sets of the first Latin hypercube.")] = 200,
    references: Annotated[int, typer.Option(min=1, max=1000, help="Variants of each set.")] = 30,
    largest: Annotated[int, typer.Option(min=1, help="Sets of the largest Latin hypercube.")] = 20_000,
    again: AgainOption = False,
    url: UrlOption = None,
    as_json: JsonOption = False,
) -> None:
    """Check by simulation whether a campaign's influence map is right where it says that a parameter does not matter."""
    wanted = {"samples": samples, "references": references, "largest": max(largest, samples)}
    with connect(url) as client:
        campaign = client.campaign(full_id(client, identifier))
        rows = [] if again else client.validation(campaign.id)
        if not rows:
            link = campaign.links.get("influence_map")
            if link is None:
                raise ConflictError(f"campaign {campaign.id} has no influence map to validate")
            sensitivity = {"map": link.rpartition("/")[2]}
            made = _make(client, campaign, "validation", {"sensitivity": sensitivity, "validation": wanted})
            rows = client.validation(made.id)
    if as_json:
        print_json([row.model_dump(mode="json") for row in rows])
    else:
        print_validation(rows)


def _make(client: Client, campaign: Campaign, study: str, stages: dict[str, Any]) -> Campaign:
    """A campaign like the given one that makes the study alone, followed to its end."""
    specification = {**campaign.spec, **dict.fromkeys(STAGES), **stages}
    specification["name"] = f"{campaign.name[:180]} ({study})"
    made = client.submit(specification)
    tell(f"campaign {made.id} makes the study")
    ended = follow(client, made.id)
    if CampaignState(ended.state) is not CampaignState.SUCCEEDED:
        tell(f"campaign {made.id} {ended.state}{f': {ended.error}' if ended.error else ''}")
        raise typer.Exit(code_of_state(ended.state))
    return ended


def print_robustness(rows: Sequence[RobustnessRow]) -> None:
    """Prints the examined sets, most robust first."""
    if not rows:
        typer.echo("no set was examined: the campaign found none with a result in every scenario")
        return
    print_columns(
        ["rank", "degree", "delta_max", "objective", "scores", "region", "to worse", "parameters"],
        [
            [
                row.rank,
                f">= {row.degree}" if row.at_least else row.degree,
                f"{row.radius:.4g}",
                None if row.objective is None else f"{row.objective:.4f}",
                " ".join(f"{name} {'-' if score is None else score}" for name, score in row.scores.items()),
                row.region,
                None if row.to_worse is None else f"{row.to_worse:.3f}",
                parameters_text(row.parameters),
            ]
            for row in rows
        ],
    )
    for row in rows:
        if row.recommended:
            typer.echo(f"recommended: rank {row.rank}, because it has {row.reason}")


def print_validation(rows: Sequence[ValidationRow]) -> None:
    """Prints Tables 1 and 2 of the paper for this map."""
    print_columns(
        ["scenario", "n", "n*_LHS", "n_ref", "compared", "different", "wrong", "R_err", "95 % interval", "effects covered"],
        [
            [
                row.scenario,
                row.reducible,
                row.bases,
                row.references,
                row.compared,
                row.different,
                row.wrong,
                None if row.error_rate is None else f"{row.error_rate:.3%}",
                None if row.lower_95 is None or row.upper_95 is None else f"{row.lower_95:.3%} to {row.upper_95:.3%}",
                f"{row.covered} of {row.effects}",
            ]
            for row in rows
        ],
    )
    nothing = [row.scenario for row in rows if not row.compared]
    if nothing:
        typer.echo(f"nothing to validate in {', '.join(nothing)}: no parameter has a region in which it does not matter")
