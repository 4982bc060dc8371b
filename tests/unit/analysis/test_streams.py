"""Random streams: every study, seed and purpose has its own, apart from those of plain seeds."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from tests.support.classified import classified

from drivecal.analysis.validation import design, generator
from drivecal.domain.errors import ConflictError

SEEDS = (0, 1, 2, 2**32, 2**63 - 1)


def first(drawing: np.random.Generator) -> int:
    return int(drawing.integers(2**63))


def test_no_two_streams_begin_alike() -> None:
    keyed = [first(generator(name, seed, *key)) for name, seed, key in product(("a", "b"), SEEDS, ((), (0,), (1,), (0, 0)))]
    plain = [first(np.random.Generator(np.random.PCG64(seed))) for seed in SEEDS]
    assert len({*keyed, *plain}) == len(keyed) + len(plain)
    assert first(generator("a", 1, 0)) == keyed[5]


def test_a_list_that_ends_with_zeros_is_the_stream_of_the_plain_seed() -> None:
    """The reason for the spawn key."""
    assert first(np.random.Generator(np.random.PCG64([1, 0]))) == first(np.random.Generator(np.random.PCG64(1)))


def test_a_validation_draws_its_earlier_stream_on_request_and_refuses_one_of_the_future() -> None:
    space = classified([np.zeros(100, dtype=np.int64)] * 3)
    today, again, earlier = (design(space, 20, 2, 1, 20, *stream) for stream in ((), (2,), (1,)))
    assert today is not None
    assert again is not None
    assert earlier is not None
    assert np.array_equal(today.variants, again.variants)
    assert not np.array_equal(today.bases, earlier.bases)
    with pytest.raises(ConflictError):
        design(space, 20, 2, 1, 20, 3)
