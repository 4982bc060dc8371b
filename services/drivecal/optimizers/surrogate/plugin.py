"""`optimizer: {kind: surrogate}`."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from pydantic import BaseModel, Field

from drivecal.plugins.ports import Ability
from drivecal.plugins.search import AskedCell, CellAnswer, Search, SearchPlugin, SearchTask

if TYPE_CHECKING:
    from drivecal.optimizers.surrogate.search import SurrogateSearch


class SurrogateSettings(BaseModel, extra="forbid"):
    """Learns a Gaussian process for each scenario, asks cell by cell, and gives sets up that cannot win any more."""

    kind: Literal["surrogate"] = "surrogate"
    seed: Annotated[int, Field(ge=0, lt=2**63, description="Seed of all random numbers.")] = 1


class SurrogatePlugin:
    """See `drivecal.plugins.search.SearchPlugin`."""

    name = "surrogate"
    settings: type[BaseModel] = SurrogateSettings
    supports: frozenset[Ability] = frozenset(get_args(Ability))

    def begin(self, settings: BaseModel, task: SearchTask) -> "SurrogateSearch":
        """Begins a search."""
        from drivecal.optimizers.surrogate.search import SurrogateSearch  # scipy takes seconds; most commands need none

        if not isinstance(settings, SurrogateSettings):
            raise TypeError(f"settings must be {SurrogateSettings.__name__}, not {type(settings).__name__}")
        return SurrogateSearch(settings.seed, task)

    def resume(
        self,
        settings: BaseModel,
        task: SearchTask,
        rounds: Sequence[Sequence[AskedCell]],
        answers: Sequence[Sequence[CellAnswer]],
        state: Mapping[str, Any],
    ) -> Search:
        """Returns the search after these rounds."""
        search = self.begin(settings, task)
        search.restore(rounds, answers, state)
        return search


SURROGATE: SearchPlugin = SurrogatePlugin()
