"""CMA-ES proposes sets in the unit cube, a population at a time; drivecal evaluates them.

Usage: python with_cma.py SPEC.yaml [SIMULATIONS]
"""

import sys

import cma

from drivecal.client import Client
from drivecal.client.documents import plain


def search(client: Client, spec: str, simulations: int) -> float:
    """Returns the objective of the best set."""
    document = plain(spec)
    space = document["parameters"]
    strategy = cma.CMAEvolutionStrategy([0.5] * len(space), 0.25, {"bounds": [0, 1], "seed": 1, "verbose": -9})
    with client.ask_tell({**document, "budget": {"simulations": simulations}}) as campaign:
        while not strategy.stop():
            points = strategy.ask()
            sets = [
                {
                    each["name"]: each["lower"] + x * (each["upper"] - each["lower"])
                    for each, x in zip(space, point, strict=True)
                }
                for point in points
            ]
            strategy.tell(points, [answer.loss for answer in campaign.evaluate(sets)])
    best = campaign.result().best
    return float("nan") if best is None else best.objective


if __name__ == "__main__":
    with Client() as connected:
        print(search(connected, sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 200))
