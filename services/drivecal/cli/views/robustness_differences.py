"""Differences of two robustness studies of the same sets, for example in a plain and a hybrid vehicle."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import typer

from drivecal.analysis.robustness import difference, pairs_of
from drivecal.cli.views.output import dumped, parameters_text, print_columns
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.setup import CampaignSetup
from drivecal.contracts.tables import RobustnessRow
from drivecal.report.blocks import fixed

BOXES = ("delta", "steps", "samples", "eta", "condition", "seed")
"""Settings that decide what a degree means; `seed` draws the vehicles."""
CHOICE = ("of", "solutions", "sets")
"""Settings that decide which sets are examined."""
Settings = dict[str, tuple[Any, Any]]


@dataclass(frozen=True, slots=True)
class MadeStudy:
    """A robustness study: its campaign, the campaign's setup, and the examined sets."""

    maker: Campaign
    setup: CampaignSetup
    rows: Sequence[RobustnessRow]

    @property
    def settings(self) -> dict[str, Any]:
        """Settings on which the degrees depend, by their names in the campaign file."""
        spec, wanted = self.maker.spec, self.maker.spec.get("robustness") or {}
        values: dict[str, Any] = {name: wanted.get(name) for name in (*BOXES, *CHOICE)}
        values["of"] = values["of"] or self.maker.id
        scenarios = self.setup.scenarios
        values["scenarios"] = [scenario.scenario for scenario in scenarios]
        values["weights"] = {scenario.scenario: round(scenario.weight, 6) for scenario in scenarios}
        values["evaluator"] = self.setup.evaluator
        for name in ("driving_function", "vehicle", "simulator"):  # with their versions, where a run has been asked for
            used = sorted({str(getattr(scenario, name)) for scenario in scenarios if getattr(scenario, name)})
            known = spec.get(name)
            values[name] = ", ".join(used) or (known["model"] if isinstance(known, dict) else known)
        values["vehicle.parameters"] = (spec.get("vehicle") or {}).get("parameters") or {}
        return values


def settings_that_differ(here: Mapping[str, Any], there: Mapping[str, Any]) -> Settings:
    """Returns differing settings by name, as (this study's, the other study's). A study that examines named sets alone repeats another one:
    how these were chosen is no difference."""
    repeated = 0 in {here.get("solutions"), there.get("solutions")}
    skipped = {"solutions", "sets"} if repeated else set()
    return {name: (value, there.get(name)) for name, value in here.items() if value != there.get(name) and name not in skipped}


def document(here: MadeStudy, there: MadeStudy) -> dict[str, object]:
    """Returns the differences, JSON-ready."""
    differing = settings_that_differ(here.settings, there.settings)
    return {
        "settings": {name: list(both) for name, both in differing.items()},
        "difference": asdict(difference(here.rows, there.rows)),
        "here": dumped(here.rows),
        "there": dumped(there.rows),
    }


def settings_text(differing: Settings) -> list[str]:
    """Returns lines about differing settings and their meaning for the comparison."""
    if not differing:
        return ["both studies have the same settings"]
    listed = ", ".join(f"{name} {_said(here)} -> {_said(there)}" for name, (here, there) in differing.items())
    lines = [f"settings that differ: {listed}"]
    if any(name in differing for name in BOXES):
        lines.append("the degrees do not mean the same: boxes or condition are others")
    return lines


def _said(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name}={part}" for name, part in value.items()) or "none"
    if isinstance(value, list):
        return f"{len(value)} given" if value and isinstance(value[0], dict) else ", ".join(map(str, value)) or "none"
    return f"{value:g}" if isinstance(value, float) else str(value)


def print_difference(first: MadeStudy, other: MadeStudy) -> None:
    """Prints differing settings, both studies side by side, and a summary of the changes."""
    typer.echo("\n".join([*settings_text(settings_that_differ(first.settings, other.settings)), ""]))
    rows, others = first.rows, other.rows
    header = ["rank", "degree", "objective", "scores that differ", "parameters"]
    print_columns(header, [_line(mine, theirs) for mine, theirs in pairs_of(rows, others)])
    change = difference(rows, others)
    here, there = change.mean_degree
    lines = [f"{change.sets} sets in both studies" + (f", {change.only_one} in one of them alone" if change.only_one else "")]
    lines.append("degrees: {} equal, {} lower, {} higher".format(*change.degrees) + f"; mean {here:.2f} to {there:.2f}")
    lines.append("scores in the nominal vehicle: {} equal, {} lower, {} higher".format(*change.scores))
    if change.tau is not None:
        lines.append(f"ranking: Kendall's tau {change.tau:.2f}")
    lines.append(f"recommended: {'the same set' if change.same_recommended else 'another set'}")
    typer.echo("\n".join(lines))


def _line(mine: RobustnessRow, theirs: RobustnessRow) -> list[object]:
    scores = {name: (score, theirs.scores.get(name)) for name, score in mine.scores.items()}
    return [
        _both(mine.rank, theirs.rank),
        _both(degree_text(mine), degree_text(theirs)),
        _both(fixed(mine.objective, 3), fixed(theirs.objective, 3)),
        ", ".join(f"{name} {_both(*both)}" for name, both in scores.items() if both[0] != both[1]),
        parameters_text(mine.parameters),
    ]


def _both(here: object, there: object) -> str:
    shown = ["-" if value is None else str(value) for value in (here, there)]
    return shown[0] if shown[0] == shown[1] else " -> ".join(shown)


def degree_text(row: RobustnessRow) -> str:
    """Returns the degree of robustness: a lower bound if no box failed."""
    return f">= {row.degree}" if row.at_least else str(row.degree)
