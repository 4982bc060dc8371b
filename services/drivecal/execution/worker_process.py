"""A worker as the coordinator sees it: what it does, until when, and how often it went wrong. Pure but for the clock."""

import time
from collections import deque
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any

from drivecal.cluster.members import Node
from drivecal.domain.evaluations import Breakdown
from drivecal.execution.backend import LONGEST_QUEUED, Lost

CALLS_PER_WORKER = 2
LONGEST_PAUSE = 30.0
"""Longest pause between attempts to start a worker, s."""
RECENT_BATCHES = 20
"""Batches that the speed is taken from: some seconds of work."""


@dataclass(slots=True)
class Call:
    """A batch at a worker."""

    batch_id: int
    cells: int
    scenario: str
    reference: Any
    seconds: float
    """Time limit."""
    expected: float = 0.0
    """Expected seconds; 0 if unknown, infinity for simulators of users."""


@dataclass(slots=True)
class WorkerProcess:
    """State of one worker: its node, process, calls and record."""

    index: int
    home: Node | None = None
    """Its node of a cluster; None on this machine alone."""
    incarnation: int = 0
    handle: Any = None
    """The backend's own hold on the process; None while there is none."""
    warming: Any = None
    """Reference to the call of `warm`; None once it has answered."""
    calls: deque[Call] = field(default_factory=deque)
    alone: bool = False
    deadline: float = 0.0
    """Deadline of the first call, or of the start."""
    died_at: float | None = None
    """Time of its noticed death, until it is known whether the whole backend has died."""
    start_again_at: float = 0.0
    failed_starts: int = 0
    faults: int = 0
    """Replacements since the last result."""
    reason: str = ""
    """The last fault; empty once it has started, or given a result after a fault."""
    node: str = ""
    pid: int | None = None
    cells: int = 0
    recent: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=RECENT_BATCHES))
    """Results and seconds of the last batches."""
    bundles: set[str] = field(default_factory=set)
    """Digests of bundles whose files were sent to it."""

    @property
    def name(self) -> str:
        """Its name, with a number after its first process."""
        return f"worker-{self.index}" if self.incarnation <= 1 else f"worker-{self.index}.{self.incarnation}"

    def pause(self, times: int) -> None:
        """Starts again later the more often it went wrong: at once after no time, then after 1, 2, 4 ... seconds."""
        self.start_again_at = time.monotonic() + (min(LONGEST_PAUSE, 2.0 ** min(times - 1, 10)) if times else 0.0)

    @property
    def place(self) -> str:
        """Its name, and where it runs, for messages."""
        return self.name if self.pid is None else f"{self.name} (process {self.pid} on {self.node})"

    @property
    def ready(self) -> bool:
        """True if it has started."""
        return self.handle is not None and self.warming is None

    @property
    def state(self) -> str:
        """State that users see."""
        return "starting" if not self.ready else "busy" if self.calls else "idle"

    @property
    def scenario(self) -> str | None:
        """Scenario of the running call; None without one."""
        return self.calls[0].scenario if self.calls else None

    @property
    def since(self) -> datetime | None:
        """Start of the running call; None without one."""
        return datetime.now(UTC) - timedelta(seconds=self.busy_seconds()) if self.calls else None

    @property
    def cells_per_second(self) -> float | None:
        """Speed in the last batches; None before the first."""
        seconds = sum(spent for _, spent in self.recent)
        return sum(count for count, _ in self.recent) / seconds if seconds else None

    @property
    def waited_for(self) -> Any:
        """Reference to what it does; None if it does nothing."""
        if self.warming is not None:
            return self.warming
        return self.calls[0].reference if self.calls else None

    def room(self, *, alone: bool) -> bool:
        """Returns whether it can take another call; an `alone` call has no neighbours."""
        if not self.ready:
            return False
        if not self.calls:
            return True
        quick = all(call.expected <= LONGEST_QUEUED for call in self.calls)
        return quick and not alone and not self.alone and len(self.calls) < CALLS_PER_WORKER

    def take(self, call: Call, *, alone: bool) -> None:
        """Adds a call."""
        self.calls.append(call)
        self.alone = alone
        if len(self.calls) == 1:
            self.deadline = time.monotonic() + call.seconds

    def started(self, node: str, pid: int) -> None:
        """Marks the worker as ready."""
        self.warming, self.node, self.pid = None, node, pid
        self.failed_starts = 0
        if not self.faults:
            self.reason = ""

    def next_call(self) -> Call:
        """Takes the running call away; the one behind it is running now."""
        call = self.calls.popleft()
        if self.calls:
            self.deadline = time.monotonic() + self.calls[0].seconds
        return call

    def busy_seconds(self) -> float:
        """Time (s) since the running call began; 0 without one."""
        return max(0.0, time.monotonic() - self.deadline + self.calls[0].seconds) if self.calls else 0.0

    def lose(self, breakdown: Breakdown, detail: str, *, departed: bool = False) -> list[Lost]:
        """All its calls are gone; only the running one has taken time."""
        seconds = self.busy_seconds()
        calls, self.calls = self.calls, deque()
        return [
            Lost(call.batch_id, self.name, breakdown, detail, 0.0 if behind else seconds, not behind, departed)
            for behind, call in enumerate(calls)
        ]
