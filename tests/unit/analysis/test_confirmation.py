"""The best set of a search is simulated where it owes scores to references, until one is as good as it seems."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.support.values import by_score, present

from drivecal.analysis.confirmation import Confirming
from drivecal.analysis.solutions import Ranking
from drivecal.domain.evaluations import CellScore

LATER = 9
"""An iteration behind the last one."""


def copied(number: int, score: int, *, own: bool = False) -> CellScore:
    return CellScore(number, "S1", score, float(score), own, 0, number)


def confirmed(answers: list[CellScore], truth: dict[int, int | None], limit: int) -> tuple[Ranking, Confirming]:
    """Carried out to its end; `truth` is what simulations give."""
    ranking = by_score({"S1": 1})
    ranking.add(answers)
    best = present(ranking.best())
    confirmation = Confirming(limit, best[0].objective)
    while (chosen := confirmation.choose(ranking)) is not None:
        confirmation.tried.append(chosen.parameter_set)
        score = truth[chosen.parameter_set]
        rating = None if score is None else float(score)
        ranking.add([CellScore(chosen.parameter_set, "S1", score, rating, True, LATER + len(confirmation.tried), 0)])
    return ranking, confirmation


def test_sets_are_tried_from_the_best_on_until_one_has_only_scores_of_its_own() -> None:
    believed = [copied(1, 5), copied(2, 7), copied(3, 6), copied(4, 5, own=True), copied(5, 4)]
    ranking, confirmation = confirmed(believed, {2: 3, 3: 6}, limit=10)
    assert confirmation.tried == [2, 3]
    best = ranking.best_first()[0]
    assert (best.parameter_set, best.objective, best.reused) == (3, 6.0, ())
    outcome = confirmation.outcome(best)
    assert (outcome.state, outcome.objective, outcome.believed, outcome.tried) == ("confirmed", 6.0, 7.0, 2)


def test_a_set_whose_simulation_fails_is_tried_once_and_told() -> None:
    ranking, confirmation = confirmed([copied(1, 7), copied(2, 6), copied(3, 5, own=True)], {1: None, 2: 4}, limit=10)
    assert confirmation.tried == [1, 2]
    outcome = confirmation.outcome(ranking.best_first()[0])
    assert (outcome.state, outcome.copied, outcome.failed) == ("unconfirmed", ["S1"], True)


def test_no_more_than_the_limit_are_tried_and_that_is_told() -> None:
    ranking, confirmation = confirmed([copied(number, 7) for number in range(5)], dict.fromkeys(range(5), 1), limit=3)
    assert confirmation.tried == [0, 1, 2]
    outcome = confirmation.outcome(ranking.best_first()[0])
    assert (outcome.state, outcome.failed, outcome.tried) == ("unconfirmed", False, 3)


@pytest.mark.parametrize(("believed", "state"), [(7, "untried"), (5, "confirmed")])
def test_sets_that_are_believed_to_be_better_and_were_not_tried_are_named(believed: int, state: str) -> None:
    ranking = by_score({"S1": 1})
    own = copied(1, 5, own=True)
    predicted = [replace(copied(number, believed), predicted=True, rating=believed + 0.3) for number in (2, 3)]
    ranking.add([own, *predicted])
    confirmation = Confirming(1, 5.0, [2])
    ranking.add([replace(copied(2, 4, own=True), iteration=LATER)])
    assert confirmation.choose(ranking) is None
    untried = present(ranking.doubtful(confirmation.tried))
    assert untried.parameter_set == 3
    outcome = confirmation.outcome(ranking.best_first()[0], untried)
    assert (outcome.state, outcome.reach) == (state, 7.0 if state == "untried" else None)


@given(
    believed=st.lists(st.tuples(st.integers(0, 7), st.booleans()), min_size=1, max_size=12),
    off=st.lists(st.integers(-3, 1), min_size=12, max_size=12),
)
def test_the_confirmed_best_has_scores_of_its_own(believed: list[tuple[int, bool]], off: list[int]) -> None:
    answers = [copied(number, score, own=own) for number, (score, own) in enumerate(believed)]
    truth: dict[int, int | None] = {number: max(0, score + off[number]) for number, (score, _) in enumerate(believed)}
    ranking, confirmation = confirmed(answers, truth, limit=100)
    best, *others = ranking.best_first()
    assert not best.reused
    assert len(set(confirmation.tried)) == len(confirmation.tried)
    assert best.objective == max(item.objective for item in [best, *others] if not item.reused)
    assert not any(other.reused and ranking.order(other) < ranking.order(best) for other in others), (
        "nothing that only seems better is left"
    )
