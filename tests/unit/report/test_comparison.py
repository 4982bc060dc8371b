"""The report of a comparison: every run is drawn, and the page needs nothing else."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.lines import Line2D
from tests.unit.report.rows import generation

from drivecal.analysis import comparison as analysis
from drivecal.campaigns.comparisons.results import ComparisonResults as Rows
from drivecal.campaigns.comparisons.results import pair_row
from drivecal.contracts.campaign import Best, Campaign
from drivecal.contracts.comparison import ComparedRun
from drivecal.plugins.ports import Floats
from drivecal.report.comparison import summary, write_comparison
from drivecal.report.data import ComparisonData
from drivecal.report.figures.comparison import effects_figure, optima_figure, search_figures

OPTIMIZERS, POPULATIONS, SEEDS, REDUCTIONS = ("genetic", "swarm"), (10, 20), (1, 2, 3), ("exact", "influence")
ITERATIONS = 4


def findings() -> ComparisonData:
    """All swarms end at 6, genetic searches at 7; with the map the third seed of the latter ends at 6.5."""
    runs, courses, listed = [], [], {}
    for number, one in enumerate(product(OPTIMIZERS, POPULATIONS, SEEDS, REDUCTIONS)):
        conditions = analysis.Conditions(*one)
        optimum = 6.0 if conditions.optimizer == "swarm" else 6.5 if conditions[2:] == (3, "influence") else 7.0
        taken = conditions.population if conditions.reduction == "exact" else conditions.population // 2
        figures = [
            generation(
                i, best=5.0 if i == 0 else optimum, rating=optimum + 0.1, requested=taken + 5, predicted=5, repeated=0, reused=0
            )
            for i in range(ITERATIONS)
        ]
        listed[f"{number:032x}"] = figures
        bests = [one.best for one in figures]
        courses.append(analysis.Course(conditions, bests, bests, [1] * ITERATIONS, bests, [taken] * ITERATIONS, ended=True))
        runs.append(
            ComparedRun(
                run=f"{number:032x}",
                **conditions._asdict(),
                state="succeeded",
                iterations=ITERATIONS,
                requested=taken * ITERATIONS,
                simulations=taken * ITERATIONS,
                analysis=0,
                best=optimum,
                simulated_best=optimum,
                rating=optimum + 0.1,
                alternatives=1,
                mean=5.0,
                converged_at=2 if number == 0 else None,
                simulations_to_converge=20 if number == 0 else None,
                alternatives_converged_at=None,
                success=optimum == 7.0,
            )
        )
    rows = Rows([], courses)
    best = Best(objective=7.0, parameters={"P1": 1.0}, scores={"S3": 7}, alternatives=1)
    campaign = Campaign(
        id="c" * 32,
        name="a <comparison>",
        kind="comparison",
        state="succeeded",
        best=best,
        spec={"catalogue": ["S3"], "seeds": [1, 2, 3]},
    )
    pairs = analysis.pairs(courses)
    told = {one.conditions: run.run for one, run in zip(courses, runs, strict=True)}
    return ComparisonData(
        campaign,
        runs,
        rows.groups(),
        [pair_row(one, told[one.run.conditions], told[one.base.conditions]) for one in pairs],
        rows.effects(),
        listed,
    )


def points(line: Line2D) -> Floats:
    """Shape (n, 2)."""
    return np.asarray(line.get_xydata(), dtype=np.float64)


def test_the_figures_of_optimizers_show_every_run_and_not_only_the_best() -> None:
    found = findings()
    genetic, swarm = search_figures(found.runs, found.generations)
    assert (genetic.name, swarm.name) == ("search-genetic", "search-swarm")
    assert genetic.caption.startswith("All runs of genetic. ")
    assert swarm.caption.startswith("All runs of swarm. ")
    for drawn in (genetic, swarm):
        left, right = drawn.figure.axes
        assert len([one for one in left.lines if len(points(one)) == ITERATIONS]) == 12
        assert len(right.lines) == 12
        np.testing.assert_equal(points(right.lines[0])[:, 0], [10, 20, 30, 40])
    heights = {round(float(points(one)[-1, 1]), 9) for one in swarm.figure.axes[0].lines}
    assert len(heights) == 12, "lines of equal value lie beside each other"
    assert max(abs(one - 6.0) for one in heights) < 0.1


def test_final_optima_and_pairs_have_a_mark_for_each_run() -> None:
    found = findings()
    for panel in optima_figure(found.runs).figure.axes:
        assert sum(len(points(one)) for one in panel.lines) == len(found.runs)
    left, right = effects_figure(found.pairs, found.effects).figure.axes
    assert sum(len(points(one)) for one in right.lines) == len(found.pairs) == 12
    assert {-0.5, 0.0} == {float(x) for one in left.lines if one.get_marker() == "o" for x in points(one)[:, 0]}


def test_the_page_says_what_was_found_and_needs_nothing_else(tmp_path: Path) -> None:
    found = findings()
    sentences = summary(found)
    assert re.search(r"7\.0000: genetic in 10 of 12 runs, swarm in 0 of 12 runs", sentences[0])
    assert (
        "in 12 pairs of searches with the same seed, 0 ended with a better optimum, 10 with an equal and 2 with a worse one"
        in sentences[1]
    )
    assert "50.0% less" in sentences[1]
    written = write_comparison(found, {"comparison": [b"run\n", b"1\n"]}, tmp_path)
    names = [path.relative_to(tmp_path).as_posix() for path in written]
    assert names[-1] == "index.html"
    assert {"figures/search-genetic.svg", "figures/reduction.png", "tables/comparison.csv", "comparison.json"} <= set(names)
    page = written[-1].read_text()
    assert "a &lt;comparison&gt;" in page
    assert not re.search(r"<script|https?://(?!www\.w3\.org)", page)
    assert "drivecal compare-optimizers comparison.json --wait" in page
    assert all(f'href="{name}"' in page for name in names[:-1])


@pytest.mark.slow
def test_what_a_run_believed_stands_beside_what_it_has(tmp_path: Path) -> None:
    found = findings()
    runs = [
        one.model_copy(update={"best": 7.5, "confirmations": 4321}) if one.reduction == "influence" else one
        for one in found.runs
    ]
    believed = replace(found, runs=runs)
    assert summary(believed) == summary(found)
    page = write_comparison(believed, {}, tmp_path)[-1].read_text()
    assert "a search prefers sets whose scores are too good" in page
    assert page.count(">7.5000<") == page.count(">4,321<") == 12
    assert ">confirming<" in page
    assert ">believed<" in page


def renamed(found: ComparisonData, **labels: str) -> ComparisonData:
    """With other labels of the optimizers."""

    def changed(rows: Sequence[Any]) -> list[Any]:
        return [one.model_copy(update={"optimizer": labels.get(one.optimizer, one.optimizer)}) for one in rows]

    return replace(
        found,
        runs=changed(found.runs),
        groups=changed(found.groups),
        pairs=changed(found.pairs),
        effects=changed(found.effects),
    )


@pytest.mark.slow
def test_labels_are_text_and_neither_formulas_nor_patterns_nor_names_of_files(tmp_path: Path) -> None:
    found = renamed(findings(), genetic=r"a $\frac$ \d", swarm=r"A $\frac$ (d)")
    figures = [path.name for path in write_comparison(found, {}, tmp_path) if path.suffix == ".svg"]
    assert figures == ["search-a-frac-d.svg", "search-a-frac-d-2.svg", "optima.svg", "reduction.svg"]
    assert r"a $\frac$ \d: individuals per iteration" in (tmp_path / "figures" / figures[0]).read_text()


def test_an_optimizer_of_which_nothing_is_answered_yet_spoils_no_report() -> None:
    found = findings()
    begun = [one.model_copy(update={"best": None, "rating": None}) if one.optimizer == "swarm" else one for one in found.runs]
    first = [generation(0, best=None, rating=None, mean=None, minimum=None)]
    listed = {one.run: first if one.best is None else found.generations[one.run] for one in begun}
    assert [one.alt for one in search_figures(begun, listed)] == [
        "12 runs of genetic; the best objective found is 7.000.",
        "12 runs of swarm; nothing is answered yet.",
    ]


def test_a_comparison_without_any_result_has_a_report(tmp_path: Path) -> None:
    empty = ComparisonData(Campaign(id="c" * 32, name="queued", kind="comparison", state="queued"), [], [], [], [], {})
    assert "queued" in write_comparison(empty, {}, tmp_path)[-1].read_text()
