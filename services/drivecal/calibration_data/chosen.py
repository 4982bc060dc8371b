"""Values of a campaign's chosen set in a calibration file, and how sure they are."""

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from drivecal.calibration_data.carried import replaced
from drivecal.calibration_data.characteristics import Axis, Characteristic, Quality, index
from drivecal.contracts.results import CampaignResults, ResultTrust
from drivecal.contracts.setup import SearchedParameter, ShapeAnswer
from drivecal.contracts.tables import FrontRow, Solution


def characteristics_of(
    values: Mapping[str, float | str], parameters: Sequence[SearchedParameter], labels: Mapping[str, str]
) -> list[Characteristic]:
    """Returns the values of a parameter set under their labels, in the order of the parameters. Parameters without one among
    the `labels` keep their names."""
    return [
        Characteristic(
            labels.get(each.name, each.name), int(values[each.name]) if each.kind == "integer" else values[each.name],
            each.unit, each.description,
            None if each.choices else each.lower, None if each.choices else each.upper,
            integer=each.kind == "integer", choices=tuple(each.choices),
        )
        for each in parameters
        if each.name in values
    ]  # fmt: skip


def curves_of(
    values: Mapping[str, float | str], shapes: Mapping[str, ShapeAnswer], labels: Mapping[str, str]
) -> list[Characteristic]:
    """Returns the curves and maps of a set under their labels. Those over 0, 1, ... without a unit are arrays. What is called as an axis of
    one (`gain.x`) has its points."""
    curves = {}
    for name, shape in shapes.items():
        counted = [index(len(axis)) for axis in shape.axes]
        is_array = [list(axis.points) for axis in counted] == shape.axes and set(shape.axis_units) == {"1"}
        own = [Axis("STD_AXIS", tuple(points), unit) for points, unit in zip(shape.axes, shape.axis_units, strict=True)]
        kind, axes = ("VAL_BLK", counted) if is_array else (("CURVE", "MAP")[len(own) - 1], own)
        said = (labels.get(name, name), None, shape.unit, shape.description, shape.lower, shape.upper)
        points = np.transpose(shape.values(values)).ravel().tolist()
        curves[said[0]] = Characteristic(*said, kind=kind, axes=tuple(axes), values=tuple(points))
    moved = [curves.pop(label) for label in list(curves) if label[:-2] in curves and label[-2:] in {".x", ".y"}]
    return list(replaced(curves, moved, "the problem").values())


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
    """Yields the rank of a set, what it is ranked by, its objectives, constrained amounts and scores. The campaign has the rest.

    Args:
        known: the results of the campaign.
        chosen: the set, of the solutions or of the front.
        weights: weights that it was chosen by, if they are not the campaign's own, which are given otherwise.
        score: the score, likewise.
    """
    if isinstance(chosen, FrontRow):
        yield "rank on the front", str(chosen.rank)
        yield from ((f"objective {name}", _number(amount)) for name, amount in (chosen.objectives | chosen.uncertainty).items())
    else:
        yield "rank", str(chosen.rank)
        yield "objective", _number(chosen.objective)
        ends = {"standard error": chosen.standard_error, "lower end": chosen.lower, "upper end": chosen.upper}
        yield from ((f"{name} of the objective", _number(amount)) for name, amount in ends.items() if amount is not None)
    yield "score", score or known.campaign.scale.name
    named = "weights"
    if weights is None and not known.variants:
        weights = {each.scenario: each.weight for each in known.setup.scenarios}
        named = "weights of scenarios" if isinstance(chosen, FrontRow) else named
    if weights is not None:
        yield named, ",".join(f"{name}={_number(weight)}" for name, weight in weights.items())
    yield from ((f"constraint {number}", text) for number, text in enumerate(known.setup.constraints, 1))
    yield from ((f"constrained {name}", _number(amount)) for name, amount in chosen.constraints.items())
    if chosen.violation > 0 and chosen.undecided:
        yield "limits on rates", "not known to be kept"
    elif chosen.violation > 0:
        yield "violation of constraints", _number(chosen.violation)
    for scenario, amount in chosen.scores.items():
        taken = " (taken from a reference)" if scenario in chosen.reused else ""
        yield f"score {scenario}", f"{_number(amount)}{taken}"


def _number(value: float) -> str:
    return f"{value:.10g}"
