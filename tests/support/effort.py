"""How much the tests try: a fixed sample in `make test`, and all of it, at random points, in `make test-faults` (DRIVECAL_LONG=1)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TypeVar

Case = TypeVar("Case")
LONG = bool(os.environ.get("DRIVECAL_LONG"))


def tries(everyday: int, long: int) -> int:
    """A number of repetitions."""
    return long if LONG else everyday


def examples(everyday: int) -> int:
    """The number of a property's examples: ten times as many in the long form."""
    return tries(everyday, 10 * everyday)


def sample(cases: Sequence[Case], everyday: int) -> list[Case]:
    """As many of the cases, evenly spread from the first to the last; all of them in the long form."""
    if LONG or len(cases) <= everyday:
        return list(cases)
    return [cases[number * (len(cases) - 1) // (everyday - 1)] for number in range(everyday)]
