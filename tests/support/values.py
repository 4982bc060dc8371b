"""Values of parameter sets as tests compute with them."""

from __future__ import annotations

from drivecal.domain.parameter_sets import ParameterSet


def numbers(parameters: ParameterSet) -> dict[str, float]:
    """The floats of a set without choices, by name."""
    return {name: float(value) for name, value in parameters.floats.items()}
