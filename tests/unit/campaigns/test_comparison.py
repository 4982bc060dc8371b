"""Which campaigns a comparison consists of."""

from collections import Counter
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter
from tests.support.runs import EXPERT_SPACE
from tests.support.values import faults_of, present

from drivecal.campaigns.comparison import CONFIRMED, resolve_comparison, runs_of, tag_of
from drivecal.contracts.comparison import ComparisonSpecification
from drivecal.contracts.input_errors import validated
from drivecal.contracts.strict_json import Tag
from drivecal.optimizers.genetic import pairs_per_generation
from drivecal.plugins import registry
from drivecal.plugins.search import SearchPlugin

COMPARED: dict[str, Any] = {
    "fixed": {"P9": 5, "P10": 10, "P11": 100},
    "catalogue": ["S3"],
    "optimizers": [{"kind": "genetic", "mutation": 0.2}, {"kind": "genetic", "mutation": 0.5}],
    "populations": [20, 10],
    "seeds": [3, 1, 2],
}


def specification(**changes: Any) -> ComparisonSpecification:
    return validated(ComparisonSpecification, COMPARED | changes)


def test_runs_come_by_optimizer_population_seed_and_reduction() -> None:
    runs = runs_of(specification(sensitivity={"map": "m"}, reductions=["off", {"mode": "influence", "audit": 0.1}]))
    assert [run.name for run in runs[:3]] == [
        "comparison: genetic mutation=0.2, population 20, seed 3, off",
        "comparison: genetic mutation=0.2, population 20, seed 3, influence",
        "comparison: genetic mutation=0.2, population 20, seed 1, off",
    ]
    assert runs[-1].name == "comparison: genetic mutation=0.5, population 10, seed 2, influence"
    assert len({run.name for run in runs}) == len(runs) == 2 * 2 * 3 * 2
    last = runs[-1]
    chosen = {"kind": "genetic", "mutation": 0.5, "population": 10, "iterations": 80, "start": "lhs", "seed": 2}
    assert present(last.optimizer).model_dump(exclude={"start_sets", "start_results"}) == chosen
    assert (last.reduction.mode, last.reduction.audit) == ("influence", 0.1)
    assert last.sensitivity is not None
    assert all(run.reduction.isolated for run in runs)
    assert runs[-2].sensitivity is None, "an analysis that the run does not use would count"
    assert last.fixed == COMPARED["fixed"]


@pytest.mark.parametrize(
    ("given", "confirm"),
    [
        ("predicted", CONFIRMED),
        ("both", CONFIRMED),
        ({"mode": "both", "confirm": 20}, 20),
        ({"mode": "predicted", "confirm": 0}, 0),
        ({"mode": "exact", "confirm": 5}, 5),
    ],
)
def test_modes_with_scores_of_others_confirm_alike(given: Any, confirm: int) -> None:
    wanted = specification(sensitivity={"samples": 2, "intervals": 2}, reductions=["off", given], iterations=2)
    stored = validated(ComparisonSpecification, resolve_comparison(wanted).specification.model_dump(mode="json"))
    assert [runs_of(each)[1].reduction.confirm for each in (wanted, stored)] == [confirm, confirm]


def test_equal_keys_have_equal_tags_and_names_are_in_them() -> None:
    assert tag_of("Ours & theirs", "key") == tag_of("Ours & theirs", "key")
    assert tag_of("Ours & theirs", "key").startswith("ours-theirs-")
    assert tag_of("x" * 200, "key") != tag_of("x" * 200, "other")
    assert TypeAdapter(Tag).validate_python(tag_of("\u4e00" * 200, "key"))


def test_the_cost_is_that_of_all_runs() -> None:
    problem = resolve_comparison(specification(iterations=5))
    assert problem.proposed == 2 * 3 * (20 + 10) * 5
    assert problem.at_most == 2 * 3 * sum(size + 4 * pairs_per_generation(size, 0.8, 0.7) for size in (20, 10))


@pytest.mark.parametrize("kind", ["genetic", "swarm", "random"])
@pytest.mark.parametrize("start", ["halton", "lhs"])
def test_every_optimizer_begins_with_the_population_that_its_size_and_seed_give(kind: str, start: str) -> None:
    n_values = np.array([59, 201, 201, 2001, 1501, 101, 201, 2001])

    def first(name: str, population: int, seed: int) -> list[list[int]]:
        plugin = registry.optimizer(name)
        assert not isinstance(plugin, SearchPlugin)
        document = {"kind": name, "population": population, "start": start, "seed": seed}
        result: list[list[int]] = plugin.create(plugin.settings.model_validate(document), n_values).ask().population.tolist()
        return result

    assert first(kind, 12, 1) == first("genetic", 12, 1)
    assert (first(kind, 12, 1) == first(kind, 12, 2)) == (start == "halton")


def test_everything_that_is_wrong_is_told_at_once_and_once() -> None:
    assert [
        problem.field
        for problem in faults_of(
            resolve_comparison,
            specification(
                parameters=EXPERT_SPACE,
                fixed={"P9": 7},
                optimizers=[{"kind": "swarm", "c1": 2.0, "c2": -1.0}, {"kind": "genetic", "colour": 1}],
            ),
        )
    ] == ["optimizers[0].c1", "optimizers[0].c2", "fixed.P9", "optimizers[1].colour"]


def test_a_search_by_the_cell_has_one_campaign_for_all_populations(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivecal.campaigns.comparison.LARGEST_RUNS", 9)
    document = {"optimizers": [{"kind": "surrogate"}, {"kind": "genetic"}], "populations": [20, 50], "seeds": [1, 2, 3]}
    problem = resolve_comparison(ComparisonSpecification.model_validate(document | {"budget": {"simulations": 120}}))
    chosen = [(run.optimizer.kind, run.optimizer.population) for run in problem.runs if run.optimizer is not None]
    assert Counter(chosen) == {("surrogate", None): 3, ("genetic", 20): 3, ("genetic", 50): 3}
    assert problem.at_most == 9 * 120
