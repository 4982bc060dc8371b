"""Parts of an optimizer's state as plain data that strict JSON can carry and give back bit by bit."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drivecal.plugins.ports import Floats


def dump_generator(generator: np.random.Generator) -> dict[str, Any]:
    """The generator's state: names and plain integers of any size."""
    return dict(generator.bit_generator.state)


def load_generator(state: Mapping[str, Any]) -> np.random.Generator:
    """The inverse of `dump_generator`; draws continue where they stopped."""
    generator = np.random.Generator(np.random.PCG64())
    generator.bit_generator.state = state
    return generator


def dump_floats(values: Floats | None) -> list[float | None] | None:
    """NaN becomes null, which JSON knows."""
    return None if values is None else [None if np.isnan(value) else value for value in values.tolist()]


def load_floats(values: Sequence[float | None] | None) -> Floats | None:
    """The inverse of `dump_floats`."""
    return None if values is None else np.array([np.nan if value is None else value for value in values], dtype=np.float64)
