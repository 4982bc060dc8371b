"""A search by the cell for tests: random sets, scenario by scenario, which are given up when they cannot be the best any more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict

from drivecal.plugins.ports import Ability
from drivecal.plugins.search import AskedCell, CellAnswer, SearchTask

AT_ONCE = 8
"""Sets that are begun together."""


class CellSearchSettings(BaseModel):
    """Settings."""

    model_config = ConfigDict(extra="forbid")
    kind: Literal["cell_search"] = "cell_search"
    seed: int = 1


class CellSearch:
    """Asks for the cells of random sets and remembers which answers it knew when it asked."""

    def __init__(self, settings: CellSearchSettings, task: SearchTask) -> None:
        self._task, self._generator = task, np.random.Generator(np.random.PCG64(settings.seed))
        self._open: list[AskedCell] = []
        self._known: dict[tuple[int, ...], dict[int, float]] = {}
        self._asked = 0
        self.discarded = 0

    def ask(self, room: int) -> list[AskedCell]:
        limit = room if self._task.cells is None else min(room, self._task.cells - self._asked)
        if len(self._open) < limit:
            first = () if self._known else self._task.start
            drawn = [*first, *self._task.sample(AT_ONCE, self._generator)]
            new = [indices for row in drawn if (indices := tuple(row.tolist())) not in self._known]
            self._known |= {indices: {} for indices in new}
            self._open += [
                AskedCell(indices, scenario) for scenario in range(self._task.aim.scenarios) for indices in dict.fromkeys(new)
            ]
        cells, self._open = self._open[:limit], self._open[limit:]
        self._asked += len(cells)
        return cells

    def tell(self, answers: Sequence[CellAnswer]) -> None:
        for answer in answers:
            self._known[answer.cell.indices][answer.cell.scenario] = answer.values[0]
            best = max(
                (sum(each.values()) for each in self._known.values() if len(each) == self._task.aim.scenarios), default=-np.inf
            )
            here = self._known[answer.cell.indices]
            hoped = sum(here.get(place, float(self._task.aim.best[place, 0])) for place in range(self._task.aim.scenarios))
            if hoped < best:
                left = [cell for cell in self._open if cell.indices != answer.cell.indices]
                self.discarded += len(self._open) - len(left)
                self._open = left

    def state(self) -> dict[str, Any]:
        return {}


class CellSearchPlugin:
    """`optimizer: {kind: cell_search}`."""

    name = "cell_search"
    settings = CellSearchSettings
    supports: frozenset[Ability] = frozenset({"grid", "continuous", "integer", "choice", "constraints"})

    def begin(self, settings: BaseModel, task: SearchTask) -> CellSearch:
        assert isinstance(settings, CellSearchSettings)
        return CellSearch(settings, task)

    def resume(
        self,
        settings: BaseModel,
        task: SearchTask,
        rounds: Sequence[Sequence[AskedCell]],
        answers: Sequence[Sequence[CellAnswer]],
        state: Mapping[str, Any],
    ) -> CellSearch:
        del state
        search, window = self.begin(settings, task), len(rounds) - len(answers)
        for number, cells in enumerate(rounds):
            if number >= window:
                search.tell(answers[number - window])
            assert list(cells) == search.ask(len(cells))
        return search
