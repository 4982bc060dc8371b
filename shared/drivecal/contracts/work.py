"""Messages between dispatcher and workers: plain, picklable data."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

SetupKey = tuple[str, ...]
"""Key shared by requests that run and rate the same."""
Kind = tuple[str, ...]
"""Key shared by requests whose cells cost about the same."""


@dataclass(frozen=True, slots=True)
class DriveRequest:
    """A setup of the built-in closed loop; the worker rebuilds it from its own installation and compares the fingerprints."""

    catalogue: str
    scenario: str
    driving_function: str
    vehicle: str
    vehicle_parameters: Mapping[str, float]
    """Every parameter of the vehicle model."""
    evaluator: str
    run_fingerprint: str
    document: Mapping[str, object] = field(default_factory=dict)
    """The fingerprinted document (`Setup.document`), so that a worker can name differences."""
    evaluator_version: str | None = None
    """The coordinator's: ratings of another one must not be stored under its name. None if it does not matter."""

    @property
    def key(self) -> SetupKey:
        """Key shared by requests that run and rate the same."""
        return (self.run_fingerprint, self.catalogue, self.scenario, self.evaluator)

    @property
    def kind(self) -> Kind:
        """Key without the vehicle's parameters: a robustness study drives few cells in each of hundreds of vehicles."""
        versions = (str(self.document.get(name)) for name in ("driving_function_version", "vehicle_version", "simulator"))
        return (self.catalogue, self.scenario, self.driving_function, self.vehicle, self.evaluator, *versions)

    @property
    def bundle(self) -> None:
        """Needs no files of users."""
        return

    @property
    def timeout(self) -> None:
        """Has no time limit of its own."""
        return


@dataclass(frozen=True, slots=True)
class BundleRequest:
    """A setup of a problem bundle. The worker returns measures; the coordinator rates them."""

    bundle: str
    """Digest of the bundle's archive."""
    problem: str
    scenario: str
    data: Mapping[str, Any]
    """The scenario's data."""
    simulator: Mapping[str, Any]
    """The manifest's section."""
    parameters: tuple[str, ...]
    integers: tuple[str, ...]
    """Parameters that are sent as whole numbers: 3, not 3.0."""
    measures: tuple[str, ...]
    failures: tuple[str, ...]
    series: tuple[str, ...]
    """Names: of the measures to report (`Manifest.reported`), of the declared failures and time series."""
    run_fingerprint: str
    document: Mapping[str, object] = field(default_factory=dict)
    tools: str | None = None
    """Answer of the manifest's `probe` to which the results belong: a worker with another one refuses. None without a probe, and in a
    batch without cells, which asks for it."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Units of the parameters by name, if they are known."""

    @property
    def key(self) -> SetupKey:
        """Key shared by requests that run the same; different manifests may declare other measures for equal runs."""
        return (self.run_fingerprint, self.bundle, self.scenario)

    @property
    def kind(self) -> Kind:
        """Every setup is a kind of its own."""
        return self.key

    @property
    def timeout(self) -> float:
        """Time limit of a run, s."""
        return float(self.simulator["timeout"])


SetupRequest = DriveRequest | BundleRequest
"""Names what to run."""


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
    """Cells of one setup, sized so that they take 50 to 500 ms. Without cells, a worker only runs the `probe` of the setup's bundle."""

    setup: SetupRequest
    cells: tuple[Cell, ...]


@dataclass(frozen=True, slots=True)
class CellResult:
    """Result of a cell: a rated run (`breakdown` None), or the reason for a missing one (`breakdown`, in words `detail`)."""

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
    """Whether a `breakdown` happened in a child process of a user's simulator: it says nothing about the worker."""
    repeats: bool | None = None
    """Whether a second run of a bundle's cell gave the same measures, bit by bit; None if there was none."""
    trace: bytes | None = None
    """The time series that were wanted, as gzipped JSON."""
    checking: float = 0.0
    """CPU time (ms), part of `milliseconds`, of a second run."""
    wall_milliseconds: float | None = None
    """Wall-clock time of the run, without a second one; None for simulations that never wait."""

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
    unsuitable: bool = False
    """Whether it is refused because of the problem's files, so that no other worker is able to run the setup either."""
