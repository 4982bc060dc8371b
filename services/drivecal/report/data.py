"""The data of reports on a campaign, and of review sheets."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from drivecal.contracts.results import CampaignResults, FrontSummary
from drivecal.contracts.tables import FrontRow, Generation, InfluenceRow, OptimumRow, Solution

RANKED = 1000
"""Number of best sets in a report; all of them are in the table."""


@dataclass(frozen=True, slots=True)
class ReportData:
    """The results of a campaign and rows of its tables. `basis`: the analysis behind its influence map, None without a map or for a posted
    one. `optima`: the sets that share the best objective."""

    results: CampaignResults
    generations: Sequence[Generation] = ()
    solutions: Sequence[Solution] = ()
    optima: Sequence[OptimumRow] = ()
    influence: Sequence[InfluenceRow] = ()
    basis: Mapping[str, Any] | None = None
    front: Sequence[FrontRow] = ()


@dataclass(frozen=True, slots=True)
class Report:
    """The data of a report, and its tables: CSV by name, in pieces."""

    data: ReportData
    tables: Mapping[str, Iterable[bytes]]


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
    """A chosen set and the results of its campaign, with the verdicts on the set. Cells are sorted by scenario; a single objective has no
    front."""

    results: CampaignResults
    table: RankedIn
    chosen: Solution | FrontRow
    cells: Mapping[str, ScoreOrigin]
    summary: FrontSummary
    front: Sequence[FrontRow] = ()

    @property
    def id(self) -> str:
        """The id of the campaign."""
        return self.results.campaign.id

    @property
    def objectives(self) -> dict[str, float]:
        """The values of the objectives; of a set of the solutions the first alone."""
        if isinstance(self.chosen, FrontRow):
            return self.chosen.objectives
        return {self.summary.objectives[0].name: self.chosen.objective}

    @property
    def words(self) -> str:
        """The set in words."""
        return f"set {self.chosen.rank} of the {self.table} of campaign {self.id}"

    @property
    def listing(self) -> str:
        """The command that lists the set."""
        if self.table == "front":
            return f"drivecal front {self.id} --limit {self.summary.size}"
        return f"drivecal solutions {self.id} --limit {self.chosen.rank}"

    def baseline_of(self, name: str) -> float | None:
        """Returns the baseline's value of an objective; of others than the first only if the baseline has a value of each."""
        judged, baseline = self.summary.baseline, self.results.campaign.baseline
        if judged is not None:
            return judged.objectives.get(name)
        return None if baseline is None or name != self.summary.objectives[0].name else baseline.objective


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

    def labelled(self) -> dict[str, ReviewedSet]:
        """Returns the sets by the words that distinguish them in captions."""
        return {f" of {label}": each for label, each in self.sets.items()} if len(self.sets) > 1 else {"": self.first}

    def campaigns(self) -> dict[str, ReviewedSet]:
        """Returns `labelled` with each campaign once."""
        alike = len({each.id for each in self.sets.values()}) == 1
        return {"": self.first} if alike else self.labelled()

    def commands(self, lines: Callable[[ReviewedSet], str]) -> str:
        """Returns the lines of all sets, each once."""
        return "\n".join(dict.fromkeys(line for each in self.sets.values() for line in lines(each).splitlines()))
