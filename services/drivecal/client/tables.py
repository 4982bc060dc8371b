"""Tables of a campaign as lists of their row models."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from drivecal.contracts.campaign import FrontSummary, TradeOff
from drivecal.contracts.comparison import ComparedGroup, ComparedPair, ComparedRun, ReductionEffect
from drivecal.contracts.tables import FrontRow, InfluenceRow, OptimumRow, RobustnessRow, TableName, ValidationRow
from drivecal.domain.errors import UnavailableError

Answer = TypeVar("Answer", bound=BaseModel)


class TypedTables(ABC):
    """Methods of the client, a table each."""

    @abstractmethod
    def rows(self, identifier: str, table: TableName, **query: Any) -> Iterator[dict[str, Any]]:
        """Yields every row of a table."""

    @abstractmethod
    def _get(self, model: type[Answer], *place: str, **query: Any) -> Answer:
        """Returns the answer at a place."""

    @abstractmethod
    def _strange(self) -> UnavailableError:
        """Returns the error for an answer of an unknown form."""

    def influence(self, identifier: str) -> list[InfluenceRow]:
        """Returns the rows of the influence map that a campaign uses, empty without a map."""
        return self._rows_of(identifier, "influence", InfluenceRow)

    def optima(self, identifier: str) -> list[OptimumRow]:
        """Returns the sets that share a campaign's best objective, with their regions."""
        return self._rows_of(identifier, "optima", OptimumRow)

    def front(self, identifier: str, weights: str | None = None, *, everything: bool = False) -> list[FrontRow]:
        """Returns the sets of a campaign's front, best first under `weights` of the objectives (`comfort=2,gap=1`) if they are given; with
        `everything` of all that is stored in its setups and space."""
        return self._rows_of(identifier, "front", FrontRow, weights=weights, everything=everything or None)

    def front_summary(self, identifier: str, *, everything: bool = False) -> FrontSummary:
        """Returns the objectives, knee, extremes and hypervolumes of a front."""
        return self._get(FrontSummary, "campaigns", identifier, "front", "summary", everything=everything or None)

    def trade_off(
        self, identifier: str, first: int, second: int, weights: str | None = None, *, everything: bool = False
    ) -> TradeOff:
        """Returns how two sets of a front differ, by their ranks under the same `weights`."""
        query = {"first": first, "second": second, "weights": weights, "everything": everything or None}
        return self._get(TradeOff, "campaigns", identifier, "front", "trade-off", **query)

    def robustness(self, identifier: str) -> list[RobustnessRow]:
        """Returns the examined sets of a campaign, most robust first; empty before the robustness stage."""
        return self._rows_of(identifier, "robustness", RobustnessRow)

    def validation(self, identifier: str) -> list[ValidationRow]:
        """Returns the validation of a campaign's map by scenario; empty before that stage."""
        return self._rows_of(identifier, "validation", ValidationRow)

    def compared_runs(self, identifier: str) -> list[ComparedRun]:
        """Returns the runs of a comparison."""
        return self._rows_of(identifier, "comparison", ComparedRun)

    def compared_groups(self, identifier: str) -> list[ComparedGroup]:
        """Returns the runs of a comparison by optimizer, population and reduction: Table 5."""
        return self._rows_of(identifier, "comparison-groups", ComparedGroup)

    def compared_pairs(self, identifier: str) -> list[ComparedPair]:
        """Returns the runs of a comparison that differ in the reduction alone, side by side."""
        return self._rows_of(identifier, "comparison-pairs", ComparedPair)

    def reduction_effects(self, identifier: str) -> list[ReductionEffect]:
        """Returns the effects over all pairs."""
        return self._rows_of(identifier, "comparison-effects", ReductionEffect)

    def _rows_of(self, identifier: str, table: TableName, model: type[Answer], **query: Any) -> list[Answer]:
        try:
            return [model.model_validate(row) for row in self.rows(identifier, table, **query)]
        except ValidationError as error:
            raise self._strange() from error
