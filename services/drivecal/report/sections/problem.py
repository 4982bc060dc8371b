"""Problem, versions, fingerprints, and the commands that repeat the campaign."""

import json
from collections.abc import Mapping
from typing import Any

from drivecal.contracts.assignments import value_text
from drivecal.contracts.setup import CampaignSetup
from drivecal.domain.scales import unit_text
from drivecal.report.data import ReportData
from drivecal.report.markup import paragraph, subheading, table, verbatim
from drivecal.report.rows import Number
from drivecal.report.sections.commands import evaluation

SETTINGS = ("optimizer", "reduction", "sensitivity", "robustness", "validation")
SPECIFICATION = "campaign.json"
MOST_CHARACTERS = 10_000
"""Settings of a specification on the page; the file has all."""


def setting(findings: ReportData) -> list[str]:
    """Returns scenarios, parameters and the stages' settings."""
    setup, spec = findings.setup, findings.campaign.spec
    scenarios = [
        [
            scenario.scenario,
            findings.titles.get(scenario.scenario, ""),
            Number(f"{scenario.weight:.4g}"),
            scenario.step_seconds,
            scenario.seed,
        ]
        for scenario in setup.scenarios
    ]
    parameters = [
        [
            parameter.name,
            parameter.description,
            unit_text(parameter.unit, ""),
            ", ".join(parameter.choices) or parameter.lower,
            None if parameter.choices else parameter.upper,
            "any" if parameter.kind == "continuous" else parameter.n_values,
            "searched" if parameter.fixed is None else f"held at {value_text(parameter.fixed)}",
        ]
        for parameter in setup.parameters
    ]
    stages = [[name, _settings(spec[name])] for name in SETTINGS if name in spec]
    return [
        table(
            ["scenario", "", "weight", "step, s", "seed"], scenarios, "Scenarios, and their shares of the objective", wrap=True
        ),
        table(["parameter", "meaning", "unit", "lower", "upper", "values", ""], parameters, "Parameters", wrap=True),
        table(["stage", "settings"], stages, "Settings", wrap=True),
    ]


def _settings(value: object) -> str:
    """Returns a stage's settings in one line, without empty ones."""
    if not isinstance(value, dict):
        return "none" if value is None else json.dumps(value)
    kept = {name: item for name, item in value.items() if item is not None and item not in ([], {})}
    return ", ".join(f"{name} {item if isinstance(item, str) else json.dumps(item)}" for name, item in kept.items())


def versions(setup: CampaignSetup, version: str) -> list[str]:
    """Returns the versions of the runs and their fingerprints in the reference table."""
    program = f"drivecal {version}" if version == setup.server else f"drivecal {version} of a server {setup.server}"
    known = [scenario for scenario in setup.scenarios if scenario.simulator is not None]
    used: dict[str, list[str | None]] = {
        "this report": [program],
        "driving function": [solution.driving_function for solution in known],
        "vehicle": [solution.vehicle for solution in known],
        "simulator": [solution.simulator for solution in known],
        "files of the problem": [solution.files for solution in known],
        "evaluator": [setup.evaluator],
    }
    rows = [
        [name, ", ".join(dict.fromkeys(value for value in values if value))] for name, values in used.items() if any(values)
    ]
    fingerprints = [[scenario.scenario, scenario.fingerprint, scenario.scenario_digest] for scenario in setup.scenarios]
    parts = [
        table(["", "version"], rows, "Versions"),
        table(["scenario", "run fingerprint", "of its network and definition"], fingerprints, "Fingerprints of the setups"),
    ]
    vehicle: Mapping[str, float] | None = next((solution.vehicle_parameters for solution in known), None)
    if vehicle:
        values = [[name.replace("_", " "), value] for name, value in vehicle.items()]
        parts.append(table(["vehicle parameter", "value"], values, "Parameters of the nominal vehicle, in SI units"))
    return parts


def again(findings: ReportData) -> list[str]:
    """Returns the commands that repeat the campaign, and drive its best and its recommended set alone."""
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
    scenarios = [scenario.scenario for scenario in findings.setup.scenarios]
    if campaign.best is not None:
        commands.append(f"{evaluation(campaign.best.parameters, campaign.spec, scenarios)}    # the best set")
    if recommended is not None:
        driven = findings.robustness[0].study.vehicle
        commands.append(f"{evaluation(recommended.parameters, campaign.spec, scenarios, driven)}    # the recommended set")
    parts.append(verbatim("\n".join(commands)))
    lines = (f"  {json.dumps(name)}: {json.dumps(value, ensure_ascii=False)}" for name, value in campaign.spec.items())
    document = "{\n" + ",\n".join(lines) + "\n}"
    return parts if len(document) > MOST_CHARACTERS else [*parts, subheading("Specification"), verbatim(document)]
