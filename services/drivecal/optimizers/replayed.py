"""Optimizers of other libraries behind drivecal's port.

Their internal state cannot be stored as plain data. So the answers are stored: all of them are deterministic for a seed, and replaying
the same answers restores the same state. Another version of a library may draw otherwise, so that a digest of every proposal is stored,
too, and each replayed proposal must have the same.
"""

from collections.abc import Callable, Mapping, Sequence
from contextvars import ContextVar
from hashlib import sha256
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np

from drivecal.domain.errors import InvalidInputError, Problem, ReplayError
from drivecal.domain.parameters import Indices
from drivecal.domain.rounding import Scaling
from drivecal.optimizers.population import dump_floats, load_floats
from drivecal.optimizers.repair import checked_answers, checked_vectors, fitting
from drivecal.plugins.ports import Floats, Proposal

_is_abandoned: ContextVar[Callable[[], bool]] = ContextVar("is_abandoned", default=lambda: False)


class AbandonedError(Exception):
    """Nothing waits for the result of the running computation."""


def abandon_when(is_abandoned: Callable[[], bool]) -> None:
    """Lets `is_abandoned` end the long computations of this thread: a thread cannot be ended from outside."""
    _is_abandoned.set(is_abandoned)


def stop_if_abandoned() -> None:
    """Raises AbandonedError if nothing waits for the running computation; long ones call it from time to time."""
    if _is_abandoned.get()():
        raise AbandonedError


def require(package: str, extra: str) -> None:
    """Raises InvalidInputError if a library is not installed. Call it before importing the library."""
    if find_spec(package) is None:
        raise InvalidInputError(
            Problem(
                "optimizer.kind", f"it needs the package {package}", f"install drivecal with the extra [{extra}] on the server"
            )
        )


def scalings_of(objectives: Floats) -> list[Scaling]:
    """Returns what brings each objective near 1, by the first population with a result: libraries compare with absolute numbers. Empty
    before."""
    return [Scaling.of(column) for column in objectives.T] if np.isfinite(objectives).any() else []


def scaled(objectives: Floats, scalings: Sequence[Scaling]) -> Floats:
    """Returns scaled objectives, shape (n, m)."""
    if not scalings:
        return objectives
    return np.column_stack([scaling(column) for scaling, column in zip(scalings, objectives.T, strict=True)])


def named(package: str) -> str:
    """Returns a library's name with its installed version."""
    return f"{package} {version(package)}"


class Engine(Protocol):
    """A library's optimizer of grid indices."""

    library: str
    """The library with its version, for errors."""

    def propose(self) -> Indices:
        """The next population, shape (n, n_searched)."""

    def learn(self, population: Indices, objectives: Floats, tie_breakers: Floats) -> None:
        """Takes the objectives of a population, also of the first, which the library has not proposed. See `ports.Optimizer.tell`."""


class Replayed:
    """Ask/tell: the campaign's start design first, then what the engine proposes."""

    def __init__(self, first: Indices, engine: Engine) -> None:
        """`first`: the start population, shape (n, n_searched)."""
        self._first = self._population = first
        self._changed = np.ones(len(first), dtype=np.bool_)
        self._engine = engine
        self._history: list[tuple[Floats, Floats]] = []
        self._digests = [_digest(first)]
        self._told = False

    def ask(self) -> Proposal:
        """The next population; individuals that are proposed again in the same place are not `changed`."""
        if self._told:
            before, self._population = self._population, self._engine.propose()
            self._changed = (self._population != before).any(axis=1)
            self._digests.append(_digest(self._population))
            self._told = False
        return Proposal(self._population.copy(), self._changed.copy())

    def tell(self, objectives: Floats, tie_breakers: Floats) -> None:
        """The answers to the last `ask`. Raises RuntimeError if they were given already, ValueError if they do not fit."""
        if self._told:
            raise RuntimeError("the objectives of this population are known already; ask for the next one")
        checked = checked_vectors if objectives.ndim == 2 else checked_answers
        answers = checked(objectives, tie_breakers, len(self._changed))
        self._history.append(answers)
        self._engine.learn(self._population, *answers)
        self._told = True

    def state(self) -> dict[str, Any]:
        """The start population, all answers since, and a digest of every proposal, as data for strict JSON."""
        return {
            "first": self._first.tolist(),
            "told": [[dump_floats(objectives), dump_floats(ties)] for objectives, ties in self._history],
            "asked": not self._told,
            "digests": list(self._digests),
            "library": self._engine.library,
        }

    def resume(self, state: Mapping[str, Any]) -> None:
        """Replays all answers. Raises InvalidInputError if it belongs to a population of another size or another space, and ReplayError at
        the first proposal whose digest is another one.
        """
        self._first = self._population = fitting(np.array(state["first"], dtype=np.int64), self._first)
        self._digests = [_digest(self._first)]
        self._compare(state)
        for objectives, ties in state["told"]:
            self._ask_again(state)
            self.tell(np.array(load_floats(objectives)), np.array(load_floats(ties)))
        if state["asked"]:
            self._ask_again(state)

    def _ask_again(self, state: Mapping[str, Any]) -> None:
        stop_if_abandoned()
        self.ask()
        self._compare(state)

    def _compare(self, state: Mapping[str, Any]) -> None:
        """Raises ReplayError if the last proposal is not the saved one."""
        iteration, saved = len(self._digests) - 1, state["digests"]
        if self._digests[iteration:] != saved[iteration : iteration + 1]:
            raise ReplayError(iteration, state["library"], self._engine.library)


def _digest(population: Indices) -> str:
    """Sixteen hexadecimal digits of a population, shape and order included."""
    shape = "x".join(map(str, population.shape))
    return sha256(shape.encode() + population.astype("<i8").tobytes()).hexdigest()[:16]
