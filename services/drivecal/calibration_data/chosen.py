"""Values of a campaign's chosen set in a calibration file, and how sure they are."""

from collections.abc import Iterator, Mapping, Sequence

from drivecal.calibration_data.characteristics import Characteristic, Quality
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.setup import CampaignSetup, SearchedParameter
from drivecal.contracts.tables import RobustnessRow, Solution


def characteristics_of(
    values: Mapping[str, float | str], parameters: Sequence[SearchedParameter], labels: Mapping[str, str]
) -> list[Characteristic]:
    """Returns the values of a parameter set under their labels, in the order of the parameters. `labels`: by parameter; else its name."""
    return [
        Characteristic(
            labels.get(parameter.name, parameter.name),
            values[parameter.name],
            parameter.unit,
            lower=None if parameter.choices else parameter.lower,
            upper=None if parameter.choices else parameter.upper,
            integer=parameter.kind == "integer",
            choices=tuple(parameter.choices),
        )
        for parameter in parameters
        if parameter.name in values
    ]


def quality_of(campaign: Campaign, setup: CampaignSetup, chosen: Solution, robustness: Sequence[RobustnessRow]) -> Quality:
    """Returns the quality data of a chosen set. It is preliminary while a score is a reference's or the campaign has not succeeded."""
    sure = campaign.state == "succeeded" and not chosen.reused
    time = campaign.ended_at or campaign.created_at
    problem = str(campaign.spec.get("problem", "highway"))
    simulators = sorted({scenario.simulator for scenario in setup.scenarios if scenario.simulator})
    return Quality(
        state="calibrated" if sure else "prelimCalibrated",
        date="" if time is None else time.isoformat(timespec="seconds"),
        project=problem,
        work_product=campaign.name,
        test_object=", ".join(simulators) or str(campaign.spec.get("driving_function", problem)),
        campaign=campaign.id,
        data=next((scenario.files for scenario in setup.scenarios if scenario.files), ""),
        figures=tuple(_figures(campaign, chosen, robustness)),
    )


def _figures(campaign: Campaign, chosen: Solution, robustness: Sequence[RobustnessRow]) -> Iterator[tuple[str, str]]:
    scale = campaign.scale
    yield "objective", _number(chosen.objective)
    if campaign.baseline is not None and campaign.baseline.objective is not None:
        yield "objective of the baseline", _number(campaign.baseline.objective)
    unit = "" if scale.unit == "1" else f" {scale.unit}"
    yield "score", f"{scale.name}, {scale.direction.value}, {_number(scale.lower)} to {_number(scale.upper)}{unit}"
    yield "rank", str(chosen.rank)
    for scenario, score in chosen.scores.items():
        taken = " (taken from a reference)" if scenario in chosen.reused else ""
        yield f"score {scenario}", f"{_number(score)}{taken}"
    row = next((row for row in robustness if row.parameters == chosen.parameters), None)
    if row is not None:
        yield "degree of robustness", f"{'at least ' if row.at_least else ''}{row.degree}"
    for scenario, released in campaign.released.items():
        if released.upper_95 is not None:
            yield f"share of wrong predictions {scenario}", f"at most {released.upper_95:.3g} (95 %)"
    for scenario, checked in campaign.error_rate.items():
        if checked.upper_95 is not None:
            yield f"share of wrong reused scores {scenario}", f"at most {checked.upper_95:.3g} (95 %)"


def _number(value: float) -> str:
    return f"{value:.10g}"
