"""Random streams of studies: equal seeds of two studies draw nothing in common. Pure."""

import numpy as np


def generator(study: str, seed: int, *key: int) -> np.random.Generator:
    """Returns the generator of a `study` by its name, its `seed` and the `key` of one of its purposes.

    A list of numbers alone would not do: numpy fills short ones up with zeros, so that `PCG64([seed, 0])` is `PCG64(seed)`, the stream of
    every optimizer's start population. What is in a spawn key follows the filling and always counts.
    """
    name = int.from_bytes(study.encode(), "big")
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(name, *key))))
