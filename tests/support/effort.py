"""How much the tests try: a fixed sample in `make test`, and all of it, at random points, in `make test-faults` (DRIVECAL_LONG=1)."""

import os
import random
from collections.abc import Sequence
from typing import TypeVar

Case = TypeVar("Case")
LONG = bool(os.environ.get("DRIVECAL_LONG"))
SEED = int(os.environ.get("DRIVECAL_FUZZ_SEED") or (random.randrange(1, 10**9) if LONG else 0))
"""Seed of all mutations: 0 in `make test`, else DRIVECAL_FUZZ_SEED or a new seed for each long run."""


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


def chance(subject: str | bytes) -> random.Random:
    """Returns the random mutations of a subject; a long run prints how to repeat them."""
    if not SEED:
        return random.Random(subject)
    print(f"DRIVECAL_FUZZ_SEED={SEED}")
    return random.Random(f"{SEED} {subject!r}")
