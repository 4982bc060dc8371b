"""Answers about the inventory: scenarios, parameter spaces, influence maps, references, workers, health, pushed problems."""

from datetime import datetime
from typing import Any

from pydantic import Field

from drivecal.contracts.campaign import Answer, Page, html_facts, html_table
from drivecal.contracts.setup import ShapeAnswer
from drivecal.contracts.tables import InfluenceRow


class InfluenceMapAnswer(Answer):
    """A stored influence map. `source` is the id of the campaign that made it, or `expert`; `rows` and `basis` are left out of lists."""

    id: str
    name: str
    source: str
    driving_function: str
    created_at: datetime | None = None
    rows: list[InfluenceRow] | None = None
    basis: dict[str, Any] | None = None
    """Basis of an analysis: its settings, fixed values, setups, evaluator and runs, and by scenario `smallest_s_rel`, the smallest
    s_rel that is not 0 of its `intervals` and of its `overall` analysis; null for a map that a user posted."""
    links: dict[str, str] = Field(default_factory=dict)

    def _repr_html_(self) -> str:
        """Returns the map as a notebook shows it."""
        facts = {"influence map": self.name, "id": self.id, "source": self.source, "driving function": self.driving_function}
        return html_facts(facts) + html_table([row.model_dump(mode="json") for row in self.rows or []])


class InfluenceMapPage(Page[InfluenceMapAnswer]):
    """Influence maps, newest first."""


class ScenarioAnswer(Answer):
    """A scenario of an installed catalogue. `duration` and `step` in seconds; `vehicles` counts the others on the road."""

    id: str
    catalogue: str
    title: str
    manoeuvre: str
    duration: float
    step: float
    vehicles: int


class BrokenPluginAnswer(Answer):
    """An installed plug-in that cannot be used, with the reason; `package` registers it in the entry point `group`."""

    group: str
    name: str
    package: str
    error: str


class ScenarioPage(Page[ScenarioAnswer]):
    """All scenarios, and what goals of their campaigns can name: `scores`, and `measures` with their units. `broken`: the catalogues that
    cannot be used."""

    scores: list[str] = Field(default_factory=list)
    measures: dict[str, str] = Field(default_factory=dict)
    broken: list[BrokenPluginAnswer] = Field(default_factory=list)


class ParameterAnswer(Answer):
    """A parameter with `n_values` equally spaced values; bounds of a choice are positions in `choices`. A continuous one has any value from
    `lower` to `upper`: `step` and `n_values` are null."""

    name: str
    unit: str
    lower: float
    upper: float
    step: float | None
    n_values: int | None
    description: str
    kind: str = "grid"
    choices: list[str] = Field(default_factory=list)


class ParameterSpaceAnswer(Answer):
    """A parameter space that a campaign can name in `parameters`. `driving_function`: the plug-in or the problem to which it belongs."""

    driving_function: str
    name: str
    parameters: list[ParameterAnswer]


class ParameterSpacePage(Page[ParameterSpaceAnswer]):
    """All parameter spaces. `broken`: the driving functions that cannot be used."""

    broken: list[BrokenPluginAnswer] = Field(default_factory=list)


class OptimizerAnswer(Answer):
    """An installed optimizer. `supports`: the kinds of parameters that it searches, and `constraints`; `settings`: the JSON schema of the
    section `optimizer` for it."""

    name: str
    supports: list[str]
    settings: dict[str, Any]


class OptimizerPage(Page[OptimizerAnswer]):
    """All optimizers. `broken`: the unusable ones."""

    broken: list[BrokenPluginAnswer] = Field(default_factory=list)


class ReferenceAnswer(Answer):
    """Number of a setup's runs in the reference table. A bundle's setup has neither driving function nor vehicle."""

    scenario: str
    fingerprint: str
    driving_function: str | None = None
    vehicle: str | None = None
    simulator: str
    runs: int


class ReferencePage(Page[ReferenceAnswer]):
    """The reference table's size by setup."""


class WorkerAnswer(Answer):
    """A worker as the dispatcher last saw it; `cells` counts what it has finished. A busy one simulates `scenario`, this batch of it
    `since` then; `cells_per_second` is its speed in the last batches, null before the first."""

    id: str
    node: str | None = None
    state: str
    cells: int = 0
    scenario: str | None = None
    since: datetime | None = None
    cells_per_second: float | None = None


class ResourceAnswer(Answer):
    """Licences or another scarce thing that runs share: how many exist, and how many of these are held, `settling` among them by runs of
    workers that are gone, which may go on for a while."""

    name: str
    total: int
    held: int
    settling: int = 0


class WaitingAnswer(Answer):
    """A campaign that waits, or has cells that wait for something else than their turn, and why."""

    id: str
    name: str
    reason: str


class WorkerTime(Answer):
    """A worker's stored runs in equal parts of a window, the oldest first: `busy` seconds of each part, and the id of the campaign that
    took most of it: `deleted` if it is gone, null if the worker was idle or still runs it. Repeats of stored runs and runs without a
    result are not stored."""

    worker: str
    runs: int
    busy: list[float]
    campaigns: list[str | None]


class WorkerWindow(Answer):
    """The time from `since` to `until` in parts of `part_seconds`. Runs before `complete_since` were too many to read. `names` has the
    campaigns' names by id."""

    since: datetime
    until: datetime
    part_seconds: float
    complete_since: datetime
    workers: list[WorkerTime]
    names: dict[str, str]


class WorkerPage(Page[WorkerAnswer]):
    """The workers, and when the dispatcher that drives them was last heard of (null: never). `fresh` is false if it has been silent for
    too long to believe what it said; `degraded` says what is wrong. `window` covers the asked minutes; null without any."""

    resources: list[ResourceAnswer] = Field(default_factory=list)
    waiting: list[WaitingAnswer] = Field(default_factory=list)
    window: WorkerWindow | None = None
    dispatcher_seen_at: datetime | None = None
    fresh: bool = False
    degraded: str | None = None


class Readiness(Answer):
    """True if work can be accepted and will be done; `problems` says what is missing."""

    ready: bool
    problems: list[str] = Field(default_factory=list)


class ProblemHeading(Answer):
    """A pushed problem in a list, with the `digest` of its content and the `size` of its archive in bytes. `latest` is true if its name
    means it."""

    name: str
    digest: str
    size: int
    latest: bool
    created_at: datetime
    links: dict[str, str] = Field(default_factory=dict)


class ProblemPage(Page[ProblemHeading]):
    """Problems, last pushed first."""


class ProblemAnswer(ProblemHeading):
    """A problem: the sections of its `problem.yaml`, checked and with the defaults filled in."""

    description: str
    parameters: dict[str, dict[str, Any]]
    """Parameters that a search moves; curves and maps are replaced by their coefficients."""
    shapes: dict[str, ShapeAnswer]
    """Curves and maps."""
    varied: dict[str, dict[str, Any]]
    """Side conditions of runs, which robustness studies vary."""
    constraints: list[str]
    baseline: dict[str, float | str] | None
    simulator: dict[str, Any]
    scenarios: dict[str, dict[str, Any]]
    measures: dict[str, str]
    """Units by measure."""
    failures: list[str]
    series: dict[str, str]
    """Units by time series."""
    scores: dict[str, dict[str, Any]]
    notes: list[str] = Field(default_factory=list)
    """Why runs of the push before answer nothing, when it is pushed."""
