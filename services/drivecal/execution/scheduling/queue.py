"""The queue: claims to simulations that wait for a worker, in lines of one campaign. Pure.

A higher priority goes first. Among campaigns of equal priority it is the turn of the one that has had the least worker time
(start-time fair queueing, Goyal, Vin and Cheng 1996): one that comes, or comes back after it had nothing waiting, starts level with
the least of those that wait, so that it neither makes up for the time in which it asked for nothing nor waits until others have
caught up with it. Within a line, claims wait in groups of one setup, because a worker has to load each.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import Counter, deque
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from drivecal.execution.scheduling.in_flight import Claim, PendingSimulation, SetupKey

Avoid = frozenset[str]
"""The workers that must not have a suspect."""


@dataclass(slots=True, eq=False)
class ClaimGroup:
    """Claims of one line to simulations of one setup: suspects that keep away from the same workers, or such as never broke down."""

    line: Line
    setup: SetupKey
    avoid: Avoid | None
    """None: no suspects."""
    entries: deque[Claim] = field(default_factory=deque)
    """Skips entries that wait elsewhere by now, or no longer wait: that is cheaper than a search."""
    waiting: int = 0


@dataclass(slots=True, eq=False)
class Line:
    """Of one campaign at one priority. `used`: seconds of the workers' time that it has had, finished or, as expected, running."""

    priority: int
    tag: str
    number: int
    used: float = 0.0
    groups: dict[SetupKey, ClaimGroup] = field(default_factory=dict)
    suspects: dict[tuple[SetupKey, Avoid], ClaimGroup] = field(default_factory=dict)

    @property
    def turn(self) -> tuple[float, int]:
        """Lines of equal priority are served in this order."""
        return self.used, self.number


class FairQueue:
    """No call takes time in proportion to the cells that wait, but for those that it is about."""

    def __init__(self) -> None:
        self._lines: dict[int, dict[str, Line]] = {}
        self._made = 0
        self._turns: dict[int, list[tuple[float, int, Line]]] = {}
        """The lines with waiting cells by priority, in their order."""
        self._groups: dict[Claim, ClaimGroup] = {}
        """The line of each waiting claim."""
        self._simulations: dict[int, Counter[SetupKey]] = {}
        """How many wait, by setup, each at the highest priority at which it is claimed."""
        self._counted: dict[PendingSimulation, int] = {}
        self._avoided: dict[str, dict[ClaimGroup, None]] = {}
        """By worker, the groups of suspects that it must not have."""

    def put(self, simulation: PendingSimulation) -> None:
        """A simulation begins to wait, at the end of its lines."""
        for claim in simulation.claims:
            self.join(claim)

    def put_back(self, taken: Sequence[Claim]) -> None:
        """Simulations that were taken from the queue go back to the front, in this order, and their line to its turn."""
        for leader in reversed(taken):
            for claim in leader.simulation.claims:
                self._enter(claim, front=True, level=claim is not leader)

    def join(self, claim: Claim) -> None:
        """A claim begins to wait, at the end of its line, if it does not wait already."""
        if claim not in self._groups:
            self._enter(claim, front=False, level=True)

    def leave(self, claim: Claim) -> None:
        """A claim ceases to wait, if it does."""
        group = self._groups.pop(claim, None)
        if group is None:
            return
        group.waiting -= 1
        self._count(claim.simulation)
        if not group.waiting:
            self._remove(group)

    def withdraw(self, simulation: PendingSimulation) -> None:
        """A simulation ceases to wait for all who claim it."""
        for claim in simulation.claims:
            self.leave(claim)

    def take(self, group: ClaimGroup, most: int) -> list[Claim]:
        """The first claims of a group; their simulations wait no longer, in no line."""
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
        """Worker time that a line has had, or, negative, has not had after all."""
        waits = self._waits(line)
        if waits:
            self._out_of_turn(line)
        line.used += seconds
        if waits:
            self._into_turn(line)

    def forget(self, tag: str) -> None:
        """A campaign is over, or starts anew. None of its claims waits."""
        for lines in self._lines.values():
            lines.pop(tag, None)

    def simulations(self, priority: int) -> Mapping[SetupKey, int]:
        """How many wait at a priority, by setup."""
        return self._simulations.get(priority, {})

    def setups(self) -> Collection[SetupKey]:
        """Returns the setups with waiting cells."""
        return {setup for counted in self._simulations.values() for setup in counted}

    def avoiding(self, worker: str) -> Iterable[ClaimGroup]:
        """The suspects that a worker must not have."""
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
        self._count(simulation)

    def _level(self, priority: int) -> float:
        """Where a line starts: with the least of those that wait; where none does, with the most of those that may come back."""
        turns = self._turns.get(priority)
        return turns[0][0] if turns else max(line.used for line in self._lines[priority].values())

    def _line(self, priority: int, tag: str) -> Line:
        lines = self._lines.setdefault(priority, {})
        if tag not in lines:
            self._made += 1
            lines[tag] = Line(priority, tag, self._made)
        return lines[tag]

    def _group(self, line: Line, simulation: PendingSimulation) -> ClaimGroup:
        if simulation.breakdowns:
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

    def _count(self, simulation: PendingSimulation) -> None:
        """Keeps how many simulations wait, after a claim to one began or ceased to."""
        priority = max((claim.priority for claim in simulation.claims if claim in self._groups), default=None)
        before = self._counted.get(simulation)
        if priority == before:
            return
        if before is not None:
            counter = self._simulations[before]
            counter[simulation.key] -= 1
            if not counter[simulation.key]:
                del counter[simulation.key]
            if not counter:
                del self._simulations[before]
            del self._counted[simulation]
        if priority is not None:
            self._simulations.setdefault(priority, Counter())[simulation.key] += 1
            self._counted[simulation] = priority

    def _waits(self, line: Line) -> bool:
        return bool(line.groups or line.suspects)

    def _into_turn(self, line: Line) -> None:
        insort(self._turns.setdefault(line.priority, []), (*line.turn, line))

    def _out_of_turn(self, line: Line) -> None:
        turns = self._turns[line.priority]
        del turns[bisect_left(turns, line.turn)]
        if not turns:
            del self._turns[line.priority]
