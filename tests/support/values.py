"""Values of parameter sets as tests compute with them."""

from __future__ import annotations

from drivecal.domain.parameter_sets import ParameterSet

MIDDLE: dict[str, float] = {
    "P1": 0,
    "P2": 1,
    "P3": 100,
    "P4": 1000,
    "P5": 750,
    "P6": 0.5,
    "P7": 100,
    "P8": 1000,
    "P9": 5,
    "P10": 10,
    "P11": 100,
}
"""Middle of the highway's parameter space, but for P1, which is 0 dB."""


def numbers(parameters: ParameterSet) -> dict[str, float]:
    """The floats of a set without choices, by name."""
    return {name: float(value) for name, value in parameters.floats.items()}
