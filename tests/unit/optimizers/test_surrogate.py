"""The search by models of scenarios, on small functions."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.support.effort import examples
from threadpoolctl import threadpool_info  # type: ignore[import-untyped]  # it ships no types

from drivecal.analysis.aims import JudgedGoals, WeightedScore
from drivecal.analysis.goals import Aggregate, Bound, CellValue, Goals, Objective
from drivecal.domain.parameters import Indices, Kind
from drivecal.domain.scales import Direction, Scale
from drivecal.optimizers.surrogate.merits import Merit, Standing
from drivecal.optimizers.surrogate.models import Warp
from drivecal.optimizers.surrogate.plugin import SURROGATE, SurrogateSettings
from drivecal.optimizers.surrogate.search import VALUE_PROMISE
from drivecal.plugins.ports import Floats
from drivecal.plugins.search import Aim, AskedCell, CellAnswer, Search, SearchTask

COST = Scale("cost", Direction.MINIMISE, lower=0.0, upper=10.0, tolerance=0.1, failed=20.0)
POINTS = Scale("points", Direction.MAXIMISE, lower=0.0, upper=7.0, tolerance=1.0, failed=0.0, step=1.0)
N_VALUES = np.array([101, 10**9, 9, 3], dtype=np.int64)
KINDS: Sequence[Kind] = ("grid", "continuous", "integer", "choice")


def mean_of(scale: Scale, scenarios: int) -> WeightedScore:
    """Returns the mean of a score."""
    return WeightedScore({f"S{place}": 1 / scenarios for place in range(scenarios)}, scale)


def allowed(rows: Indices) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Returns which rows keep the constraint between the first and the third parameter."""
    return rows[:, 0] / 100 >= rows[:, 2] / 8 - 0.5


def repaired(rows: Indices) -> Indices:
    """Moves the first parameter."""
    rows = rows.copy()
    rows[:, 0] = np.maximum(rows[:, 0], np.ceil(100 * (rows[:, 2] / 8 - 0.5)).astype(np.int64))
    return rows


def task_of(
    aim: Aim, cells: int | None = 80, window: int = 1, n_values: Indices = N_VALUES, kinds: Sequence[Kind] = KINDS
) -> SearchTask:
    """Returns a task on the mixed space, or on another one without constraints."""
    mixed = n_values is N_VALUES

    def sample(count: int, generator: np.random.Generator) -> Indices:
        rows = generator.integers(0, n_values, size=(count, len(n_values)))
        return repaired(rows) if mixed else rows

    def anything(rows: Indices) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        return np.ones(len(rows), dtype=np.bool_)

    start = np.array([n_values // 2], dtype=np.int64)
    return SearchTask(
        n_values,
        kinds,
        aim,
        allowed if mixed else anything,
        repaired if mixed else (lambda rows: rows),
        sample,
        start,
        (),
        cells,
        window,
    )


def cost(cell: AskedCell) -> tuple[float, bool]:
    """A bowl, which lies elsewhere in each scenario; a corner of the space fails."""
    x = np.array(cell.indices) / (N_VALUES - 1)
    if x[0] + x[1] > 1.7:
        return COST.failed, True
    away = (x[:3] - 0.3 - 0.1 * cell.scenario) ** 2
    return float(5 * away.sum() + (0.3 if cell.indices[3] != 1 else 0.0)), False


def points(cell: AskedCell) -> tuple[float, bool]:
    """The same as a rating of 0 to 7."""
    value, failed = cost(cell)
    return (POINTS.failed, True) if failed else (max(0.0, 7.0 - value), False)


@dataclass
class Played:
    """The rounds and answers of a search."""

    task: SearchTask
    value: Callable[[AskedCell], tuple[float, bool]]
    room: int
    rounds: list[list[AskedCell]] = field(default_factory=list)
    answers: list[list[CellAnswer]] = field(default_factory=list)

    def play(self, search: Search, most: int | None = None) -> "Played":
        """Asks and tells until the search is over, at most `most` rounds."""
        while most is None or len(self.rounds) < most:
            asked = list(search.ask(self.room))
            if asked:
                self.rounds.append(asked)
            behind = len(self.rounds) - len(self.answers)
            if not behind:
                break
            if not asked or behind >= self.task.window:
                self.answers.append([self.answered(cell) for cell in self.rounds[len(self.answers)]])
                search.tell(self.answers[-1])
        return self

    def answered(self, cell: AskedCell) -> CellAnswer:
        """Returns the answer of a cell."""
        value, failed = self.value(cell)
        return CellAnswer(cell, (value,) * self.task.aim.values, failed)

    @property
    def cells(self) -> list[AskedCell]:
        """All cells in the order of asking."""
        return [cell for cells in self.rounds for cell in cells]

    def complete(self) -> dict[tuple[int, ...], Floats]:
        """Returns the values of the sets that are known in every scenario, shape (n_scenarios, n_values)."""
        known: dict[tuple[int, ...], dict[int, tuple[float, ...]]] = {}
        for answer in [*self.task.known, *(answer for answers in self.answers for answer in answers)]:
            known.setdefault(answer.cell.indices, {})[answer.cell.scenario] = answer.values
        scenarios = range(self.task.aim.scenarios)
        return {
            indices: np.array([values[scenario] for scenario in scenarios])
            for indices, values in known.items()
            if len(values) == len(scenarios)
        }

    def best(self) -> float:
        """Returns the best objective."""
        return float(self.task.aim.judge(np.stack(list(self.complete().values())))[0].max())


def begun(task: SearchTask, seed: int = 1) -> Search:
    """Returns a new search."""
    return SURROGATE.begin(SurrogateSettings(seed=seed), task)


def assert_same_after(rounds: int, whole: Played, seed: int = 1) -> None:
    """Asserts that a search that is resumed after these rounds asks for the same cells."""
    first = begun(whole.task, seed)
    part = Played(whole.task, whole.value, whole.room).play(first, rounds)
    state = json.loads(json.dumps(first.state(), allow_nan=False))
    again = SURROGATE.resume(SurrogateSettings(seed=seed), whole.task, part.rounds, part.answers, state)
    assert again.discarded == first.discarded
    assert part.play(again).rounds == whole.rounds


rooms = st.integers(1, 9)
windows = st.integers(1, 4)


@pytest.mark.slow
@settings(max_examples=examples(2), deadline=None)
@given(seed=st.integers(0, 1000), room=rooms, window=windows, steps=st.booleans(), data=st.data())
def test_asked_cells_are_new_and_feasible(seed: int, room: int, window: int, steps: bool, data: st.DataObject) -> None:
    task, value = task_of(mean_of(POINTS if steps else COST, 3), 60, window), points if steps else cost
    whole = Played(task, value, room).play(begun(task, seed))
    assert len(set(whole.cells)) == len(whole.cells) <= 60
    assert all(len(cells) <= room for cells in whole.rounds)
    rows = np.array([cell.indices for cell in whole.cells])
    assert allowed(rows).all()
    assert ((rows >= 0) & (rows < N_VALUES)).all()
    assert_same_after(data.draw(st.integers(0, len(whole.rounds))), whole, seed)


def test_answers_of_late_rounds_change_nothing_before_they_are_told() -> None:
    task = task_of(mean_of(COST, 3), 60, window=3)
    first, second = begun(task), begun(task)
    early = [first.ask(4) for _ in range(6)]
    late = [second.ask(4) for _ in range(6)]
    assert early == late
    assert len({cell for cells in early for cell in cells}) == 24


@pytest.mark.slow
@settings(max_examples=examples(2), deadline=None)
@given(seed=st.integers(0, 1000), steps=st.booleans())
def test_sets_given_up_for_certain_would_not_be_better(seed: int, steps: bool) -> None:
    task = task_of(mean_of(POINTS if steps else COST, 3), 60)
    value = points if steps else cost
    search = begun(task, seed)
    played = Played(task, value, 1).play(search)
    best = played.best()
    sets = {cell.indices for cell in played.cells}
    order = list(dict.fromkeys(cell.indices for cell in played.cells))
    for (_, _, beaten, _), indices in zip(search.state()["sets"], order, strict=True):
        if beaten:
            values = [[value(AskedCell(indices, scenario))[0]] for scenario in range(3)]
            assert task.aim.judge(np.array([values]))[0][0, 0] <= best + 1e-9
    assert search.discarded <= 3 * len(sets) - len(played.cells)


def test_a_search_that_stands_still_explores() -> None:
    aim = mean_of(COST, 1)
    merit = Merit(aim, Standing.of(aim, np.array([[[2.0]], [[7.0]]])), np.ones(1))
    draws = np.linspace(-1.0, 1.0, 11)
    fails, neighbour = np.where(draws < 0.3, -np.inf, -2.5), -2.05 + 0.04 * draws
    below = np.stack([-6.0 + 0.1 * draws, -4.0 + 0.1 * draws, -4.5 + 2.0 * draws, fails, neighbour], axis=1)
    assert not merit.improvements(below).any()
    assert merit.best_first(below).tolist() == [4, 2, 1, 0, 3]
    assert merit.best_first(np.column_stack([below, -6.0 + 5.0 * draws]))[0] == 5, "improvements count first"
    merit.least_gain = 0.1
    assert merit.best_first(below).tolist() == [2, 4, 1, 0, 3]


def test_a_rare_large_gain_counts_where_small_gains_do_not() -> None:
    aim = mean_of(COST, 1)
    merit = Merit(aim, Standing.of(aim, np.array([[[2.0]]])), np.ones(1))
    small, rare = np.full(64, -1.9), np.full(64, -6.0)
    rare[0] = -0.5
    draws = np.stack([small, rare], axis=1)
    assert merit.best_first(draws).tolist() == [0, 1]
    merit.least_gain = 0.2
    assert merit.best_first(draws).tolist() == [1, 0]


def test_it_beats_random_search() -> None:
    task = task_of(mean_of(COST, 4), 80)
    ours = [Played(task, cost, 1).play(begun(task, seed)).best() for seed in range(2)]
    values = []
    for seed in range(2):
        rows = task.sample(20, np.random.default_rng(seed))
        cells = [[[cost(AskedCell(tuple(row), scenario))[0]] for scenario in range(4)] for row in rows.tolist()]
        values.append(float(task.aim.judge(np.array(cells))[0].max()))
    assert min(ours) > max(values)


def test_a_small_grid_is_searched_whole_and_then_the_search_is_over() -> None:
    sizes = np.array([4, 3], dtype=np.int64)
    task = task_of(mean_of(COST, 2), None, 2, sizes, ("grid", "choice"))

    def value(cell: AskedCell) -> tuple[float, bool]:
        return abs(cell.indices[0] - 2) + (cell.indices[1] != 1) + 0.1 * cell.scenario, False

    search = begun(task)
    played = Played(task, value, 3).play(search)
    assert played.best() == pytest.approx(-0.05)
    assert search.ask(5) == []
    assert (2, 1) in played.complete()


def test_known_answers_are_asked_only_of_partly_known_sets_that_are_finished() -> None:
    task = task_of(mean_of(COST, 3), 45)
    before = Played(task, cost, 1).play(begun(task)).answers
    known = [answer for answers in before for answer in answers]
    best = max(known, key=lambda answer: -answer.values[0]).cell.indices
    known = [answer for answer in known if answer.cell.scenario != 1]
    again = replace(task, known=known, cells=15)
    played = Played(again, cost, 1).play(begun(again))
    before_it = {answer.cell for answer in known}
    finished = {cell.indices for cell in played.cells if cell not in before_it}
    assert {cell.indices for cell in before_it & set(played.cells)} <= finished
    assert {AskedCell(best, scenario) for scenario in range(3)} <= set(played.cells), "a campaign ranks sets by its own cells"
    own = Played(replace(again, known=()), cost, 1, played.rounds, played.answers)
    assert own.best() == played.best(), "and the best one first"


def test_cells_without_a_result_end_their_set() -> None:
    task = task_of(mean_of(COST, 3), 60)

    def value(cell: AskedCell) -> tuple[float, bool]:
        return (float("nan"), False) if cell.indices[3] == 0 else cost(cell)

    played = Played(task, value, 2).play(begun(task))
    later = played.cells[30:]
    assert sum(cell.indices[3] == 0 for cell in later) < len(later) / 2
    assert np.isfinite(played.best()) or np.isnan(played.best())


def two_objectives() -> JudgedGoals:
    """Two measures of a cell, and a constraint on the second one."""
    first = CellValue(measure="a", failed=20.0)
    second = CellValue(measure="b", failed=20.0)
    shares = {"S0": 0.5, "S1": 0.5}
    objectives = (
        Objective("a", first, shares, Aggregate("mean"), sign=-1),
        Objective("b", second, shares, Aggregate("max"), sign=-1),
    )
    return JudgedGoals(
        Goals(objectives, (Bound("b", second, shares, Aggregate("max"), sign=-1, limit=0.9, span=1.0),)), ("S0", "S1")
    )


@pytest.mark.slow
def test_several_objectives_spread_over_the_front_and_keep_constraints() -> None:
    task = task_of(two_objectives(), 90)

    @dataclass
    class Two(Played):
        def answered(self, cell: AskedCell) -> CellAnswer:
            x = np.array(cell.indices) / (N_VALUES - 1)
            rest = (x[0] - 0.5) ** 2 + (x[2] - 0.5) ** 2
            return CellAnswer(cell, (float(x[1] + rest), float(1 - x[1] + rest + 0.1 * cell.scenario)))

    played = Two(task, cost, 2).play(begun(task))
    values = np.stack(list(played.complete().values()))
    objectives, violations = task.aim.judge(values)
    kept = objectives[violations == 0]
    assert len(kept) > len(objectives) / 3
    front = [row for row in kept if not ((kept >= row).all(axis=1) & (kept > row).any(axis=1)).any()]
    assert np.ptp(np.array(front)[:, 0]) > 0.4


def measured(bounds: tuple[Bound, ...] = (), failed: float | None = None, weights: Sequence[float] = (1.0,)) -> JudgedGoals:
    """Returns the aim to minimise the measure `energy`, whose failed runs have a worth or none, under constraints."""
    shares = {f"S{place}": weight for place, weight in enumerate(weights)}
    energy = Objective("energy", CellValue(measure="energy", failed=failed), shares, Aggregate(), -1)
    return JudgedGoals(Goals((energy,), bounds), tuple(shares))


@dataclass
class Measured(Played):
    """`measures` has the values of a cell; the run failed if one is NaN."""

    measures: Callable[[Floats, int], tuple[float, ...]] = field(kw_only=True)

    def answered(self, cell: AskedCell) -> CellAnswer:
        values = self.measures(np.array(cell.indices) / (self.task.n_values - 1), cell.scenario)
        return CellAnswer(cell, values, failed=not np.isfinite(values).all())


def grid_task(aim: Aim, cells: int, sizes: int = 3, **changes: Any) -> SearchTask:
    """Returns a task on a grid of 41 values for each parameter."""
    n_values, kinds = np.full(sizes, 41, dtype=np.int64), [KINDS[0]] * sizes
    return replace(task_of(aim, cells, 1, n_values, kinds), start=n_values[:0].reshape(0, sizes), **changes)


def test_while_all_sets_fail_it_explores_the_whole_space() -> None:
    def value(cell: AskedCell) -> tuple[float, bool]:
        x = np.array(cell.indices) / 40
        return (3 + 2 * x[2], False) if min(x[:2]) > 0.7 else (POINTS.failed, True)

    task = grid_task(mean_of(POINTS, 1), 60)
    played = Played(task, value, 1).play(begun(task, 2))
    assert sum(not answer.failed for answers in played.answers for answer in answers) > 20


@pytest.mark.slow("True")
@pytest.mark.parametrize("random", [False, True])
def test_sets_that_all_fail_in_one_scenario_are_left(random: bool) -> None:
    def value(cell: AskedCell) -> tuple[float, bool]:
        is_sound = cell.scenario == 0 or min(cell.indices[:2]) >= 30
        return (6 - cell.indices[0] / 20, False) if is_sound else (0.0, True)

    task = grid_task(mean_of(POINTS, 2), 80, random=random)
    assert any(min(cell.indices[:2]) >= 30 for cell in Played(task, value, 1).play(begun(task, 2)).cells)


@pytest.mark.slow
def test_a_measure_with_two_limits_gives_no_set_up() -> None:
    def measures(x: Floats, scenario: int) -> tuple[float, ...]:
        return float(((x - 0.3 - 0.05 * scenario) ** 2).sum() + 1), float(30 + 20 * (x[0] - 0.3) + scenario)

    shares, gap = {"S0": 0.5, "S1": 0.5}, CellValue(measure="gap")
    low, high = (
        Bound("gap", gap, shares, Aggregate("min"), 1, 10.0, 10.0),
        Bound("gap", gap, shares, Aggregate("max"), -1, 50.0, 50.0),
    )
    both, one = (grid_task(measured(bounds, weights=(0.5, 0.5)), 40, 2) for bounds in ((low, high), (low,)))
    complete = [len(Measured(task, cost, 1, measures=measures).play(begun(task)).complete()) for task in (both, one)]
    assert complete[0] > 0.8 * complete[1] > 10


def test_a_measure_that_only_has_limits_is_not_warped(monkeypatch: pytest.MonkeyPatch) -> None:
    chosen = Warp.chosen
    noted = Mock(side_effect=chosen)
    monkeypatch.setattr(Warp, "chosen", noted)
    gap = Bound("gap", CellValue(measure="gap"), {"S0": 1.0}, Aggregate("max"), -1, 0.2, 1.0)
    task = grid_task(measured((gap,)), 10, 2)
    Measured(task, cost, 1, measures=lambda x, _: (float(x[0]), float(x[1]))).play(begun(task))
    assert {str(call.args[1]) for call in noted.call_args_list} == {"-inf", "nan"}
    assert chosen(np.exp(np.arange(9.0)), np.nan).sign == 0.0 != chosen(np.exp(np.arange(9.0)), -np.inf).sign


@pytest.mark.slow
def test_failures_without_a_worth_do_not_blind_the_search_of_a_random_simulator() -> None:
    noise = np.random.default_rng(1)

    def measures(x: Floats, scenario: int) -> tuple[float, ...]:
        del scenario
        return (float("nan") if x[0] > 0.7 else float(((x - 0.4) ** 2).sum() + 0.02 * noise.normal()),)

    task = grid_task(measured(), 50, random=True, replicates=10)
    played = Measured(task, cost, 1, measures=measures).play(begun(task, 2))
    assert any(answer.failed for answers in played.answers for answer in answers)
    assert max(cell.replicate for cell in played.cells) > 1
    assert min(float(((np.array(cell.indices) / 40 - 0.4) ** 2).sum()) for cell in played.cells) < 0.02


def test_a_set_without_a_value_that_a_constraint_bounds_is_not_the_best() -> None:
    def measures(x: Floats, scenario: int) -> tuple[float, ...]:
        return float(x[0]), float("nan") if scenario == 1 and x[0] < 0.5 else 1.0

    gap = Bound("gap", CellValue(measure="gap"), {"S1": 1.0}, Aggregate("min"), 1, 0.5, 1.0)
    task = grid_task(replace(measured((gap,)), names=("S0", "S1")), 40, 2)
    played = Measured(task, cost, 1, measures=measures).play(begun(task))
    assert min(indices[0] for indices, values in played.complete().items() if np.isfinite(values[1]).all()) == 20


def test_a_failure_in_one_scenario_leaves_the_order_of_the_others() -> None:
    weights = (0.01, 0.01, 0.02, 0.96)

    def measures(x: Floats, scenario: int) -> tuple[float, ...]:
        return (float("nan") if scenario == 0 and x[0] > 0.8 else float(((x - 0.4) ** 2).sum()),)

    task = grid_task(measured(weights=weights), 60, 2)
    played = Measured(task, cost, 1, measures=measures).play(begun(task, 2))
    assert any(answer.failed for answers in played.answers for answer in answers)
    firsts = {cell.indices: cell.scenario for cell in reversed(played.cells)}
    assert [*firsts.values()][: len(firsts) // 2].count(3) > len(firsts) // 4, "sets after the design begin with what decides"


@pytest.mark.parametrize("worth", [3.0, 1e6])
def test_the_worth_of_a_failed_run_does_not_scale_the_front(worth: float) -> None:
    points = np.array([[[-0.1], [-0.9]], [[-0.9], [-0.1]], [[-worth], [-3.0]]]).reshape(3, 1, 2)
    first, second = (Objective(name, CellValue(measure=name), {"S0": 1.0}, Aggregate(), 1) for name in ("a", "b"))
    aim = JudgedGoals(Goals((first, second)), ("S0",))
    merit = Merit(aim, Standing.of(aim, points), np.array([0.5, 0.5]))
    better = merit(np.array([[[-0.5, -0.5]], [[-0.9, -0.1]]]))
    assert better[0] > better[1]


@pytest.mark.parametrize("reach", [0.0, 0.6])
def test_a_set_that_aims_beyond_the_front_seeks_a_further_end(reach: float) -> None:
    first, second = (Objective(name, CellValue(measure=name), {"S0": 1.0}, Aggregate(), 1) for name in ("a", "b"))
    aim = JudgedGoals(Goals((first, second)), ("S0",))
    known = np.array([[[0.0, 1.0]], [[1.0, 0.0]]])
    merit = Merit(aim, Standing.of(aim, known), np.array([0.9, 0.1]), reach)
    assert (float(merit(np.array([[[1.3, -0.3]]]))[0]) > merit.best) is (reach > 0)


@pytest.mark.slow
def test_a_large_round_holds_different_sets() -> None:
    task = task_of(mean_of(COST, 3), None)
    played = Played(task, cost, 200).play(begun(task), 2)
    assert [len(cells) for cells in played.rounds] == [200, 200]
    assert len({cell.indices for cell in played.rounds[0]}) > 100


NOISE = 0.4


def noisy(cell: AskedCell) -> tuple[float, bool]:
    """A cost with noise of its own, and as much that all sets have in common."""
    value, failed = cost(cell)
    own = np.random.default_rng([*cell.indices, cell.scenario, cell.replicate]).normal()
    common = np.random.default_rng([cell.scenario, cell.replicate]).normal()
    return (value, True) if failed else (value + NOISE * (own + common), False)


def mean_cost(indices: tuple[int, ...]) -> float:
    return float(np.mean([cost(AskedCell(indices, scenario))[0] for scenario in range(2)]))


def random_task(cells: int = 110) -> SearchTask:
    return replace(task_of(mean_of(COST, 2), cells, window=2), random=True, replicates=6)


@pytest.mark.slow
def test_promising_sets_of_a_random_simulator_are_asked_again() -> None:
    played = Played(random_task(), noisy, 2).play(begun(random_task(), 2))
    assert len(set(played.cells)) == len(played.cells) <= 110
    asked: dict[tuple[int, ...], list[int]] = {}
    for cell in played.cells:
        asked.setdefault(cell.indices, []).append(cell.replicate)
    often = {indices: replicates for indices, replicates in asked.items() if max(replicates) > 1}
    assert all(sorted(replicates) == replicates and max(replicates) <= 6 for replicates in often.values())
    assert 3 <= len(often) < len(asked) / 2
    assert np.mean([mean_cost(each) for each in often]) < np.median([mean_cost(each) for each in asked])


@pytest.mark.slow
def test_a_resumed_random_search_asks_for_the_same_cells() -> None:
    whole = Played(random_task(100), noisy, 2).play(begun(random_task(100), 2))
    assert any(cell.replicate > 1 for cells in whole.rounds[:42] for cell in cells)
    assert_same_after(42, whole, 2)


def test_a_search_of_variants_is_resumed_amid_a_partly_known_set() -> None:
    task = task_of(mean_of(COST, 4), 32)
    before = Played(task, cost, 2).play(begun(task)).answers
    known = [answer for answers in before for answer in answers if answer.cell.scenario < 2]
    variants = [WeightedScore({f"S{place}": (place != left) / 3 for place in range(4)}, COST) for left in (0, 3)]
    task = replace(task, known=known, variants=variants, start=task.start[:0])
    assert_same_after(18, Played(task, cost, 1).play(begun(task)))


def test_searches_beside_each_other_compute_with_one_thread_each() -> None:
    begun(random_task()).ask(1)
    assert {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"} == {1}


def test_the_settings_are_checked() -> None:
    with pytest.raises(TypeError):
        SURROGATE.begin(Scale, task_of(mean_of(COST, 3)))  # type: ignore[arg-type]  # the wrong settings are the point


def test_a_random_search_tries_each_value_of_a_choice_again_and_again() -> None:
    """A few unlucky runs would say for good that one is worse."""
    task = task_of(mean_of(COST, 2), 100, 1, np.array([11, 11, 4], dtype=np.int64), ("grid", "grid", "choice"))
    luck = np.random.default_rng(1)

    def unlucky(cell: AskedCell) -> tuple[float, bool]:
        return 1.0 + 0.1 * cell.indices[0] + 3.0 * (cell.indices[2] != 2) + 0.3 * float(luck.normal()), False

    for room in (1, 40):
        played = Played(replace(task, random=True, replicates=5), unlucky, room)
        played.play(begun(played.task))
        sets = {cell.indices for cells in played.rounds for cell in cells}
        tried = [sum(indices[2] == value for indices in sets) for value in range(4)]
        assert min(tried) >= 3, tried
        assert tried[2] > sum(tried) / 2, "most have the best one"


@pytest.mark.parametrize(("values", "known"), [(20, 0), (4, 500)])
def test_rare_values_of_a_choice_take_a_fifth_of_the_sets(values: int, known: int) -> None:
    """Also of many values, and where many sets are known that have one of them; a value that constraints forbid takes nothing."""
    task = task_of(mean_of(COST, 2), 100, 1, np.array([11, 11, values], dtype=np.int64), ("grid", "grid", "choice"))
    luck = np.random.default_rng(1)
    rows = task.sample(known, np.random.default_rng(2))
    rows[:, 2] = 1
    before = tuple(CellAnswer(AskedCell(tuple(row), 0), (5.0,)) for row in rows.tolist())
    task = replace(task, random=True, replicates=5, known=before, feasible=lambda rows: rows[:, 2] != 3)
    played = Played(task, lambda cell: (1.0 + 3.0 * (cell.indices[2] != 2) + float(luck.normal()), False), 1)
    search = begun(task)
    played.play(search)
    assert len(played.cells) == 100
    promises = [promise for promise, *_ in search.state()["sets"]]
    assert 3 < sum(promise == VALUE_PROMISE for promise in promises) <= len({cell.indices for cell in played.cells}) / 5


def test_sets_that_are_only_known_from_before_are_not_left_out() -> None:
    task = task_of(mean_of(COST, 3), 30)
    before = task.sample(200, np.random.default_rng(1)).tolist()
    known = tuple(CellAnswer(AskedCell(tuple(row), 0), (COST.failed,)) for row in before)
    played = Played(replace(task, known=known), cost, 1)
    search = begun(played.task)
    played.play(search)
    assert search.discarded <= 3 * len({cell.indices for cells in played.rounds for cell in cells})
