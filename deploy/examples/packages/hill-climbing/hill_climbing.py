"""An optimizer of your own: `optimizer: {kind: hill_climbing, reach: 0.1}` in a campaign file."""

from typing import Literal

import numpy as np
from pydantic import Field

from drivecal.contracts.specification import OptimizerSpecification
from drivecal.plugins.ports import Proposal

WORST = -1e300  # of individuals without a result; JSON has no infinity


class Settings(OptimizerSpecification):
    kind: Literal["hill_climbing"] = "hill_climbing"
    reach: float = Field(0.1, gt=0, le=1)  # longest step, as a share of a parameter's values


class HillClimbing:
    """Each individual climbs alone: it tries a neighbour and stays if that is no better. Everything that it knows is in `known`."""

    def __init__(self, settings, n_values, known):
        self.settings, self.n_values, self.known = settings, np.asarray(n_values), known

    def tried(self):
        places = np.array(self.known["places"])
        if self.known["iteration"] == 0:
            return places
        random = np.random.default_rng([self.settings.seed, self.known["iteration"]])  # a restored search draws the same
        reach = np.maximum(np.rint(self.settings.reach * self.n_values), 1).astype(int)
        steps = random.integers(-reach, reach + 1, size=places.shape)
        moves = random.random(places.shape) < 2 / len(self.n_values)  # some of the parameters
        return np.clip(places + np.where(moves, steps, 0), 0, self.n_values - 1)

    def ask(self):
        return Proposal(self.tried(), np.ones(len(self.known["places"]), dtype=bool))

    def tell(self, objectives, tie_breakers):
        tried, results = self.tried(), np.nan_to_num([objectives, tie_breakers], nan=WORST).T.tolist()
        better = [new > old for new, old in zip(results, self.known["results"], strict=True)]
        self.known = {
            "iteration": self.known["iteration"] + 1,
            "places": np.where(np.array(better)[:, None], tried, self.known["places"]).tolist(),
            "results": [new if up else old for new, old, up in zip(results, self.known["results"], better, strict=True)],
        }

    def state(self):
        return self.known


class Plugin:
    name, settings = "hill_climbing", Settings
    supports = frozenset({"grid", "integer"})  # kinds of parameters

    def requested_individuals(self, settings):
        return settings.population * settings.iterations

    def create(self, settings, n_values, start=None, _kinds=None):
        drawn = np.random.default_rng(settings.seed).integers(0, n_values, size=(settings.population, len(n_values)))
        places = drawn if start is None else np.concatenate([start, drawn[len(start) :]])
        known = {"iteration": 0, "places": places.tolist(), "results": [[2 * WORST] * 2] * len(places)}
        return HillClimbing(settings, n_values, known)

    def restore(self, settings, n_values, state, _kinds=None):
        return HillClimbing(settings, n_values, dict(state))


HILL_CLIMBING = Plugin()
