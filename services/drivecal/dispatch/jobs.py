"""Takes campaigns up from their rows: those that begin, and those that somebody began before."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from drivecal.campaigns.cells.planning import View
from drivecal.campaigns.comparisons.resolve import resolve_comparison
from drivecal.campaigns.comparisons.runs import ComparisonJob
from drivecal.campaigns.job import Job
from drivecal.campaigns.resolve.problem import CalibrationProblem
from drivecal.campaigns.resolve.resolved_spec import problem_of
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
"""Somebody waits for a single evaluation; a campaign can wait a batch longer."""


@dataclass(slots=True)
class Active:
    """A campaign in work. `job` is None until it is taken up from its rows; `unwritten` survives a failed transaction."""

    campaign: CampaignHeading
    job: Job | None = None
    unwritten: list[Completed] = field(default_factory=list)
    stopping: CampaignState | None = None
    """Where it goes once nothing of it is at a worker: cancelled or paused."""
    not_before: float = 0.0
    """When it may be taken up."""

    @property
    def tag(self) -> str:
        """Under which the pool knows its cells."""
        return self.campaign.id

    @property
    def stage(self) -> StageName | None:
        """The running stage, for the log."""
        return None if self.job is None else self.job.stage

    @property
    def priority(self) -> int:
        """Of its cells."""
        return EVALUATION_PRIORITY if self.campaign.kind == "evaluation" else self.campaign.priority


def take_up(database: Database, sequence: int) -> Job:
    """A job that goes on from the campaign's rows. Raises ConflictError if it was begun with another version of anything."""
    with database.read() as connection:
        campaign = campaigns.by_sequence(connection, sequence)
    if campaign.kind == "comparison":
        resolved = resolve_comparison(validated(ComparisonSpecification, campaign.spec))
        return ComparisonJob(database, campaign, resolved, lambda number: take_up(database, number))
    problem = problem_of(campaign)
    _pin(database, campaign, problem.resolution())
    if isinstance(problem, CalibrationProblem):
        return StagedCampaign(database, campaign, problem)
    with database.read() as connection:
        traced = traces.is_made_by(connection, campaign.sequence)
    view = View(campaign.sequence, campaign.watermark or 0, problem.bench, traced=traced)
    return SingleEvaluation(database, campaign, problem, view)


def _pin(database: Database, campaign: StoredCampaign, resolution: Mapping[str, Any]) -> None:
    """Writes down what a campaign is begun with; later, makes sure that it goes on with the same."""
    if campaign.resolution is None:
        with database.transaction() as connection:
            campaigns.set_resolution(connection, campaign.sequence, resolution)
        return
    changed = [part for part in resolution if resolution[part] != campaign.resolution.get(part)]
    if changed:
        raise ConflictError(
            f"the campaign was begun with another version of its {' and '.join(changed)}; submit it again: results of two versions"
            " cannot be compared"
        )
