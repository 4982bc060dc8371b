"""Protocols of the plug-ins: driving functions, vehicles, evaluators, optimizers and scenario catalogues.

A plug-in is an object behind a Python entry point (`drivecal.driving_functions`, `.vehicles`, `.evaluators`, `.optimizers`,
`.scenarios`). The object itself is a light description that the coordinator loads. Only workers import the code behind `create` (numba
kernels, model arrays), inside `create`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel

from drivecal.bundles.highway import Scenario
from drivecal.domain.constraints import Constraint
from drivecal.domain.evaluations import Rating
from drivecal.domain.parameters import Indices, Kind, Parameter
from drivecal.domain.vehicles import VehicleParameter

Floats = npt.NDArray[np.float64]


@dataclass(slots=True)
class Observation:
    """Input of the driving function at one planning instant.

    `ego`: (s, s', s'', d, d', d''), derivatives with respect to time, SI units, shape (6,).
    `neighbours`: one row per other vehicle in the order of the scenario's traffic: (s, d, s', d', length, width), shape (n, 6).
    """

    time: float
    ego: Floats
    neighbours: Floats


class Planner(Protocol):
    """Instance of a driving function for one scenario. Deterministic: its output depends only on its inputs since `reset`."""

    @property
    def period(self) -> float:
        """Time between two plans (s), a multiple of the scenario's step."""

    def reset(self, parameters: Sequence[float]) -> None:
        """Starts a new run with these parameter values, in the order of the driving function's parameters."""

    def plan(self, observation: Observation) -> Floats:
        """Returns the trajectory to follow, shape (n, 7), at least `period` plus one second long.

        Rows every scenario step; columns: t from now, x, y, heading, curvature, speed, acceleration.
        """


class Named(Protocol):
    """A plug-in that campaign files refer to by its name."""

    @property
    def name(self) -> str:
        """Name used in campaign files."""


class Versioned(Named, Protocol):
    """A plug-in whose version is part of the key of stored results."""

    @property
    def version(self) -> str:
        """Changes whenever any result or rating may change by a bit."""


class DrivingFunction(Versioned, Protocol):
    """A driving function whose parameters are calibrated."""

    @property
    def spaces(self) -> Mapping[str, tuple[Parameter, ...]]:
        """Built-in search spaces by name, each with all parameters in the order of `Planner.reset`."""

    @property
    def limits(self) -> Mapping[str, tuple[float | None, float | None]]:
        """Smallest and largest value that a user's own space may contain, by parameter; None means unlimited."""

    def create(self, scenario: Scenario) -> Planner:
        """Creates the planner for one scenario."""


class VehicleModel(Protocol):
    """Instance of a vehicle with given parameter values. The sample time of `dynamics` is 0.01 s.

    A model may have `metrics` as well: further measures of the run since `start`, by names with units.
    """

    def start(self, x: float, y: float, heading: float, speed: float) -> None:
        """Starts a new run."""

    @property
    def pose(self) -> Floats:
        """(x, y, heading, speed, side slip angle, yaw rate, accelerations along and across the course), shape (8,), SI."""

    def follow(self, trajectory: Floats, since: float, duration: float, dynamics: Floats) -> bool:
        """Tracks `trajectory` (as from `Planner.plan`) from `since` seconds after its start for `duration` seconds.

        Writes one row per 0.01 s to `dynamics`, shape (duration / 0.01, 5): speed, longitudinal acceleration, lateral
        acceleration, yaw rate, steering angle. Returns False if the vehicle became unstable (spin, non-finite state).
        """


class Vehicle(Versioned, Protocol):
    """A vehicle that a campaign can choose."""

    @property
    def parameters(self) -> tuple[VehicleParameter, ...]:
        """Parameters with nominal values and the bounds of the robustness study."""

    def create(self, parameters: Mapping[str, float]) -> VehicleModel:
        """Creates the model with these values, which must cover all `parameters`."""


class Evaluator(Versioned, Protocol):
    """Rates the comfort of a run from its measured metrics."""

    def rate(self, rated_as: str, metrics: Mapping[str, float]) -> Rating:
        """Rates a run that did not fail, of a scenario of this class."""


@dataclass(frozen=True, slots=True)
class Series:
    """Time series of a run.

    `dynamics`: one row per 0.01 s: speed, longitudinal acceleration, lateral acceleration, yaw rate, steering angle of the front wheels
    (SI), shape (n, 5). `offset`: signed distance (m) from the centre of the target lane every scenario step, shape (m,). The last values
    of both belong to the same instant.
    """

    dynamics: Floats
    offset: Floats


@runtime_checkable
class SeriesEvaluator(Protocol):
    """Optional protocol of an evaluator that needs the time series of a run: workers call `rate_series` instead of `rate`.

    Its `rate` raises ValueError. Stored runs have metrics only and keep the ratings of other evaluators; they are simulated again, once,
    when a rating by this evaluator is needed. Failed runs need no rating.
    """

    def rate_series(self, rated_as: str, series: Series) -> Rating:
        """Rates a run that did not fail, of a scenario of this class. The next run overwrites the arrays of `series`."""


@runtime_checkable
class ConstrainedFunction(Protocol):
    """Optional protocol of a driving function that allows only some combinations of values."""

    @property
    def constraints(self) -> Mapping[str, Constraint]:
        """Constraints over all parameters by their text, e.g. `{"a <= b": lambda values: values["a"] <= values["b"]}`."""


class Catalogue(Named, Protocol):
    """A catalogue of scenarios."""

    @property
    def scenarios(self) -> Mapping[str, Scenario]:
        """Scenarios by id, in the order of the catalogue."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """Population of one iteration.

    `population`: grid indices, shape (n, n_searched). `changed`: shape (n,), False for individuals that are unchanged since the last
    iteration: they are carried over, not requested again.
    """

    population: Indices
    changed: npt.NDArray[np.bool_]


class Optimizer(Protocol):
    """Pure ask/tell optimizer over grid indices. Serialisable at any time: a restored optimizer continues exactly like the original."""

    def ask(self) -> Proposal:
        """Returns the next population. Call `tell` before the next `ask`."""

    def tell(self, objectives: Floats, tie_breakers: Floats) -> None:
        """Receives the objectives of the last population, shape (n,): higher is better, NaN for individuals without a result (ranked last).

        `tie_breakers` rank equal objectives (the weighted continuous rating).

        An optimizer that declares `objectives` gets them from a campaign with several or with constraints on results, in shape (n, m), and
        in the place of tie breakers the sums of violations, shape (n,): 0 for individuals that keep all constraints, which are better than
        all that do not. NaN in both for individuals without a result.
        """

    def state(self) -> dict[str, Any]:
        """Returns the complete state as JSON-ready plain data."""


Ability = Literal["grid", "continuous", "integer", "choice", "constraints", "objectives"]
"""Kinds of parameters that an optimizer searches, `constraints`: repaired individuals, and `objectives`: several, and constraints on
results."""


class OptimizerPlugin(Named, Protocol):
    """An optimizer that a campaign can choose by its `name` (`optimizer.kind`).

    `kinds` has the kind of each parameter, in the order of `n_values`; grids if it is left out. Indices of a continuous parameter are up to
    2e15 steps of 1e-9; indices of a choice have no order.
    """

    @property
    def settings(self) -> type[BaseModel]:
        """Model of the campaign's `optimizer` section, with at least `kind`, `population`, `iterations`, `seed`."""

    @property
    def supports(self) -> frozenset[Ability]:
        """All abilities, `grid` included.

        `constraints` says that the optimizer copes with repair: an infeasible individual is replaced by a feasible one after `ask`, by a
        pure function of the individual, and `tell` gives the replacement's result.
        """

    def requested_individuals(self, settings: BaseModel) -> int:
        """Returns the largest number of individuals requested over all iterations, without the ones carried over."""

    def create(
        self, settings: BaseModel, n_values: Indices, start: Indices | None = None, kinds: Sequence[Kind] | None = None
    ) -> Optimizer:
        """Creates an optimizer for grids of sizes `n_values`, shape (n_searched,).

        `start`, shape (k, n_searched), k <= population: parameter sets that must be in the start population.
        """

    def restore(
        self, settings: BaseModel, n_values: Indices, state: Mapping[str, Any], kinds: Sequence[Kind] | None = None
    ) -> Optimizer:
        """Creates an optimizer that continues from `state`."""
