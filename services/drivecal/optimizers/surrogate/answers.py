"""The sets that a search has begun, and what is known of them."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from drivecal.domain.parameters import Indices
from drivecal.optimizers.surrogate.gaussian_process import Encoding, Points
from drivecal.optimizers.surrogate.models import Bools
from drivecal.plugins.ports import Floats
from drivecal.plugins.search import Aim, CellAnswer

EQUAL_REPEATS = 8
"""Equal repeats in each scenario after which a simulator counts as not random."""


@dataclass(slots=True)
class BegunSet:
    """A set with cells that were asked or are known. `number`: its row in all tables."""

    indices: tuple[int, ...]
    number: int
    whole: bool = False
    """Asked in all scenarios, whatever the answers are."""
    promise: float | None = None
    """The probability, when it was begun, that it beats the best one; None before the first look."""
    improbable: bool = False
    """Given up, because it has become improbable that it beats the best one."""
    beaten: bool = False
    """Given up, because it cannot beat the best one."""
    replicate: int = 1
    """Replicate of its newest cells."""

    @property
    def given_up(self) -> bool:
        """True if no more cells are asked."""
        return self.improbable or self.beaten


class Answers:
    """Tables of n sets, in the order of beginning."""

    def __init__(self, encoding: Encoding, aim: Aim, replicates: int) -> None:
        self._encoding, self._aim = encoding, aim
        self.sets: list[BegunSet] = []
        self._numbers: dict[tuple[int, ...], int] = {}
        cells, runs = (64, aim.scenarios), (64, aim.scenarios, replicates)
        self._features: Floats = np.empty((64, len(encoding.owners)))
        self._values: Floats = np.full((*cells, aim.values), np.nan)
        self._asked: Bools = np.zeros(runs, dtype=np.bool_)
        self._answered: Bools = np.zeros(runs, dtype=np.bool_)
        self._failed: Bools = np.zeros(cells, dtype=np.bool_)
        self.order: list[list[int]] = [[] for _ in range(aim.scenarios)]
        """The sets that are answered in each scenario, by number, in the order of the answers."""
        self._listed: list[list[tuple[int, Floats, bool]]] = [[] for _ in range(aim.scenarios)]
        """Replicate, values and failure of each answer in `order`."""
        self._repeats: Floats = np.zeros(aim.scenarios)
        """Repeats in each scenario while all are equal; infinite afterwards."""
        self._upwards = np.sign(np.where(np.isinf(aim.best) | np.isnan(aim.worst), aim.best, aim.best - aim.worst))
        self.best: Floats = aim.best.astype(np.float64)
        """The best value to be expected of a cell, shape (n_scenarios, n_values): what the aim says, or the best answer if it is better."""

        self._from_before: set[int] = set()
        """Sets with answers from before the search that it has not asked on."""
        self._asked_on: set[int] = set()

    def end_of_known(self) -> None:
        """Notes that all answers so far are from before the search."""
        self._from_before = set(range(len(self.sets)))

    def __contains__(self, indices: tuple[int, ...]) -> bool:
        return indices in self._numbers

    def begin(self, indices: tuple[int, ...], *, promise: float | None = None) -> BegunSet:
        """Returns the set with these grid indices, a new one if it has not begun."""
        if indices in self._numbers:
            return self.sets[self._numbers[indices]]
        number = self._numbers[indices] = len(self.sets)
        if number == len(self._asked):
            self._grow()
        self._features[number] = self._encoding(np.array([indices], dtype=np.int64))[0]
        self.sets.append(BegunSet(indices, number, promise=promise))
        return self.sets[-1]

    def _grow(self) -> None:
        self._features = np.concatenate([self._features, np.empty_like(self._features)])
        self._values = np.concatenate([self._values, np.full_like(self._values, np.nan)])
        self._asked, self._answered, self._failed = (
            np.concatenate([table, np.zeros_like(table)]) for table in (self._asked, self._answered, self._failed)
        )

    def ask(self, begun: BegunSet, scenario: int) -> None:
        """Notes that a cell is asked. If the set has answers from before, their cells count as not asked: see `asked_on`."""
        if begun.number in self._from_before:
            self._from_before.remove(begun.number)
            self._asked_on.add(begun.number)
            self._asked[begun.number] = False
        self._asked[begun.number, scenario, begun.replicate - 1] = True

    def take(self, answer: CellAnswer) -> None:
        """Notes an answer."""
        begun, scenario, place = self.begin(answer.cell.indices), answer.cell.scenario, answer.cell.replicate - 1
        values, before = np.array(answer.values, dtype=np.float64), self._values[begun.number, scenario].copy()
        self._values[begun.number, scenario] = values
        self._failed[begun.number, scenario] = answer.failed or not np.isfinite(values).all()
        known: Bools = self._answered[begun.number, scenario]
        if not known[place]:
            if known.any():
                self._repeats[scenario] += 1 if np.array_equal(values, before, equal_nan=True) else np.inf
            self.order[scenario].append(begun.number)
            self._listed[scenario].append((answer.cell.replicate, values, bool(self._failed[begun.number, scenario])))
        self._asked[begun.number, scenario, place] = known[place] = True
        if not self._failed[begun.number, scenario]:
            better = self._upwards[scenario] * (values - self.best[scenario]) > 0
            self.best[scenario] = np.where(better, values, self.best[scenario])

    def points(self, sets: Sequence[BegunSet]) -> Points:
        """Returns sets under their newest seeds."""
        numbers, seeds = [begun.number for begun in sets], [begun.replicate for begun in sets]
        return Points(self._features[numbers], np.array(seeds, dtype=np.int64))

    def known(self, scenario: int) -> tuple[Points, Floats, Bools]:
        """Returns points, values and failures of the answers in a scenario, in their order."""
        seeds, values, failed = ([each[place] for each in self._listed[scenario]] for place in range(3))
        points = Points(self._features[self.order[scenario]], np.array(seeds, dtype=np.int64))
        return points, np.array(values).reshape(len(seeds), self._aim.values), np.array(failed, dtype=np.bool_)

    def values(self, sets: Iterable[BegunSet]) -> Floats:
        """Returns the values of sets, shape (n, n_scenarios, n_values); NaN without an answer."""
        return self._values[[begun.number for begun in sets]]

    def answered(self, begun: BegunSet) -> Bools:
        """Returns a mask of the scenarios that a set was answered in."""
        answered: Bools = self._answered[begun.number].any(axis=1)
        return answered

    def missing(self, begun: BegunSet, needs: Bools | None = None) -> Indices:
        """Returns the scenarios that a set was not asked in under its newest replicate, rising, of an aim's `needs`."""
        missing: Bools = ~self._asked[begun.number, :, begun.replicate - 1]
        return np.flatnonzero(missing if needs is None else missing & needs)

    def pending(self, begun: BegunSet) -> int:
        """Returns the number of cells of a set that are under way."""
        return int((self._asked[begun.number] & ~self._answered[begun.number]).sum())

    def complete(self, needs: Bools | None = None) -> list[BegunSet]:
        """Returns the sets with an answer in every scenario, or in the scenarios of an aim."""
        answered = np.any(self._answered[: len(self.sets)], axis=2) | (False if needs is None else ~needs)
        return [self.sets[number] for number in np.flatnonzero(answered.all(axis=1)).tolist()]

    def repeatable(self) -> list[BegunSet]:
        """Returns the complete sets of the search that may be asked again under another seed; none if all repeats so far are equal."""
        if np.all((self._repeats >= EQUAL_REPEATS) & np.isfinite(self._repeats)):
            return []
        spent = np.all(self._asked, axis=(1, 2))
        return [
            each
            for each in self.complete()
            if not (each.number in self._from_before or spent[each.number] or len(self.missing(each)) or self.pending(each))
        ]

    def next_unasked(self, begun: BegunSet) -> int:
        """Returns the first replicate that a set was not asked for in all scenarios."""
        return 1 + int(np.argmin(np.all(self._asked[begun.number], axis=0)))

    @property
    def open(self) -> list[BegunSet]:
        """The sets that a promise was made for, that were not asked in every scenario and not given up."""
        whole = np.any(self._asked, axis=2).all(axis=1)
        return [begun for begun in self.sets if not whole[begun.number] and not begun.given_up and begun.promise is not None]

    @property
    def unanswered(self) -> list[BegunSet]:
        """The sets that are going to be complete, as it seems."""
        whole = np.any(self._answered, axis=2).all(axis=1)
        return [
            begun
            for begun in self.sets
            if not whole[begun.number] and not begun.given_up and (begun.whole or begun.promise is not None)
        ]

    @property
    def asked_on(self) -> list[BegunSet]:
        """The sets with answers from before that a cell of the search has completed, and that are neither given up nor asked wholly."""
        return [each for each in self.complete() if each.number in self._asked_on and not (each.whole or each.given_up)]

    @property
    def dormant(self) -> list[BegunSet]:
        """The sets that are known in some scenarios from before the search."""
        return [
            begun
            for begun in self.sets
            if begun.promise is None and not begun.whole and len(self.missing(begun)) and not begun.beaten
        ]

    @property
    def discarded(self) -> int:
        """Cells of given-up sets that were not asked."""
        given_up = [begun.number for begun in self.sets if begun.given_up and begun.number not in self._from_before]
        return int((~np.any(self._asked[given_up], axis=2)).sum())
