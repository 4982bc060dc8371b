"""The cells without an answer and their simulations, which identical cells of parallel campaigns share.

Each cell holds a claim to its simulation. The first claim to reach the head of a queue leads: the simulation is sent under its cell's id
and answers all claims. Claims can therefore come and go without rearrangement.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from drivecal.contracts.work import Batch, Cell, CellResult, SetupKey, SetupRequest

Identity = tuple[SetupKey, tuple[str, ...], bytes]
"""Key shared by cells whose results are the same, bit by bit."""

_TEXT = struct.pack("d", float("nan"))
LOSSES_TOGETHER = 2
"""Workers that may leave with a batch before its cells are sent alone."""
WITNESSES = 2
"""Workers that must report an exception before it counts: a worker or an earlier cell of the batch may be to blame."""


@dataclass(slots=True)
class RunBudget:
    """Runs that a campaign may start beyond the one run that each of its open cells has: its stage and the scheduler share it."""

    left: float = math.inf
    kept: float = 0.0
    """The part of `left` that its search needs for further cells."""
    taken: dict[int, int] = field(default_factory=dict)
    """Further runs of each cell without an answer, by id."""

    def take(self, cell: int, *, beyond: float = 0.0) -> bool:
        """Takes a further run for a cell without an answer if more than `beyond` are left; returns whether there was one."""
        if cell not in self.taken or self.left < beyond + 1:
            return False
        self.left, self.taken[cell] = self.left - 1, self.taken[cell] + 1
        return True

    def give_back(self, cell: int) -> None:
        """Gives all runs of a cell back: it has an answer, and its starts are counted."""
        self.left += 1 + self.taken.pop(cell, 0)


@dataclass(frozen=True, slots=True)
class Work:
    """Cells of one setup to simulate; a cell's id is its evaluation's id.

    `exclusive` simulates each cell separately, even if an identical cell is under way. `breakdowns` counts earlier breakdowns by cell id.
    """

    setup: SetupRequest
    cells: Sequence[Cell]
    exclusive: bool = False
    breakdowns: Mapping[int, int] = field(default_factory=dict)


@dataclass(slots=True, eq=False)
class PendingSimulation:
    """A simulation to send until it has a result, and its claims."""

    setup: SetupRequest
    key: SetupKey
    identity: Identity | None
    """None if the simulation is not shared."""
    claims: list[Claim] = field(default_factory=list)
    leader: Claim | None = None
    """The claim whose cell is at a worker; None while the simulation waits."""
    breakdowns: int = 0
    losses: int = 0
    """Workers that left while they ran it, killed from outside or with their node: no breakdowns."""
    witnesses: frozenset[str] = frozenset()
    """Living workers that reported a breakdown."""
    fault: str | None = None
    """The last breakdown in words, which the answer of a later attempt has as its `detail`."""

    @property
    def is_suspect(self) -> bool:
        """True if it may be to blame for the end of workers: it is sent alone."""
        return self.breakdowns > 0 or self.losses >= LOSSES_TOGETHER

    @property
    def avoid(self) -> frozenset[str]:
        """Workers whose report alone does not count."""
        return self.witnesses if len(self.witnesses) < WITNESSES else frozenset()


@dataclass(slots=True, eq=False)
class Claim:
    """Claim of a cell of campaign `tag` to the result of a simulation."""

    cell: Cell
    tag: str
    priority: int
    simulation: PendingSimulation
    withdrawn: bool = False
    """The campaign dropped the cell while its claim leads."""


class InFlightCells:
    """All claims until their cells are answered or given up."""

    def __init__(self) -> None:
        self._claims: dict[int, Claim] = {}
        self._by_tag: dict[str, dict[int, Claim]] = {}
        self._shared: dict[Identity, PendingSimulation] = {}
        self._setups: dict[SetupKey, tuple[SetupRequest, int]] = {}

    def add(self, work: Work, tag: str, priority: int) -> list[Claim]:
        """Returns the claims of new cells. A cell joins the simulation of an identical cell unless either is `exclusive`.

        Raises ValueError if a cell is in flight already; nothing is added then.
        """
        ids = [cell.id for cell in work.cells]
        twice = [identifier for identifier in ids if identifier in self._claims]
        if twice or len(set(ids)) < len(ids):
            raise ValueError(f"cells are in flight already or listed twice, e.g. {twice[:3] or ids[:3]}")
        if not work.cells:
            return []
        setup, key = work.setup, work.setup.key
        claims = [self._claim(setup, key, cell, tag, priority, exclusive=work.exclusive) for cell in work.cells]
        new = {claim.cell.id: claim for claim in claims}
        self._claims |= new
        self._by_tag.setdefault(tag, {}).update(new)
        self._setups[key] = (setup, self._setups.get(key, (setup, 0))[1] + len(claims))
        return claims

    def remove(self, claim: Claim) -> None:
        """Removes the claim of an answered or dropped cell, and its simulation if it was the last claim."""
        simulation = claim.simulation
        simulation.claims.remove(claim)
        if not simulation.claims and simulation.identity is not None:
            del self._shared[simulation.identity]
        del self._claims[claim.cell.id]
        its = self._by_tag[claim.tag]
        del its[claim.cell.id]
        if not its:
            del self._by_tag[claim.tag]
        setup, count = self._setups[simulation.key]
        if count > 1:
            self._setups[simulation.key] = (setup, count - 1)
        else:
            del self._setups[simulation.key]

    def of(self, tag: str) -> Collection[Claim]:
        """The claims of a campaign."""
        return self._by_tag.get(tag, {}).values()

    def wanted(self) -> set[SetupKey]:
        """Returns the setups with unanswered cells that no campaign dropped."""
        return {claim.simulation.key for claim in self._claims.values() if not claim.withdrawn}

    def setup(self, key: SetupKey) -> SetupRequest:
        """Returns a setup with unanswered cells."""
        return self._setups[key][0]

    def setups(self) -> Mapping[SetupKey, SetupRequest]:
        """Returns the setups with unanswered cells."""
        return {key: setup for key, (setup, _) in self._setups.items()}

    def _claim(self, setup: SetupRequest, key: SetupKey, cell: Cell, tag: str, priority: int, *, exclusive: bool) -> Claim:
        identity = None if exclusive else _identity(key, cell)
        simulation = None if identity is None else self._shared.get(identity)
        if simulation is None:
            simulation = PendingSimulation(setup, key, identity)
            if identity is not None:
                self._shared[identity] = simulation
        claim = Claim(cell, tag, priority, simulation)
        simulation.claims.append(claim)
        return claim


def _identity(key: SetupKey, cell: Cell) -> Identity:
    names = tuple(sorted(cell.parameters))
    return key, names, b"".join(_packed(cell.parameters[name]) for name in names)


def _packed(value: float | str) -> bytes:
    """Returns a value so that different ones differ: a text begins with bytes that no finite number has."""
    return _TEXT + value.encode() + b"\0" if isinstance(value, str) else struct.pack("d", value)


@dataclass(frozen=True, slots=True)
class Completed:
    """The final answer of a cell; `attempts` counts its breakdowns and the attempt with the result."""

    tag: str
    worker: str
    result: CellResult
    attempts: int
    shared: bool = False
    """True if an identical cell was simulated instead."""
    lease: int | None = None
    """The number of the lease of a cell that was simulated itself; the pool fills it in."""
    unstarted: int = 0
    """Starts of the simulator that the lease counts and that did not happen; the pool fills it in."""


@dataclass(frozen=True, slots=True)
class Dispatch:
    """A batch to send now; see `Backend.submit`."""

    worker: str
    batch_id: int
    batch: Batch
    expected_seconds: float | None
    alone: bool
    breakdowns: Mapping[int, int]
    """Breakdowns so far of the batch's cells, by id."""
