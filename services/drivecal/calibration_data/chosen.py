"""Values of a campaign's chosen set in a calibration file, and how sure they are."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from drivecal.calibration_data.characteristics import Characteristic, Quality
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.results import CampaignResults, FrontSummary, ResultTrust
from drivecal.contracts.setup import SearchedParameter
from drivecal.contracts.tables import FrontRow, Solution
from drivecal.domain.scales import unit_text


@dataclass(frozen=True, slots=True)
class RankedBy:
    """Ranking that a set was chosen from, if it is not the campaign's own: another `score`, other `weights`, and the objective that the
    campaign's baseline has under them, None if it has none."""

    score: str | None
    weights: Mapping[str, float] | None
    baseline: float | None


def characteristics_of(
    values: Mapping[str, float | str], parameters: Sequence[SearchedParameter], labels: Mapping[str, str]
) -> list[Characteristic]:
    """Returns the values of a parameter set under their labels, in the order of the parameters. Parameters without one among
    the `labels` keep their names."""
    return [
        Characteristic(
            labels.get(parameter.name, parameter.name),
            values[parameter.name],
            parameter.unit,
            lower=None if parameter.choices else parameter.lower,
            upper=None if parameter.choices else parameter.upper,
            integer=parameter.kind == "integer",
            choices=tuple(parameter.choices),
            description=parameter.description,
        )
        for parameter in parameters
        if parameter.name in values
    ]


def quality_of(
    known: CampaignResults, chosen: Solution | FrontRow, figures: Iterable[tuple[str, str]], *, judged: bool
) -> Quality:
    """Returns the quality data of a chosen set. It is preliminary while a score is a reference's, the campaign has not succeeded or did not
    evaluate the set, the set breaks constraints, or its light is red.

    Args:
        known: the results of the campaign, with the verdicts on the set.
        chosen: the set.
        figures: what is known of it.
        judged: whether the verdicts are about the set.
    """
    campaign, setup = known.campaign, known.setup
    own = not chosen.reused and not chosen.violation and chosen.iteration is not None
    sure = campaign.state == "succeeded" and own and not (judged and known.trust.light == "red")
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
        figures=(*figures, *(_trust(known.trust) if judged else ())),
    )


def _trust(deserved: ResultTrust) -> Iterator[tuple[str, str]]:
    if deserved.light is not None:
        yield "light of the set", deserved.light
        worst = (each.text for each in deserved.verdicts if each.light == deserved.light != "green")
        yield from ((f"reason {number}", text) for number, text in enumerate(worst, 1))


def solution_figures(known: CampaignResults, chosen: Solution, ranked_by: RankedBy | None) -> Iterator[tuple[str, str]]:
    """Yields what is known of a set of the solutions. Under another score, the bounds of the campaign's own score are left out."""
    campaign, setup = known.campaign, known.setup
    own = campaign.baseline.objective if campaign.baseline is not None else None
    baseline = own if ranked_by is None else ranked_by.baseline
    yield "objective", _number(chosen.objective)
    if baseline is not None:
        yield "objective of the baseline", _number(baseline)
    score = None if ranked_by is None or ranked_by.score == campaign.scale.name else ranked_by.score
    yield "score", score or _scale(campaign)
    if ranked_by is None and campaign.objective is not None:
        first = campaign.objective
        yield "ranked by", f"{first.name}, {first.direction}{unit_text(first.unit, ', ')}"
    else:
        given = None if ranked_by is None else ranked_by.weights
        weights = {scenario.scenario: scenario.weight for scenario in setup.scenarios} if given is None else given
        yield "weights", _weights({name: weights.get(name, 1.0) for name in chosen.scores})
    yield "rank", str(chosen.rank)
    yield from _constraints(chosen, setup.constraints)
    yield from _scores(chosen)
    if score is None:
        yield from _bounds(known, chosen)


def front_figures(
    known: CampaignResults, chosen: FrontRow, summary: FrontSummary, weights: Mapping[str, float] | None
) -> Iterator[tuple[str, str]]:
    """Yields what is known of a set of the front. `weights`: weights of the objectives; None if the first objective alone ranks."""
    for name, amount in chosen.objectives.items():
        yield f"objective {name}", _number(amount)
    baseline = {} if summary.baseline is None else summary.baseline.objectives
    for name, amount in baseline.items():
        yield f"objective {name} of the baseline", _number(amount)
    for objective in summary.objectives:
        unit = unit_text(objective.unit, ", ")
        yield f"scale of objective {objective.name}", f"{objective.direction}, {objective.aggregate}{unit}"
    if weights is not None and chosen.weighted is not None:
        yield "weights of the objectives", _weights({name: weights.get(name, 1.0) for name in chosen.objectives})
        yield "weighted objectives", _number(chosen.weighted)
    yield "rank on the front", str(chosen.rank)
    if chosen.iteration is None:
        yield "origin", "evaluated by other campaigns only"
    yield from _constraints(chosen, summary.constraints)
    yield "score", _scale(known.campaign)
    yield from _scores(chosen)
    yield from ((f"value {name}", _number(value)) for name, value in chosen.values.items())
    yield from _bounds(known, chosen)


def _scale(campaign: Campaign) -> str:
    scale = campaign.scale
    return f"{scale.name}, {scale.direction.value}, {_number(scale.lower)} to {_number(scale.upper)}{unit_text(scale.unit)}"


def _weights(weights: Mapping[str, float]) -> str:
    return ",".join(f"{name}={_number(weight)}" for name, weight in weights.items())


def _constraints(chosen: Solution | FrontRow, words: Sequence[str]) -> Iterator[tuple[str, str]]:
    for (name, amount), text in zip(chosen.constraints.items(), words, strict=False):
        yield f"constraint {name}", f"{_number(amount)} ({text})"
    if chosen.violation > 0:
        yield "violation of constraints", _number(chosen.violation)


def _scores(chosen: Solution | FrontRow) -> Iterator[tuple[str, str]]:
    for scenario, score in chosen.scores.items():
        taken = " (taken from a reference)" if scenario in chosen.reused else ""
        yield f"score {scenario}", f"{_number(score)}{taken}"


def _bounds(known: CampaignResults, chosen: Solution | FrontRow) -> Iterator[tuple[str, str]]:
    campaign = known.campaign
    own = [row for each in known.of_stage("robustness") if each.study.in_own_vehicle for row in each.robustness]
    row = next((row for row in own if row.parameters == chosen.parameters), None)
    if row is not None:
        yield "degree of robustness", f"{'at least ' if row.at_least else ''}{row.degree}"
        if row.failing_at_most is not None:
            yield "vehicles that may change more", f"at most {100 * row.failing_at_most:.3g} % (95 %)"
    for scenario, released in campaign.released.items():
        if released.upper_95 is not None and released.upper_95 < 1:
            yield f"share of wrong predictions {scenario}", f"at most {100 * released.upper_95:.3g} % (95 %)"
    for scenario, checked in campaign.error_rate.items():
        if checked.upper_95 is not None and checked.upper_95 < 1:
            yield f"share of wrong reused scores {scenario}", f"at most {100 * checked.upper_95:.3g} % (95 %)"


def _number(value: float) -> str:
    return f"{value:.10g}"
