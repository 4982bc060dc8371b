"""Campaigns on random simulators: seeds, replicates, and a best set that is no fluke."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
from itertools import product
from pathlib import Path
from statistics import fmean
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import yaml
from tests.support.computed import ComputedBackend
from tests.support.databases import migrated
from tests.support.deaths import Killed
from tests.support.documentation import DOCS, blocks
from tests.support.problems import scored, store, submit_checked
from tests.support.runs import dispatcher, everything, finish, get, rows_of, run, study_of
from tests.support.values import faults_of, present

from drivecal.analysis.replicates import SetStatistics
from drivecal.analysis.robustness import directions, vehicles
from drivecal.api.results.document import results_of
from drivecal.api.tables.front import front_table, summary
from drivecal.api.tables.ranking import ranking_of, variants_of
from drivecal.campaigns.results.front import StoredRanking, front_of
from drivecal.campaigns.stages.replication import Replication
from drivecal.contracts.work import Cell, CellResult, SetupRequest
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.evaluations import Outcome
from drivecal.domain.vehicles import VehicleParameter
from drivecal.storage import evaluations, generations
from drivecal.storage.campaigns import StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance.consistency import check_counters
from drivecal.storage.outside import answers as outside_answers
from drivecal.storage.outside import sets as outside_sets
from drivecal.storage.outside.sets import OutsideSet
from drivecal.storage.references import influence_maps

NOISE = 0.3
SIMULATOR = {"kind": "process", "command": ["mysim"], "random": True}
MANIFEST = scored("noisy", {"x": {"lower": 0, "upper": 1, "step": 0.005}}, simulator=SIMULATOR)
SPEC: dict[str, Any] = {"problem": "noisy", "optimizer": {"kind": "surrogate", "seed": 1}, "budget": {"simulations": 120}}
POPULATIONS = {"kind": "random", "population": 10, "seed": 1}


def true_cost(x: float) -> float:
    return 5 + 8 * (x - 0.6) ** 2


def noisy(setup: SetupRequest, cell: Cell) -> CellResult:
    """A cost with its minimum at 0.6, noise that depends on set and seed, and noise that all sets have in common."""
    x, scenario = float(cell.parameters["x"]), sum(setup.scenario.encode())
    own = np.random.Generator(np.random.PCG64([setup.seed, round(200 * x), scenario])).normal()
    common = np.random.Generator(np.random.PCG64([setup.seed, scenario])).normal()
    return CellResult(cell.id, None, None, {"y": true_cost(x) + NOISE * (own + 2 * common)}, None, 7.0)


def opened(path: Path, **changes: Any) -> Database:
    database = migrated(f"sqlite:///{path}")
    store(database, MANIFEST | changes)
    return database


@pytest.fixture
def database(tmp_path: Path) -> Database:
    return opened(tmp_path / "drivecal.db")


def carried_out(
    database: Database, order: int = 0, driven: Callable[[Any, Cell], CellResult] = noisy, **changes: Any
) -> StoredCampaign:
    return run(database, submit_checked(database, SPEC | changes), ComputedBackend(order, driven=driven))


@pytest.mark.slow
def test_each_variant_has_a_best_set_that_is_reported(database: Database) -> None:
    def apart(setup: SetupRequest, cell: Cell) -> CellResult:
        shift = 0.4 * (setup.scenario == "city")
        return noisy(setup, replace(cell, parameters={"x": (cell.parameters["x"] + shift) % 1.0}))

    variants = {"town": {"scenarios": ["city"]}, "land": {"scenarios": ["road"]}}
    ended = carried_out(database, driven=apart, variants=variants, budget={"simulations": 120})
    assert ended.cells.runs == 120
    rows = {each.name: each for each in variants_of(StoredRanking.of(database, ended))}
    for name, x in (("town", 0.2), ("land", 0.6)):
        best = present(rows[name].best)
        assert best.parameters["x"] == pytest.approx(x, abs=0.25)
        assert None not in (best.lower, best.upper)
        assert present(rows[name].cost) > -NOISE


@pytest.mark.slow("population")
@pytest.mark.parametrize("optimizer", [SPEC["optimizer"], POPULATIONS], ids=["cells", "population"])
def test_the_best_set_is_known_by_runs_and_reported_by_others(database: Database, optimizer: dict[str, Any]) -> None:
    counted = Mock(side_effect=noisy)
    ended = carried_out(database, driven=counted, optimizer=optimizer, baseline={"x": 0.1})
    assert ended.state is CampaignState.SUCCEEDED
    assert ended.best is not None
    assert true_cost(float(ended.best.parameters["x"])) < true_cost(0.6) + NOISE
    rows = rows_of(database, ended)
    assert ended.cells.runs == sum(row.outcome is Outcome.SIMULATED for row in rows) <= 120
    best = [row for row in rows if row.parameters.floats == ended.best.parameters]
    fresh = [row.score for row in best if row.seed > 12]
    assert sorted({row.seed for row in best if row.seed > 12}) == list(range(13, 21))
    assert ended.best.objective == pytest.approx(fmean(score for score in fresh if score is not None))
    assert ended.best.lower is not None
    assert ended.best.upper is not None
    assert ended.best.standard_error is not None
    assert ended.best.lower < ended.best.objective < ended.best.upper
    baseline = present(ended.baseline)
    assert not baseline.close
    shared = [row.score for row in best if row.seed in baseline.seeds]
    assert baseline.best_objective == pytest.approx(fmean(score for score in shared if score is not None))
    assert {row.seed for row in rows if row.parameters.floats == {"x": 0.1}} >= {13, 14, 15}, "as the best set's report"
    assert not any("tolerance" in note for note in ended.notes), "predictions answer no cell"
    with database.read() as connection:
        assert list(check_counters(connection)) == []
        runs = evaluations.runs_by_purpose(connection, ended.sequence)
    assert sum(runs.values()) == counted.call_count
    assert runs == Counter(row.purpose for row in rows if row.runs) | {"start": 2, "report": 16 + 6}
    assert {row.seed > 12 for row in rows if row.purpose == "report"} == {True}
    assert runs.keys() == {"start", "search", "choice", "report"}


def test_a_ranking_that_several_requests_look_at_first_is_the_same_for_all(
    database: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = SetStatistics.bounds

    def late(known: SetStatistics, confidence: float) -> Any:
        time.sleep(0.05)  # the others would find a ranking without its bounds
        return usual(known, confidence)

    ended = carried_out(database, optimizer=POPULATIONS)
    stored = StoredRanking.of(database, ended)
    expected = [each.parameter_set for each in stored.sets.best_first()]

    def asked(_: int) -> list[int]:
        return [each.parameter_set for each in ranking_of(database, ended.id).sets.best_first()]

    monkeypatch.setattr(SetStatistics, "bounds", late)
    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(asked, range(4))) == [expected] * 4
    assert [member.solution.parameter_set for member in front_of(stored).members] == expected[:1]


def test_a_budget_too_small_for_a_further_set_is_no_stagnation(database: Database) -> None:
    ended = carried_out(database, replicates={"least": 5, "most": 20}, budget={"simulations": 30})
    assert present(ended.search).ended_by == "budget"


def test_what_is_left_after_a_search_counts_the_runs_that_choose_its_best(database: Database) -> None:
    campaign = submit_checked(database, SPEC | {"baseline": {"x": 0.1}})
    working, seen = dispatcher(database, ComputedBackend(driven=noisy)), list[tuple[int, int]]()
    while not get(database, campaign).state.ended:
        working.step()
        now = get(database, campaign)
        if now.search is not None and now.search.ended_by is not None:
            seen.append((now.progress.done, now.progress.total))
    asked = now.cells.requested
    assert asked - seen[0][0] > 20
    assert all(asked - done <= 2 * (total - done) for done, total in seen)


def test_individuals_run_under_all_seeds_of_a_round_also_where_one_of_them_is_stored(database: Database) -> None:
    whole: dict[str, Any] = {"optimizer": POPULATIONS | {"population": 40}}
    carried_out(database, budget={"simulations": 100}, replicates={"least": 1, "most": 10}, **whole)
    again = carried_out(database, budget={"simulations": 90}, replicates={"least": 2, "most": 10}, **whole)
    seeds: dict[int, set[int]] = {}
    for row in rows_of(database, again):
        if row.iteration == 0:
            seeds.setdefault(row.individual, set()).add(row.seed)
    assert again.cells.repeated > 0
    assert set(map(len, seeds.values())) == {2}


def test_equal_seeds_give_equal_campaigns_whatever_ran_before(database: Database, tmp_path: Path) -> None:
    asked: list[tuple[str, int, float, bool]] = []

    def noted(setup: SetupRequest, cell: Cell) -> CellResult:
        asked.append((setup.scenario, setup.seed, float(cell.parameters["x"]), cell.check))
        return noisy(setup, cell)

    carried_out(database, driven=noted, optimizer=POPULATIONS, budget={"simulations": 80})
    first, other = list(asked), opened(tmp_path / "other.db")
    store(other, scored("before", {"x": {"lower": 2, "upper": 3}}, simulator=SIMULATOR))
    carried_out(other, problem="before", optimizer=POPULATIONS, budget={"simulations": 40})
    asked.clear()
    carried_out(other, driven=noted, optimizer=POPULATIONS, budget={"simulations": 80})
    assert any(twice for *_, twice in first)
    assert sorted(asked) == sorted(first)


@pytest.mark.slow
def test_all_sets_meet_the_same_seeds_and_good_ones_more_of_them(database: Database) -> None:
    ended = carried_out(database, budget={"simulations": 120})
    by_set: dict[float, set[int]] = {}
    rows = [row for row in rows_of(database, ended) if row.seed <= 12]
    for row in rows:
        by_set.setdefault(float(row.parameters.floats["x"]), set()).add(row.seed)
    assert all(seeds == set(range(1, len(seeds) + 1)) for seeds in by_set.values())
    often = [x for x, seeds in by_set.items() if len(seeds) > 3]
    assert 1 <= len(often) < len(by_set) / 2
    assert fmean(map(true_cost, often)) < fmean(map(true_cost, by_set))
    with database.read() as connection:
        searched = len(generations.populations(connection, ended.sequence))
    asked = {float(row.parameters.floats["x"]) for row in rows if row.seed > 1 and row.iteration < searched}
    assert len(asked) >= 3
    assert max(map(true_cost, asked)) < true_cost(0.0)
    assert present(ended.best).noise == pytest.approx({"city": NOISE, "road": NOISE}, rel=0.7)
    assert list(present(ended.best).failure_interval or ()) == pytest.approx([0.0, 1 - 0.025 ** (1 / 16)])


def test_an_outside_optimizer_gets_its_replicates_with_their_seeds(database: Database) -> None:
    campaign = submit_checked(database, SPEC | {"optimizer": {"kind": "external"}})
    with database.transaction() as connection:
        outside_sets.add(connection, campaign, [OutsideSet("a", [10], None, 3), OutsideSet("b", [20], ["city"])])
        outside_sets.finish(connection, campaign)
    run(database, campaign, ComputedBackend(driven=noisy))
    with database.read() as connection:
        answers = outside_answers.after(connection, campaign, 0, 100)
    expected = [("a", scenario, seed) for scenario in ("city", "road") for seed in (1, 2, 3)] + [("b", "city", 1)]
    assert sorted((answer.key, answer.scenario, answer.seed) for answer in answers) == expected
    assert len({answer.score for answer in answers}) == 7


@pytest.mark.slow
def test_a_study_of_another_campaign_chooses_by_the_seeds_that_chose_there(tmp_path: Path) -> None:
    def alike(setup: SetupRequest, cell: Cell) -> CellResult:
        noise = noisy(setup, cell).metrics["y"] - true_cost(float(cell.parameters["x"]))
        return CellResult(cell.id, None, None, {"y": 5.0 + noise}, None, 7.0)

    database = opened(tmp_path / "study.db", varied={"mass": {"lower": 1, "upper": 3, "nominal": 2}})
    searched = carried_out(database, driven=alike, optimizer=POPULATIONS | {"seed": 2}, replicates={"least": 3})
    robust = {"of": searched.id, "delta": 0.05, "steps": 1, "samples": 2, "solutions": 1}
    own: dict[str, Any] = {"optimizer": None, "budget": None, "replicates": {"most": 5}}
    study = carried_out(database, driven=alike, robustness=robust, **own)
    assert [row["parameters"] for row in study_of(database, study)["items"]] == [present(searched.best).parameters]


@pytest.mark.slow
def test_the_runs_that_a_study_compares_have_one_seed_and_others_have_others(tmp_path: Path) -> None:
    def seeded(setup: SetupRequest, cell: Cell) -> CellResult:
        """Much noise that all runs of a seed share. The set matters under even seeds, the mass under the second one."""
        x, heavy = float(cell.parameters["x"]), setup.varied["mass"] - 2
        y = 2 + setup.seed * 7 % 5 + x * (setup.seed % 2 == 0) + 0.1 * heavy * (setup.seed == 2)
        return CellResult(cell.id, None, None, {"y": y}, None, 7.0)

    parameters = MANIFEST["parameters"] | {"z": {"lower": 0, "upper": 1, "step": 0.005}}
    database = opened(tmp_path / "studies.db", varied={"mass": {"lower": 1, "upper": 3, "nominal": 2}}, parameters=parameters)
    analysis: dict[str, Any] = {
        "sensitivity": {"intervals": 2, "samples": 4, "threshold": 0.001},
        "budget": None,
        "optimizer": None,
    }
    robust = {"delta": 0.1, "steps": 2, "samples": 3, "eta": 0.001, "sets": [{"x": 1, "z": 0}, {"x": 0, "z": 0}]}
    ended = carried_out(database, driven=seeded, **analysis, robustness=robust, validation={"samples": 3, "references": 2})
    rows = rows_of(database, ended)
    with database.read() as connection:
        influence = influence_maps.get(connection, present(ended.influence_map_id)).scenarios
    robustness, validation = (study_of(database, ended, stage) for stage in (StageName.ROBUSTNESS, StageName.VALIDATION))
    assert {name: each["influential"] for name, each in influence["city"].items()} == {"x": True, "z": False}
    for stage, seeds in ((StageName.SENSITIVITY, 4), (StageName.ROBUSTNESS, 3), (StageName.VALIDATION, 3)):
        assert {row.seed for row in rows if row.stage is stage} == set(range(1, seeds + 1))
    masses = vehicles([VehicleParameter("mass", "kg", 2, 1, 3)], {"mass": 2}, 0.1, directions(1, 3, 1, 1))
    first, second = robustness["items"]
    assert first["trials"][0]["deviations"]["city"] == pytest.approx(0.1 * abs(masses[1]["mass"] - 2))
    assert (first["replicates"], first["objective"], second["objective"]) == (3, pytest.approx(13 / 3), pytest.approx(14 / 3))
    assert [(row["wrong"], row["different"], row["compared"] > 0) for row in validation["items"]] == [(0, 0, True)] * 2


RATED: dict[str, Any] = {
    "replicates": {"most": 15},
    "budget": {"simulations": 160},
    "objectives": [{"measure": "y", "direction": "minimise", "failed": 5}],  # failed runs pay
    "constraints": [{"rate": 0.2}],
}


def failing(setup: SetupRequest, cell: Cell) -> CellResult:
    """A cost with its minimum at 0.6, around which half of the runs fail."""
    x = float(cell.parameters["x"])
    drawn = np.random.Generator(np.random.PCG64([setup.seed, round(200 * x), sum(setup.scenario.encode())])).random()
    failure = "collision" if abs(x - 0.6) < 0.05 and drawn < 0.5 else None
    return CellResult(cell.id, None, None, {"y": true_cost(x)}, failure, 7.0)


@pytest.mark.slow
def test_a_set_whose_failures_are_rare_enough_is_the_best(database: Database) -> None:
    rated = carried_out(database, driven=failing, **RATED | {"baseline": {"x": 0.1}})
    kept, baseline = present(rated.best), present(rated.baseline)
    assert baseline.undecided, "it had too few runs to show that it keeps the rate"
    assert 0.05 <= abs(float(kept.parameters["x"]) - 0.6) < 0.1
    assert (kept.violation, kept.undecided, kept.constraints["failures"]) == (0.0, False, 0.0)
    assert kept.constraints["failures_upper"] <= 0.2
    rows = front_table(front_of(StoredRanking.of(database, rated)))
    assert {(row.violation, row.undecided, row.constraints["failures_upper"] <= 0.2) for row in rows} == {(0.0, False, True)}


@pytest.mark.slow
def test_the_values_of_a_front_have_intervals_and_sets_that_may_belong_to_it_are_counted(database: Database) -> None:
    names = ("city", "road")
    objectives = [{"name": name, "measure": "y", "direction": "minimise", "scenarios": [name]} for name in names]
    ended = carried_out(database, objectives=objectives, budget={"simulations": 88})
    front = front_of(StoredRanking.of(database, ended))
    rows, known = front_table(front), summary(front)
    for row, name in product(rows, names):
        lower, upper = (row.uncertainty[f"{name}_{end}"] for end in ("lower", "upper"))
        assert lower < true_cost(float(row.parameters["x"])) < upper
        assert upper - lower > 2 * row.uncertainty[f"{name}_error"] > 0
    assert 1 <= known.close < known.evaluated - known.size, "some sets are surely beaten"
    assert len(front.unbeaten) == known.close + len(front.ranks)
    single = carried_out(database, objectives=objectives, budget={"simulations": 20}, replicates={"most": 1})
    for campaign, is_unknown in ((ended, False), (single, True)):
        verdicts = results_of(StoredRanking.of(database, campaign)).trust.verdicts
        assert ("noise_unknown" in {each.code for each in verdicts}) == is_unknown


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"constraints": [{"rate": 0.01}]}, "constraints[0].rate"),
        ({"budget": {"simulations": 50}}, "constraints[0].rate"),
        ({"constraints": [{"measure": "y", "at_most": 3, "rate": 0.2, "scenarios": ["city"]}]}, "constraints[0].rate"),
        ({"variants": {"eu": {"scenarios": ["city"]}, "us": {}}}, "constraints[0].rate"),
    ],
    ids=["seeds", "budget", "scenarios", "variants"],
)
def test_a_rate_that_a_campaign_cannot_show_is_refused(database: Database, changes: dict[str, Any], field: str) -> None:
    assert [each.field for each in faults_of(submit_checked, database, SPEC | RATED | changes)] == [field]


def test_a_rate_that_no_number_of_seeds_shows_is_refused_with_one_that_the_most_seeds_show(database: Database) -> None:
    spec = SPEC | RATED | {"budget": {"simulations": 50_000}}
    (problem,) = faults_of(submit_checked, database, spec | {"constraints": [{"rate": 1e-9}]})
    least, most = map(float, re.findall(r"[\d.]+e?-?\d+", problem.remedy))
    assert most == 10_000
    submit_checked(database, spec | {"replicates": {"most": int(most)}, "constraints": [{"rate": least}]})


def test_the_example_of_rates_can_be_shown_in_one_scenario(database: Database) -> None:
    example = next(block.text for block in blocks(DOCS / "pages" / "how-to" / "rates.md"))
    given = yaml.safe_load(example.replace("closest_m", "y"))
    submit_checked(database, SPEC | RATED | {"weights": {"road": 0}, "budget": {"simulations": 2000}} | given)


@pytest.mark.slow
def test_runs_are_repeated_by_seed_under_any_score(tmp_path: Path) -> None:
    gain = {"formula": "10 - y", "direction": "maximise", "range": [0, 10]}
    varied = {"mass": {"lower": 1, "upper": 3, "nominal": 2}}
    database = opened(tmp_path / "drivecal.db", scores={**MANIFEST["scores"], "gain": gain}, varied=varied)
    robust = {"delta": 0.1, "steps": 2, "samples": 3, "eta": 10, "sets": [{"x": 1}]}
    spec: dict[str, Any] = {"optimizer": POPULATIONS | {"iterations": 3}, "budget": None, "robustness": robust}
    first, again, other = (carried_out(database, evaluator=score, **spec) for score in ("cost", "cost", "gain"))
    assert first.cells.runs > 32
    assert [each.counts(StageName.ROBUSTNESS).runs > 0 for each in (first, again, other)] == [True, False, False]
    assert (again.cells.runs, again.best, other.cells.runs) == (0, first.best, 0)
    assert {row.outcome for row in rows_of(database, again)} == {Outcome.REPEATED}


def test_a_population_runs_each_set_under_the_least_number_of_seeds(database: Database) -> None:
    ended = carried_out(database, optimizer=POPULATIONS, replicates={"least": 3, "most": 3}, budget={"simulations": 96})
    seeds: dict[tuple[int, int, str], list[int]] = {}
    for row in rows_of(database, ended):
        seeds.setdefault((row.iteration, row.individual, row.scenario), []).append(row.seed)
    assert len(seeds) > 20
    assert all(of_a_set == [1, 2, 3] for of_a_set in seeds.values())  # also of the sets for which the budget sufficed at last


@pytest.mark.slow
def test_a_simulator_that_says_random_and_is_not_gets_few_further_runs(database: Database) -> None:
    def exact(_: SetupRequest, cell: Cell) -> CellResult:
        return CellResult(cell.id, None, None, {"y": true_cost(float(cell.parameters["x"]))}, None, 7.0)

    ended = carried_out(database, driven=exact, budget={"simulations": 200})
    assert sum(row.seed > 1 for row in rows_of(database, ended)) <= 26
    assert present(ended.best).standard_error in {None, 0.0}


def test_a_simulator_that_is_random_without_saying_so_gets_replicates(tmp_path: Path) -> None:
    database = opened(tmp_path / "unsaid.db", simulator=MANIFEST["simulator"] | {"random": False})

    def unsaid(setup: SetupRequest, cell: Cell) -> CellResult:
        return replace(noisy(setup, cell), repeats=False if cell.check else None)

    ended = carried_out(database, driven=unsaid, budget={"simulations": 64})
    assert ended.cells.unrepeatable > 0
    assert present(ended.best).lower is not None
    assert sum("samples" in note for note in ended.notes) == 1
    assert not any("tolerance" in note for note in ended.notes), "predictions answer no cell"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "driven"),
    [
        ({"budget": {"simulations": 160}}, noisy),
        ({"optimizer": POPULATIONS, "replicates": {"aggregate": {"quantile": 0.9}}}, noisy),
        (RATED, failing),
    ],
    ids=["cells", "quantiles of a population", "rates"],
)
def test_kills_workers_and_the_order_of_answers_change_nothing(
    tmp_path: Path, changes: dict[str, Any], driven: Callable[[Any, Cell], CellResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    results = []
    for deaths, workers in ((0, 1), (3, 8)):
        left = [deaths]
        ask = Replication.ask

        def die(replication: Replication, *arguments: Any, left: list[int] = left, ask: Any = ask) -> Any:
            if left[0] and replication._taken > -1:
                left[0] -= 1
                raise Killed("between two rounds of replicates")
            return ask(replication, *arguments)

        database = opened(tmp_path / f"{deaths}.db")
        campaign = submit_checked(database, SPEC | changes)
        with monkeypatch.context() as patched:
            patched.setattr(Replication, "ask", die)
            while not get(database, campaign).state.ended:
                with suppress(Killed):
                    finish(database, campaign, dispatcher(database, ComputedBackend(deaths, driven=driven, count=workers)))
        assert left == [0]
        seeds = [(row.iteration, row.individual, row.scenario, row.seed) for row in rows_of(database, campaign)]
        results.append((seeds, everything(database, campaign)))
    assert results[0] == results[1]


@pytest.mark.slow
def test_what_is_left_of_a_budget_tells_whether_the_best_set_is_better_than_the_baseline(tmp_path: Path) -> None:
    database = opened(tmp_path / "few.db", parameters={"x": {"lower": 0, "upper": 0.9, "step": 0.15}})
    ended = carried_out(database, baseline={"x": 0.45}, budget={"simulations": 240})
    baseline = present(ended.baseline)
    assert (ended.cells.runs < 240, baseline.close, baseline.seeds) == (True, True, list(range(13, 21)))
