"""The manifest of a problem bundle, `problem.yaml`: parameters, constraints, simulator, scenarios, measures and scores.

A simulation gives measures; a declared score turns measures into numbers. The models check each field by itself; `checks.checked` checks
the whole.
"""

from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, StringConstraints, Tag, TypeAdapter, ValidationError, model_validator

from drivecal.bundles.highway import HighwaySimulator, PlannerController
from drivecal.bundles.highway_catalogue import MEASURES
from drivecal.bundles.shapes import Shape, ShapeEntry, takes_elements, with_coefficients
from drivecal.bundles.simulators import Command, File, Resources, SimulatorEntry, Text, Unit
from drivecal.contracts.specification import Given, Model, ParameterEntry
from drivecal.contracts.strict_json import Identifier, Number
from drivecal.domain.scales import Direction, Scale
from drivecal.domain.setups import canonical_json, digest
from drivecal.domain.values import Setting
from drivecal.domain.vehicles import VehicleParameter


def _is_shape(entry: object) -> str:
    keys = entry if isinstance(entry, Mapping) else {}
    return "shape" if isinstance(entry, ShapeEntry) or "curve" in keys or "map" in keys else "scalar"


AnyParameter = Annotated[
    Annotated[ParameterEntry, Tag("scalar")] | Annotated[ShapeEntry, Tag("shape")], Discriminator(_is_shape)
]


class VariedEntry(Model):
    """A side condition of a run that no campaign searches, such as the vehicle's mass: robustness studies vary it.

    A run gets its value among the parameters: the nominal one, but for the campaign's own `vehicle.parameters` and in these studies.
    """

    nominal: Number
    """Usual value."""
    lower: Number
    upper: Number
    """The range, by whose shares robustness studies vary it."""
    unit: Unit = "1"
    """For readers; 1 is none."""
    description: Text = ""
    """For readers."""


class ProcessSimulator(SimulatorEntry):
    """A program that answers JSON lines, started once per worker and scenario.

    A word of `command` that starts with `./` names a file of the bundle; a program without `/` is looked up on the worker's PATH.
    """

    kind: Literal["process"]
    command: Command
    """The program and its arguments."""


class CommandSimulator(SimulatorEntry):
    """A program that is started for each cell: `{parameters}`, `{scenario}` and `{results}` are paths of JSON files, `{seed}` the number
    that the variable DRIVECAL_SEED has as well."""

    kind: Literal["command"]
    command: Command
    """The program and its arguments."""

    @property
    def renews(self) -> bool:
        """True if each run has a new process."""
        return True


class PythonSimulator(SimulatorEntry):
    """A function `(parameters: dict, scenario: dict) -> dict of measures` in a file; `wheels`: folder with its packages.

    The scenario of a random simulator has an entry `seed`.
    """

    kind: Literal["python"]
    file: File
    """The module."""
    function: Identifier = "evaluate"
    """Its name in the module."""
    wheels: File | None = None
    """A folder of wheel files that the function imports."""


class FmuSimulator(SimulatorEntry):
    """An FMI 2 or 3 co-simulation FMU of the whole system.

    `measures`: `last(x)`, `min(x)`, `max(x)`, `mean(x)` or `integral(x)` of an output.
    """

    kind: Literal["fmu"]
    file: File
    """The FMU."""
    duration: Annotated[float, Field(gt=0, le=1e6)]
    """Duration of a run, s."""
    step: Annotated[float, Field(gt=0, le=1e4)]
    """Step of the communication, s."""
    measures: Annotated[dict[Identifier, str], Field(min_length=1, max_length=1000)]
    """By name, how each is computed from an output."""
    seed: Identifier | None = None
    """The FMU's parameter or start value that a random FMU takes its seed from."""
    reset: bool = True
    """Between runs the FMU is reset; false: each run has a new process, for FMUs whose reset is missing or leaves something."""

    @model_validator(mode="after")
    def _has_a_seed(self) -> Self:
        if self.random != (self.seed is not None):
            raise ValueError("a random FMU has `random: true` and `seed: NAME`, the variable of the seed; give both or neither")
        return self


AnySimulator = Annotated[
    ProcessSimulator | CommandSimulator | PythonSimulator | FmuSimulator | HighwaySimulator, Field(discriminator="kind")
]


_RESOURCES = TypeAdapter[Any](Resources)


def are_resources(counts: object) -> bool:
    """Returns whether a value is a mapping of numbers by the names of resources."""
    try:
        _RESOURCES.validate_python(counts, strict=True)
    except ValidationError:
        return False
    return True


class ScoreEntry(Model):
    """A score: arithmetic over measures, or an installed evaluator's rating of a run.

    `range`: its usual values; `failed`: the worth of a failed run, by default the worst end of the range. A failed run never beats another:
    a score that is worse than `failed` counts as `failed`. If scores may lie beyond the range, give `failed` a value worse than any run's.
    """

    formula: Annotated[str, StringConstraints(min_length=1, max_length=2000)] | None = None
    """Arithmetic over measures."""
    evaluator: Identifier | None = None
    """Name of an installed evaluator, in place of a formula."""
    direction: Literal["maximise", "minimise"]
    """Direction of better scores."""
    range: Annotated[tuple[Number, Number], Field(strict=False)]
    """Usual values; scores may lie beyond, but none counts worse than `failed`."""
    tolerance: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    """Smaller differences are no error of a reused or predicted score."""
    failed: Number | None = None
    """Worth of a failed run, worse than any run's score; null: the worst end of the range. Worse scores count as it, with a warning."""
    step: Annotated[float, Field(gt=0, le=1e6)] | None = None
    """Distance of neighbouring scores, if an evaluator gives only multiples of it."""
    unit: Unit = "1"
    """For readers; 1 is none."""

    @model_validator(mode="after")
    def _is_computed(self) -> Self:
        if (self.formula is None) == (self.evaluator is None):
            raise ValueError("a score needs a formula or an evaluator; give one of them")
        if self.step is not None and self.evaluator is None:
            raise ValueError("formulas have no steps; leave `step` out")
        return self

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
        return Scale(name, direction, lower, upper, self.tolerance, self.failed_worth, self.step, self.unit)


class Manifest(Model):
    """`problem.yaml`. `failures` and `series`: names of failures and units of time series that the simulator may report."""

    problem: Identifier
    """Its name."""
    description: Text = ""
    """For readers."""
    parameters: Annotated[dict[Identifier, AnyParameter], Field(min_length=1, max_length=200)]
    """The searched space: numbers, choices, curves and maps."""
    added: Annotated[dict[Identifier, Given], Field(max_length=200, default_factory=dict)]
    """New parameters: stored runs of the same files without them mean these values."""
    removed: Annotated[dict[Identifier, Given], Field(max_length=200, default_factory=dict)]
    """Former parameters: runs behave as stored ones with these values."""
    renamed: Annotated[dict[Identifier, Identifier], Field(max_length=200, default_factory=dict)]
    """Former names by the new ones; the values mean the same."""
    varied: Annotated[dict[Identifier, VariedEntry], Field(max_length=100, default_factory=dict)]
    """Side conditions that robustness studies vary."""
    constraints: Annotated[tuple[Text, ...], Field(max_length=100, strict=False)] = ()
    """Comparisons that a parameter set has to keep, such as `a >= 2*b`."""
    baseline: dict[Identifier, Given] | None = None
    """The set that results are compared with; curves and maps become the nearest ones of their coefficients."""
    simulator: AnySimulator
    """The program that runs a parameter set in a scenario."""
    scenarios: Annotated[dict[Identifier, dict[str, Any]], Field(min_length=1, max_length=1000)]
    """Data of each, which the simulator gets as it is, without `resources`."""
    scenario_resources: Annotated[dict[Identifier, Resources], Field(max_length=1000, default_factory=dict)]
    """Resources of single scenarios, in place of the simulator's of the same name; written as `resources` of the scenario."""
    measures: Annotated[dict[Identifier, Unit], Field(min_length=1, max_length=1000)]
    """Results of a run, with units."""
    failures: Annotated[tuple[Identifier, ...], Field(max_length=100, strict=False)] = ()
    """Names of failures that a run may return; none listed: any."""
    series: Annotated[dict[Identifier, Unit], Field(max_length=100, default_factory=dict)]
    """Time series that a run may return, with units."""
    scores: Annotated[dict[Identifier, ScoreEntry], Field(min_length=1, max_length=100)]
    """Made of measures; the first is a campaign's default."""

    @model_validator(mode="before")
    @classmethod
    def _resources_of_scenarios(cls, document: Any) -> Any:
        """Moves valid `resources` out of the scenarios, whose data simulators get; `checks` reports the others where they stand."""
        scenarios = document.get("scenarios") if isinstance(document, Mapping) else None
        if not isinstance(scenarios, Mapping):
            return document
        known = {name: row["resources"] for name, row in scenarios.items() if isinstance(row, Mapping) and "resources" in row}
        valid = {name: counts for name, counts in known.items() if are_resources(counts)}
        written = document.get("scenario_resources") or {}
        if not valid or not isinstance(written, Mapping):
            return document
        rest = {
            name: {key: value for key, value in data.items() if key != "resources"}
            for name, data in scenarios.items()
            if name in valid
        }
        return {**document, "scenarios": {**scenarios, **rest}, "scenario_resources": {**written, **valid}}

    @property
    def claims(self) -> bool:
        """True if it says what runs of its earlier versions mean."""
        return bool(self.added or self.removed or self.renamed)

    def resources(self, scenario: str) -> dict[str, int]:
        """Returns the number of each resource that a run of a scenario holds, without zeros."""
        counts = (self.simulator.resources or {}) | self.scenario_resources.get(scenario, {})
        return {name: count for name, count in counts.items() if count}

    @model_validator(mode="after")
    def _has_one_seed(self) -> Self:
        seeded = [name for name, data in self.scenarios.items() if "seed" in data]
        if seeded and self.simulator.random:
            raise ValueError(f"scenarios.{seeded[0]}: each run of a random simulator has a seed of its own; leave `seed` out")
        return self

    @cached_property
    def shapes(self) -> dict[str, Shape]:
        """Curves and maps by name."""
        return {name: Shape.declared(name, each) for name, each in self.parameters.items() if isinstance(each, ShapeEntry)}

    @property
    def coefficients(self) -> dict[str, dict[str, Any]]:
        """Inputs that decide the curve or map of each coefficient, by its name."""
        return {each: shape.document for shape in self.shapes.values() for each in shape.names}

    @property
    def form(self) -> str:
        """A digest of all curves and maps."""
        return digest(canonical_json({name: shape.document for name, shape in self.shapes.items()}).encode())

    @cached_property
    def scalars(self) -> dict[str, ParameterEntry]:
        """Parameters that a search moves: each curve and map is replaced by its coefficients."""
        scalars: dict[str, ParameterEntry] = {}
        for name, entry in self.parameters.items():
            if isinstance(entry, ParameterEntry):
                scalars[name] = entry
                continue
            for coefficient, place in self.shapes[name].described(entry.axis_units):
                of_all = entry.model_dump(include={"lower", "upper", "step", "unit"})
                scalars[coefficient] = ParameterEntry(**of_all, description=f"{name} at {place}")
        return scalars

    @cached_property
    def conditions(self) -> tuple[str, ...]:
        """The declared constraints, then the constraints that keep the form of curves and maps."""
        return (*self.constraints, *(each for shape in self.shapes.values() for each in shape.conditions))

    @cached_property
    def start(self) -> dict[str, Setting] | None:
        """The baseline with the coefficients of curves and maps. Raises InvalidInputError if a list does not fit."""
        return None if self.baseline is None else with_coefficients(self.baseline, self.shapes, "baseline")

    @property
    def arguments(self) -> dict[str, str]:
        """Units of what simulators get, by name: an FMU gets points of curves and maps as `gain[1]`, `torque[1,2]`."""
        if not takes_elements(self.simulator.model_dump()):
            return {name: entry.unit for name, entry in self.parameters.items()}
        return {
            element: entry.unit
            for name, entry in self.parameters.items()
            for element in (self.shapes[name].elements if name in self.shapes else (name,))
        }

    @property
    def has_planner(self) -> bool:
        """True if drivecal's own planner drives scenarios with tasks: such runs need no child process."""
        return isinstance(self.simulator, HighwaySimulator) and isinstance(self.simulator.controller, PlannerController)

    @property
    def varied_parameters(self) -> tuple[VehicleParameter, ...]:
        """The varied parameters with their nominal values and ranges."""
        return tuple(
            VehicleParameter(name, entry.unit, entry.nominal, entry.lower, entry.upper, entry.description)
            for name, entry in self.varied.items()
        )

    @property
    def integers(self) -> tuple[str, ...]:
        """Names of the integer parameters, sorted. A simulator gets 3 for them, not 3.0."""
        return tuple(sorted(name for name, entry in self.scalars.items() if entry.integer))

    @property
    def reported(self) -> dict[str, str]:
        """Measures that runs of campaigns report and store, with units: the declared ones, and whatever else the simulator always computes,
        for scores that are pushed later."""
        always = MEASURES if isinstance(self.simulator, HighwaySimulator) and not self.has_planner else {}
        return self.measures | {name: unit for name, unit in always.items() if name not in self.measures}
