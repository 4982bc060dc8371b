"""Docstrings, comments and pages are free of phrases that make a reader stop."""

import re

import pytest
from tests.architecture.plain_words import LINES, NAMES, OPENER, PARAMETER, PROSE, patterns_in, phrases_in


def test_there_are_no_unclear_phrases() -> None:
    assert [str(phrase) for phrase in phrases_in()] == []


@pytest.mark.parametrize(
    ("text", "pattern"),
    [
        ("Whether it is there.", OPENER),
        ("`name`: of the file.", PARAMETER),
        ("The file of\nwhich it is.", "of which"),
        ("So many rows.", "so many"),
        ("Rows from the second on.", "from ... on"),
        ("Names of those that ended.", "those that"),
        ("The folder beside it.", "beside"),
        ("If nobody waits.", "nobody"),
        ("The one that ended.", "one that"),
    ],
)
def test_an_unclear_phrase_is_noticed(text: str, pattern: str) -> None:
    assert pattern in {found for _, found in patterns_in(1, text, is_docstring=True)}


def test_every_pattern_is_tried_and_code_is_left_alone() -> None:
    assert len(PROSE) + len(NAMES) + len(LINES) + 2 == 12
    assert re.search(LINES["share without a blank"], f"{5:.0f}" + "%")
    assert list(patterns_in(1, "Returns `those that` ended.", is_docstring=True)) == []
