"""Docstrings, comments and pages are free of phrases that make a reader stop."""

import pytest
from tests.architecture.plain_words import NAMES, OPENER, PARAMETER, PROSE, patterns_in, phrases_in

CEILINGS = {"docs": 4, "tests": 251}
"""Largest number of unclear phrases in folders that are not mended yet."""


@pytest.mark.parametrize("folder", ["deploy", "docs", "services", "shared", "tests", "workers"])
def test_a_folder_has_no_unclear_phrases(folder: str) -> None:
    phrases = [str(phrase) for phrase in phrases_in(folder)]
    assert len(phrases) <= CEILINGS.get(folder, 0), phrases


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
    assert len(PROSE) + len(NAMES) + 2 == 11
    assert list(patterns_in(1, "Returns `those that` ended.", is_docstring=True)) == []
