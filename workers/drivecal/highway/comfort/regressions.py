"""Arrays of the learned evaluator: one regression per class of manoeuvres."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from drivecal.highway.comfort.reference import Manoeuvre
from drivecal.plugins.arrays import Array, DamagedArraysError, read_arrays
from drivecal.plugins.ports import Floats

FILE = Path(__file__).with_name("learned.npz")
KERNELS, CHANNELS, LARGEST_DILATION = 84, 6, 19


@dataclass(frozen=True, slots=True)
class Regression:
    """MiniRocket features, see `rocket.transform`, and their weights in the rating of one class of manoeuvres.

    `dilations` (d,), `per_dilation` (d,), `n_channels` (84 d,), `channels` (sum of n_channels,), `biases` (84 sum of per_dilation,): whole
    numbers. `weights`, one per bias, and `intercept` (1,): the rating is features @ weights + intercept.
    """

    dilations: npt.NDArray[np.int32]
    per_dilation: npt.NDArray[np.int32]
    n_channels: npt.NDArray[np.int32]
    channels: npt.NDArray[np.int32]
    biases: npt.NDArray[np.int32]
    weights: Floats
    intercept: Floats

    def __post_init__(self) -> None:
        # The kernels index by these arrays without bounds checks, so that inconsistent arrays must not reach them.
        fits = (
            len(self.dilations) == len(self.per_dilation) > 0
            and self.dilations.min() >= 1
            and self.dilations.max() <= LARGEST_DILATION
            and self.per_dilation.min() >= 0
            and len(self.n_channels) == KERNELS * len(self.dilations)
            and self.n_channels.min() >= 1
            and int(self.n_channels.sum()) == len(self.channels)
            and self.channels.min() >= 0
            and self.channels.max() < CHANNELS
            and len(self.biases) == len(self.weights) == KERNELS * int(self.per_dilation.sum())
        )
        if not fits:
            raise ValueError("dilations, kernels, channels, biases and weights do not fit together")


_NAMES = tuple(field.name for field in fields(Regression))


def arrays_of(regressions: Mapping[Manoeuvre, Regression]) -> dict[str, Array]:
    """Returns the stored arrays by name."""
    return {
        f"{manoeuvre.value}_{name}": getattr(regression, name)
        for manoeuvre, regression in regressions.items()
        for name in _NAMES
    }


def write(path: Path, regressions: Mapping[Manoeuvre, Regression]) -> None:
    """Stores one regression per class."""
    np.savez_compressed(path, allow_pickle=False, **arrays_of(regressions))


@cache
def shipped(path: Path = FILE) -> dict[Manoeuvre, Regression]:
    """Returns the regressions in a file, by default the shipped ones. Raises DamagedArraysError if it is missing or damaged."""
    arrays = read_arrays(path, [f"{manoeuvre.value}_{name}" for manoeuvre in Manoeuvre for name in _NAMES])
    try:
        return {each: Regression(**{name: arrays[f"{each.value}_{name}"] for name in _NAMES}) for each in Manoeuvre}
    except ValueError as error:
        raise DamagedArraysError(path.name, str(error)) from error
