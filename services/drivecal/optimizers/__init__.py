"""Optimizers as pure ask/tell over grid indices: no I/O, an explicit generator, and a state that serialises at any moment.

>>> import numpy as np
>>> from drivecal.optimizers import GENETIC, GeneticSettings
>>> settings = GeneticSettings(population=40, iterations=30, seed=1)
>>> optimizer = GENETIC.create(settings, n_values=np.array([101, 101]))
>>> for _ in range(settings.iterations):
...     points = optimizer.ask().population
...     objectives = -((points - [30, 70]) ** 2).sum(axis=1).astype(float)
...     optimizer.tell(objectives, tie_breakers=objectives)
>>> bool(objectives.max() > -50)
True

`drivecal.optimizers.cma_es` and `.optuna_samplers` need the extras of their libraries.
"""

from drivecal.optimizers.built_in import GENETIC, RANDOM, SWARM, GeneticSettings, RandomSettings, SwarmSettings
from drivecal.optimizers.genetic import GeneticAlgorithm
from drivecal.optimizers.population import RandomSearch, start_population
from drivecal.optimizers.swarm import ParticleSwarm

__all__ = [
    "GENETIC",
    "RANDOM",
    "SWARM",
    "GeneticAlgorithm",
    "GeneticSettings",
    "ParticleSwarm",
    "RandomSearch",
    "RandomSettings",
    "SwarmSettings",
    "start_population",
]
