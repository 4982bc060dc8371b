"""The manifest of a problem bundle, `problem.yaml`: parameters, constraints, simulator, scenarios, measures and scores.

A simulation gives measures; a declared score turns measures into numbers. The models check each field by itself; `checks.checked` checks
the whole.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, StringConstraints

from drivecal.bundles.highway import HighwaySimulator
from drivecal.bundles.simulators import Command, File, SimulatorEntry, Text, Unit
from drivecal.contracts.specification import Choice, Identifier, Model, Number
from drivecal.domain.scales import Direction, Scale


class ParameterEntry(Model):
    """A parameter: a grid (`step`), continuous (none), integer, or a choice."""

    lower: Number | None = None
    upper: Number | None = None
    step: Annotated[float, Field(gt=0, le=1e6)] | None = None
    integer: bool = False
    choices: Annotated[list[Choice], Field(min_length=2, max_length=1000)] | None = None
    unit: Unit = "1"
    description: Text = ""


class ProcessSimulator(SimulatorEntry):
    """A program that answers JSON lines, started once per worker and scenario.

    A word of `command` that starts with `./` names a file of the bundle; a program without `/` is looked up on the worker's PATH.
    """

    kind: Literal["process"]
    command: Command


class CommandSimulator(SimulatorEntry):
    """A program that is started for each cell: `{parameters}`, `{scenario}` and `{results}` are paths of JSON files."""

    kind: Literal["command"]
    command: Command


class PythonSimulator(SimulatorEntry):
    """A function `(parameters: dict, scenario: dict) -> dict of measures` in a file; `wheels`: folder with its packages."""

    kind: Literal["python"]
    file: File
    function: Identifier = "evaluate"
    wheels: File | None = None


class FmuSimulator(SimulatorEntry):
    """An FMI 2 or 3 co-simulation FMU of the whole system.

    `measures`: `last(x)`, `min(x)`, `max(x)`, `mean(x)` or `integral(x)` of an output.
    """

    kind: Literal["fmu"]
    file: File
    duration: Annotated[float, Field(gt=0, le=1e6)]
    step: Annotated[float, Field(gt=0, le=1e4)]
    measures: Annotated[dict[Identifier, str], Field(min_length=1, max_length=1000)]


AnySimulator = Annotated[
    ProcessSimulator | CommandSimulator | PythonSimulator | FmuSimulator | HighwaySimulator, Field(discriminator="kind")
]


class ScoreEntry(Model):
    """A score: arithmetic over measures.

    `range`: its usual values; `failed`: the worth of a failed run, by default the worst end of the range.
    """

    formula: Annotated[str, StringConstraints(min_length=1, max_length=2000)]
    direction: Literal["maximise", "minimise"]
    range: Annotated[tuple[Number, Number], Field(strict=False)]
    tolerance: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    failed: Number | None = None
    unit: Unit = "1"

    @property
    def worst(self) -> float:
        """Worst end of the range."""
        return self.range[0] if self.direction == "maximise" else self.range[1]

    @property
    def failed_worth(self) -> float:
        """Worth of a failed run."""
        return self.worst if self.failed is None else self.failed

    def scale(self, name: str) -> Scale:
        """Returns the scale of the score of this name."""
        lower, upper = self.range
        direction = Direction(self.direction)
        return Scale(name, direction, lower, upper, self.tolerance, self.failed_worth, unit=self.unit)


class Manifest(Model):
    """`problem.yaml`. `failures` and `series`: names of failures and units of time series that the simulator may report."""

    problem: Identifier
    description: Text = ""
    parameters: Annotated[dict[Identifier, ParameterEntry], Field(min_length=1, max_length=200)]
    constraints: Annotated[tuple[Text, ...], Field(max_length=100, strict=False)] = ()
    baseline: dict[Identifier, Number | Choice] | None = None
    simulator: AnySimulator
    scenarios: Annotated[dict[Identifier, dict[str, Any]], Field(min_length=1, max_length=1000)]
    measures: Annotated[dict[Identifier, Unit], Field(min_length=1, max_length=1000)]
    failures: Annotated[tuple[Identifier, ...], Field(max_length=100, strict=False)] = ()
    series: Annotated[dict[Identifier, Unit], Field(max_length=100, default_factory=dict)]
    scores: Annotated[dict[Identifier, ScoreEntry], Field(min_length=1, max_length=100)]

    @property
    def integers(self) -> tuple[str, ...]:
        """Names of the integer parameters, sorted. A simulator gets 3 for them, not 3.0."""
        return tuple(sorted(name for name, entry in self.parameters.items() if entry.integer))
