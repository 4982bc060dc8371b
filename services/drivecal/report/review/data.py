"""The data of a review sheet."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from drivecal.contracts.campaign import Campaign
from drivecal.contracts.results import FrontSummary, TrustAnswer
from drivecal.contracts.setup import CampaignSetup
from drivecal.contracts.tables import FrontRow, RobustnessRow, Solution, ValidationRow
from drivecal.report.data import Studied

RankedIn = Literal["solutions", "front"]


@dataclass(frozen=True, slots=True)
class ScoreOrigin:
    """The cell that a score is taken from: its number, what answered it, and its campaign's id, if it is another campaign's. `outcome`:
    as in tables of cells, or `later` if the cell was copied or predicted, and simulated later."""

    number: int
    outcome: str
    campaign: str | None = None


@dataclass(frozen=True, slots=True)
class ReviewedSet:
    """A chosen set with what is known of it and of its campaign. `cells`: by scenario. Studies: those that succeeded, the newest
    first."""

    campaign: Campaign
    setup: CampaignSetup
    table: RankedIn
    chosen: Solution | FrontRow
    cells: Mapping[str, ScoreOrigin]
    summary: FrontSummary
    trust: TrustAnswer
    front: Sequence[FrontRow] = ()
    """Empty for a single objective."""
    robustness: Sequence[Studied[RobustnessRow]] = ()
    validation: Sequence[Studied[ValidationRow]] = ()
    """Validations of the influence map and of released predictions."""

    @property
    def objectives(self) -> dict[str, float]:
        """The values of the objectives; of a set of the solutions the first alone."""
        if isinstance(self.chosen, FrontRow):
            return self.chosen.objectives
        return {self.summary.objectives[0].name: self.chosen.objective}

    @property
    def robust(self) -> tuple[Studied[RobustnessRow], RobustnessRow] | None:
        """The newest succeeded robustness study that examined the set, and its row; None without one."""
        for studied in self.robustness:
            for row in studied.rows:
                if row.parameters == self.chosen.parameters:
                    return studied, row
        return None


@dataclass(frozen=True, slots=True)
class Review:
    """The subject of a sheet: a set, or two sets by their labels. `query`: the path and query of the API that returns the sheet."""

    sets: Mapping[str, ReviewedSet]
    query: str
    version: str

    @property
    def first(self) -> ReviewedSet:
        """The set that is reviewed."""
        return next(iter(self.sets.values()))

    @property
    def columns(self) -> list[str]:
        """The heads of the columns of the sets."""
        return list(self.sets) if len(self.sets) > 1 else ["chosen"]

    def labelled(self) -> dict[str, ReviewedSet]:
        """Returns the sets by the words that distinguish them in captions."""
        return {f" of {label}": each for label, each in self.sets.items()} if len(self.sets) > 1 else {"": self.first}

    def campaigns(self) -> dict[str, ReviewedSet]:
        """Returns `labelled` with each campaign once."""
        return self.distinct(lambda each: each.campaign.id)

    def distinct(self, part: Callable[[ReviewedSet], object]) -> dict[str, ReviewedSet]:
        """Returns `labelled` without sets whose `part` is that of the first."""
        different = {label: each for label, each in self.labelled().items() if part(each) != part(self.first)}
        return (
            {label: each for label, each in self.labelled().items() if each is self.first or label in different}
            if different
            else {"": self.first}
        )

    def commands(self, lines: Callable[[ReviewedSet], str]) -> str:
        """Returns the lines of all sets, each once."""
        return "\n".join(dict.fromkeys(line for each in self.sets.values() for line in lines(each).splitlines()))
