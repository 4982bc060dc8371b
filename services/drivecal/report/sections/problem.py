"""What was asked for, and all that one needs to ask for it again: problem, versions, fingerprints, commands."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from drivecal.contracts.setup import CampaignSetup
from drivecal.report.data import ReportData
from drivecal.report.markup import Number, paragraph, subheading, table, verbatim
from drivecal.report.sections.commands import evaluation

SETTINGS = ("optimizer", "reduction", "sensitivity", "robustness", "validation")
SPECIFICATION = "campaign.json"
MOST_CHARACTERS = 10_000
"""Of a specification that the page shows; the file has all of it."""


def setting(findings: ReportData) -> list[str]:
    """Scenarios, parameters and the stages' settings."""
    setup, spec = findings.setup, findings.campaign.spec
    scenarios = [
        [one.scenario, findings.titles.get(one.scenario, ""), Number(f"{one.weight:.4g}"), one.step_seconds, one.seed]
        for one in setup.scenarios
    ]
    parameters = [
        [
            one.name,
            "" if one.unit == "1" else one.unit,
            one.lower,
            one.upper,
            one.n_values,
            "searched" if one.fixed is None else f"held at {one.fixed:g}",
        ]
        for one in setup.parameters
    ]
    stages = [[name, _settings(spec[name])] for name in SETTINGS if name in spec]
    return [
        table(
            ["scenario", "", "weight", "step, s", "seed"], scenarios, "Scenarios, and their shares of the objective", wrap=True
        ),
        table(["parameter", "unit", "lower", "upper", "values", ""], parameters, "Parameters on their grids"),
        table(["stage", "settings"], stages, "Settings", wrap=True),
    ]


def _settings(value: object) -> str:
    """A stage's settings in one line; what is empty or null is left out."""
    if not isinstance(value, dict):
        return "none" if value is None else json.dumps(value)
    kept = {name: one for name, one in value.items() if one is not None and one not in ([], {})}
    return ", ".join(f"{name} {one if isinstance(one, str) else json.dumps(one)}" for name, one in kept.items())


def versions(setup: CampaignSetup, version: str) -> list[str]:
    """What decided the runs, and the fingerprints under which the reference table keeps them."""
    program = f"drivecal {version}" if version == setup.server else f"drivecal {version} of a server {setup.server}"
    known = [one for one in setup.scenarios if one.driving_function is not None]
    used: dict[str, list[str | None]] = {
        "this report": [program],
        "driving function": [one.driving_function for one in known],
        "vehicle": [one.vehicle for one in known],
        "simulator": [one.simulator for one in known],
        "evaluator": [setup.evaluator],
    }
    rows = [[name, ", ".join(dict.fromkeys(one for one in values if one))] for name, values in used.items()]
    fingerprints = [[one.scenario, one.fingerprint, one.scenario_digest] for one in setup.scenarios]
    parts = [
        table(["", "version"], rows, "Versions"),
        table(["scenario", "run fingerprint", "of its network and definition"], fingerprints, "Fingerprints of the setups"),
    ]
    vehicle: Mapping[str, float] | None = next((one.vehicle_parameters for one in known), None)
    if vehicle:
        values = [[name.replace("_", " "), value] for name, value in vehicle.items()]
        parts.append(table(["vehicle parameter", "value"], values, "Parameters of the nominal vehicle, in SI units"))
    return parts


def again(findings: ReportData) -> list[str]:
    """The commands that repeat the campaign, and drive its best and its recommended set alone."""
    campaign, recommended = findings.campaign, findings.recommended
    commands = [f"drivecal submit {SPECIFICATION} --wait"]
    text = (
        f"The file {SPECIFICATION} beside this page is the campaign's specification with all its defaults. With the versions above and the "
        "same reference table it gives the same sets and scores; what the table holds by then is answered from it."
    )
    sensitivity: Any = campaign.spec.get("sensitivity")
    if isinstance(sensitivity, dict) and "map" in sensitivity:
        text += " It names an influence map by its id, which another database does not have: post it there first."
    parts = [subheading("The same again"), paragraph(text)]
    scenarios = [one.scenario for one in findings.setup.scenarios]
    if campaign.best is not None:
        commands.append(f"{evaluation(campaign.best.parameters, campaign.spec, scenarios)}    # the best set")
    if recommended is not None:
        driven = findings.robustness[0].study.vehicle
        commands.append(f"{evaluation(recommended.parameters, campaign.spec, scenarios, driven)}    # the recommended set")
    parts.append(verbatim("\n".join(commands)))
    lines = (f"  {json.dumps(name)}: {json.dumps(value, ensure_ascii=False)}" for name, value in campaign.spec.items())
    document = "{\n" + ",\n".join(lines) + "\n}"
    return parts if len(document) > MOST_CHARACTERS else [*parts, subheading("Specification"), verbatim(document)]
