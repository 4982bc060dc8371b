"""The queue of claims to simulations that wait for a worker, one line per campaign. Pure.

Higher priorities go first. Among equal priorities the campaign with the least worker time is next (start-time fair queueing, Goyal, Vin
and Cheng 1996). A campaign that joins, or returns after it had nothing waiting, starts level with the least waiting campaign: it neither
catches up nor waits for others. Within a line, claims wait in groups of one setup, because a worker has to load each setup.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from drivecal.contracts.work import SetupKey
from drivecal.execution.scheduling.in_flight import Claim, PendingSimulation

Avoid = frozenset[str]
"""Workers that must not get a suspect."""


@dataclass(slots=True, eq=False)
class ClaimGroup:
    """Claims of a line to simulations of one setup: suspects that avoid the same workers, or simulations that never broke down."""

    line: Line
    setup: SetupKey
    avoid: Avoid | None
    """None if the claims are no suspects."""
    entries: deque[Claim] = field(default_factory=deque)
    """May hold stale entries, which are skipped: cheaper than a search."""
    waiting: int = 0


@dataclass(slots=True, eq=False)
class Line:
    """Claims of a campaign at one priority. `used`: its worker time, s, with the expected time of running batches."""

    priority: int
    tag: str
    number: int
    used: float = 0.0
    groups: dict[SetupKey, ClaimGroup] = field(default_factory=dict)
    suspects: dict[tuple[SetupKey, Avoid], ClaimGroup] = field(default_factory=dict)

    @property
    def turn(self) -> tuple[float, int]:
        """Sort key among lines of equal priority."""
        return self.used, self.number

    @property
    def setups(self) -> tuple[SetupKey, ...]:
        """The setups of its claims."""
        return (*self.groups, *(setup for setup, _ in self.suspects))


class FairQueue:
    """Waiting claims by line. The cost of a call does not depend on the number of other waiting cells."""

    def __init__(self) -> None:
        self._lines: dict[int, dict[str, Line]] = {}
        self._made = 0
        self._turns: dict[int, list[tuple[float, int, Line]]] = {}
        """Lines with waiting cells by priority, in order."""
        self._groups: dict[Claim, ClaimGroup] = {}
        self._avoided: dict[str, dict[ClaimGroup, None]] = {}
        """Groups of suspects that a worker must not get."""

    def put(self, simulation: PendingSimulation) -> None:
        """Adds a simulation at the end of its lines."""
        for claim in simulation.claims:
            self.join(claim)

    def put_back(self, taken: Sequence[Claim]) -> None:
        """Returns taken simulations to the front, in this order, and their line to its turn."""
        for leader in reversed(taken):
            for claim in leader.simulation.claims:
                self._enter(claim, front=True, level=claim is not leader)

    def join(self, claim: Claim) -> None:
        """Adds a claim at the end of its line unless it waits already."""
        if claim not in self._groups:
            self._enter(claim, front=False, level=True)

    def leave(self, claim: Claim) -> None:
        """Removes a claim if it waits."""
        group = self._groups.pop(claim, None)
        if group is None:
            return
        group.waiting -= 1
        if not group.waiting:
            self._remove(group)

    def withdraw(self, simulation: PendingSimulation) -> None:
        """Removes all claims to a simulation."""
        for claim in simulation.claims:
            self.leave(claim)

    def take(self, group: ClaimGroup, most: int) -> list[Claim]:
        """Takes the first claims of a group; their simulations leave all lines."""
        taken: list[Claim] = []
        while group.waiting and len(taken) < most:
            claim = group.entries.popleft()
            if self._groups.get(claim) is group:
                taken.append(claim)
                self.withdraw(claim.simulation)
        return taken

    def in_turn(self) -> Iterator[Line]:
        """Yields the lines with waiting cells, the next in turn first. The queue must not change meanwhile."""
        for priority in sorted(self._turns, reverse=True):
            for _, _, line in self._turns[priority]:
                yield line

    def charge(self, line: Line, seconds: float) -> None:
        """Adds worker time to a line; negative corrects an earlier charge."""
        waits = self._waits(line)
        if waits:
            self._out_of_turn(line)
        line.used += seconds
        if waits:
            self._into_turn(line)

    def forget(self, tag: str) -> None:
        """Forgets a campaign without waiting claims."""
        for lines in self._lines.values():
            lines.pop(tag, None)

    def waiting(self, priority: int) -> Counter[SetupKey]:
        """Returns the number of waiting claims at a priority, by setup."""
        counted = Counter[SetupKey]()
        for line in self._lines.get(priority, {}).values():
            for group in (*line.groups.values(), *line.suspects.values()):
                counted[group.setup] += group.waiting
        return counted

    def setups(self, tag: str | None = None) -> set[SetupKey]:
        """Returns the setups of the waiting cells of a campaign, or of all."""
        lines = (line for lines in self._lines.values() for line in lines.values() if tag in {None, line.tag})
        return {setup for line in lines for setup in line.setups}

    def avoiding(self, worker: str) -> Iterable[ClaimGroup]:
        """Returns the suspects that a worker must not get."""
        return self._avoided.get(worker, ())

    def _enter(self, claim: Claim, *, front: bool, level: bool) -> None:
        simulation = claim.simulation
        line = self._line(claim.priority, claim.tag)
        if not self._waits(line):
            if level:
                line.used = max(line.used, self._level(line.priority))
            self._into_turn(line)
        group = self._group(line, simulation)
        self._groups[claim] = group
        group.waiting += 1
        if front:
            group.entries.appendleft(claim)
        else:
            group.entries.append(claim)

    def _level(self, priority: int) -> float:
        """The start of a line: the least of the waiting lines; without any, the most of the lines that may return."""
        turns = self._turns.get(priority)
        return turns[0][0] if turns else max(line.used for line in self._lines[priority].values())

    def _line(self, priority: int, tag: str) -> Line:
        lines = self._lines.setdefault(priority, {})
        if tag not in lines:
            self._made += 1
            lines[tag] = Line(priority, tag, self._made)
        return lines[tag]

    def _group(self, line: Line, simulation: PendingSimulation) -> ClaimGroup:
        if simulation.is_suspect:
            place = (simulation.key, simulation.avoid)
            if place not in line.suspects:
                line.suspects[place] = ClaimGroup(line, *place)
                for worker in simulation.avoid:
                    self._avoided.setdefault(worker, {})[line.suspects[place]] = None
            return line.suspects[place]
        if simulation.key not in line.groups:
            line.groups[simulation.key] = ClaimGroup(line, simulation.key, None)
        return line.groups[simulation.key]

    def _remove(self, group: ClaimGroup) -> None:
        line = group.line
        if len(line.groups) + len(line.suspects) == 1:
            self._out_of_turn(line)
        if group.avoid is None:
            del line.groups[group.setup]
            return
        del line.suspects[group.setup, group.avoid]
        for worker in group.avoid:
            del self._avoided[worker][group]
            if not self._avoided[worker]:
                del self._avoided[worker]

    def _waits(self, line: Line) -> bool:
        return bool(line.groups or line.suspects)

    def _into_turn(self, line: Line) -> None:
        insort(self._turns.setdefault(line.priority, []), (*line.turn, line))

    def _out_of_turn(self, line: Line) -> None:
        turns = self._turns[line.priority]
        del turns[bisect_left(turns, line.turn)]
        if not turns:
            del self._turns[line.priority]
