"""The trie of one setup: proves that a run would go as a stored one did, or says that it cannot.

Why it is a proof: simulator, vehicle and planner are deterministic, and parameters enter a run through the planner's choice of a
candidate only. Two runs that begin alike are in the same state until they choose differently. So the trie's nodes are states: a
parameter set that chooses, by the planner's own arithmetic on the stored features, what was chosen before at every node down to a leaf,
drives that leaf's run, bit for bit. A candidate that would win but was never tested for feasibility proves nothing: that run has to be
simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np

from drivecal.certification.memory import Memory
from drivecal.certification.nodes import NONE, Floats, Nodes, visit
from drivecal.domain.errors import DrivecalError
from drivecal.plugins.ports import CertifiablePlanner, Observation

Result = TypeVar("Result")
BYTES_PER_RESULT = 4000
"""Roughly, of what is kept of a run: its metrics by name, mostly."""


class NotDeterministicError(DrivecalError):
    """The same decisions led to another state: something besides them decides runs, and nothing may be certified."""


@dataclass(frozen=True, slots=True)
class Proof(Generic[Result]):
    """A parameter set would drive as the run `proven_by` did, whose result is `result`."""

    result: Result
    proven_by: int


class Trie(Generic[Result]):
    """Of one scenario in one setup, in one process. A cache: what it forgets is simulated again."""

    def __init__(self, planner: CertifiablePlanner, memory: Memory) -> None:
        """`memory`: shared with the other tries of the process."""
        self._planner = planner
        self._nodes = Nodes(planner.n_values, planner.n_candidates, planner.grid)
        self._results: list[Proof[Result]] = []
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

    def prove(self, parameters: Sequence[float]) -> Proof[Result] | None:
        """The stored run that these parameters would repeat; None where that is not proved."""
        node = self._planner.walk(self._nodes, parameters)
        self._visit(node)
        leaf = int(self._nodes.leaf[node])
        return None if leaf == NONE else self._results[leaf]

    def record(self) -> Recording[Result]:
        """Takes part in a run, as its planner, and learns from it."""
        self._memory.settle()
        return Recording(self._planner, self._nodes, self)

    def learn(self, end: int, result: Result, run: int) -> None:
        """A run, known as number `run`, ended in node `end`."""
        if self._nodes.leaf[end] == NONE:
            self._nodes.leaf[end] = len(self._results)
            self._results.append(Proof(result, run))
        self._visit(end)
        self._memory.settle()

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


class Recording(Generic[Result]):
    """A planner that plans as its own does and writes the states and decisions of the run into the trie."""

    def __init__(self, planner: CertifiablePlanner, nodes: Nodes, trie: Trie[Result]) -> None:
        self._planner, self._nodes, self._trie = planner, nodes, trie
        self._node = 0
        self.period = planner.period

    def reset(self, parameters: Sequence[float]) -> None:
        """See `ports.Planner`."""
        self._planner.reset(parameters)
        self._node = 0

    def plan(self, observation: Observation) -> Floats:
        """See `ports.Planner`. Raises NotDeterministicError where the state is not what the same decisions led to before."""
        trajectory = self._planner.plan(observation)
        nodes, node, planner = self._nodes, self._node, self._planner
        infeasible, digest = planner.infeasible, planner.state_digest
        described = bool(nodes.row_count[node])
        if described and nodes.digest[node] != digest:
            raise NotDeterministicError(
                f"the same decisions led to another state at {observation.time} s: certified reuse is not possible with this setup"
            )
        if not described:
            nodes.describe(node, *planner.contenders(infeasible), infeasible, digest)
        elif infeasible.any():  # who cannot be driven keeps nobody else out
            known = nodes.infeasible(node)
            if (infeasible & ~known).any():
                known |= infeasible
                nodes.describe(node, *planner.contenders(known), known, digest)
        child = nodes.child(node, planner.chosen)
        self._node = child if child != NONE else nodes.add(node, planner.chosen)
        return trajectory

    def finish(self, result: Result, run: int) -> None:
        """The run is over; `run` is the number by which it is known."""
        self._trie.learn(self._node, result, run)
