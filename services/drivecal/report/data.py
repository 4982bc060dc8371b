"""The data of a report on a campaign, from the server."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, Generic, TypeVar

from drivecal.client.client import Client
from drivecal.contracts.accounting import Accounting
from drivecal.contracts.campaign import Campaign, Study, StudyName
from drivecal.contracts.evaluation import FailureCause
from drivecal.contracts.results import FrontSummary, TrustAnswer
from drivecal.contracts.setup import CampaignSetup
from drivecal.contracts.tables import FrontRow, Generation, InfluenceRow, OptimumRow, RobustnessRow, Solution, ValidationRow
from drivecal.domain.campaigns import CampaignState

RANKED = 1000
"""Number of best sets in a report; all of them are in the table."""
MOST_STUDIES = 5
"""Largest number of studies of one kind in a report."""
Row = TypeVar("Row", RobustnessRow, ValidationRow)


@dataclass(frozen=True, slots=True)
class Studied(Generic[Row]):
    """A study and its results."""

    study: Study
    rows: Sequence[Row]


@dataclass(frozen=True, slots=True)
class ReportData:
    """A campaign and its results.

    `basis`: the analysis behind its influence map, None without a map or for a posted one. `accounting`: None before the first answered
    cell, and after a pruning. `titles`: of scenarios, by id. `optima`: the sets that share the best objective. Studies: those that
    succeeded, made by any campaign; those in the campaign's own vehicle first, the newest first.
    """

    campaign: Campaign
    setup: CampaignSetup
    generations: Sequence[Generation]
    solutions: Sequence[Solution]
    optima: Sequence[OptimumRow]
    influence: Sequence[InfluenceRow]
    basis: Mapping[str, Any] | None
    titles: Mapping[str, str]
    accounting: Accounting | None
    robustness: Sequence[Studied[RobustnessRow]] = ()
    validation: Sequence[Studied[ValidationRow]] = ()
    """Validations of the influence map."""
    failures: Sequence[FailureCause] = ()
    """Causes of failed cells."""
    predictions: Sequence[Studied[ValidationRow]] = ()
    """Validations of released predictions."""
    trust: TrustAnswer | None = None
    """None from a server of an earlier release."""
    front: Sequence[FrontRow] = ()
    front_summary: FrontSummary | None = None
    """None without objectives."""

    @property
    def recommended(self) -> RobustnessRow | None:
        """The set that the first robustness study recommends."""
        return next((row for studied in self.robustness[:1] for row in studied.rows if row.recommended), None)


def collect(client: Client, identifier: str) -> ReportData:
    """Reads the data of a campaign. Raises NotFoundError for an unknown campaign, and the client's other exceptions."""
    campaign = client.campaign(identifier)
    used = client.map_of(campaign)
    answered = campaign.cells.requested or campaign.sensitivity_cells.requested
    compromises = bool(campaign.spec.get("objectives")) and campaign.best is not None
    studies = sorted(client.studies(identifier).items, key=lambda study: not study.in_own_vehicle)
    return ReportData(
        campaign=campaign,
        setup=client.setup(identifier),
        generations=[Generation.model_validate(row) for row in client.rows(identifier, "generations")],
        solutions=client.solutions(identifier, limit=RANKED).items,
        optima=client.optima(identifier),
        influence=client.influence(identifier),
        basis=None if used is None else used.basis,
        titles={scenario.id: scenario.title for scenario in client.scenarios().items},
        accounting=client.accounting(identifier) if answered and campaign.pruned_at is None else None,
        trust=client.trust(identifier) if "trust" in campaign.links else None,
        front=client.front(identifier) if compromises else (),
        front_summary=client.front_summary(identifier) if compromises else None,
        failures=client.failures(identifier).items if answered else (),
        robustness=_studied(studies, "robustness", client.robustness),
        validation=_studied([study for study in studies if not study.settings.get("of")], "validation", client.validation),
        predictions=_studied([study for study in studies if study.settings.get("of")], "validation", client.validation),
    )


def _studied(studies: Sequence[Study], stage: StudyName, rows: Callable[[str], list[Row]]) -> list[Studied[Row]]:
    wanted = (study for study in studies if study.stage == stage and study.state == CampaignState.SUCCEEDED)
    studied = [Studied(study, rows(study.campaign)) for study in islice(wanted, MOST_STUDIES)]
    return [study_rows for study_rows in studied if study_rows.rows]
