"""The simulator port: opens a session for a scenario, evaluates parameter sets, closes. A simulation gives measures, not scores."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, Self

from drivecal.contracts.evaluation import ReplayAnswer
from drivecal.contracts.work import SetupRequest
from drivecal.domain.errors import DrivecalError, UnavailableError
from drivecal.domain.evaluations import Breakdown, Rating
from drivecal.domain.values import Argument
from drivecal.plugins.ports import Named

VERSIONS: Mapping[str, str] = MappingProxyType({"process": "2", "command": "2", "python": "2", "fmu": "1", "highway": "14"})
"""Version of each kind's adapter; that of `highway` is the closed loop's, for planners too. Increase it whenever a run may change by
a bit; `tests/golden` detects such changes. Here, because the coordinator needs it, too."""


def sumo() -> str:
    """Returns SUMO's library and its version as installed now, without importing it."""
    try:
        return f"libsumo {version('libsumo')}"
    except PackageNotFoundError:
        return "libsumo not installed"


loaded_sumo = cache(sumo)
"""Returns the same as at its first call: a process keeps the library that it has loaded."""


START_SECONDS = 60.0
"""Shortest time limit of a simulator's start, which may load libraries and licences. Here, because the coordinator waits for it, too."""
PROBE_SECONDS = 45.0
"""Time limit of a probe, and of each command of `inputs`: below the limit of a batch and above the start of slow tools."""


SEED = 1
"""Seed of simulators without randomness, and first seed of random ones."""
MOST_SESSIONS = 8
"""Open sessions of a worker, least recently used first to go: each may hold a process of the user's."""
END_SECONDS = 3.0
"""Time (s) within which a simulator has ended: all its processes are asked to, and what still runs is killed."""


def start_limit(timeout: float) -> float:
    """Returns the time limit of a start (s) of a simulator with this limit of a run."""
    return max(timeout, START_SECONDS)


def probe_limit(section: Mapping[str, Any]) -> float:
    """Returns the time limit (s) of all that a worker is asked about its tools for a manifest's section `simulator`: the probe, the digest
    of variables and files, and each command of `inputs`."""
    commands = [each for each in section.get("inputs") or () if not isinstance(each, str)]
    return PROBE_SECONDS * ((section.get("probe") is not None) + 1 + len(commands))


@dataclass(frozen=True, slots=True)
class RunOutcome:
    """Result of one simulation: `measures` by name, the name of a `failure` of the system under test, and time series by name.

    `cpu_seconds` is the CPU time of child processes during the run, not part of the result. `start_seconds` is the time for another start
    of the simulator before the run, and belongs to no run. `queued_seconds` is the time that the run waited for a core. `replay` shows the
    drive from above; `highway` alone reports it, with the series. `rating` is that of `Declared.evaluator`, None for a failed run.
    """

    measures: Mapping[str, float]
    failure: str | None = None
    series: Mapping[str, Sequence[float]] = field(default_factory=dict)
    cpu_seconds: float = field(default=0.0, compare=False)
    start_seconds: float = field(default=0.0, compare=False)
    queued_seconds: float = field(default=0.0, compare=False)
    replay: ReplayAnswer | None = field(default=None, compare=False)
    rating: Rating | None = None


@dataclass(frozen=True, slots=True)
class Declared:
    """Names that a manifest declares of a simulator's answers. Without declared `failures`, a simulator may report any name.

    `watched`: drivecal records the files that a Python function opens. `varied`: values of side conditions, which all runs of a session
    have in common. `evaluator`: name of an installed evaluator that rates the time series of runs in this process.
    """

    problem: str
    measures: tuple[str, ...]
    failures: tuple[str, ...] = ()
    series: tuple[str, ...] = ()
    watched: bool = field(default=False, compare=False)
    varied: Mapping[str, float] = field(default_factory=dict)
    evaluator: str | None = None

    @classmethod
    def of(cls, setup: SetupRequest, *, watched: bool = False) -> Self:
        """Returns what the simulator of a setup is told, on a worker and by the check of a problem."""
        return cls(
            *(setup.problem, setup.measures, setup.failures, setup.series, watched, setup.varied),
            evaluator=setup.evaluator and setup.evaluator.split()[0],
        )


class NoMeasuresError(DrivecalError):
    """A run has no result: its process crashed, hung, ran out of memory or answered something else. Costs this cell only.

    `cpu_seconds`: CPU time that its child processes took all the same. `is_contained`: it happened in a child process.
    """

    def __init__(self, breakdown: Breakdown, detail: str, cpu_seconds: float = 0.0, *, is_contained: bool = True) -> None:
        super().__init__(breakdown, detail, cpu_seconds)
        self.breakdown, self.detail, self.cpu_seconds, self.is_contained = breakdown, detail, cpu_seconds, is_contained

    def __str__(self) -> str:
        return self.detail


class BusyError(UnavailableError):
    """A simulator takes no run for now, because a licence or a device is in use: the run is to be tried again later."""


class UnsuitableError(UnavailableError):
    """A scenario that no machine can run, because of the problem's files. Another attempt or machine does not help."""


class SimulatorSession(Protocol):
    """A simulator that is ready for runs of one scenario. After a NoMeasuresError it restarts itself and the next run is unaffected."""

    def evaluate(self, parameters: Mapping[str, Argument], *, series: bool = False, seed: int = SEED) -> RunOutcome:
        """Runs one parameter set under a seed. `series`: report time series, too.

        Raises NoMeasuresError without a result, and UnavailableError if the simulator had to start again and could not.
        """

    def close(self) -> None:
        """Ends all child processes and removes scratch files. Idempotent."""


class Simulator(Protocol):
    """A kind of simulator, e.g. `process`."""

    @property
    def version(self) -> str:
        """Changes whenever equal inputs may give other results because of the adapter; part of the key of stored results."""

    def open(
        self, section: Mapping[str, Any], scenario: str, data: Mapping[str, Any], folder: Path, declared: Declared
    ) -> SimulatorSession:
        """Opens a session. `section`: the manifest's `simulator`; `data`: the scenario's; `folder`: the unpacked, read-only bundle.

        Raises UnavailableError if this machine cannot run it, e.g. a command that does not exist, or if the simulator says so itself,
        and UnsuitableError if no machine can.
        A start that fails in another way costs the first cell: `evaluate` reports it.
        """


class InstalledSimulator(Named, Simulator, Protocol):
    """A simulator behind the entry point group `drivecal.simulators`, which runs in the worker's own process."""
