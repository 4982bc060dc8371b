"""The trie of one setup, which proves that a run would repeat a stored run.

Why this is a proof: simulator, vehicle and planner are deterministic, and parameters affect a run only through the planner's choice of a
candidate. Two runs are in the same state until they choose differently. The nodes of the trie are these states. If a parameter set makes
the stored choice at every node down to a leaf, by the planner's own arithmetic on the stored features, it drives that leaf's run, bit for
bit.

In a state that was seen a few times, the planner itself decides again, from its stored inputs. States that are queried more often get a
description, from which deciding is a dozen times cheaper. With a description, a winning candidate that was never tested for feasibility
proves nothing: that run has to be simulated.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from time import thread_time_ns
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from drivecal.domain.errors import DrivecalError
from drivecal.highway.certification.kernels import NONE, decisions_to, visit
from drivecal.highway.certification.memory import Memory
from drivecal.highway.certification.nodes import Floats, Nodes
from drivecal.highway.certification.recording import DecisionRecord
from drivecal.plugins.ports import CertifiablePlanner, Observation

Result = TypeVar("Result")
BYTES_PER_RESULT = 4000
"""Approximate size of a stored result, mostly metrics by name."""
DECISIONS_UNTIL_DESCRIPTION = 4
"""Decisions of the planner in a state before it is described: a description costs as much as four to six decisions."""
TIMED = 8
"""Every so many plans planning and recording are timed: reading the clock takes a good part of what recording a plan does."""


class NotDeterministicError(DrivecalError):
    """Equal decisions led to different states: other influences decide runs, and no run can be certified."""


@dataclass(frozen=True, slots=True)
class Certificate(Generic[Result]):
    """Proof that a parameter set would repeat the run `proven_by`, whose result is `result`."""

    result: Result
    proven_by: int


@dataclass(slots=True)
class Spent:
    """CPU time in nanoseconds of so many timed plans."""

    nanoseconds: int = 0
    plans: int = 0

    @property
    def mean(self) -> float:
        """Nanoseconds of a plan."""
        return self.nanoseconds / self.plans if self.plans else 0.0


class Trie(Generic[Result]):
    """Recorded runs of one scenario in one setup, in one process. A cache: forgotten runs are simulated again."""

    def __init__(self, planner: CertifiablePlanner, memory: Memory) -> None:
        """Creates an empty trie. `memory`: shared by all tries of the process."""
        self._planner = planner
        self._nodes = Nodes(planner.n_values, planner.n_candidates, planner.grid)
        self._results: list[Certificate[Result]] = []
        self._memory = memory
        self.is_intact = True
        """False if an exception interrupted a change."""
        self.known: list[int] = []
        """First decisions of the run that the last `prove` was about, if it has no certificate. They are proven, too."""
        self.spent = {False: Spent(), True: Spent()}
        """CPU time of plans that were made, and of those that repeated a known decision."""
        memory.join(self)

    def use(self, planner: CertifiablePlanner) -> None:
        """Continues with another planner for the same scenario."""
        self._planner = planner

    @property
    def bytes(self) -> int:
        """Memory in use."""
        return self._nodes.bytes + BYTES_PER_RESULT * len(self._results)

    @property
    def nodes(self) -> int:
        """Number of stored planning states."""
        return self._nodes.count

    @property
    def runs(self) -> int:
        """Number of stored runs."""
        return len(self._results)

    @property
    def visited(self) -> Any:
        """Time of the last visit of each node, by the memory's clock, shape (nodes,)."""
        return self._nodes.visited[: self._nodes.count]

    def prove(self, parameters: Sequence[float]) -> Certificate[Result] | None:
        """Returns the stored run that these parameters would repeat; None without a proof. No run may be recording."""
        with self._change():
            return self._prove(parameters)

    def _prove(self, parameters: Sequence[float]) -> Certificate[Result] | None:
        nodes, planner, described = self._nodes, self._planner, False
        self.known, untried = [], []
        node = planner.walk(nodes, parameters, 0)
        if node == NONE:
            return None
        while nodes.state[node] != NONE:
            chosen = planner.decide(nodes.states[nodes.state[node]], parameters)
            nodes.decided[node] += 1
            if nodes.decided[node] >= DECISIONS_UNTIL_DESCRIPTION or planner.infeasible.any():
                nodes.describe(node, *planner.contenders(planner.infeasible), planner.infeasible)
                described = True
            child = nodes.child(node, chosen)
            if child == NONE:
                untried = [chosen]
                break
            node = planner.walk(nodes, parameters, child) if nodes.row_count[child] else child
        self._visit(node)
        leaf = int(nodes.leaf[node])
        certificate = None if leaf == NONE else self._results[leaf]
        if certificate is None:
            self.known = decisions_to(node, nodes.parent, nodes.decision).tolist() + untried
        if described:
            self._memory.evict()
        return certificate

    def record(self, known: Sequence[int] = ()) -> RecordingPlanner[Result]:
        """Returns a planner that records its next run in this trie. `known`: the run's first decisions, which are not planned again."""
        return RecordingPlanner(self._planner, self, known)

    def learn(self, recording: DecisionRecord, result: Result, run: int) -> None:
        """Adds a run under the number `run`. Raises NotDeterministicError if the same decisions led to another state before."""
        with self._change():
            self._learn(recording, result, run)

    def _learn(self, recording: DecisionRecord, result: Result, run: int) -> None:
        end, deviation = self._nodes.extend(recording.decisions, np.array(recording.states))
        if deviation is not None:
            raise NotDeterministicError(
                f"the same decisions led to another state at {deviation * self._planner.period:g} s:"
                " certified reuse is not possible with this setup"
            )
        if self._nodes.leaf[end] == NONE:
            self._nodes.leaf[end] = len(self._results)
            self._results.append(Certificate(result, run))
        for index, infeasible in recording.infeasible:
            self._mark_infeasible(recording, index, infeasible)
        self._visit(end)
        self._memory.evict()

    def _mark_infeasible(self, recording: DecisionRecord, index: int, infeasible: npt.NDArray[np.bool_]) -> None:
        """Marks candidates as infeasible in the state of plan number `index`, so that they exclude no other contender.

        A state without description needs no marks: the planner itself checks its candidates there.
        """
        nodes, node = self._nodes, 0
        for decision in recording.decisions[:index]:
            node = nodes.child(node, decision)
        if not nodes.row_count[node]:
            return
        known = nodes.infeasible(node)
        if (infeasible & ~known).any():
            self._planner.decide(recording.states[index], recording.parameters)
            known |= infeasible
            nodes.describe(node, *self._planner.contenders(known), known)

    def forget_until(self, clock: int) -> None:
        """Forgets the states whose last visit is not after `clock`. Visits include all ancestors, so the rest is a trie again."""
        nodes = self._nodes
        retained = self.visited > clock
        retained[0] = True
        nodes.keep(retained)
        leaves = np.flatnonzero(nodes.leaf != NONE)
        self._results = [self._results[leaf] for leaf in nodes.leaf[leaves].tolist()]
        nodes.leaf[leaves] = np.arange(len(leaves), dtype=np.int32)

    @contextmanager
    def _change(self) -> Iterator[None]:
        self.is_intact = False
        yield
        self.is_intact = True

    def _visit(self, node: int) -> None:
        self._memory.clock += 1
        visit(node, self._nodes.parent, self._nodes.visited, self._memory.clock)


class RecordingPlanner(Generic[Result]):
    """A planner that delegates to another one and records the run for a trie."""

    def __init__(self, planner: CertifiablePlanner, trie: Trie[Result], known: Sequence[int] = ()) -> None:
        self._planner, self._trie, self._known = planner, trie, known
        self.period = planner.period
        self.recording = DecisionRecord()
        """The finished run."""
        self._parameters: Sequence[float] = ()
        self._states: list[bytes] = []
        """State of each plan, as bytes: copying an array takes five times as long, and slows the run itself."""
        self._decisions: list[int] = []
        self._infeasible: list[tuple[int, npt.NDArray[np.bool_]]] = []
        self._timed = 0

    @property
    def milliseconds(self) -> float:
        """CPU time of recording so far, less what repeated decisions spared; negative if they spared more. Both are estimated from every
        `TIMED`-th plan."""
        count, spent = len(self._decisions), self._trie.spent
        timed = -(-count // TIMED)
        recording = self._timed * count / timed if timed else 0.0
        spared = spent[False].mean - spent[True].mean if spent[False].plans else 0.0
        return (recording - spared * min(count, len(self._known))) / 1e6

    def reset(self, parameters: Sequence[float]) -> None:
        self._planner.reset(parameters)
        self._parameters, self._states, self._decisions, self._infeasible = parameters, [], [], []
        self._timed = 0

    def plan(self, observation: Observation) -> Floats:
        number = len(self._decisions)
        if number % TIMED:
            trajectory = self._plan(observation, number)
            self._record()
            return trajectory
        start = thread_time_ns()
        trajectory = self._plan(observation, number)
        planned = thread_time_ns()
        self._record()
        self._timed += thread_time_ns() - planned
        spent = self._trie.spent[number < len(self._known)]
        spent.nanoseconds += planned - start
        spent.plans += 1
        return trajectory

    def _plan(self, observation: Observation, number: int) -> Floats:
        if number < len(self._known):
            return self._planner.repeat(observation, self._known[number])
        return self._planner.plan(observation)

    def _record(self) -> None:
        planner = self._planner
        if True in planner.infeasible.tobytes():  # several times faster than numpy on so few values
            self._infeasible.append((len(self._decisions), planner.infeasible.copy()))
        self._states.append(planner.state.tobytes())
        self._decisions.append(planner.chosen)

    def finish(self, result: Result, run: int) -> None:
        """Stores the finished run under the number `run`. Raises like `Trie.learn`."""
        states = np.frombuffer(bytearray().join(self._states)).reshape(len(self._decisions), -1)  # writable, as kernels expect
        self.recording = DecisionRecord(self._parameters, states, self._decisions, self._infeasible)
        self._trie.learn(self.recording, result, run)
