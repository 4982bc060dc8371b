"""A cell is repeated if possible, else reused, else simulated."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from drivecal.contracts.specification import ReductionSpecification
from drivecal.domain.evaluations import Donor, Outcome, Purpose, RequestedCell
from drivecal.domain.parameters import ParameterSet
from drivecal.reduction.assignment import assign, is_audited, is_checked

INFLUENCE = ReductionSpecification(mode="influence", audit=0.0)
DONOR = Donor(evaluation=7, run=3, score=5, rating=5.2, failure=None)


def _set(label: str) -> ParameterSet:
    return ParameterSet(("P1",), (int.from_bytes(label.encode()),))


def _cell(individual: int, label: str, reference_key: str | None = None, scenario: str = "S1") -> RequestedCell:
    return RequestedCell(individual, scenario, _set(label), None if reference_key is None else reference_key.encode())


def _plans(cells: list[RequestedCell]) -> list[tuple[Outcome, Donor | None, int | None, bool]]:
    return [(cell.plan, cell.donor, cell.leader, cell.purpose == "audit") for cell in cells]


SIMULATED = (Outcome.SIMULATED, None, None, False)


def test_a_stored_set_is_repeated_even_where_a_reference_exists_too() -> None:
    result = assign([_cell(0, "a", "k")], INFLUENCE, 0, {("S1", _set("a")): DONOR}, {("S1", b"k"): DONOR})
    assert _plans(result) == [(Outcome.REPEATED, DONOR, None, False)]


def test_cells_of_one_population_that_share_a_key_are_simulated_once() -> None:
    cells = [_cell(0, "a", "k"), _cell(1, "b", "k"), _cell(2, "a", "k"), _cell(3, "c", "other")]
    assert _plans(assign(cells, INFLUENCE, 0, {}, {})) == [
        SIMULATED,
        (Outcome.REUSED, None, 0, False),
        (Outcome.REPEATED, None, 0, False),
        SIMULATED,
    ]


def test_exact_mode_copies_nothing_but_equal_sets() -> None:
    cells = [_cell(0, "a", "k"), _cell(1, "b", "k"), _cell(2, "b", "k")]
    result = assign(cells, ReductionSpecification(mode="exact"), 0, {}, {("S1", b"k"): DONOR})
    assert [item.plan for item in result] == [Outcome.SIMULATED, Outcome.SIMULATED, Outcome.REPEATED]


def test_off_simulates_everything() -> None:
    cells = [_cell(0, "a", "k"), _cell(1, "a", "k")]
    planned = assign(cells, ReductionSpecification(mode="off"), 0, {("S1", _set("a")): DONOR}, {("S1", b"k"): DONOR})
    assert _plans(planned) == [SIMULATED] * 2


def test_an_audited_cell_is_simulated_and_remembers_the_donor_that_was_not_trusted() -> None:
    cells = [_cell(0, "a", "k"), _cell(1, "a", "k")]
    result = assign(cells, ReductionSpecification(mode="influence", audit=1.0), 0, {}, {("S1", b"k"): DONOR})
    assert _plans(result) == [(Outcome.SIMULATED, DONOR, None, True), (Outcome.REPEATED, None, 0, False)]


@given(st.integers(0, 2**63 - 1))
def test_the_audited_share_is_close_to_what_was_asked(seed: int) -> None:
    cells = [_cell(i, f"set {i}") for i in range(2_000)]
    audited = sum(is_audited(cell.scenario, cell.parameters, share=0.2, seed=seed) for cell in cells)
    assert 280 < audited < 520
    assert {is_checked("S1", number, _set("a"), 0.5, seed) for number in range(60)} == {False, True}, "seeds are drawn apart"


_keys = st.sampled_from("abcdef")
_cells = st.lists(st.tuples(st.integers(0, 20), _keys, _keys, st.sampled_from(["S1", "S2"])), max_size=40)


@given(_cells, st.sampled_from(["off", "exact", "influence"]), st.floats(0, 1), st.integers(0, 99))
def test_leaders_are_earlier_and_simulated(raw: list[tuple[int, str, str, str]], mode: str, audit: float, seed: int) -> None:
    # the class of a set is a function of the set: equal sets share their reference key
    cells = [_cell(individual, key + reference, reference, scenario) for individual, key, reference, scenario in raw]
    policy = ReductionSpecification(mode=mode, audit=audit)  # type: ignore[arg-type]  # sampled from the literal's values
    result = assign(cells, policy, seed, {}, {})
    for position, one in enumerate(result):
        assert one.donor is None
        if one.leader is not None:
            assert one.leader < position
            assert result[one.leader].plan is Outcome.SIMULATED
            assert cells[one.leader].scenario == cells[position].scenario
        if one.plan in {Outcome.REPEATED, Outcome.REUSED} or one.purpose == "audit":
            assert one.leader is not None
        if one.plan is Outcome.REPEATED:
            assert one.leader is not None
            assert cells[one.leader].parameters == cells[position].parameters


def test_no_reference_answers_a_given_set_which_answers_others() -> None:
    cells = [replace(_cell(0, "a", "k"), purpose=Purpose.START), _cell(1, "b", "k")]
    stored = assign(cells, INFLUENCE, 0, {}, {("S1", b"k"): DONOR})
    assert _plans(stored) == [SIMULATED, (Outcome.REUSED, DONOR, None, False)]
    assert _plans(assign(cells, INFLUENCE, 0, {}, {})) == [SIMULATED, (Outcome.REUSED, None, 0, False)]
    known = assign(cells[:1], INFLUENCE, 0, {("S1", _set("a")): DONOR}, {})
    assert _plans(known) == [(Outcome.REPEATED, DONOR, None, False)]
