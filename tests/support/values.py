"""Values of parameter sets as tests compute with them."""

from drivecal.cli.commands.demo import BASELINE
from drivecal.domain.parameters import ParameterSet

MIDDLE = BASELINE
"""Middle of the highway's parameter space, but for P1, which is 0 dB."""


def numbers(parameters: ParameterSet) -> dict[str, float]:
    """The floats of a set without choices, by name."""
    return {name: float(value) for name, value in parameters.floats.items()}
