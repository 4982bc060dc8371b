"""SciPy's differential evolution proposes sets, a generation at a time; drivecal evaluates them.

Usage: python with_scipy.py SPEC.yaml [SIMULATIONS]
"""

import sys

import numpy as np
from scipy.optimize import differential_evolution

from drivecal.client import Client
from drivecal.client.documents import plain


def search(client: Client, spec: str, simulations: int) -> float:
    """Returns the objective of the best set."""
    document = plain(spec)
    names = [each["name"] for each in document["parameters"]]
    bounds = [(each["lower"], each["upper"]) for each in document["parameters"]]
    with client.ask_tell({**document, "budget": {"simulations": simulations}}) as campaign:

        def losses(points: np.ndarray) -> np.ndarray:
            sets = [dict(zip(names, map(float, point), strict=True)) for point in points.T]
            return np.array([answer.loss for answer in campaign.evaluate(sets)])

        differential_evolution(losses, bounds, vectorized=True, updating="deferred", popsize=4, seed=1, polish=False)
    best = campaign.result().best
    return float("nan") if best is None else best.objective


if __name__ == "__main__":
    with Client() as connected:
        print(search(connected, sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 200))
