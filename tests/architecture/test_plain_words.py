"""Docstrings, comments and pages are free of phrases that make a reader stop."""

from tests.architecture.plain_words import phrases_in


def test_there_are_no_unclear_phrases() -> None:
    assert [str(phrase) for phrase in phrases_in()] == []
