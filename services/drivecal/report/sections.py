"""Sections about a campaign's results that report, review sheet and command line share. Pure."""

import json
import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import groupby
from typing import Any

from drivecal.analysis.optima import NEIGHBOURS
from drivecal.contracts.accounting import Accounting
from drivecal.contracts.assignments import value_text
from drivecal.contracts.campaign import Campaign, ErrorRate, Narrowed, Released
from drivecal.contracts.evaluation import FailureCause
from drivecal.contracts.results import ResultTrust
from drivecal.contracts.setup import CampaignSetup, ScenarioSetup, SearchedParameter
from drivecal.contracts.specification import EvaluationSpecification, VehicleSpecification
from drivecal.contracts.tables import InfluenceRow, OptimumRow, Solution, ValidationRow
from drivecal.domain.scales import COMFORT, Scale, plain, told, unit_text
from drivecal.report.blocks import (
    Block,
    Bullets,
    Emphasized,
    Heading,
    Number,
    Paragraph,
    Table,
    bound,
    counted,
    fixed,
    objective_number,
    percent,
    shortened,
)
from drivecal.sensitivity.thresholds import caveats

OUTCOMES = ("simulated", "repeated", "reused", "predicted", "failed")
"""Outcomes of requested cells, frequent ones first."""
CHECKS = {"audited": "of simulated: audits", "sampled": "samples of predictions"}
SHOWN = 20
"""The best sets that the page shows; all of them are in the table."""
MOST_REGIONS = 12
"""Regions that are listed."""
QUESTIONS = {"scores": "Are the scores right?", "search": "Is the search finished?"}
LOTS_NOTE = (
    "The limit holds for the expected number of errors over all lots together, by the rule that releases them; the 95 % bound is what the "
    "samples of this campaign alone prove, even if all are right: a few samples of a lot prove little about its other answers."
)
"""Explains a bound that exceeds the limit."""
LOTS = ("scenario", "asked", "lots", "rejected", "released", "sampled", "beyond tolerance", "limit", "at most (95 %)")
_CAUSES = {"no_result": "no result", "failed": "failed run", "unscored": "score without a value"}

Values = Mapping[str, float | str]


def trust_blocks(trust: ResultTrust, label: str = "") -> list[Block]:
    """Returns the light of a result, and the verdicts by question, the gravest first; nothing without a verdict."""
    if not trust.verdicts:
        return []
    blocks: list[Block] = [Paragraph(f"Light{label}: {trust.light or 'open until the end'}.", "light")]
    for question, title in QUESTIONS.items():
        said = [f"{each.light}: {each.text}" for each in trust.verdicts if each.question == question]
        blocks += [Heading(title), Bullets(said)] if said else []
    return blocks


def cells_table(campaign: Campaign, label: str = "") -> list[Block]:
    """Returns the cells of a campaign by outcome and stage."""
    fields = {"proposed": "proposed", "carried_over": "carried over", "requested": "requested"}
    fields |= {outcome: outcome for outcome in OUTCOMES} | CHECKS
    stages = {stage: cells for stage, cells in campaign.stages.items() if cells.requested}
    rows = [[title, *(getattr(cells, field, None) for cells in stages.values())] for field, title in fields.items()]
    caption = f"Cells by outcome and stage{label}"
    return [Table(["cells", *stages], rows, caption, f"drivecal show {campaign.id}")] if stages else []


def audits_table(rates: Mapping[str, ErrorRate], scale: Scale, command: str = "") -> list[Block]:
    """Returns the audits of copied scores by scenario; nothing without one."""
    rows = [
        [
            *(name, rate.audited, rate.different, rate.wrong),
            percent(rate.wrong / rate.audited if rate.audited else None),
            *(bound(rate.upper_95), rate.contradictions, rate.lots, rate.rejected),
        ]
        for name, rate in rates.items()
        if rate.audited or rate.contradictions
    ]
    header = ["scenario", "audited", "different", "wrong", "R_err", "at most (95 %)", "contradictions", "lots", "rejected"]
    caption = (
        f"Audits: copied scores that were simulated all the same; wrong: off by more than {scale.amount(scale.tolerance)}; a lot with too "
        "many wrong samples was rejected, and each cell of it simulated; at most: the share of wrong answers among those that lots released"
    )
    return [Table(header, rows, caption, command)] if rows else []


def lots_table(released: Mapping[str, Released], command: str = "") -> list[Block]:
    """Returns the inspected lots of predicted answers by scenario; nothing without one."""
    rows = [
        [
            *(name, lots.asked, lots.lots, lots.rejected, lots.predicted, lots.sampled, lots.different),
            *(percent(lots.limit, 1), bound(lots.upper_95)),
        ]
        for name, lots in released.items()
        if lots.lots
    ]
    caption = (
        "Predicted answers, released in lots after the simulation of a sample of each. Asked: batches in which the predictor was; beyond "
        "tolerance: samples; limit: of the expected errors released, for each prediction in a lot"
    )
    exceeds = any(lots.upper_95 is not None and lots.upper_95 > lots.limit for lots in released.values())
    note: list[Block] = [Paragraph(LOTS_NOTE)] if exceeds else []
    return [Table(LOTS, rows, caption, command), *note] if rows else []


def failures_table(causes: Sequence[FailureCause]) -> list[Block]:
    """Returns the causes of failed cells; nothing without one."""
    rows = [
        [
            *(cause.cells, _CAUSES[cause.kind], cause.cause, shortened(cause.detail), " ".join(cause.scenarios[:5])),
            str(cause.example),
        ]
        for cause in causes
    ]
    header = ["cells", "what", "cause", "last message", "scenarios", "example"]
    caption = "Failed runs and cells without a result by cause; `drivecal explain CAMPAIGN EXAMPLE` shows one"
    return [Table(header, rows, caption)] if rows else []


def account_blocks(account: Accounting | None) -> list[Block]:
    """Returns savings and costs; nothing before the first answered cell, and after a pruning."""
    if account is None or account.pruned:
        return []
    clock = "CPU" if account.clock == "cpu" else "wall-clock"
    items = [*((item.label, item.seconds) for item in account.balance), ("net", account.net_seconds)]
    rows = [[label, Number(f"{round(seconds, 1) + 0.0:+,.1f}")] for label, seconds in items]
    blocks: list[Block] = [
        Paragraph(account.sentence),
        Table(["", "seconds"], rows, f"Savings and costs, in {clock} time of the workers"),
    ]
    return [*blocks, Bullets(account.remarks)] if account.remarks else blocks


def narrowed_table(narrowed: Sequence[Narrowed] | None) -> list[Block]:
    """Returns the parts that were cut from the search space; nothing without one."""
    rows = [
        [
            *(cut.parameter, cut.choice or cut.lower, cut.choice or cut.upper),
            *(cut.full_lower, cut.full_upper, cut.removed_values, cut.values),
        ]
        for cut in narrowed or ()
    ]
    header = ["parameter", "lower", "upper", "of lower", "of upper", "values left out", "of"]
    return [Table(header, rows, "The search was narrowed to where some scenario is influenced")] if rows else []


def scenarios_table(setup: CampaignSetup, label: str = "", command: str = "") -> Table:
    """Returns the scenarios with their shares of the objective and the fingerprints of their setups."""
    rows = [
        [each.scenario, each.title, Number(f"{each.weight:.4g}"), each.step_seconds, each.seed, each.fingerprint]
        for each in setup.scenarios
    ]
    caption = f"Scenarios{label}: share of the objective, and the fingerprint of all that decides a run"
    return Table(["scenario", "", "weight", "step, s", "seed", "fingerprint"], rows, caption, command, wrap=True)


def parameters_table(parameters: Iterable[SearchedParameter], sets: Mapping[str, Values], command: str = "") -> Table:
    """Returns the parameters with unit, range and meaning, and their values in `sets`, by the heads of the columns."""
    rows = [
        [
            *(each.name, each.description, unit_text(each.unit, ""), _range(each)),
            *(_value(values.get(each.name)) for values in sets.values()),
        ]
        for each in parameters
    ]
    return Table(["parameter", "meaning", "unit", "range", *sets], rows, "Parameters", command, wrap=True)


def _range(parameter: SearchedParameter) -> str:
    if parameter.fixed is not None:
        return f"held at {_digits(parameter.fixed)}"
    if parameter.choices:
        return ", ".join(parameter.choices)
    steps = "" if parameter.kind == "continuous" else f", {parameter.n_values:,} values"
    return f"{_digits(parameter.lower)} to {_digits(parameter.upper)}{steps}"


def _digits(value: float | str) -> str:
    """Returns a value with all digits that decide a run."""
    return value if isinstance(value, str) else str(plain(value))


def _value(value: float | str | None) -> object:
    return value if value is None or isinstance(value, str) else Number(_digits(value))


def settings_text(value: object) -> str:
    """Returns settings in one line, without empty ones."""
    if isinstance(value, list):
        return "; ".join(map(settings_text, value))
    if not isinstance(value, dict):
        return value if isinstance(value, str) else json.dumps(value)
    kept = {name: item for name, item in value.items() if name != "kind" and item is not None and item not in ([], {})}
    settings = ", ".join(f"{name} {item if isinstance(item, str) else json.dumps(item)}" for name, item in kept.items())
    return ": ".join(filter(None, [value.get("kind"), settings]))


ASKED = {
    "Held fixed": "fixed",
    "Baseline": "baseline",
    "Optimizer": "optimizer",
    "Budget": "budget",
    "Objectives": "objectives",
    "Constraints": "constraints",
    "Sensitivity": "sensitivity",
    "Reduction": "reduction",
    "Robustness": "robustness",
    "Validation": "validation",
}
"""Fields of a specification by the words for them."""
USED = {"Driving function": "driving_function", "Vehicle": "vehicle", "Simulator": "simulator", "Files": "files"}
"""Fields of a scenario's setup by the words for them."""


def settings_of(spec: Mapping[str, Any], scenarios: Sequence[ScenarioSetup], evaluator: str) -> dict[str, str]:
    """Returns what was asked for in words: problem, versions in use, settings of the stages."""
    used = {
        title: ", ".join(dict.fromkeys(value for scenario in scenarios if (value := getattr(scenario, field))))
        for title, field in USED.items()
    }
    problem = {"Problem": str(spec.get("problem", ""))}
    stages = {title: settings_text(spec[field]) for title, field in ASKED.items() if spec.get(field)}
    known = problem | used | {"Evaluator": evaluator} | stages
    return {title: text for title, text in known.items() if text}


def objective_words(campaign: Campaign) -> str:
    """Returns which values of the objective are good."""
    goal, scale = campaign.objective, campaign.scale
    if goal is not None:
        return f"{goal.name}{unit_text(goal.unit, ', ')}, {'higher' if goal.direction == 'maximise' else 'lower'} is better"
    return f"{scale.lower:g} to {scale.upper:g}, {'higher' if scale.sign > 0 else 'lower'} is better"


def by_scenario(rows: Iterable[InfluenceRow]) -> dict[str, list[InfluenceRow]]:
    """Returns the rows of each scenario, in order."""
    return {scenario: list(members) for scenario, members in groupby(rows, key=lambda row: row.scenario)}


def segment(row: InfluenceRow) -> tuple[float, float] | None:
    """Returns the influential part of a parameter's range, from 0 (its lower bound) to 1 (its upper bound); None if nothing is."""
    if not row.influential:
        return None
    if row.space_lower is None or row.space_upper is None:
        return 0.0, 1.0
    size = row.space_upper - row.space_lower
    lower = 0.0 if row.lower is None else (row.lower - row.space_lower) / size
    upper = 1.0 if row.upper is None else (row.upper - row.space_lower) / size
    return lower, upper


def influence_blocks(
    rows: Sequence[InfluenceRow], basis: Mapping[str, Any] | None, drawings: Sequence[Block], campaign: Campaign
) -> list[Block]:
    """Returns the basis of the map, its figure, and the bounds as a table."""
    if not rows:
        ways = {"predictions": campaign.cells.predicted, "references": campaign.cells.reused}
        used = [name for name, count in ways.items() if count]
        others = f"; equal sets and {' and '.join(used)} answer cells" if used else ", so only equal sets answer cells"
        return [Paragraph(f"No influence map is in use{others} without a simulation.")]
    scenarios = by_scenario(rows)
    cells = {(row.scenario, row.parameter): _bounds(row) for row in rows}
    names = list(dict.fromkeys(row.parameter for row in rows))
    lines = [[name, *(cells.get((scenario, name)) for scenario in scenarios)] for name in names]
    caption = "Influential bounds in parameter units, inclusive; a dash where nothing is influential"
    return [Paragraph(_origin(basis)), *drawings, Table(["parameter", *scenarios], lines, caption)]


def _origin(basis: Mapping[str, Any] | None) -> str:
    if basis is None:
        return "The influence map was posted by a user; no analysis stands behind it."
    settings = basis["sensitivity"]
    ends = "".join(f" {line[0].upper()}{line[1:]}." for line in caveats(settings))
    return (
        f"An analysis by elementary effects: design {settings['design']}, {settings['intervals']} intervals, {settings['samples']} "
        f"samples, threshold {json.dumps(settings['threshold'])}, seed {settings['seed']}; {basis['runs']:,} runs asked for, "
        f"{basis['simulated']:,} simulated for it.{ends}"
    )


def _bounds(row: InfluenceRow) -> str | None:
    if not row.influential:
        return None
    if row.unknown:
        return Emphasized("unknown")
    if (row.lower, row.upper) == (row.space_lower, row.space_upper):
        return Emphasized("everywhere")
    return Emphasized(" … ".join("" if end is None else f"{end:g}" for end in (row.lower, row.upper)))


def searched(parameters: Iterable[SearchedParameter]) -> list[SearchedParameter]:
    """Returns the parameters that are not held."""
    return [parameter for parameter in parameters if parameter.fixed is None]


def constant(sets: Sequence[Solution], parameters: Iterable[SearchedParameter]) -> dict[str, float | str]:
    """Returns the parameters that have one value in all of the sets; empty for a single set."""
    if len(sets) < 2:
        return {}
    values = {each.name: {parameter_set.parameters[each.name] for parameter_set in sets} for each in parameters}
    return {name: next(iter(seen)) for name, seen in values.items() if len(seen) == 1}


def optima_text(optima: Sequence[OptimumRow]) -> str:
    """Returns the numbers of sets and regions."""
    regions = len({optimum.region for optimum in optima})
    share = "shares" if len(optima) == 1 else "share"
    return f"{counted(len(optima), 'set')} that {share} the best objective, in {counted(regions, 'distinct region')}."


def optima_blocks(
    optima: Sequence[OptimumRow], total: int, parameters: Sequence[SearchedParameter], drawings: Sequence[Block]
) -> list[Block]:
    """Returns sets and regions, the figure, the table of regions. `total`: number of sets; `optima` are the first."""
    same = constant(optima, searched(parameters))
    text = f"The search found {optima_text(optima)}"
    if total > len(optima):
        text = f"The search found {total:,} sets that share the best objective. Of these here: {optima_text(optima)}"
    if same:
        text += f" In all of them {', '.join(f'{name} = {value_text(value)}' for name, value in same.items())}."
    groups: dict[int, list[OptimumRow]] = {}
    for optimum in optima:
        groups.setdefault(optimum.region, []).append(optimum)
    first = sorted(groups.items())[:MOST_REGIONS]
    rows = [[region, len(members), members[0].rank, *_to_worse(members)] for region, members in first]
    caption = (
        f"Regions: chains of sets that are at most {NEIGHBOURS:g} apart (root mean square, in shares of the searched ranges). A set that "
        "lies far from every worse one tolerates small changes of its parameters"
    )
    if len(groups) > MOST_REGIONS:
        caption += f"; the first {MOST_REGIONS} of {len(groups)}, all in optima.csv"
    header = ["region", "sets", "best rank", "nearest worse set: least distance", "largest distance"]
    return [Paragraph(text), *drawings, Table(header, rows, caption, wrap_header=True)]


def _to_worse(members: Iterable[OptimumRow]) -> list[Number | None]:
    known = [member.to_worse for member in members if member.to_worse is not None]
    return [fixed(min(known), 3), fixed(max(known), 3)] if known else [None, None]


def solutions_table(solutions: Sequence[Solution], optima: Sequence[OptimumRow] = (), shown: int = SHOWN) -> list[Block]:
    """Returns the best sets, with the regions of the sets that share the best objective; nothing without a set."""
    if not solutions:
        return []
    known = {optimum.rank: optimum.region for optimum in optima}
    first, listed = solutions[0], solutions[:shown]
    broken = ["breaks constraints by"] if any(solution.violation > 0 for solution in listed) else []
    region = ["region"] if known else []
    rows = [
        [
            *(solution.rank, objective_number(solution.objective), fixed(solution.rating, 3)),
            *(known.get(solution.rank) for _ in region),
            *(percent(solution.violation or None, 1) for _ in broken),
            *(Number(f"{value:.6g}") for value in solution.constraints.values()),
            *(Number(f"{told(score)}*" if name in solution.reused else told(score)) for name, score in solution.scores.items()),
            *solution.parameters.values(),
        ]
        for solution in listed
    ]
    caption = "The best sets; equal objectives are ordered by the continuous rating"
    if any(solution.reused for solution in listed):
        caption += ". *: the score is that of a reference, this very set was not simulated there"
    header = ["rank", "objective", "rating", *region, *broken, *first.constraints, *first.scores, *first.parameters]
    return [Table(header, rows, caption)]


def evaluation_command(
    parameters: Values, spec: Mapping[str, Any], scenarios: Collection[str], vehicle: str | None = None
) -> str:
    """Returns the command that drives a parameter set as a campaign did. It has an option for each setting that differs from the command's
    default.

    Args:
        parameters: the set.
        spec: of the campaign.
        scenarios: of the campaign.
        vehicle: another vehicle model.
    """
    usual = EvaluationSpecification.model_fields
    given = ((name, spec.get(name)) for name in ("problem", "catalogue", "driving_function", "evaluator"))
    words = [shlex.quote(f"{name}={value_text(value, None)}") for name, value in parameters.items()]
    words += [
        f"--{name.replace('_', '-')} {value}"
        for name, value in given
        if isinstance(value, str) and value != usual[name].default
    ]
    own: Mapping[str, Any] = spec.get("vehicle") or {}
    nominal = VehicleSpecification().model
    model = vehicle or own.get("model", nominal)
    if model != nominal:
        words.append(f"--vehicle {model}")
    if own.get("parameters"):
        words.append(f"--vehicle-parameters {','.join(f'{name}={value:.10g}' for name, value in own['parameters'].items())}")
    if len(scenarios) == 1:
        words.append(f"--scenario {next(iter(scenarios))}")
    return " ".join(["drivecal evaluate", *words])


def validation_tables(rows: Sequence[ValidationRow], scale: Scale, command: str = "") -> list[Block]:
    """Returns the shares of wrong answers by scenario: of released predictions, or of variants that a map calls equal."""
    if any(row.released is not None for row in rows):
        header = [
            "scenario",
            "released",
            "simulated",
            "different",
            "beyond tolerance",
            "per prediction in lots",
            "limit",
            "wrong",
        ]
        caption = (
            "Released predictions, simulated afterwards; limit: of the expected errors released, for each prediction in a lot; each 95 % "
            "interval is that of a binomial share (Clopper-Pearson)"
        )
        cells = [
            [
                *(row.scenario, row.released, row.compared, row.different, row.beyond, percent(_per_inspected(row))),
                *(percent(row.limit, 1), row.wrong, *_rate(row)),
            ]
            for row in rows
        ]
    else:
        header = ["scenario", "reducible", "effects", "covered", "drawn", "bases", "variants", "compared", "different", "wrong"]
        caption = (
            "Share of wrong answers of the influence map with its 95 % interval. Reducible parameters have a region in which they do not "
            "matter; effects: of these and their interactions; bases: sets of the drawn Latin hypercube that qualify, each with variants. "
            "The interval is one of the mean over bases (by betting, for any distribution): variants of one basis are alike"
        )
        cells = [
            [
                *(row.scenario, row.reducible, row.effects, row.covered, row.drawn, row.bases, row.references),
                *(row.compared, row.different, row.wrong, *_rate(row)),
            ]
            for row in rows
        ]
    header += ["R_err", "95 % from", "to"]
    caption += f"; wrong: off by more than {scale.amount(scale.tolerance)}"
    return [Table(header, cells, caption, command, wrap_header=True)]


def _rate(row: ValidationRow) -> list[object]:
    return [percent(share) for share in (row.error_rate, row.lower_95, row.upper_95)]


def _per_inspected(row: ValidationRow) -> float | None:
    """Returns the errors released for each prediction in a lot, if the drawn predictions are like the others."""
    if not row.compared or not row.inspected:
        return None
    return (row.beyond or 0) / row.bases * (row.released or 0) / row.inspected


def histogram_bins(rows: Sequence[ValidationRow], scale: Scale = COMFORT) -> range:
    """Returns the numbers of the bars from the largest negative difference of the scale, or of a row, to the largest positive one."""
    usual = round(scale.span / rows[0].histogram_step)
    last = max([usual, *(abs(number) for row in rows for number in row.histogram)])
    return range(-last, last + 1)
