"""Values and scales as tests compute with them, and as they expect them."""

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import pytest

from drivecal.analysis.goals import weighted_mean
from drivecal.analysis.solutions import Ranking
from drivecal.cli.commands.demo import BASELINE
from drivecal.contracts.specification import ReplicatesSpecification
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.parameters import ParameterSet
from drivecal.domain.scales import COMFORT, Direction, Scale

T = TypeVar("T")

MIDDLE = BASELINE
"""Middle of the highway's parameter space, but for P1, which is 0 dB."""
COST = Scale("cost", Direction.MINIMISE, lower=0.0, upper=100.0, tolerance=2.0, failed=100.0)
"""A scale that shares nothing with the comfort score: less is better, no steps, wide."""


def numbers(parameters: ParameterSet) -> dict[str, float]:
    """The floats of a set without choices, by name."""
    return {name: float(value) for name, value in parameters.floats.items()}


def present(value: T | None) -> T:
    """The value; fails if there is none."""
    assert value is not None
    return value


def faults_of(call: Callable[..., object], *arguments: Any, **named: Any) -> tuple[Problem, ...]:
    """The faults with which a call is refused; fails if it is not."""
    with pytest.raises(InvalidInputError) as refused:
        call(*arguments, **named)
    return refused.value.problems


def faulty_fields(call: Callable[..., object], *arguments: Any, **named: Any) -> list[str]:
    """The fields of these faults."""
    return [problem.field for problem in faults_of(call, *arguments, **named)]


def by_score(weights: Mapping[str, float], scale: Scale = COMFORT, wanted: ReplicatesSpecification | None = None) -> Ranking:
    """A ranking by the weighted mean of the score."""
    return Ranking(weights, weighted_mean(scale, weights), wanted)
