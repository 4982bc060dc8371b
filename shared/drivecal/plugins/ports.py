"""The ports of drivecal: what a driving function, vehicle, evaluator, optimizer or scenario catalogue must offer.

A plug-in is an object behind a Python entry point (`drivecal.driving_functions`, `.vehicles`, `.evaluators`, `.optimizers`,
`.scenarios`). The object itself is a light description that the coordinator loads; the machinery behind `create` (numba kernels, model
arrays) is imported by workers only, inside `create`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel

from drivecal.domain.evaluations import Rating
from drivecal.domain.parameters import Indices, Parameter
from drivecal.domain.scenarios import Manoeuvre, Scenario
from drivecal.domain.vehicles import VehicleParameter

Floats = npt.NDArray[np.float64]


@dataclass(slots=True)
class Observation:
    """What the driving function sees at one planning instant.

    `ego`: (s, s', s'', d, d', d''), derivatives with respect to time, SI units, shape (6,).
    `neighbours`: one row per other vehicle in the order of the scenario's traffic: (s, d, s', d', length, width), shape (n, 6).
    """

    time: float
    ego: Floats
    neighbours: Floats


class Planner(Protocol):
    """A driving function at work in one scenario. Deterministic: its answers depend on what it was given since `reset` only."""

    @property
    def period(self) -> float:
        """Time between two plans, s; a multiple of the scenario's step."""

    def reset(self, parameters: Sequence[float]) -> None:
        """Starts a new run with these parameter values, in the order of the driving function's parameters."""

    def plan(self, observation: Observation) -> Floats:
        """The trajectory to follow from now on, shape (n, 7): rows every scenario step, columns
        (t from now, x, y, heading, curvature, speed, acceleration); at least `period` plus one second long."""


class CertifiablePlanner(Planner, Protocol):
    """A planner that decides by the lowest cost over candidates, linear in weights that depend on parameters alone, over features that do
    not depend on them: whatever else it does must not depend on parameters either. Then a run is determined by its decisions, and
    `drivecal.certification` can prove from stored decisions what another parameter set would drive."""

    @property
    def n_values(self) -> int:
        """Numbers that a candidate's cost is computed from."""

    @property
    def n_candidates(self) -> int:
        """Candidates that are decided among."""

    @property
    def grid(self) -> float:
        """A power of two that most of these numbers are non-negative multiples of: those are stored in two bytes, others in twelve."""

    @property
    def state(self) -> Floats:
        """All that the features of the last plan were computed from, shape (n_state,): two plans with the same bits are in the same state.
        A view, overwritten by the next plan."""

    def decide(self, state: Floats, parameters: Sequence[float]) -> int:
        """What `plan` would choose in this `state` with these parameters. Leaves `infeasible`, `chosen` and what `contenders` tells as
        `plan` would, and changes nothing else of a run."""

    def contenders(self, infeasible: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.int64], Floats]:
        """Of the last plan or decision: the candidates that could be chosen with some parameters, shape (n,), ascending, and what their
        costs are computed from, shape (n, n_values), no negative zeros. `infeasible`, shape (n_candidates,), are known to be, so that they
        keep no other candidate from being chosen. `drivecal.certification.kernels.contenders` finds them for linear costs."""

    @property
    def infeasible(self) -> npt.NDArray[np.bool_]:
        """The candidates that the last plan or decision found infeasible, shape (n_candidates,)."""

    @property
    def chosen(self) -> int:
        """The candidate of the last plan that is driven, or of the last decision."""

    def walk(self, nodes: Any, parameters: Sequence[float], node: int) -> int:
        """Decides again from node to node of `drivecal.certification.nodes.Nodes`, from `node` on, as `plan` would with these parameters:
        the cheapest candidate that is not known to be infeasible; where all are, the cheapest of all. Gives the node where the way
        ends: one with a leaf, one that is not described, or one whose choice was never driven. -1 for parameters beyond those that
        `contenders` allows for."""


class DrivingFunction(Protocol):
    """A driving function whose parameters are calibrated."""

    @property
    def name(self) -> str:
        """By which a campaign chooses it."""

    @property
    def version(self) -> str:
        """Changes whenever any result may change by a bit."""

    @property
    def spaces(self) -> Mapping[str, tuple[Parameter, ...]]:
        """Built-in search spaces by name, each with all parameters in the order that `Planner.reset` expects."""

    @property
    def limits(self) -> Mapping[str, tuple[float | None, float | None]]:
        """Smallest and largest value that a user's own space may contain, by parameter; None is unlimited."""

    @property
    def certifiable(self) -> bool:
        """True where its planners are `CertifiablePlanner`s."""

    def create(self, scenario: Scenario) -> Planner:
        """The planner for one scenario."""


class VehicleModel(Protocol):
    """A vehicle at work. The sample time of `dynamics` is 0.01 s."""

    def start(self, x: float, y: float, heading: float, speed: float) -> None:
        """Starts a new run."""

    @property
    def pose(self) -> Floats:
        """(x, y, heading, speed, side slip angle, yaw rate, longitudinal acceleration, lateral acceleration), shape (8,), SI."""

    def follow(self, trajectory: Floats, since: float, duration: float, dynamics: Floats) -> bool:
        """Tracks `trajectory` (as from `Planner.plan`) from `since` seconds after its start for `duration` seconds.

        Writes one row per 0.01 s to `dynamics`, shape (duration / 0.01, 5): speed, longitudinal acceleration, lateral
        acceleration, yaw rate, steering angle. False where the vehicle went unstable (spin, non-finite state).
        """


@runtime_checkable
class SelfMeasuring(Protocol):
    """What a vehicle model offers besides where it knows something of a run that its dynamics do not show."""

    @property
    def metrics(self) -> Mapping[str, float]:
        """Of the run since `start`, stored with the run's metrics; names carry units."""


class Vehicle(Protocol):
    """A vehicle model that can be chosen in a campaign."""

    @property
    def name(self) -> str:
        """By which a campaign chooses it."""

    @property
    def version(self) -> str:
        """Changes whenever any result may change by a bit."""

    @property
    def parameters(self) -> tuple[VehicleParameter, ...]:
        """With nominal values and the bounds for robustness."""

    def create(self, parameters: Mapping[str, float]) -> VehicleModel:
        """The model with these values, one for each of `parameters`."""


class Evaluator(Protocol):
    """Rates the comfort of a run from its measured metrics."""

    @property
    def name(self) -> str:
        """By which a campaign chooses it."""

    @property
    def version(self) -> str:
        """Changes whenever any rating may change by a bit."""

    def rate(self, manoeuvre: Manoeuvre, metrics: Mapping[str, float]) -> Rating:
        """The rating of a run that did not fail."""


@dataclass(frozen=True, slots=True)
class Series:
    """How a run went, step by step.

    `dynamics`: one row per 0.01 s: speed, longitudinal acceleration, lateral acceleration, yaw rate, steering angle of the front wheels
    (SI), shape (n, 5). `offset`: signed distance (m) from the centre of the target lane every scenario step, shape (m,); the last
    values of both are of the same moment.
    """

    dynamics: Floats
    offset: Floats


@runtime_checkable
class SeriesEvaluator(Protocol):
    """What an evaluator offers besides where it needs the time series of a run: then `rate_series` rates, in workers, instead of `rate`.

    Its `rate` raises ValueError: stored runs, of which there are metrics only, keep what others rated and are simulated again, once, when
    this evaluator's opinion is needed. Runs that failed score 0 without it.
    """

    def rate_series(self, manoeuvre: Manoeuvre, series: Series) -> Rating:
        """The rating of a run that did not fail. `series` is only lent: its arrays are overwritten by the next run."""


class Catalogue(Protocol):
    """A catalogue of scenarios."""

    @property
    def name(self) -> str:
        """By which a campaign chooses it."""

    @property
    def scenarios(self) -> Mapping[str, Scenario]:
        """By id, in the order of the catalogue."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """One iteration's population.

    `population`: grid indices, shape (n, n_searched). `changed`: shape (n,), False for individuals that the optimizer left as they
    were in the last iteration: they are carried over, not requested again.
    """

    population: Indices
    changed: npt.NDArray[np.bool_]


class Optimizer(Protocol):
    """Pure ask/tell over grid indices. Serialisable at any moment: a restored optimizer goes on exactly as the original."""

    def ask(self) -> Proposal:
        """The next population. To be followed by `tell`."""

    def tell(self, objectives: Floats, tie_breakers: Floats) -> None:
        """The objectives of the asked population, shape (n,), higher is better, NaN for individuals without a result (ranked last);
        `tie_breakers` rank equal objectives (the weighted continuous rating)."""

    def state(self) -> dict[str, Any]:
        """All of it, as JSON-ready plain data."""


class OptimizerPlugin(Protocol):
    """An optimizer that can be chosen in a campaign by its `name` (`optimizer.kind`)."""

    @property
    def name(self) -> str:
        """The campaign's `optimizer.kind`."""

    @property
    def settings(self) -> type[BaseModel]:
        """Validates the campaign's `optimizer` section; has at least `kind`, `population`, `iterations`, `seed`."""

    def requested_individuals(self, settings: BaseModel) -> int:
        """How many individuals are requested at most over all iterations; the others are carried over."""

    def create(self, settings: BaseModel, n_values: Indices, start: Indices | None = None) -> Optimizer:
        """A fresh optimizer for grids of sizes `n_values`, shape (n_searched,); `start`, shape (k, n_searched), k <= population, are
        parameter sets that must be in the start population."""

    def restore(self, settings: BaseModel, n_values: Indices, state: Mapping[str, Any]) -> Optimizer:
        """An optimizer that goes on from `state`."""
