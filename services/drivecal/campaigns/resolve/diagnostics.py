"""Collects what is wrong with a specification, so that a user sees all of it at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from drivecal.domain.errors import InvalidInputError, Problem

T = TypeVar("T")
MOST_FINDINGS = 1_000
"""A hostile megabyte of start sets has a hundred times as many."""


class Diagnostics:
    """Problems in the order in which they were found."""

    def __init__(self) -> None:
        self.problems: list[Problem] = []

    def add(self, field: str, message: str, remedy: str = "") -> None:
        """Adds a problem, up to a limit."""
        if len(self.problems) < MOST_FINDINGS:
            self.problems.append(Problem(field, message, remedy))

    def attempt(self, make: Callable[[], T]) -> T | None:
        """What `make` gives; None where it raised InvalidInputError, whose problems are noted."""
        try:
            return make()
        except InvalidInputError as error:
            self.problems.extend(error.problems)
            return None

    def raise_if_any(self) -> None:
        """Raises InvalidInputError with everything that was noted."""
        if self.problems:
            raise InvalidInputError(*self.problems)
