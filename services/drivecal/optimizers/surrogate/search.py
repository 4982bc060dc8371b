"""The search: what to ask next, given a model for each scenario.

The probability that a set beats the best one comes from draws of all its scenarios, which `Aim.judge` rounds and adds up as it does with
answers. New sets have the largest expected improvement among candidates spread over the space and near the best sets. A set is asked
scenario by scenario, first where the draws decide most, and given up early (`beaten`, `improbable`).
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri
from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]  # it ships no types

from drivecal.domain.parameters import Indices
from drivecal.optimizers.surrogate.answers import Answers, BegunSet
from drivecal.optimizers.surrogate.gaussian_process import Encoding
from drivecal.optimizers.surrogate.merits import REACH, Merit, Standing
from drivecal.optimizers.surrogate.models import Bools, ScenarioModel
from drivecal.plugins.ports import Floats
from drivecal.plugins.search import Aim, AskedCell, CellAnswer, SearchTask

GIVE_UP_SHARE = 0.02
"""A set is given up when its probability to beat the best falls below this share of its first value."""
GIVE_UP_LEAST = 0.0001
"""The same, whatever the first value was."""


def beaten(
    aim: Aim, answers: Answers, sets: Sequence[BegunSet], standing: Standing, best: Floats, needs: npt.NDArray[np.bool_]
) -> npt.NDArray[np.bool_]:
    """Returns which sets cannot be better than the best complete ones, even with the best value in every scenario left, shape (n,).

    Args:
        aim: the campaign's aim.
        answers: all answers.
        sets: n sets that are not complete.
        standing: the complete sets.
        best: the best values to be expected of each set, shape (n, n_scenarios, n_values).
        needs: the scenarios of the aim, shape (n_scenarios,).
    """
    values = answers.values(sets)
    missing = ~np.stack([answers.answered(begun) for begun in sets])
    with np.errstate(invalid="ignore"):
        objectives, violations = aim.judge(np.where(missing[:, :, np.newaxis], best, values))
    return standing.beats(objectives, violations) | without_result(answers, sets, needs)


def without_result(answers: Answers, sets: Sequence[BegunSet], needs: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Returns which sets have an answer without a result in a needed scenario, shape (n,)."""
    answered = np.stack([answers.answered(begun) for begun in sets]) & needs
    dead: npt.NDArray[np.bool_] = np.any(answered & np.isnan(answers.values(sets)).any(axis=2), axis=1)
    return dead


def improbable(chance: float, promise: float) -> bool:
    """Returns whether a set is not worth a simulation any more; this touches what is asked, never what is reported. `promise`: its first
    probability to beat the best."""
    return chance < promise and chance <= max(GIVE_UP_SHARE * promise, GIVE_UP_LEAST)


FEWEST_FIRST, MOST_FIRST = 4, 5
"""Sets of the first design."""
DESIGN_SHARE = 0.2
"""Share of the budget that the first design takes."""
BEFORE_REPEATS = 20
"""Complete sets before a set gets another seed, or a quarter of the budget's: models of few sets take a valley for one's luck."""
DRAWS = 64
"""Draws for a candidate."""
OPEN_DRAWS = 256
"""Draws for a set that was begun."""
FEW_DRAWS = 16
"""Draws for each of many sets that are known in part."""
SPREAD, NEAR = 300, 500
"""Candidates over the whole space, and near the best sets."""
CROSSED = 0.3
"""Share of the children that have two parents."""
SHORTEST, LONGEST = 0.005, 0.3
"""Deviations of steps, in ranges; each child has its own, on a logarithmic scale."""
PARENTS = 8
REFINEMENTS, REFINED, REFINING = 2, 8, 150
"""How often the most promising candidates have children, how many of them, and how many children."""
TOGETHER = 8
"""Most sets that are chosen from the same candidates: all but the first by a draw each."""
STANDING_STILL, NOTABLE = 20, 0.01
"""Sets without a notable gain, a share of what the complete sets range over, after which every other set must promise one: small gains
near the best set would otherwise hide for long that a distant region is better."""
TURNS = 3
"""Steps of asking a set when many cells are under way; with one cell at a time there is a step for each scenario."""
GROUPS = 4
"""Most groups of such sets in a round."""
PENDING = 64
"""Most unanswered sets that the models count as known."""
DORMANT = 64
"""Most sets with known answers from before that are looked at in detail."""
VALUE_EVERY, VALUE_PROMISE = 5, 0.01
"""Each fifth set, at most, is begun for a rare value of a choice, with this promise, which no other set has."""
DESIGN, PROPOSAL, DRAWING, DIRECTION, NOISE = range(5)
"""Streams of random numbers."""


class SurrogateSearch:
    """See `drivecal.plugins.search.Search`."""

    def __init__(self, seed: int, task: SearchTask) -> None:
        self._seed, self._task, self._aim = seed, task, task.aim
        encoding = Encoding(task.n_values, task.kinds)
        self._encoding = encoding
        self._answers = Answers(encoding, task.aim, max(1, task.replicates) if task.random else 1)
        self._aims = (task.aim, *task.variants)
        improving, bounding = zip(*map(_needed, self._aims), strict=True)
        self._needs = [np.ones(task.aim.scenarios, dtype=np.bool_), *np.any([improving, bounding], axis=(0, 3))[1:]]
        """Masks of the scenarios of each aim, shape (n_scenarios,)."""
        # a measure that has a limit alone may have to get better than any answer by more than a logarithm's origin leaves
        ends = np.where(np.isinf(task.aim.best) & ~np.any(improving, axis=0), np.nan, task.aim.best)
        self._models = [
            ScenarioModel(task.aim.values, len(task.kinds), encoding.owners, best, worst, random=task.random)
            for best, worst in zip(ends, task.aim.worst, strict=True)
        ]
        self._learned: list[tuple[int, ...]] = [() for _ in self._models]
        """Basis of each model: number of answers, and pending sets."""
        self._standings: list[Standing] = []
        self._merits: dict[int, Merit] = {}
        self._spent = 0
        for answer in task.known:
            self._answers.take(answer)
        self._answers.end_of_known()
        self._begin_first_sets()
        # other bits with more threads; for good, as searches of other campaigns compute in this process meanwhile
        ThreadpoolController().limit(limits=1)

    def _begin_first_sets(self) -> None:
        cells = self._task.cells
        size = int(np.clip(DESIGN_SHARE * (cells or np.inf) / self._aim.scenarios, FEWEST_FIRST, MOST_FIRST))
        size = max(0, size - len(self._answers.complete()) - len(self._task.start))
        drawn = self._task.sample(size, self._generator(DESIGN)) if size else self._task.start[:0]
        for row in np.concatenate([self._task.start, drawn]).tolist():
            self._answers.begin(tuple(row)).whole = True

    def _generator(self, stream: int, number: int = 0) -> np.random.Generator:
        return np.random.Generator(np.random.PCG64(np.random.SeedSequence((self._seed, stream, number))))

    @property
    def discarded(self) -> int:
        """Cells of given-up sets that were not asked."""
        return self._answers.discarded

    def tell(self, answers: Sequence[CellAnswer]) -> None:
        """Receives the answers of the oldest round that has not been told."""
        for answer in answers:
            self._answers.take(answer)

    def state(self) -> dict[str, Any]:
        """Returns the hyperparameters, and the promise and fate of each set; rounds and answers give the rest."""
        return {
            "models": [model.to_json() for model in self._models],
            "sets": [[each.promise, each.improbable, each.beaten, each.whole] for each in self._answers.sets],
        }

    def restore(
        self, rounds: Sequence[Sequence[AskedCell]], answers: Sequence[Sequence[CellAnswer]], state: Mapping[str, Any]
    ) -> None:
        """Continues a search that has just begun after these rounds."""
        for cell in (cell for cells in rounds for cell in cells):
            begun = self._answers.begin(cell.indices)
            begun.replicate = cell.replicate
            self._answers.ask(begun, cell.scenario)
            self._spent += 1
        for told in answers:
            self.tell(told)
        for begun, (*fate, was_whole) in zip(self._answers.sets, state.get("sets", ()), strict=False):
            begun.promise, begun.improbable, begun.beaten = fate
            begun.whole |= was_whole
        for model, document in zip(self._models, state.get("models", ()), strict=False):
            model.restore(document)

    def ask(self, room: int) -> Sequence[AskedCell]:
        """Returns the cells of the next round; see `drivecal.plugins.search.Search`."""
        left = self._left
        at_once = min(-(-self._aim.scenarios // TURNS), room * self._task.window)
        room = room if left is None else min(room, left)
        cells: list[AskedCell] = []
        self._ask_whole(room, cells)
        if len(cells) < room:
            self._search(room, at_once, cells)
        return cells

    @property
    def _left(self) -> int | None:
        return None if self._task.cells is None else max(0, self._task.cells - self._spent)

    def _ask(self, begun: BegunSet, scenario: int, cells: list[AskedCell]) -> None:
        self._answers.ask(begun, scenario)
        cells.append(AskedCell(begun.indices, scenario, begun.replicate))
        self._spent += 1

    def _ask_whole(self, room: int, cells: list[AskedCell]) -> None:
        for begun in self._answers.sets:
            left = self._left
            if begun.whole and len(cells) < room and (left is None or len(self._answers.missing(begun)) <= left):
                self._ask_all(begun, room, cells)

    def _ask_all(self, begun: BegunSet, room: int, cells: list[AskedCell]) -> None:
        for scenario in self._answers.missing(begun)[: room - len(cells)].tolist():
            self._ask(begun, scenario, cells)

    def _ask_deciding(self, begun: BegunSet, drawn: Floats, aim: int, count: int, cells: list[AskedCell]) -> None:
        if count > 0:
            for scenario in self._deciding(begun, drawn, aim)[:count].tolist():
                self._ask(begun, scenario, cells)

    def _search(self, room: int, at_once: int, cells: list[AskedCell]) -> None:
        """Fills the room: sets that may still win are asked on, then new ones begin; at the end first what can be completed."""
        self._learn()
        self._standings = [
            Standing.of(aim, self._values(self._answers.complete(needs)))
            for aim, needs in zip(self._aims, self._needs, strict=True)
        ]
        self._merits = {}
        # a campaign ranks sets by cells of its own: what was stored is asked of the best alone
        for begun in self._answers.asked_on:
            values, merits = self._values([begun]), [self._merit(begun.number, aim) for aim in range(len(self._aims))]
            begun.whole = any(self._aim.objectives > 1 or each(values)[0] >= each.best - 1e-9 * each.unit for each in merits)
        self._ask_whole(room, cells)
        promising = self._promising()
        for begun, drawn, aim in promising:
            if self._left is not None and len(self._answers.missing(begun, self._needs[aim])) > self._left:
                continue
            wanted = min(room - len(cells), at_once - self._answers.pending(begun))
            self._ask_deciding(begun, drawn, aim, wanted, cells)
        first = True
        while len(cells) < room and self._may_begin():
            wanted = -(-(room - len(cells)) // at_once)
            together = 1 if wanted <= TOGETHER else max(TOGETHER, -(-wanted // GROUPS))
            if not first:
                self._learn()
            first = False
            aim = self._turn(len(self._answers.sets))
            sets = self._proposed(min(wanted, together))
            if not sets:
                break
            for begun, drawn in zip(sets, self._drawn(sets), strict=True):
                self._ask_deciding(begun, drawn, aim, min(room - len(cells), at_once), cells)
        if len(cells) < room:
            given_up = [begun for begun in self._answers.sets if begun.improbable and len(self._answers.missing(begun))]
            for begun in [begun for begun, *_ in promising] + sorted(given_up, key=lambda begun: -(begun.promise or 0.0)):
                left = self._left
                if left is None or len(self._answers.missing(begun)) <= left or not begun.improbable:
                    begun.improbable = False
                    self._ask_all(begun, room, cells)

    def _may_begin(self) -> bool:
        """Returns whether enough cells are left for a new set and the open sets: with many workers, many would stay incomplete."""
        left = self._left
        reserved = sum(len(self._answers.missing(begun)) for begun in self._answers.open)
        return left is None or left - reserved >= self._needs[self._turn(len(self._answers.sets))].sum()

    def _turn(self, number: int) -> int:
        """Returns the place of the aim that a set is begun for: they take turns."""
        return number % len(self._aims)

    def _learn(self) -> None:
        pending = self._answers.unanswered[-PENDING:]
        for scenario, model in enumerate(self._models):
            sets = [begun for begun in pending if not self._answers.answered(begun)[scenario]]
            basis = (len(self._answers.order[scenario]), *(begun.number for begun in sets))
            if basis != self._learned[scenario]:
                model.learn(*self._answers.known(scenario), self._answers.points(sets))
                self._learned[scenario] = basis

    def _merit(self, number: int, aim: int | None = None) -> Merit:
        """Returns what makes one number of objectives for a set; with several, each set has a direction of its own. `aim`: the place of an
        aim, by default of that which it is begun for."""
        place = self._turn(number) if aim is None else aim
        key = number if self._aim.objectives > 1 else place
        if key not in self._merits:
            direction = self._generator(DIRECTION, key).dirichlet(np.ones(self._aim.objectives))
            reach = REACH * (key // len(self._aims) % 2)
            self._merits[key] = merit = Merit(self._aims[place], self._standings[place], direction, reach)
            if self._task.random and (complete := self._answers.complete(self._needs[place])):
                best = complete[int(np.argmax(merit(self._values(complete))))]
                merit.noise = self._noise(best, merit)
        return self._merits[key]

    def _values(self, sets: Sequence[BegunSet]) -> Floats:
        """Returns what complete sets are worth: their answers, or what models expect after samples, so that luck does not count. Values
        that are known without an answer stay as they are."""
        values = self._answers.values(sets)
        if self._task.random and len(sets):
            features = self._answers.points(sets).features
            expected = np.stack([model.expected(features) for model in self._models], axis=1)
            values = np.where(np.isnan(values), np.nan, self._task.with_given(self._rows(sets), expected))
        return values

    def _noise(self, begun: BegunSet, merit: Merit) -> float:
        """Returns the deviation of a set's merit by a sample in each scenario."""
        features, generator = self._answers.points([begun]).features, self._generator(NOISE)
        runs = [
            model.runs(features, generator.normal(size=(OPEN_DRAWS, 1, self._aim.values)), generator.random((OPEN_DRAWS, 1)))
            for model in self._models
        ]
        merits = merit(self._task.with_given(self._rows([begun]), np.stack(runs, axis=2))[:, 0])
        return float(merits[np.isfinite(merits)].std()) if np.isfinite(merits).any() else 0.0

    def _promising(self) -> list[tuple[BegunSet, Floats, int]]:
        """Gives sets up that win for no aim; returns the remaining open sets, the most promising first, with draws of their values and the
        place of an aim: first the aim of its turn, then the most promising aim."""
        sets = [each for each in self._answers.sets if not each.beaten and not each.whole and len(self._answers.missing(each))]
        if sets:
            best = self._task.with_given(self._rows(sets), np.stack([self._answers.best] * len(sets)))
            lost = [
                without_result(self._answers, sets, needs)  # a sample bounds nothing
                if self._task.random
                else beaten(aim, self._answers, sets, standing, best, needs)
                for aim, standing, needs in zip(self._aims, self._standings, self._needs, strict=True)
            ]
            for begun, is_lost in zip(sets, np.all(lost, axis=0), strict=True):
                begun.beaten = bool(is_lost)
        ranked: list[tuple[float, BegunSet, Floats, int]] = []
        left = self._answers.open
        for begun, drawn in zip(left, self._drawn(left), strict=True):
            chances = list[tuple[bool, float, int]]()
            for aim, needs in enumerate(self._needs):
                merit, is_open = self._merit(begun.number, aim), not self._answers.answered(begun)[needs].all()
                chance = merit.beaten_by(merit(drawn)) if is_open else 0.0
                if is_open and not improbable(chance, begun.promise or 0.0):
                    chances.append((aim == self._turn(begun.number), chance, aim))
            begun.improbable = not chances
            if chances:
                _, chance, aim = max(chances)
                ranked.append((chance, begun, drawn, aim))
        return [each[1:] for each in sorted(ranked, key=lambda each: -each[0])]

    def _rows(self, sets: Sequence[BegunSet]) -> Indices:
        return np.array([begun.indices for begun in sets], dtype=np.int64)

    def _draws(self, rows: Indices, count: int, generator: np.random.Generator, *, pending: bool) -> Floats:
        """Returns draws of values, shape (count, n, n_scenarios, n_values). All sets share the random numbers, so that they compare."""
        features = self._encoding(rows)
        shape = (count, 1, self._aim.scenarios, self._aim.values)
        normal = ndtri((np.argsort(generator.random(shape), axis=0) + 0.5) / count)
        uniform = (np.argsort(generator.random(shape[:3]), axis=0) + 0.5) / count
        drawn = [
            model.values(model.predict(features, pending=pending), normal[:, :, place], uniform[:, :, place])
            for place, model in enumerate(self._models)
        ]
        return self._task.with_given(rows, np.stack(drawn, axis=2))

    def _drawn(self, sets: Sequence[BegunSet], count: int = OPEN_DRAWS) -> Floats:
        """Returns draws of the values of sets, shape (n, n_draws, n_scenarios, n_values), with the answers that are known."""
        if not sets:
            return np.empty((0, count, self._aim.scenarios, self._aim.values))
        drawn = self._draws(self._rows(sets), count, self._generator(DRAWING), pending=False).transpose(1, 0, 2, 3)
        if self._task.random:
            return drawn
        known = np.stack([self._answers.answered(begun) for begun in sets])[:, np.newaxis, :, np.newaxis]
        return np.where(known, self._answers.values(sets)[:, np.newaxis], drawn)

    def _deciding(self, begun: BegunSet, drawn: Floats, aim: int) -> Indices:
        """Returns the scenarios that an aim misses, first the one whose draws alone change the merit most."""
        missing = self._answers.missing(begun, self._needs[aim])
        if not len(missing):
            return missing
        usual = np.nanmedian(np.where(np.isnan(drawn).all(axis=0), 0.0, drawn), axis=0)
        values = np.repeat(usual[np.newaxis], len(missing) * DRAWS, axis=0)
        values = values.reshape(len(missing), DRAWS, *values.shape[1:])
        for place, scenario in enumerate(missing.tolist()):
            values[place, :, scenario] = drawn[:: OPEN_DRAWS // DRAWS, scenario]
        merits = self._merit(begun.number, aim)(values.reshape(-1, *values.shape[2:])).reshape(len(missing), DRAWS)
        known = np.isfinite(merits)
        spreads = np.where(known, merits, merits[known].min() if known.any() else 0.0).std(axis=1)
        return missing[np.argsort(-spreads, kind="stable")]

    def _proposed(self, count: int) -> list[BegunSet]:
        """Begins up to `count` sets, or goes on with a set that is known in part, or repeats one with another seed: the first has the
        largest expected improvement for its cost, each further one is the best of a draw."""
        number = len(self._answers.sets)
        generator, merit = self._generator(PROPOSAL, number), self._merit(number)
        merit.least_gain = self._least_gain(number, merit)
        drawn = np.concatenate([self._task.sample(SPREAD, generator), self._children(self._parents(), NEAR, generator)])
        for *rare, wanted in self._rare_values():
            if len(rows := self._new(drawn, generator, rare)):
                count = min(count, wanted)
                break
        else:
            rare, rows = [], self._new(drawn, generator)
        merits = self._merits_of(rows, merit, number)
        for _ in range(REFINEMENTS if len(rows) else 0):
            top = merit.best_first(merits)[:REFINED]
            more = self._new(self._children(rows[top], REFINING, generator), generator, rare)
            rows, merits = np.concatenate([rows, more]), np.concatenate([merits, self._merits_of(more, merit, number)], axis=1)
        improvements = merit.improvements(merits)
        begun = None if rare else self._begun_before(merit)
        if begun is not None and (not len(rows) or begun[0] > improvements.max()):
            if len(self._answers.missing(begun[1])):
                begun[1].promise, begun[1].whole = begun[2], len(self._aims) > 1
            else:
                begun[1].replicate, begun[1].whole = self._answers.next_unasked(begun[1]), True
            return [begun[1]]
        if not len(rows):
            return []
        sets: list[BegunSet] = []
        for place in range(count):
            order = merit.best_first(merits) if place == 0 else np.argsort(-merits[(number + place) % DRAWS], kind="stable")
            chosen = next((row for row in order.tolist() if tuple(rows[row].tolist()) not in self._answers), None)
            if chosen is not None:
                chance = VALUE_PROMISE if rare else merit.beaten_by(merits[:, chosen])
                sets.append(self._answers.begin(tuple(rows[chosen].tolist()), promise=chance))
        return sets

    def _least_gain(self, number: int, merit: Merit) -> float:
        """Returns what the next set must promise: a notable gain if the search stands still and the set's number is even, else anything."""
        complete = self._answers.complete(self._needs[self._turn(number)])
        if number // len(self._aims) % 2 or self._aim.objectives > 1 or not complete:
            return 0.0
        notable = NOTABLE * merit.unit
        as_good = merit(self._values(complete)) >= merit.best - notable
        first = min(begun.number for begun, is_as_good in zip(complete, as_good, strict=True) if is_as_good)
        return notable if number - first >= STANDING_STILL * len(self._aims) else 0.0

    def _merits_of(self, rows: Indices, merit: Merit, number: int) -> Floats:
        """Returns merits of draws, shape (DRAWS, n)."""
        if not len(rows):
            return np.empty((DRAWS, 0))
        drawn = self._draws(rows, DRAWS, self._generator(DRAWING, number + 1), pending=True)
        return merit(drawn.reshape(-1, *drawn.shape[2:])).reshape(DRAWS, len(rows))

    def _begun_before(self, merit: Merit) -> tuple[float, BegunSet, float] | None:
        """Returns the most promising set that is known in part, or that may have another replicate: its expected improvement for the cost
        of a new set, itself, its chance."""
        needs = self._needs[self._turn(len(self._answers.sets))]
        sets = [begun for begun in self._dormant(merit) if len(self._answers.missing(begun, needs))]
        repeatable = self._answers.repeatable()
        first = min(BEFORE_REPEATS, (self._task.cells or np.inf) // self._aim.scenarios // 4)
        if len(self._answers.complete()) >= first and repeatable:
            order = np.argsort(-merit(self._values(repeatable)), kind="stable")[:PARENTS]
            sets += [repeatable[place] for place in order.tolist()]
        ranked: list[tuple[float, BegunSet, float]] = []
        for begun, drawn in zip(sets, self._drawn(sets), strict=True):
            merits = merit(drawn)
            gain = float(merit.improvements(merits[:, np.newaxis])[0])
            share = (len(self._answers.missing(begun, needs)) or needs.sum()) / needs.sum()
            ranked.append((gain / share if gain > 0 else gain, begun, merit.beaten_by(merits)))
        return max(ranked, key=lambda each: each[0], default=None)

    def _dormant(self, merit: Merit) -> list[BegunSet]:
        """Returns the most promising sets that are known in part: new sets are others, so that all must be looked at."""
        sets = self._answers.dormant
        if len(sets) <= DORMANT:
            return sets
        drawn = self._drawn(sets, FEW_DRAWS)
        merits = merit(drawn.reshape(-1, *drawn.shape[2:])).reshape(len(sets), FEW_DRAWS)
        return [sets[place] for place in sorted(merit.best_first(merits.T)[:DORMANT].tolist())]

    def _rare_values(self) -> list[tuple[int, int, int]]:
        """Returns choices, each with a rare value that the next sets are to have, and how many sets: the logarithm of all, as bandits try
        each arm (Lai and Robbins 1985). After a few unlucky runs of a random simulator the models promise it no gain any more."""
        sets, choices = self._answers.sets, [place for place, kind in enumerate(self._task.kinds) if kind == "choice"]
        own = [begun.promise for begun in sets if begun.promise is not None or begun.whole]
        most = len(own) // VALUE_EVERY - own.count(VALUE_PROMISE)
        if not self._task.random or not choices or most < 1:
            return []
        rows, least = self._rows(sets), int(np.ceil(np.log2(len(sets) + 1)))
        counts = ((place, np.bincount(rows[:, place], minlength=self._task.n_values[place])) for place in choices)
        counted = [(count, place, value) for place, by_value in counts for value, count in enumerate(by_value.tolist())]
        return [(place, value, min(most, least - count)) for count, place, value in sorted(counted) if count < least]

    def _new(self, rows: Indices, generator: np.random.Generator, fixed: Sequence[int] = ()) -> Indices:
        """Returns the feasible ones of repaired rows that have not begun, each once; `fixed`: a parameter and the value that all have. Rows
        nearer to a set that the aim compares with join them: no random step ends at its very values."""
        references = self._task.references
        if references is not None:
            chosen = references[generator.integers(len(references), size=len(rows))]
            back = generator.random(rows.shape) < generator.random((len(rows), 1))
            rows = np.concatenate([rows, np.where(back, chosen, rows)])
        if fixed:
            rows = rows.copy()
            rows[:, fixed[0]] = fixed[1]
        rows = self._task.repair(rows)
        if fixed:  # constraints may allow it nowhere near
            rows = rows[rows[:, fixed[0]] == fixed[1]]
        # In the order of drawing: while the models say nothing all rows are equal, and the first one is taken.
        rows = rows[np.sort(np.unique(rows, axis=0, return_index=True)[1])]
        fresh = np.array([tuple(row) not in self._answers for row in rows.tolist()], dtype=np.bool_)
        return rows[fresh & self._task.feasible(rows)]

    def _parents(self) -> Indices:
        """Returns the best complete sets, the best first; without any what a design would be."""
        complete = self._answers.complete(self._needs[self._turn(len(self._answers.sets))])
        if not complete:
            return self._task.sample(PARENTS, self._generator(DESIGN, 1))
        merits = self._merit(len(self._answers.sets))(self._values(complete))
        return np.array([complete[place].indices for place in np.argsort(-merits, kind="stable")[:PARENTS]], dtype=np.int64)

    def _children(self, parents: Indices, count: int, generator: np.random.Generator) -> Indices:
        """Returns rows near parents, shape (count, n_searched); the first parents have the most. Each child differs in one parameter or
        more, on grids by a step at least; the values of choices have no order."""
        n_values = self._task.n_values
        last, width = n_values - 1, len(n_values)
        first = parents[np.minimum((generator.random(count) ** 2 * len(parents)).astype(np.int64), len(parents) - 1)]
        second = parents[generator.integers(len(parents), size=count)]
        crossed = (generator.random((count, 1)) < CROSSED) & (generator.random((count, width)) < 0.5)
        rows = np.where(crossed, second, first)
        share = np.exp(generator.uniform(np.log(1.0 / width), 0.0, size=(count, 1)))
        moved = generator.random((count, width)) < share
        moved[np.arange(count), generator.integers(width, size=count)] = True
        deviation = np.exp(generator.uniform(np.log(SHORTEST), np.log(LONGEST), size=(count, 1)))
        steps = np.rint(generator.normal(size=(count, width)) * deviation * last).astype(np.int64)
        steps = np.where(steps == 0, 2 * generator.integers(0, 2, size=(count, width)) - 1, steps)
        stepped = np.abs(rows + steps)
        stepped = np.clip(np.where(stepped > last, 2 * last - stepped, stepped), 0, last)
        anywhere = generator.integers(0, n_values, size=(count, width))
        unordered = np.array([kind == "choice" for kind in self._task.kinds])
        return np.where(moved, np.where(unordered, anywhere, stepped), rows)


def _needed(aim: Aim) -> tuple[Bools, Bools]:
    """Returns the masks of the values that the objectives of an aim, and its constraints, need, shape (n_scenarios, n_values)."""
    shape = (aim.scenarios, aim.values)
    values = np.where(np.eye(aim.scenarios * aim.values, dtype=np.bool_), np.nan, 0.0)
    objectives, violations = aim.judge(values.reshape(-1, *shape))
    return np.isnan(objectives).any(axis=1).reshape(shape), np.isnan(violations).reshape(shape)
