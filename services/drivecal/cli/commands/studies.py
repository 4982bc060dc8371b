"""Studies of a campaign's results: existing studies, by itself or another campaign, and new ones."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import typer

from drivecal.analysis.robustness import vehicles_text
from drivecal.cli.application import CampaignArgument, app, code_of_state, say
from drivecal.cli.views.output import Asked, asking, parameters_text, print_blocks, print_columns
from drivecal.cli.views.progress import follow
from drivecal.cli.views.sections import objective_number, validation_tables
from drivecal.client.client import Client
from drivecal.contracts.campaign import STUDIES, Campaign, StudyName
from drivecal.contracts.setup import ShapeAnswer
from drivecal.contracts.tables import RobustnessRow, ValidationRow
from drivecal.domain.campaigns import CampaignState
from drivecal.domain.errors import ConflictError
from drivecal.domain.scales import COMFORT, Scale, score_text

STAGES = ("optimizer", "sensitivity", *STUDIES)
BENCH = ("problem", "catalogue", "weights", "driving_function", "vehicle", "evaluator")
"""Settings that a study takes from its subject by default."""
_STUDIES = re.compile(rf"( \(({'|'.join(STUDIES)})( in [^()]*)?\))+$")


@dataclass(frozen=True, slots=True)
class Wanted:
    """A wanted study: its given `settings`, and its bench."""

    stage: StudyName
    settings: Mapping[str, Any]
    bench: Mapping[str, Any]

    def is_made_by(self, maker: Campaign) -> bool:
        """Returns whether a campaign's study is the wanted one."""
        settings = maker.spec.get(self.stage) or {}
        same = all(settings.get(name) == value for name, value in self.settings.items())
        return same and _bench(maker) == self.bench


def wanted_of(campaign: Campaign, stage: StudyName, given: Mapping[str, Any]) -> Wanted:
    """Returns the wanted study of a campaign in its own vehicle, with the settings that the user gave."""
    settings = {name: value for name, value in given.items() if value is not None}
    return Wanted(stage, settings, _bench(campaign))


def _bench(campaign: Campaign) -> dict[str, Any]:
    return {name: campaign.spec[name] for name in BENCH if name in campaign.spec}


def known(client: Client, campaign: Campaign, wanted: Wanted) -> Campaign | None:
    """Returns the campaign that made the wanted study: itself, else the newest, if it succeeded; a campaign that makes it now is
    followed to its end. None without a study."""
    if campaign.state == CampaignState.SUCCEEDED and campaign.spec.get(wanted.stage) and wanted.is_made_by(campaign):
        return campaign
    for study in client.studies(campaign.id).items:
        state = CampaignState(study.state)
        if (
            study.stage == wanted.stage
            and study.campaign != campaign.id
            and (state is CampaignState.SUCCEEDED or not state.ended)
        ):
            maker = client.campaign(study.campaign)
            if wanted.is_made_by(maker):
                return maker if state is CampaignState.SUCCEEDED else _followed(client, maker)
    return None


def specification(campaign: Campaign, study: str, stages: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the specification of a campaign that makes only the study. A study of a study is named after their common subject."""
    name = f"{_STUDIES.sub('', campaign.name)[:180]} ({study})"
    return {**campaign.spec, **dict.fromkeys(STAGES), **stages, "name": name}


def make(client: Client, campaign: Campaign, study: str, stages: Mapping[str, Any]) -> Campaign:
    """Submits the campaign of `specification` and returns it at its end. Exits unless it succeeds."""
    return _followed(client, client.submit(specification(campaign, study, stages)))


def _followed(client: Client, made: Campaign) -> Campaign:
    say(f"campaign {made.id} makes the study")
    ended = follow(client, made.id)
    if CampaignState(ended.state) is not CampaignState.SUCCEEDED:
        say(f"campaign {made.id} {ended.state}{f': {ended.error}' if ended.error else ''}")
        raise typer.Exit(code_of_state(ended.state))
    return ended


ALL = 1_000_000
"""More than a scenario's released predictions."""


@app.command()
@asking
def validate(
    client: Client,
    identifier: CampaignArgument,
    predicted: Annotated[bool, typer.Option("--predicted", help="Simulate released predictions instead.")] = False,
    samples: Annotated[
        int | None, typer.Option(min=1, help="Sets of the first Latin hypercube, else 200; predictions by scenario, else all.")
    ] = None,
    references: Annotated[int | None, typer.Option(min=1, max=1000, help="Variants of each set; else 30.")] = None,
) -> Asked:
    """Check by simulation whether a campaign's influence map is right where it says that a parameter does not matter.

    With `--predicted`: whether the predictions that the campaign released are right.
    """
    if predicted and references is not None:
        raise typer.BadParameter("--references are variants of a map's sets: leave it out with --predicted")
    campaign = client.campaign(identifier)
    given = {"samples": samples or ALL} if predicted else {"samples": samples, "references": references}
    wanted = wanted_of(campaign, "validation", given)
    wanted = replace(wanted, settings={**wanted.settings, "of": campaign.id if predicted else None})
    maker = known(client, campaign, wanted)
    if maker is None:
        stages = {"sensitivity": None if predicted else _map_of(campaign), "validation": dict(wanted.settings)}
        maker = make(client, campaign, "validation", stages)
    rows = client.validation(maker.id)
    return rows, lambda: print_validation(rows, campaign.scale)


def _map_of(campaign: Campaign) -> dict[str, str]:
    link = campaign.links.get("influence_map")
    if link is None:
        raise ConflictError(f"campaign {campaign.id} has no influence map to validate; `--predicted` checks its predictions")
    return {"map": link.rpartition("/")[2]}


def print_validation(rows: Sequence[ValidationRow], scale: Scale = COMFORT) -> None:
    """Prints Tables 1 and 2 of the paper for a map, or how many released predictions are right."""
    print_blocks(validation_tables(rows, scale))
    reasons = {
        "no parameter has a region where it does not matter": [row for row in rows if row.released is None and not row.bases],
        "no prediction was released": [row for row in rows if row.released == 0],
    }
    for reason, empty in reasons.items():
        if empty:
            typer.echo(f"nothing to validate in {', '.join(row.scenario for row in empty)}: {reason}")


@app.command()
@asking
def robustness(
    client: Client,
    identifier: CampaignArgument,
    solutions: Annotated[int | None, typer.Option(min=1, max=1000, help="The most sets that are examined; else 20.")] = None,
    delta: Annotated[
        float | None, typer.Option(help="Half the width of the first box, in shares of the vehicle's ranges; else 0.01.")
    ] = None,
    steps: Annotated[int | None, typer.Option(min=1, max=100, help="Boxes; else 10.")] = None,
    samples: Annotated[int | None, typer.Option(min=1, max=10_000, help="Vehicles in each box; else 30.")] = None,
    eta: Annotated[float | None, typer.Option(help="What the condition allows; else the tolerance, of a mean 1.")] = None,
    vehicle: Annotated[
        str | None, typer.Option(help="Examine the same sets in this vehicle model; the page shows both studies.")
    ] = None,
) -> Asked:
    """Rank the best sets of a campaign by how far the vehicle may differ; simulates them in other vehicles if no study exists."""
    given = {"solutions": solutions, "delta": delta, "steps": steps, "samples": samples, "eta": eta}
    campaign = client.campaign(identifier)
    wanted = wanted_of(campaign, "robustness", given)
    maker = known(client, campaign, wanted)
    if maker is None:
        stages = {"robustness": {**wanted.settings, "of": _source(campaign)}}
        if vehicle is not None:  # an unknown vehicle is refused before anything is driven
            there = {"vehicle": campaign.spec["vehicle"] | {"model": vehicle}}
            client.expected_runs(specification(campaign, "robustness", stages | there))
        maker = make(client, campaign, "robustness", stages)
    if vehicle is not None:
        maker = _in_another_vehicle(client, campaign, maker, vehicle)
    rows = client.robustness(maker.id)
    return rows, lambda: print_robustness(rows, maker.spec["robustness"], client.setup(maker.id).shapes)


def _source(campaign: Campaign) -> str:
    """Returns the id of the campaign whose best sets are examined, also for a study of another campaign's sets."""
    return (campaign.spec.get("robustness") or {}).get("of") or campaign.id


def _in_another_vehicle(client: Client, campaign: Campaign, maker: Campaign, model: str) -> Campaign:
    """Returns the campaign of the same study, with all its settings and sets, in another vehicle model. The sets are named, for what the
    study has simulated may have changed which are the best."""
    examined = [row.parameters for row in client.robustness(maker.id)]
    settings: dict[str, Any] = {**maker.spec["robustness"], "of": _source(maker), "sets": examined, "solutions": 0}
    bench = {name: maker.spec.get(name) for name in BENCH} | {"vehicle": maker.spec["vehicle"] | {"model": model}}
    source = campaign if campaign.id == settings["of"] else client.campaign(settings["of"])
    made = known(client, source, Wanted("robustness", settings, bench))
    stages = {"robustness": settings, "vehicle": bench["vehicle"]}
    return made or make(client, maker, f"robustness in {model}", stages)


def print_robustness(rows: Sequence[RobustnessRow], settings: Mapping[str, Any], shapes: Mapping[str, ShapeAnswer]) -> None:
    """Prints the examined sets of a study with these `settings`, most robust first."""
    if not rows:
        typer.echo("no set was examined: the campaign found none with a result in every scenario")
        return
    print_columns(
        ["rank", "degree", "delta_max", "objective", "scores", "region", "parameters"],
        [
            [
                *(row.rank, f"{'≥ ' if row.at_least else ''}{row.degree}", f"{row.radius:.4g}"),
                objective_number(row.objective),
                " ".join(f"{name} {score_text(score)}" for name, score in row.scores.items()),
                *(row.region, parameters_text(row.parameters, shapes=shapes)),
            ]
            for row in rows
        ],
    )
    typer.echo(vehicles_text(settings, len(rows), rows[0].replicates))
    if not settings.get("sets") and len(rows) < settings["solutions"]:
        typer.echo("No further set is as good as the best one; `robustness.sets` in a campaign file examines others.")
    for row in (each for each in rows if each.recommended):
        typer.echo(f"recommended: rank {row.rank}, because it has {row.reason}")
