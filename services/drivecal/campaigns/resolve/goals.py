"""Resolves the objectives and constraints of a campaign against the scores and measures of its problem."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from drivecal.analysis.goals import FAILED, SCORE, Aggregate, Bound, CellValue, Goals, Objective, normalised, weighted_mean
from drivecal.bundles.shapes import Shapes
from drivecal.campaigns.resolve.spaces import given_set
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.specification import (
    CampaignSpecification,
    ConstraintSpecification,
    GoalSpecification,
    ObjectiveSpecification,
    Quantile,
    ReductionSpecification,
)
from drivecal.domain.constraints import ChangeFrom, Constraints
from drivecal.domain.errors import Diagnostics
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.scales import Direction
from drivecal.domain.setups import base_of

LIKELY = 0.25
"""Share of failed runs above which models of a search keep away, if the limit is lower: too few runs of a set tell less."""


@dataclass(frozen=True)
class KnownValues:
    """Values of a problem that goals can name: scores by name, the campaign's own without a formula, and the units of measures.

    Changes are those from the `baseline`, or from a set that keeps the `constraints`.
    """

    scores: Mapping[str, CellValue] = field(default_factory=dict)
    measures: Mapping[str, str] = field(default_factory=dict)
    constraints: Constraints | None = None
    baseline: ParameterSet | None = None
    shapes: Shapes = field(default_factory=dict)


def find_goals(
    specification: CampaignSpecification, known: KnownValues, weights: Mapping[str, float], diagnostics: Diagnostics
) -> Goals:
    """Returns the goals, by default the weighted mean of the campaign's score; with problems in `diagnostics`, this default as well."""
    own, scale = next((name, value.scale) for name, value in known.scores.items() if value.key == SCORE and value.scale)
    default = weighted_mean(scale, weights)
    if not specification.objectives and not specification.constraints:
        return default
    before = len(diagnostics.problems)
    given = specification.objectives or [ObjectiveSpecification(score=own)]
    objectives = [_objective(each, f"objectives[{place}]", known, weights, diagnostics) for place, each in enumerate(given)]
    bounds = [
        _bound(each, f"constraints[{place}]", known, weights, diagnostics)
        for place, each in enumerate(specification.constraints)
    ]
    _refuse_equal_names(given, diagnostics)
    if len({tuple(bound.value.change.reference.items()) for bound in bounds if bound and bound.value.change}) > 1:
        diagnostics.add("constraints", "they limit changes from several sets", "compare with one set")
    if len(given) > 1 and specification.replicates.level is not None:
        message = "a front has the means of several objectives over the seeds"
        diagnostics.add("replicates.aggregate", message, "leave it out, or give one objective")
    if len(diagnostics.problems) > before:
        return default
    goals = Goals(
        tuple(objective for objective in objectives if objective is not None),
        tuple(replace(bound, confidence=specification.replicates.confidence) for bound in bounds if bound is not None),
    )
    plain = len(goals.objectives) == 1 and not bounds and goals.objectives[0].is_weighted_mean(weights)
    return default if plain and goals.objectives[0].tolerance == 0 else goals


def check_reuse(
    reduction: ReductionSpecification, goals: Goals, diagnostics: Diagnostics, *, has_variants: bool = False
) -> tuple[ReductionSpecification, tuple[str, ...]]:
    """Returns the settings of reuse under these goals, with a note: references, predictions and maps know one score only, and only the best
    set in common is confirmed."""
    named = ", ".join(sorted({goal.name for goal in (*goals.objectives, *goals.bounds) if goal.value.key != SCORE}))
    named = named or ("the best sets of variants" if has_variants else "")
    if not named or not (reduction.predicts or reduction.uses_map):
        return reduction, ()
    if "mode" in reduction.model_fields_set:
        message = f"references and predictions are of the campaign's score alone, and not for {named}"
        diagnostics.add("reduction.mode", message, "give mode: exact, which repeats equal sets")
        return reduction, ()
    note = f"cells are answered by equal sets only: references and predictions do not know {named}"
    return reduction.model_copy(update={"mode": "exact"}), (note,)


def note_lost(goals: Goals) -> tuple[str, ...]:
    """Returns a note on measures that failed runs lack, under the goals of a random simulator, where many sets fail now and then."""
    named = sorted(
        {goal.value.measure for goal in (*goals.objectives, *goals.bounds) if goal.value.measure and goal.value.failed is None}
    )
    lost = f"a set with a failed run has no {', '.join(named)} and no rank; `failed` beside the measure says what such a run is worth"
    if any(bound.value.measure == FAILED for bound in goals.bounds):
        lost += ", and without it the rate of failures counts only sets that never failed"
    return (lost,) if named else ()


def _objective(
    given: ObjectiveSpecification, field: str, known: KnownValues, weights: Mapping[str, float], diagnostics: Diagnostics
) -> Objective | None:
    value = _value(given, field, known, diagnostics)
    shares = _shares(given, field, weights, diagnostics)
    if value is None or shares is None:
        return None
    scale = value.scale
    if value.change is not None:
        return Objective(given.label, value, _anywhere(shares), Aggregate("max"), -1, given.tolerance)
    direction = Direction(given.direction) if given.direction is not None else None if scale is None else scale.direction
    if direction is None:
        diagnostics.add(f"{field}.direction", "a measure has no direction of its own", "give maximise or minimise")
        return None
    if scale is not None and direction is not scale.direction:
        message = f"the score {scale.name} is one to {scale.direction}"
        diagnostics.add(f"{field}.direction", message, "leave it out, or declare another score")
    sign = 1 if direction is Direction.MAXIMISE else -1
    return Objective(given.label, value, shares, _aggregate(given.aggregate), sign, given.tolerance, _unit(value, known))


def _bound(
    given: ConstraintSpecification, field: str, known: KnownValues, weights: Mapping[str, float], diagnostics: Diagnostics
) -> Bound | None:
    value = CellValue(measure=FAILED, failed=1.0) if given.counts_failures else _value(given, field, known, diagnostics)
    shares = _shares(given, field, weights, diagnostics)
    limit = (
        max(given.rate or 0.0, LIKELY) if given.counts_failures else given.at_most if given.at_least is None else given.at_least
    )
    if value is None or shares is None or limit is None:
        return None
    sign = -1 if given.at_least is None else 1
    span = value.scale.span if value.scale else abs(limit) or 1.0
    if given.rate is not None and value.scale is None and value.failed is None:
        value = replace(value, failed=limit - sign * span)
    aggregate = _aggregate(given.aggregate or ("min" if sign > 0 else "max"))
    shares = shares if value.change is None else _anywhere(shares)
    return Bound(given.label, value, shares, aggregate, sign, limit, span, given.rate, unit=_unit(value, known))


def _unit(value: CellValue, known: KnownValues) -> str:
    return known.measures.get(value.measure or "", "1") if value.scale is None else value.scale.unit


def _anywhere(shares: Mapping[str, float]) -> dict[str, float]:
    """Returns the shares of a value that is the same in each scenario."""
    return {next(iter(shares)): 1.0}


def _change(given: GoalSpecification, field: str, known: KnownValues, diagnostics: Diagnostics) -> CellValue | None:
    place = "distance" if given.changes is None else "changes"
    wanted, reference = given.changes or given.distance or {}, known.baseline
    if isinstance(wanted, Mapping):
        reference = given_set(wanted, known.constraints, f"{field}.{place}", diagnostics, known.shapes)
    elif reference is None or wanted != "baseline":
        message = (
            "the campaign has no baseline"
            if wanted == "baseline"
            else f"{wanted} is no ranked set of a campaign with such curves"
        )
        diagnostics.add(f"{field}.{place}", message, "give a `baseline`, or the values of a set")
    if reference is None or known.constraints is None:
        return None
    kind = "changes" if given.distance is None else given.norm
    return CellValue(change=ChangeFrom.between(kind, known.constraints.space, reference))


def _value(given: GoalSpecification, field: str, known: KnownValues, diagnostics: Diagnostics) -> CellValue | None:
    if given.changes is not None or given.distance is not None:
        return _change(given, field, known, diagnostics)
    if given.score is not None:
        if given.score in known.scores:
            return known.scores[given.score]
        diagnostics.add(f"{field}.score", f"there is no score {given.score!r}", nearest(given.score, list(known.scores)))
        return None
    measure = given.measure or ""
    if measure not in known.measures:
        diagnostics.add(f"{field}.measure", f"there is no measure {measure!r}", nearest(measure, list(known.measures)))
        return None
    return CellValue(measure=measure, failed=given.failed)


def _shares(
    given: GoalSpecification, field: str, weights: Mapping[str, float], diagnostics: Diagnostics
) -> dict[str, float] | None:
    """Weights of sum 1, by scenario in the catalogue's order."""
    listed, bases = [] if given.scenarios == "all" else given.scenarios, {name: base_of(name) for name in weights}
    chosen = [name for name in weights if not listed or bases[name] in listed]
    unknown = {f"{field}.scenarios": [name for name in listed if name not in bases.values()]}
    unknown[f"{field}.weights"] = [name for name in given.weights if name not in [bases[each] for each in chosen]]
    known = {f"{field}.scenarios": dict.fromkeys(bases.values())}
    known[f"{field}.weights"] = dict.fromkeys(bases[each] for each in chosen or weights)
    for place, names in unknown.items():
        for name in names:
            diagnostics.add(place, f"the scenario {name!r} is not simulated for it", nearest(name, list(known[place])))
    if any(unknown.values()):
        return None
    if chosen == list(weights) and not given.weights:
        return dict(weights)
    own = {name: given.weights.get(bases[name], 1.0) if given.weights else weights[name] for name in chosen}
    return normalised(own)


def _aggregate(given: str | Quantile) -> Aggregate:
    match given:
        case Quantile(quantile=level):
            return Aggregate("quantile", level)
        case "mean" | "min" | "max":
            return Aggregate(given)
    raise AssertionError(given)


def _refuse_equal_names(given: list[ObjectiveSpecification], diagnostics: Diagnostics) -> None:
    labels = [each.label for each in given]
    for place, label in enumerate(labels):
        if label in labels[:place]:
            diagnostics.add(f"objectives[{place}].name", f"two objectives have the name {label}", "give each a name of its own")


def normalise_weights(
    given: Mapping[str, float], scenarios: Sequence[str], diagnostics: Diagnostics
) -> tuple[dict[str, float], tuple[str, ...]]:
    """Positive weights by scenario, of sum 1 (Eq. 6), with a note that names the scenarios of weight 0."""
    for name in given:
        if scenarios and name not in scenarios:
            diagnostics.add(f"weights.{name}", f"the campaign has no scenario {name!r}", nearest(name, scenarios))
    weights = {name: float(given.get(name, 1.0)) for name in scenarios}
    total = sum(weights.values())
    if scenarios and total == 0:
        diagnostics.add("weights", "all weights are 0, so nothing would be simulated", "give a scenario a positive weight")
        return {}, ()
    shares = normalised(weights)
    left_out = [name for name in weights if name not in shares]
    return shares, (f"not simulated because their weight is 0: {', '.join(left_out)}",) if left_out else ()
