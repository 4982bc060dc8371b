"""The sections of a review sheet. Each table has below it the command that prints or repeats its numbers."""

import json
from collections.abc import Iterable, Mapping
from typing import Any

from drivecal.contracts.setup import CampaignSetup, SearchedParameter
from drivecal.contracts.tables import FrontRow
from drivecal.domain.scales import plain, told, unit_text
from drivecal.report.markup import bullets, command, paragraph, table
from drivecal.report.review.data import Review, ReviewedSet
from drivecal.report.review.scatter import drawings
from drivecal.report.rows import Number, front_marks, shown_of_front
from drivecal.report.sections.commands import evaluation

MOST_SHOWN = 30
"""Sets of the front in its table, if no more are marked or chosen."""
SHORT = 8
"""Characters of another campaign's id in the table of scores."""
ORIGINS = {
    "simulated": "simulated",
    "repeated": "repeats a simulation",
    "certified": "certified",
    "reused": "copied",
    "predicted": "predicted",
    "later": "simulated later",
    "failed": "no result",
}
MEANINGS = {
    "simulated": "a run of this very set",
    "repeated": "the stored run of this very set",
    "certified": "a stored run of another set; a proof says that this set's run has the same bits",
    "reused": "a stored run of another set; an influence map says that the difference does not matter",
    "predicted": "a prediction from other runs, released with its lot",
    "later": "a run of this very set by another campaign, in the place of a copied or predicted score",
    "failed": "no result after all attempts",
}


def question(review: Review) -> list[str]:
    """Returns problem, versions and fingerprints."""
    facts = {label: _facts(reviewed) for label, reviewed in review.sets.items()}
    names = dict.fromkeys(name for known in facts.values() for name in known)
    rows = [[name, *(known.get(name) for known in facts.values())] for name in names]
    parts = [table(["", *review.columns], rows, "Campaign and problem"), command(review.commands(_show_json))]
    for label, reviewed in review.distinct(lambda each: each.setup.scenarios).items():
        scenarios = [
            [each.scenario, each.title, Number(f"{each.weight:.4g}"), each.step_seconds, each.seed, each.fingerprint]
            for each in reviewed.setup.scenarios
        ]
        caption = f"Scenarios{label}: share of the objective, and the fingerprint of all that decides a run"
        parts += [
            table(["scenario", "", "weight", "step, s", "seed", "fingerprint"], scenarios, caption),
            command(f'curl "$DRIVECAL_URL/api/v1/campaigns/{reviewed.campaign.id}/setup"'),
        ]
    return parts


def _facts(reviewed: ReviewedSet) -> dict[str, str]:
    campaign, setup, spec = reviewed.campaign, reviewed.setup, reviewed.campaign.spec
    ended = "" if campaign.ended_at is None else f", ended {campaign.ended_at:%Y-%m-%d %H:%M:%S} UTC"
    facts = {
        "name": campaign.name,
        "campaign": campaign.id,
        "state": f"{campaign.state}{ended}",
        "problem": str(spec.get("problem", "")),
        "digest of its files": _used(setup, "files"),
        "score": f"{campaign.scale.name}, {campaign.scale.direction}, {campaign.scale.lower:g} to {campaign.scale.upper:g}"
        + unit_text(campaign.scale.unit),
        "tolerance": campaign.scale.amount(campaign.scale.tolerance),
        "evaluator": setup.evaluator,
        "driving function": _used(setup, "driving_function"),
        "vehicle": _used(setup, "vehicle"),
        "simulator": _used(setup, "simulator"),
        "optimizer": _settings(spec.get("optimizer")),
        "reduction": _settings(spec.get("reduction")),
        "rerun of": campaign.rerun_of or "",
    }
    return {name: text for name, text in facts.items() if text}


def _used(setup: CampaignSetup, field: str) -> str:
    values = (getattr(scenario, field) for scenario in setup.scenarios)
    return ", ".join(dict.fromkeys(value for value in values if value))


def _settings(value: Any) -> str:
    kept = {} if not isinstance(value, dict) else {name: each for name, each in value.items() if each not in (None, {}, [])}
    return ", ".join(f"{name} {each if isinstance(each, str) else json.dumps(each)}" for name, each in kept.items())


def objectives(review: Review) -> list[str]:
    """Returns objectives and constraints; those that both campaigns have once."""
    parts = []
    for label, reviewed in review.distinct(
        lambda each: _objectives(each) + [[text] for text in each.summary.constraints]
    ).items():
        header = ["objective", "direction", "of the scenarios' values", "unit", "tolerance"]
        parts.append(table(header, _objectives(reviewed), f"Objectives{label}"))
        constraints = reviewed.summary.constraints
        parts.append(bullets(f"Subject to {each}." for each in constraints) if constraints else paragraph("No constraints."))
        parts.append(command(f"drivecal front {reviewed.campaign.id} --json"))
    return parts


def _objectives(reviewed: ReviewedSet) -> list[list[object]]:
    return [
        [
            *(goal.name, goal.direction, f"{goal.aggregate} over {_shares(goal.scenarios)}"),
            *(goal.unit if goal.unit != "1" else "", goal.tolerance),
        ]
        for goal in reviewed.summary.objectives
    ]


def _shares(weights: Mapping[str, float]) -> str:
    if len(set(weights.values())) == 1:
        return f"{', '.join(weights)}{' with equal weights' if len(weights) > 1 else ''}"
    return ", ".join(f"{name} ({weight:.4g})" for name, weight in weights.items())


def result(review: Review) -> list[str]:
    """Returns the chosen sets against the baseline, by objective and by scenario, with the origin of each score."""
    goals = list(dict.fromkeys(goal.name for each in review.sets.values() for goal in each.summary.objectives))
    rows = [
        _compared(review, name, _baseline_of(review.first, name), {k: v.objectives.get(name) for k, v in review.sets.items()})
        for name in goals
    ]
    parts = [
        table(["objective", "baseline", *review.columns, *_differences(review)], rows, "Objectives of the chosen set"),
        command(review.commands(_ranking)),
        *_constrained(review),
    ]
    scenarios = list(dict.fromkeys(name for each in review.sets.values() for name in each.chosen.scores))
    scores = []
    for name in scenarios:
        baseline = review.first.campaign.baseline
        known = None if baseline is None else baseline.scores.get(name)
        line = _compared(
            review, name, known, {label: each.chosen.scores.get(name) for label, each in review.sets.items()}, told
        )
        scores.append([*line, *(_origin(each, name) for each in review.sets.values())])
    scale = review.first.campaign.scale
    better = "higher" if scale.sign > 0 else "lower"
    header = ["scenario", "baseline", *review.columns, *_differences(review)]
    header += [f"origin{label}" for label in review.labelled()]
    caption = (
        f"Score by scenario: {scale.name}{unit_text(scale.unit, ', ')}, {better} is better; origin: what answered the cell, "
    )
    caption += "and its number"
    used = dict.fromkeys(cell.outcome for each in review.sets.values() for cell in each.cells.values())
    return [
        *parts,
        table(header, scores, caption),
        bullets(f"{ORIGINS[outcome].capitalize()}: {MEANINGS[outcome]}." for outcome in used if outcome in MEANINGS),
        command(review.commands(_drives)),
        *_baseline_command(review.first),
    ]


def _constrained(review: Review) -> list[str]:
    """Returns the constrained amounts of the chosen sets beside the baseline's; nothing without constraints."""
    bounds = list(dict.fromkeys(name for each in review.sets.values() for name in each.chosen.constraints))
    if not bounds:
        return []
    baseline = review.first.summary.baseline
    rows = [
        _compared(
            review,
            name,
            None if baseline is None else baseline.constraints.get(name),
            {label: each.chosen.constraints.get(name) for label, each in review.sets.items()},
        )
        for name in bounds
    ]
    header = ["constraint on", "baseline", *review.columns, *_differences(review)]
    return [table(header, rows, "Constrained amounts of the chosen set"), command(review.commands(_ranking))]


def _baseline_of(reviewed: ReviewedSet, name: str) -> float | None:
    """Returns the baseline's value of an objective; of others than the first only if the baseline has a value of each."""
    judged, baseline = reviewed.summary.baseline, reviewed.campaign.baseline
    if judged is not None:
        return judged.objectives.get(name)
    return None if baseline is None or name != reviewed.summary.objectives[0].name else baseline.objective


def _compared(
    review: Review,
    name: str,
    baseline: float | None,
    values: Mapping[str, float | None],
    text: Any = lambda value: f"{value:.6g}",
) -> list[object]:
    amounts = [values[label] for label in review.sets]
    reference = baseline if len(amounts) == 1 else amounts[0]
    shown = [None if amount is None else Number(text(amount)) for amount in (baseline, *amounts)]
    last = amounts[-1]
    change = None if reference is None or last is None else Number(f"{last - reference:+.6g}")
    return [name, *shown, change]


def _differences(review: Review) -> list[str]:
    return ["B less A" if len(review.sets) > 1 else "change"]


def _origin(reviewed: ReviewedSet, scenario: str) -> str | None:
    cell = reviewed.cells.get(scenario)
    if cell is None:
        return None
    place = "" if cell.campaign is None else f" of campaign {cell.campaign[:SHORT]}"
    return f"{ORIGINS.get(cell.outcome, cell.outcome)} ({cell.number}{place})"


def _drives(reviewed: ReviewedSet) -> str:
    numbers: dict[str, list[str]] = {}
    for cell in reviewed.cells.values():
        numbers.setdefault(cell.campaign or reviewed.campaign.id, []).append(str(cell.number))
    lines = [_evaluation(reviewed, reviewed.chosen.parameters)]
    lines += [
        f"for cell in {' '.join(cells)}; do drivecal explain {campaign} $cell; done" for campaign, cells in numbers.items()
    ]
    return "\n".join(lines)


def _baseline_command(reviewed: ReviewedSet) -> list[str]:
    baseline = reviewed.campaign.baseline
    return [] if baseline is None else [paragraph("The baseline:"), command(_evaluation(reviewed, baseline.parameters))]


def _evaluation(reviewed: ReviewedSet, values: Mapping[str, float | str]) -> str:
    scenarios = [scenario.scenario for scenario in reviewed.setup.scenarios]
    return evaluation(values, reviewed.campaign.spec, scenarios)


def parameters(review: Review) -> list[str]:
    """Returns the values with unit, range and meaning."""
    known: dict[str, SearchedParameter] = {}
    for reviewed in review.sets.values():
        known |= {each.name: known.get(each.name, each) for each in reviewed.setup.parameters}
    baseline = review.first.campaign.baseline
    rows = [
        [
            *(name, each.description, unit_text(each.unit, ""), _range(each)),
            _value(None if baseline is None else baseline.parameters.get(name)),
            *(_value(reviewed.chosen.parameters.get(name)) for reviewed in review.sets.values()),
        ]
        for name, each in known.items()
    ]
    header = ["parameter", "meaning", "unit", "range", "baseline", *review.columns]
    return [
        table(header, rows, "Parameters"),
        command(review.commands(_export)),
    ]


def _export(reviewed: ReviewedSet) -> str:
    return f"drivecal export {reviewed.campaign.id} --table {reviewed.table} --row {reviewed.chosen.rank} --format cdfx -o set.cdfx"


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
    return None if value is None else value if isinstance(value, str) else Number(_digits(value))


def front(review: Review) -> list[str]:
    """Returns the drawing and sets of the front; nothing for a single objective."""
    parts: list[str] = []
    for label, reviewed in review.labelled().items():
        if len(reviewed.summary.objectives) < 2 or not reviewed.front:
            continue
        goals = reviewed.summary.objectives
        same = {
            name: each
            for name, each in review.sets.items()
            if each.campaign.id == reviewed.campaign.id and each.table == "front"
        }
        marked = {name: list(each.objectives.values()) for name, each in same.items()}
        chosen = {each.chosen.rank for each in same.values()}
        rows = shown_of_front(reviewed.front, MOST_SHOWN, chosen)
        lines = [
            [row.rank, *(Number(f"{amount:.6g}") for amount in row.objectives.values()), row.degree, _marks(row, chosen)]
            for row in rows
        ]
        volume = reviewed.summary.hypervolume
        caption = (
            f"Front{label}: {len(lines)} of {reviewed.summary.size:,} sets that no other evaluated set beats in every objective"
        )
        caption += (
            ""
            if len(rows) == len(reviewed.front)
            else ": the chosen, the knee, the best of each objective, others spread over it"
        )
        caption += "" if volume is None else f"; hypervolume {volume:.6g}"
        parts += [
            *drawings(goals, [list(row.objectives.values()) for row in reviewed.front], marked),
            table(["rank", *(goal.name for goal in goals), "degree of robustness", ""], lines, caption),
            command(f"drivecal front {reviewed.campaign.id} --limit {reviewed.summary.size}"),
        ]
    return parts


def _marks(row: FrontRow, chosen: Iterable[int]) -> str:
    return ", ".join(mark for mark in ("chosen" if row.rank in chosen else "", front_marks(row)) if mark)


def _show_json(reviewed: ReviewedSet) -> str:
    return f"drivecal show {reviewed.campaign.id} --json"


def _ranking(reviewed: ReviewedSet) -> str:
    if reviewed.table == "front":
        return f"drivecal front {reviewed.campaign.id} --limit {reviewed.summary.size}"
    return f"drivecal solutions {reviewed.campaign.id} --limit {reviewed.chosen.rank}"


def described(reviewed: ReviewedSet) -> str:
    """Returns the set in words."""
    where = "of the front" if reviewed.table == "front" else "of the solutions"
    return f"set {reviewed.chosen.rank} {where} of campaign {reviewed.campaign.id}"
