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


def dump_floats(values: Floats | None) -> list[Any] | None:
    """Lists of the array's shape; NaN becomes null, which JSON knows."""
    if values is None:
        return None
    plain = values.astype(object)
    plain[np.isnan(values)] = None
    nested: list[Any] = plain.tolist()
    return nested


def load_floats(values: Sequence[Any] | None) -> Floats | None:
    """The inverse of `dump_floats`."""
    return None if values is None else np.array(values, dtype=np.float64)  # None becomes NaN
