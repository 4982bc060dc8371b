"""Tests of what the optimizers propose for fixed seeds. A change here changes every campaign that is repeated: it needs a reason."""

import hashlib

import numpy as np
import pytest

from drivecal.optimizers.built_in import GENETIC, RANDOM
from drivecal.plugins.ports import OptimizerPlugin

HIGHWAY = np.array([59, 201, 201, 2001, 1501, 101, 201, 2001, 101, 201, 201])


@pytest.mark.parametrize(
    ("plugin", "start", "first", "digest", "best"),
    [
        (
            GENETIC,
            "lhs",
            [16, 21, 107, 573, 501, 98, 70, 1296, 35, 5, 148],
            "665b9d794b5e01a2",
            [6.44, 6.58, 6.65, 6.65, 6.65, 6.65, 6.65, 6.65, 6.69, 6.69],
        ),
        (
            GENETIC,
            "halton",
            [29, 67, 40, 285, 136, 7, 11, 105, 4, 6, 6],
            "c676f5c6b504c111",
            [6.86, 6.86, 6.93, 6.93, 6.93, 6.93, 6.93, 6.93, 6.93, 6.93],
        ),
        (
            RANDOM,
            "lhs",
            [16, 21, 107, 573, 501, 98, 70, 1296, 35, 5, 148],
            "cf494b0d76a90a9c",
            [6.44, 6.46, 6.46, 6.46, 6.46, 6.5, 6.63, 6.63, 6.63, 6.63],
        ),
    ],
    ids=["genetic-lhs", "genetic-halton", "random-lhs"],
)
def test_the_populations_of_a_fixed_seed_are_known(
    plugin: OptimizerPlugin, start: str, first: list[int], digest: str, best: list[float]
) -> None:
    settings = plugin.settings.model_validate({"kind": plugin.name, "population": 50, "start": start, "seed": 2024})
    optimizer = plugin.create(settings, HIGHWAY)
    populations, result = hashlib.blake2b(digest_size=8), []
    for _ in range(10):
        population = optimizer.ask().population
        populations.update(population.astype("<i8").tobytes())
        objectives = np.floor(7 * np.cos(population / HIGHWAY).mean(axis=1) * 100) / 100
        optimizer.tell(objectives, population[:, 0].astype(np.float64))
        result.append(float(objectives.max()))
        if len(result) == 1:
            assert population[0].tolist() == first
    assert result == best
    assert populations.hexdigest() == digest
