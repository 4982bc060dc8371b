"""Starts and resumes campaigns from their rows."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.job import Job
from drivecal.campaigns.resolve.bundle_source import stored_bundles, with_tools
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.resolved_spec import problem_of, stored_scale
from drivecal.campaigns.stages.campaign import StagedCampaign
from drivecal.campaigns.stages.evaluation import SingleEvaluation
from drivecal.contracts.work import BundleRequest
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import ConflictError
from drivecal.execution.scheduling.dispatches import Completed
from drivecal.storage import campaigns, traces
from drivecal.storage.campaigns import CampaignHeading, StoredCampaign
from drivecal.storage.engine.database import Database

EVALUATION_PRIORITY = 1000
"""A user waits for a single evaluation; a campaign can wait a batch longer."""


@dataclass(slots=True)
class Active:
    """A campaign in work. `job` is None until it resumes from its rows; `unwritten` survives a failed transaction."""

    campaign: CampaignHeading
    job: Job | None = None
    beginning: Job | None = None
    """A job that computes before its first cells; then it becomes the `job`."""
    unwritten: list[Completed] = field(default_factory=list)
    stopping: CampaignState | None = None
    """State after the last cell leaves the workers: cancelled or paused."""
    not_before: float = 0.0
    """Earliest time to resume."""
    write_at: float = 0.0
    """Earliest time to store results while others are under way."""

    @property
    def tag(self) -> str:
        """The pool's tag for the campaign's cells."""
        return self.campaign.id

    @property
    def stage(self) -> StageName | None:
        """The running stage, for the log."""
        return None if self.job is None else self.job.stage

    @property
    def priority(self) -> int:
        """The priority of the campaign's cells."""
        return EVALUATION_PRIORITY if self.campaign.kind == "evaluation" else self.campaign.priority


Prober = Callable[[BundleRequest], str | None]
"""Returns what the `probe` of a bundle answers on a worker; None until one has answered."""


def take_up(database: Database, sequence: int, probe: Prober) -> Job | None:
    """Returns a job that continues from the campaign's rows; None while `probe` has no answer for the campaign's bundle.

    Raises ConflictError if any version differs from its start.
    """
    with database.read() as connection:
        campaign = campaigns.by_sequence(connection, sequence)
    tools: str | None = (campaign.resolution or {}).get("tools")
    problem = problem_of(campaign, with_tools(stored_bundles(database), tools))
    request = problem.bench.to_probe
    if isinstance(request, BundleRequest):
        tools = probe(request)
        if tools is None:
            return None
        problem = problem_of(campaign, with_tools(stored_bundles(database), tools))
    known = {} if tools is None else {"tools": tools}
    _pin(database, campaign, problem.resolution() | known)
    if isinstance(problem, CalibrationProblem):
        return StagedCampaign(database, campaign, problem)
    with database.read() as connection:
        traced = traces.is_made_by(connection, campaign.sequence)
    view = View(campaign.sequence, campaign.watermark or 0, problem.bench, traced=traced)
    return SingleEvaluation(database, campaign, problem, view)


def _pin(database: Database, campaign: StoredCampaign, resolution: Mapping[str, Any]) -> None:
    """Stores the versions that a campaign starts with, or checks that they are unchanged."""
    begun = campaign.resolution
    unknown = begun is not None and "tools" in resolution and "tools" not in begun  # a bundle's is stored when it is submitted
    if begun is None or (unknown and not campaign.stages):
        with database.transaction() as connection:
            campaigns.set_resolution(connection, campaign.sequence, resolution)
        return
    begun_with = {**begun, "scale": stored_scale(begun).to_json()}  # earlier releases stored none
    changed = [part for part in resolution if resolution[part] != begun_with.get(part)]
    if changed:
        raise ConflictError(
            f"the campaign was begun with another version of its {' and '.join(changed)}; submit it again: results of two versions"
            " cannot be compared"
        )
