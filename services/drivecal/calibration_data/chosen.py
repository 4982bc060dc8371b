"""Values of a campaign's chosen set in a calibration file, and how sure they are."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

from drivecal.calibration_data.characteristics import Characteristic, Quality
from drivecal.contracts.results import CampaignResults, ResultTrust
from drivecal.contracts.setup import SearchedParameter
from drivecal.contracts.tables import FrontRow, Solution


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


def quality_of(known: CampaignResults, chosen: Solution | FrontRow, figures: Iterable[tuple[str, str]]) -> Quality:
    """Returns the quality data of a chosen set. It is preliminary while a score is a reference's, the campaign has not succeeded, the
    set breaks constraints, or the light of its scores is red.

    Args:
        known: the results of the campaign, with the verdicts on the set.
        chosen: the set.
        figures: what is known of it.
    """
    campaign, setup = known.campaign, known.setup
    own = not chosen.reused and not chosen.violation
    sure = campaign.state == "succeeded" and own and known.trust.light("scores") != "red"
    time = campaign.ended_at or campaign.created_at
    problem = str(campaign.spec.get("problem", "highway"))
    simulators = sorted({scenario.simulator for scenario in setup.scenarios if scenario.simulator})
    return Quality(
        state="calibrated" if sure else "prelimCalibrated",
        date="" if time is None else time.isoformat(timespec="seconds"),
        project=problem,
        work_product=campaign.name,
        test_object=", ".join(simulators) or str(campaign.spec.get("driving_function") or problem),
        campaign=campaign.id,
        data=next((scenario.files for scenario in setup.scenarios if scenario.files), ""),
        figures=(*figures, *_trust(known.trust)),
    )


def _trust(deserved: ResultTrust) -> Iterator[tuple[str, str]]:
    yield from ((f"light of the {answer.question}", answer.light) for answer in deserved.answers if answer.light is not None)
    doubts = (each.text for each in deserved.verdicts if each.light in {"red", "amber"})
    yield from ((f"reason {number}", text) for number, text in enumerate(doubts, 1))


def figures_of(
    known: CampaignResults, chosen: Solution | FrontRow, weights: Mapping[str, float] | None, score: str | None
) -> Iterator[tuple[str, str]]:
    """Yields the rank of a set, what it is ranked by, and its objectives and scores. The campaign has the rest.

    Args:
        known: the results of the campaign.
        chosen: the set, of the solutions or of the front.
        weights: weights that it was chosen by, if they are not the campaign's own.
        score: the score, likewise.
    """
    if isinstance(chosen, FrontRow):
        yield "rank on the front", str(chosen.rank)
        yield from ((f"objective {name}", _number(amount)) for name, amount in chosen.objectives.items())
    else:
        yield "rank", str(chosen.rank)
        yield "objective", _number(chosen.objective)
    yield "score", score or known.campaign.scale.name
    if weights is not None:
        yield "weights", ",".join(f"{name}={_number(weight)}" for name, weight in weights.items())
    if chosen.violation > 0 and chosen.undecided:
        yield "limits on rates", "not known to be kept"
    elif chosen.violation > 0:
        yield "violation of constraints", _number(chosen.violation)
    for scenario, amount in chosen.scores.items():
        taken = " (taken from a reference)" if scenario in chosen.reused else ""
        yield f"score {scenario}", f"{_number(amount)}{taken}"


def _number(value: float) -> str:
    return f"{value:.10g}"
