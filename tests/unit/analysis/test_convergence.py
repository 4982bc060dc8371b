"""When an optimization counts as converged, on the cases of Tables 5 and 7."""

from hypothesis import given
from hypothesis import strategies as st

from drivecal.analysis.convergence import alternatives_at, best_at, converged_at


def test_the_best_has_converged_where_it_was_found_if_it_then_stays_for_ten_iterations() -> None:
    assert best_at([2.0, 3.0, 3.0, 5.0] + 10 * [5.0]) == 4
    assert best_at([2.0, 3.0, 3.0, 5.0] + 9 * [5.0]) is None
    assert best_at(11 * [4.0]) == 1


def test_the_number_of_alternatives_has_to_stay_for_more_than_five() -> None:
    assert alternatives_at(8 * [7.0], [1, 4, 11] + 5 * [11]) is None
    assert alternatives_at(9 * [7.0], [1, 4, 11] + 6 * [11]) == 3


def test_an_iteration_without_any_result_is_no_best() -> None:
    assert best_at(12 * [None]) is None
    assert best_at([None, *(11 * [3.0])]) == 2


@given(st.lists(st.integers(0, 3), max_size=30), st.integers(1, 8))
def test_from_there_on_nothing_changes_and_right_before_it_did(values: list[int], unchanged: int) -> None:
    result = converged_at([float(value) for value in values], unchanged)
    if result is not None:
        assert len(set(values[result - 1 :])) == 1
        assert len(values) - result >= unchanged
        assert result == 1 or values[result - 2] != values[result - 1]
    elif values:
        assert len(set(values[-unchanged - 1 :])) > 1 or len(values) <= unchanged


def test_alternatives_of_another_best_objective_are_others() -> None:
    """Each iteration has one set that is better than all before."""
    assert alternatives_at([5.0 + place / 6 for place in range(8)], [1] * 8) is None
    assert alternatives_at([5.0] + [6.0] * 7, [1] * 8) == 2
    assert alternatives_at([None] * 8, [0] * 8) is None
