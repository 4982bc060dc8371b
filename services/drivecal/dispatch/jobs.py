"""Starts and resumes campaigns from their rows."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.comparisons.resolve import resolve_comparison
from drivecal.campaigns.comparisons.runs import ComparisonJob
from drivecal.campaigns.job import Job
from drivecal.campaigns.resolve.bundle_source import stored_bundles
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.resolved_spec import problem_of, stored_scale
from drivecal.campaigns.stages.campaign import StagedCampaign
from drivecal.campaigns.stages.evaluation import SingleEvaluation
from drivecal.contracts.comparison import ComparisonSpecification
from drivecal.contracts.input_errors import validated
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import ConflictError
from drivecal.execution.scheduling.scheduler import Completed
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
    unwritten: list[Completed] = field(default_factory=list)
    stopping: CampaignState | None = None
    """State after the last cell leaves the workers: cancelled or paused."""
    not_before: float = 0.0
    """Earliest time to resume."""

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


def take_up(database: Database, sequence: int) -> Job:
    """Returns a job that continues from the campaign's rows. Raises ConflictError if any version differs from its start."""
    with database.read() as connection:
        campaign = campaigns.by_sequence(connection, sequence)
    if campaign.kind == "comparison":
        resolved = resolve_comparison(validated(ComparisonSpecification, campaign.spec), stored_bundles(database))
        if campaign.resolution is None:  # its runs pin the rest
            with database.transaction() as connection:
                campaigns.set_resolution(connection, sequence, {"scale": resolved.problems[0].bench.scale.to_json()})
        return ComparisonJob(database, campaign, resolved, lambda number: take_up(database, number))
    problem = problem_of(campaign, stored_bundles(database))
    _pin(database, campaign, problem.resolution())
    if isinstance(problem, CalibrationProblem):
        return StagedCampaign(database, campaign, problem)
    with database.read() as connection:
        traced = traces.is_made_by(connection, campaign.sequence)
    view = View(campaign.sequence, campaign.watermark or 0, problem.bench, traced=traced)
    return SingleEvaluation(database, campaign, problem, view)


def _pin(database: Database, campaign: StoredCampaign, resolution: Mapping[str, Any]) -> None:
    """Stores the versions that a campaign starts with, or checks that they are unchanged."""
    if campaign.resolution is None:
        with database.transaction() as connection:
            campaigns.set_resolution(connection, campaign.sequence, resolution)
        return
    begun_with = {**campaign.resolution, "scale": stored_scale(campaign.resolution).to_json()}  # earlier releases stored none
    changed = [part for part in resolution if resolution[part] != begun_with.get(part)]
    if changed:
        raise ConflictError(
            f"the campaign was begun with another version of its {' and '.join(changed)}; submit it again: results of two versions"
            " cannot be compared"
        )
