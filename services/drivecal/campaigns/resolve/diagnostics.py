"""Collects all problems of a specification, so that a user sees them at once."""

from collections.abc import Callable
from typing import TypeVar

from drivecal.domain.errors import InvalidInputError, Problem

T = TypeVar("T")
MOST_FINDINGS = 1_000
"""A hostile megabyte of start sets has a hundred times as many."""


class Diagnostics:
    """Problems in order of discovery, and notes."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []
        self.notes: list[str] = []

    def add(self, field: str, message: str, remedy: str = "") -> None:
        """Adds a problem, up to a limit."""
        if len(self.problems) < MOST_FINDINGS:
            self.problems.append(Problem(field, message, remedy))

    def attempt(self, make: Callable[[], T]) -> T | None:
        """Returns what `make` returns; None if it raises InvalidInputError, whose problems are added."""
        try:
            return make()
        except InvalidInputError as error:
            self.problems.extend(error.problems)
            return None

    def found(self, part: T | None) -> T:
        """Returns a part that is there if there are no problems. Raises InvalidInputError with all problems."""
        self.raise_if_any()
        if part is None:
            raise AssertionError("a part is missing without a finding")
        return part

    def raise_if_any(self) -> None:
        """Raises InvalidInputError with all problems."""
        if self.problems:
            raise InvalidInputError(*self.problems)
