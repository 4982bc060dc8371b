"""Random streams: every study, seed and purpose has its own, apart from those of plain seeds."""

from __future__ import annotations

from itertools import product

import numpy as np

from drivecal.analysis.validation import generator

SEEDS = (0, 1, 2, 2**32, 2**63 - 1)


def first(drawing: np.random.Generator) -> int:
    return int(drawing.integers(2**63))


def test_no_two_streams_begin_alike() -> None:
    keyed = [first(generator(name, seed, *key)) for name, seed, key in product(("a", "b"), SEEDS, ((), (0,), (1,), (0, 0)))]
    plain = [first(np.random.Generator(np.random.PCG64(seed))) for seed in SEEDS]
    assert len({*keyed, *plain}) == len(keyed) + len(plain)
    assert first(generator("a", 1, 0)) == keyed[5]
