"""Regions of one parameter in one scenario: what is confirmed, given back, and left open by the global analysis."""

from collections.abc import Mapping
from decimal import Decimal

import numpy as np
from tests.unit.sensitivity.synthetic import space_of

from drivecal.domain.influence import EVERYWHERE, Influence
from drivecal.sensitivity.designs import Floats
from drivecal.sensitivity.scenario import ScenarioState, interval_edges

QUIET, LOUD = np.zeros(4), np.full(4, 1.0)
STEPS = np.full(4, 0.5)


def state_after_intervals(influential: str) -> ScenarioState:
    """One parameter on a grid of 81, of whose 8 intervals those marked # are influential."""
    state = ScenarioState(space_of(81), [interval_edges(81, 8)], threshold=0.5)
    effects = np.array([[LOUD if mark == "#" else QUIET for mark in influential]])
    state.take_intervals(np.ones(3), effects, np.broadcast_to(STEPS, effects.shape))
    return state


def confirm(state: ScenarioState, answers: Mapping[str, Floats]) -> list[tuple[str, int, int]]:
    """Answers one round of confirmation by side; gives what was waiting."""
    waiting = [(item.side, *state.bounds(item)) for item in state.waiting]
    effects = np.array([answers[entry.side] for entry in state.waiting])
    state.take_confirmations(effects, np.broadcast_to(STEPS, effects.shape))
    return [(str(side), lower, upper) for side, lower, upper in waiting]


def influence_after_global(state: ScenarioState, effects: Floats, scores: Floats | None = None) -> Influence:
    state.take_overall(np.ones(3) if scores is None else scores, effects[np.newaxis], STEPS[np.newaxis])
    return state.result().parameters["P1"].influence


def test_a_confirmed_region_is_cut() -> None:
    state = state_after_intervals("....##..")
    assert confirm(state, {"below": QUIET, "above": QUIET}) == [("below", 0, 39), ("above", 61, 80)]
    assert not state.waiting
    assert [part.tolist() for part in state.box()] == [[40], [60]]
    assert influence_after_global(state, LOUD) == Influence(True, Decimal(4), Decimal(6))


def test_a_refuted_region_gives_back_its_inner_half_and_the_rest_is_confirmed_anew() -> None:
    state = state_after_intervals(".....#..")
    assert confirm(state, {"below": LOUD, "above": QUIET}) == [("below", 0, 49), ("above", 61, 80)]
    assert confirm(state, {"below": LOUD}) == [("below", 0, 19)]
    assert confirm(state, {"below": QUIET}) == [("below", 0, 9)]
    assert influence_after_global(state, LOUD) == Influence(True, Decimal(1), Decimal(6))
    confirmations = state.result().parameters["P1"].confirmations
    assert [(confirmation.lower, confirmation.upper, confirmation.verdict.influential) for confirmation in confirmations] == [
        (0, 49, True), (61, 80, False), (0, 19, True), (0, 9, False),
    ]  # fmt: skip


def test_a_region_that_is_never_confirmed_is_not_cut_at_all() -> None:
    state = state_after_intervals("..#####.")
    for _ in range(2):
        confirm(state, {"below": LOUD, "above": LOUD})
    assert not state.waiting
    assert influence_after_global(state, LOUD) == EVERYWHERE


def test_a_whole_range_that_turns_out_influential_is_given_back_whole() -> None:
    state = state_after_intervals("........")
    assert confirm(state, {"whole": LOUD}) == [("whole", 0, 80)]
    assert not state.waiting
    assert influence_after_global(state, LOUD) == EVERYWHERE


def test_a_parameter_without_influential_intervals_must_be_without_influence_globally_too() -> None:
    for effects, influence in ((QUIET, Influence(influential=False)), (LOUD, EVERYWHERE)):
        state = state_after_intervals("........")
        confirm(state, {"whole": QUIET})
        assert influence_after_global(state, effects) == influence


def test_a_parameter_below_the_threshold_in_the_influential_box_awaits_an_analysis_of_its_whole_range() -> None:
    for whole, influence in ((QUIET, Influence(influential=False)), (LOUD, Influence(True, Decimal(2), Decimal(6)))):
        state = state_after_intervals("..####..")
        confirm(state, {"below": QUIET, "above": QUIET})
        influence_after_global(state, QUIET)
        assert confirm(state, {"whole": whole}) == [("whole", 0, 80)]
        assert not state.waiting
        parameter = state.result().parameters["P1"]
        assert parameter.influence == influence
        assert parameter.confirmations[-1].verdict.influential == (whole is LOUD)


def test_a_whole_range_that_turned_out_influential_stays_so_whatever_the_global_analysis_finds() -> None:
    state = state_after_intervals("........")
    confirm(state, {"whole": LOUD})
    assert influence_after_global(state, QUIET) == EVERYWHERE
    assert not state.waiting


def test_a_global_analysis_without_any_score_changes_nothing() -> None:
    state = state_after_intervals("..####..")
    confirm(state, {"below": QUIET, "above": QUIET})
    assert influence_after_global(state, QUIET, scores=np.array([0, np.nan, 0])) == Influence(True, Decimal(2), Decimal(6))


def test_a_region_of_a_single_value_needs_no_confirmation() -> None:
    state = ScenarioState(space_of(5), [interval_edges(5, 4)], threshold=0.5)
    effects = np.array([[QUIET, LOUD, QUIET, QUIET]])
    state.take_intervals(np.ones(3), effects, np.broadcast_to(STEPS, effects.shape))
    assert [(item.side, *state.bounds(item)) for item in state.waiting] == [("above", 3, 4)]
