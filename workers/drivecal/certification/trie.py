"""The trie of one setup: proves that a run would go as a stored one did, or says that it cannot.

Why it is a proof: simulator, vehicle and planner are deterministic, and parameters enter a run through the planner's choice of a
candidate only. Two runs that begin alike are in the same state until they choose differently. So the trie's nodes are states: a
parameter set that chooses, by the planner's own arithmetic on the stored features, what was chosen before at every node down to a leaf,
drives that leaf's run, bit for bit. In a state that was seen once the planner itself decides again, from all that it had seen there; only
states that are asked for more often are worth a description, from which deciding is a dozen times cheaper. By a description, a candidate
that would win but was never tested for feasibility proves nothing: that run has to be simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from drivecal.certification.kernels import NONE, visit
from drivecal.certification.memory import Memory
from drivecal.certification.nodes import Floats, Nodes
from drivecal.domain.errors import DrivecalError
from drivecal.plugins.ports import CertifiablePlanner, Observation

Result = TypeVar("Result")
BYTES_PER_RESULT = 4000
"""Roughly, of what is kept of a run: its metrics by name, mostly."""
ASKED = 2
"""How often the planner decides in a state before it is described: a description costs as much as a few decisions."""


class NotDeterministicError(DrivecalError):
    """The same decisions led to another state: something besides them decides runs, and nothing may be certified."""


@dataclass(frozen=True, slots=True)
class Certificate(Generic[Result]):
    """A parameter set would drive as the run `proven_by` did, whose result is `result`."""

    result: Result
    proven_by: int


class Trie(Generic[Result]):
    """Of one scenario in one setup, in one process. A cache: what it forgets is simulated again."""

    def __init__(self, planner: CertifiablePlanner, memory: Memory) -> None:
        """`memory`: shared with the other tries of the process."""
        self._planner = planner
        self._nodes = Nodes(planner.n_values, planner.n_candidates, planner.grid)
        self._results: list[Certificate[Result]] = []
        self._memory = memory
        memory.join(self)

    @property
    def bytes(self) -> int:
        """Memory in use."""
        return self._nodes.bytes + BYTES_PER_RESULT * len(self._results)

    @property
    def nodes(self) -> int:
        """Planning states that are kept."""
        return self._nodes.count

    @property
    def runs(self) -> int:
        """Runs that can prove others."""
        return len(self._results)

    @property
    def visited(self) -> Any:
        """When each node was visited last, by the memory's clock, shape (nodes,)."""
        return self._nodes.visited[: self._nodes.count]

    def prove(self, parameters: Sequence[float]) -> Certificate[Result] | None:
        """The stored run that these parameters would repeat; None where that is not proved. No run may be recording."""
        nodes, planner, described = self._nodes, self._planner, False
        node = planner.walk(nodes, parameters, 0)
        if node == NONE:
            return None
        while nodes.state[node] != NONE:
            chosen = planner.decide(nodes.states[nodes.state[node]], parameters)
            nodes.asked[node] += 1
            if nodes.asked[node] >= ASKED or planner.infeasible.any():
                nodes.describe(node, *planner.contenders(planner.infeasible), planner.infeasible)
                described = True
            child = nodes.child(node, chosen)
            if child == NONE:
                break
            node = planner.walk(nodes, parameters, child)
        self._visit(node)
        leaf = int(nodes.leaf[node])
        found = None if leaf == NONE else self._results[leaf]
        if described:
            self._memory.settle()
        return found

    def record(self) -> RecordingPlanner[Result]:
        """Takes part in a run, as its planner, and learns from it."""
        return RecordingPlanner(self._planner, self)

    def learn(self, recording: RecordingPlanner[Result], result: Result, run: int) -> None:
        """A run, known as number `run`. Raises NotDeterministicError where a state is not what the same decisions led to before."""
        end, other = self._nodes.extend(recording.decisions, np.array(recording.states))
        if other is not None:
            raise NotDeterministicError(
                f"the same decisions led to another state at {other * self._planner.period:g} s:"
                " certified reuse is not possible with this setup"
            )
        if self._nodes.leaf[end] == NONE:
            self._nodes.leaf[end] = len(self._results)
            self._results.append(Certificate(result, run))
        for index, infeasible in recording.refused:
            self._refuse(recording, index, infeasible)
        self._visit(end)
        self._memory.settle()

    def _refuse(self, recording: RecordingPlanner[Result], index: int, infeasible: npt.NDArray[np.bool_]) -> None:
        """In the state of a run's plan number `index` candidates were found infeasible: who cannot be driven keeps nobody else out. Where
        the state is not described the planner will find out by itself."""
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
        """Forgets the states that were not visited after this. A state is visited whenever one below it is, so what stays is a trie."""
        nodes = self._nodes
        wanted = self.visited > clock
        wanted[0] = True
        nodes.keep(wanted)
        kept = np.flatnonzero(nodes.leaf != NONE)
        self._results = [self._results[leaf] for leaf in nodes.leaf[kept].tolist()]
        nodes.leaf[kept] = np.arange(len(kept), dtype=np.int32)

    def _visit(self, node: int) -> None:
        self._memory.clock += 1
        visit(node, self._nodes.parent, self._nodes.visited, self._memory.clock)


class RecordingPlanner(Generic[Result]):
    """A planner that plans as its own does and notes the run for the trie."""

    def __init__(self, planner: CertifiablePlanner, trie: Trie[Result]) -> None:
        self._planner, self._trie = planner, trie
        self.period = planner.period
        self.parameters: Sequence[float] = ()
        self.states: list[Floats] = []
        self.decisions: list[int] = []
        self.refused: list[tuple[int, npt.NDArray[np.bool_]]] = []
        """The number of a plan, and the candidates that it found infeasible, shape (n_candidates,), where there are any."""

    def reset(self, parameters: Sequence[float]) -> None:
        """See `ports.Planner`."""
        self._planner.reset(parameters)
        self.parameters, self.states, self.decisions, self.refused = parameters, [], [], []

    def plan(self, observation: Observation) -> Floats:
        """See `ports.Planner`."""
        planner = self._planner
        trajectory = planner.plan(observation)
        if np.count_nonzero(planner.infeasible):
            self.refused.append((len(self.decisions), planner.infeasible.copy()))
        self.states.append(planner.state.copy())
        self.decisions.append(planner.chosen)
        return trajectory

    def finish(self, result: Result, run: int) -> None:
        """The run is over; `run` is the number by which it is known. Raises as `Trie.learn`."""
        self._trie.learn(self, result, run)
