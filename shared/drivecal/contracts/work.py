"""Messages between dispatcher and workers: plain, picklable data."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drivecal.domain.setups import fingerprint_of

SetupKey = tuple[str, ...]
"""Key shared by requests that run and rate the same."""
Kind = tuple[str, ...]
"""Key shared by requests whose cells cost about the same."""


def runs_in_worker(section: Mapping[str, Any]) -> bool:
    """Returns whether a simulator with this section of a manifest runs in the worker's own process: the code is drivecal's or an installed
    plug-in's, none of a user's files is run."""
    return section.get("kind") == "highway" and section["controller"]["kind"] == "planner"


@dataclass(frozen=True, slots=True)
class SetupRequest:
    """A scenario of a problem, to be run with parameter sets. The worker returns measures. The coordinator rates them, except if the setup
    has an `evaluator`."""

    bundle: str
    """Digest of the problem's files. The worker has an archive of them, or a package there installs them."""
    problem: str
    scenario: str
    data: Mapping[str, Any]
    """The scenario's data."""
    simulator: Mapping[str, Any]
    """The manifest's section, with the plug-ins that the campaign chose."""
    parameters: tuple[str, ...]
    integers: tuple[str, ...]
    """Parameters that are sent as whole numbers: 3, not 3.0."""
    measures: tuple[str, ...]
    failures: tuple[str, ...]
    series: tuple[str, ...]
    """Names: of the measures to report (`Manifest.reported`), of the declared failures and time series."""
    run_fingerprint: str
    document: Mapping[str, Any] = field(default_factory=dict)
    """The fingerprinted document (`Setup.document`), so that a worker can name differences."""
    tools: str | None = None
    """Answer of the manifest's `probe` to which the results belong: a worker with another one refuses. None without a probe, and in a
    batch without cells, which asks for it."""
    varied: Mapping[str, float] = field(default_factory=dict)
    """Values of the problem's varied parameters, which a run gets among its parameters."""
    evaluator: str | None = None
    """Name and version of the evaluator that rates the runs on the worker, because it needs their time series: ratings of another version
    must not be stored as its own. None: the coordinator rates."""
    seed: int = 1
    session: str = ""
    """Run fingerprint without the seed and, in a child process, without `varied`: one session of the simulator serves them all. Empty: the
    run fingerprint."""
    resources: Mapping[str, int] = field(default_factory=dict)
    """Number of each scarce thing, such as licences, that a run holds."""
    shapes: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """Curves and maps by name (`Shape.document`): the simulator gets their values in the place of coefficients."""
    renews: bool = False
    """True if each run has a new process: nothing is held between two runs."""

    @property
    def keeps_resources(self) -> bool:
        """True if a session holds its resources between two runs, until it is closed."""
        return bool(self.resources) and not self.renews and not runs_in_worker(self.simulator)

    @property
    def key(self) -> SetupKey:
        """Key shared by requests that run and rate the same; different manifests may declare other measures for equal runs."""
        return (self.run_fingerprint, self.bundle, self.scenario, self.evaluator or "")

    @property
    def session_key(self) -> SetupKey:
        """Key shared by requests that one session of the simulator serves."""
        return (self.session or self.run_fingerprint, *self.key[1:])

    @property
    def kind(self) -> Kind:
        """Key without seed and varied parameters: a robustness study runs few cells at each of hundreds of their values."""
        if not self.varied:
            return self.session_key
        unseeded = {name: value for name, value in self.document.items() if name != "seed"}
        return (fingerprint_of({**unseeded, "varied": {}}), *self.key[1:])

    @property
    def timeout(self) -> float | None:
        """Time limit of a run in a child process, s."""
        return None if runs_in_worker(self.simulator) else float(self.simulator["timeout"])


@dataclass(frozen=True, slots=True)
class Cell:
    """One parameter set to simulate: `parameters` by name, numbers or texts of choices; `id` is the dispatcher's own.

    `check`: a cell of a bundle is simulated twice. `trace`: it is simulated for its time series.
    """

    id: int
    parameters: Mapping[str, Any]
    check: bool = False
    trace: bool = False


@dataclass(frozen=True, slots=True)
class Batch:
    """Cells of one setup, sized so that they take 40 to 500 ms. Without cells, a worker only runs the `probe` of the setup's bundle, or
    with `closes` ends the setup's session, which frees its resources."""

    setup: SetupRequest
    cells: tuple[Cell, ...]
    closes: bool = False


@dataclass(frozen=True, slots=True)
class CellResult:
    """Result of a cell: a rated run (`breakdown` None), or the reason for a missing one (`breakdown`, in words `detail`). A run that took
    a second attempt has the breakdown of the first in `detail`."""

    id: int
    rating: float | None
    score: float | None
    metrics: Mapping[str, float]
    failure: str | None
    milliseconds: float
    """CPU time of the worker, a second run included."""
    breakdown: str | None = None
    detail: str | None = None
    contained: bool = False
    """True if a `breakdown` happened in a child process of a user's simulator: it says nothing about the worker."""
    repeats: bool | None = None
    """True if a second run of a bundle's cell gave the same measures, bit by bit; None if there was none."""
    trace: bytes | None = None
    """The time series that were wanted, as gzipped JSON."""
    checking: float = 0.0
    """CPU time (ms), part of `milliseconds`, of a second run."""
    wall_milliseconds: float | None = None
    """Wall-clock time of the run, without a second one; None for simulations that never wait."""
    starts: int = 1
    """Starts of the simulator for this result."""

    @property
    def run_milliseconds(self) -> float:
        """CPU time (ms) of the run, without a second one."""
        return max(0.0, self.milliseconds - self.checking)


@dataclass(frozen=True, slots=True)
class BatchResult:
    """The results of a batch, in its order, and the worker that gave them."""

    worker: str
    results: tuple[CellResult, ...]
    seconds: float
    """Wall-clock time on the worker, loading the setup included: what batches are sized by."""
    refusal: str | None = None
    """Reason why this worker cannot run the setup, in words; there are no results then of the cell at which it turned out, and of those
    after it. Another worker may be able to."""
    tools: str | None = None
    """Answer of the `probe` on this worker, if the batch has no cells, or if it is refused because of that answer."""
    busy: str | None = None
    """Reason why the simulator takes no run for now, in words, such as a licence in use; as after a refusal there are no further results.
    The cells are tried again later."""
    unsuitable: bool = False
    """True if it is refused because of the problem's files, so that no other worker is able to run the setup either."""
