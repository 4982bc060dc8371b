"""Complete commands that repeat the runs of a campaign."""

import shlex
from collections.abc import Collection, Mapping
from typing import Any

from drivecal.contracts.assignments import value_text
from drivecal.contracts.specification import EvaluationSpecification, VehicleSpecification


def evaluation(
    parameters: Mapping[str, float | str], spec: Mapping[str, Any], scenarios: Collection[str], vehicle: str | None = None
) -> str:
    """Returns the command that drives a parameter set as the campaign of `spec` did in its `scenarios`, or in another `vehicle` model.

    It has an option for each setting that differs from the command's default.
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
