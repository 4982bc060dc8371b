"""`optimizer: {kind: external}`: another program proposes the sets, by the API, and a campaign evaluates them."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field

from drivecal.plugins.ports import Ability
from drivecal.plugins.search import AskedCell, CellAnswer, Search, SearchPlugin, SearchTask


class ExternalSettings(BaseModel):
    """Evaluates the sets that another program proposes, until the budget is used up or that program finishes the campaign."""

    model_config = ConfigDict(extra="forbid")

    kind: Literal["external"] = "external"
    seed: Annotated[int, Field(ge=0, lt=2**63, description="Seed of the checks of reused answers.")] = 1
    infeasible: Annotated[
        Literal["refuse", "repair"],
        Field(description="Refuses sets outside of the bounds or constraints, or takes a near set that keeps them."),
    ] = "refuse"


class External:
    """See `drivecal.plugins.search.SearchPlugin`. Its rounds are proposed sets, so that no search begins here."""

    name = "external"
    settings: type[BaseModel] = ExternalSettings
    supports: frozenset[Ability] = frozenset(get_args(Ability))

    def begin(self, settings: BaseModel, task: SearchTask) -> Search:
        """Raises TypeError."""
        del settings, task
        raise TypeError("others propose the sets of this search")

    def resume(
        self,
        settings: BaseModel,
        task: SearchTask,
        rounds: Sequence[Sequence[AskedCell]],
        answers: Sequence[Sequence[CellAnswer]],
        state: Mapping[str, Any],
    ) -> Search:
        """Raises TypeError."""
        del rounds, answers, state
        return self.begin(settings, task)


EXTERNAL: SearchPlugin = External()
