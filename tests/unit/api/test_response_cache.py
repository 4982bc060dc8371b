"""Answers that are given again a moment later."""

from __future__ import annotations

from drivecal.api import responses
from drivecal.api.responses import ResponseCache


def test_an_answer_is_given_again_for_a_moment_and_only_under_its_own_tag() -> None:
    time = 100.0
    answers = ResponseCache(clock=lambda: time)
    answers.keep("one", "a", b"1")
    assert answers.find("one", "a") == b"1"
    assert answers.find("one", "b") is None
    assert answers.find("other", "a") is None
    time += responses.REMEMBERED_SECONDS
    assert answers.find("one", "a") is None
    answers.keep("one", "b", b"2")
    assert (answers.find("one", "b"), answers.find("one", "a")) == (b"2", None)


def test_what_is_remembered_is_bounded() -> None:
    answers = ResponseCache(clock=lambda: 0.0)
    answers.keep("large", "a", b"x" * (responses.LARGEST_REMEMBERED + 1))
    assert answers.find("large", "a") is None
    for number in range(10 * responses.MOST_REMEMBERED):
        answers.keep(str(number), "a", b"x")
        assert answers.find(str(number), "a") == b"x"
    assert (
        sum(answers.find(str(number), "a") is not None for number in range(10 * responses.MOST_REMEMBERED))
        <= responses.MOST_REMEMBERED
    )
