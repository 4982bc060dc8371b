"""What the report says about convergence, and the iterations as tables."""

from __future__ import annotations

import re

from tests.unit.report.rows import generation
from tests.unit.report.test_front import SUMMARY

from drivecal.contracts.campaign import Campaign, CellCounts
from drivecal.report.figures import cells
from drivecal.report.sections import search


def test_the_criteria_of_tables_5_and_7_are_stated_with_what_was_found() -> None:
    steady = [generation(0, best=4.0, alternatives=1)] + [generation(i, best=6.0, alternatives=min(i, 5)) for i in range(1, 13)]
    best, alternatives = search.convergence(steady)
    assert best.startswith(
        "Converged by the paper's criterion for the best objective: found in iteration 2 of 13, it then stayed"
    )
    assert "10 iterations" in best
    assert alternatives.startswith(
        "Converged by the paper's criterion for the number of alternative optima: found in iteration 6 of 13"
    )
    best, alternatives = search.convergence(steady[:9])
    assert best.startswith("Not converged by the paper's criterion for the best objective: it last changed in iteration 2 ")
    assert alternatives.startswith(
        "Not converged by the paper's criterion for the number of alternative optima: it last changed in iteration 6 "
    )


def test_a_number_of_alternatives_is_not_older_than_the_best_objective_that_has_it() -> None:
    late = [generation(number, best=4.0 if number < 6 else 6.0, alternatives=1) for number in range(15)]
    best, alternatives = search.convergence(late)
    assert best.startswith("Not converged by the paper's criterion for the best objective: it last changed in iteration 7 ")
    assert alternatives.startswith(
        "Converged by the paper's criterion for the number of alternative optima: found in iteration 7 of 15"
    )
    assert search.convergence(late[:10])[1].startswith(
        "Not converged by the paper's criterion for the number of alternative optima"
    )


def test_iterations_without_a_result_count_and_rounding_is_no_change() -> None:
    rounding = (None, None, 0.5, 0.6, 0.6000000000000001)
    best, _ = search.convergence([generation(number, best=value) for number, value in enumerate(rounding)])
    assert "it last changed in iteration 4 of 5" in best


def test_several_objectives_have_no_criterion_of_a_single_one() -> None:
    (first,) = SUMMARY.objectives
    several = SUMMARY.model_copy(update={"objectives": [first, first]})
    assert search.convergence([generation(0, best=6.0)], several) == []
    assert len(search.convergence([generation(0, best=6.0)], SUMMARY)) == 2


def test_a_search_that_was_too_short_is_not_called_converged() -> None:
    found = search.convergence([generation(0, best=6.0), generation(1, best=6.0)])
    assert found[0].startswith("The best objective never changed in 2 iterations, too few")
    assert search.convergence([generation(0, best=None)]) == []


def test_cells_that_confirmed_the_best_set_are_told_apart_from_those_of_the_iterations() -> None:
    listed = [generation(0), generation(1)]
    requested = sum(one.requested for one in listed)
    ended = Campaign(id="a", name="a", state="succeeded", spec={"optimizer": {"iterations": 2}, "reduction": {"confirm": 20}})
    more = ended.model_copy(update={"stages": {"calibration": CellCounts(requested=requested + 3)}})
    assert search.afterwards(more, listed).startswith("After the last iteration 3 cells were asked for to confirm the best set")
    assert (
        search.afterwards(ended.model_copy(update={"stages": {"calibration": CellCounts(requested=requested)}}), listed) == ""
    )
    assert search.afterwards(more, listed[:1]) == "", "it ended within an iteration"


def test_long_searches_are_listed_in_part_with_their_ends() -> None:
    generations = [generation(number) for number in range(200)]
    shown = search.shown(generations)
    assert len(shown) == search.MOST_LINES
    assert (shown[0].iteration, shown[-1].iteration) == (0, 199)
    assert search.shown(generations[:4]) == generations[:4]
    assert "13 of 200 iterations" in search.population_table(generations)


def test_the_table_of_cells_adds_up_to_what_was_requested() -> None:
    html = cells.cells_table([generation(number) for number in range(3)])
    last = re.findall(r"<td[^>]*>([^<]*)</td>", html)[-9:]
    assert last == ["3", "120", "60", "12", "3", "0", "0", "15", "30"]
    assert sum(map(int, last[2:])) == int(last[1])
