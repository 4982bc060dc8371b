"""Optuna's TPE proposes sets, eight at a time; drivecal evaluates them.

Usage: python with_optuna.py SPEC.yaml [SIMULATIONS]
"""

import sys

import optuna

from drivecal.client import Client
from drivecal.client.documents import plain


def search(client: Client, spec: str, simulations: int) -> float:
    """Returns the objective of the best set."""
    document = plain(spec)
    study = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=1, constant_liar=True))
    with client.ask_tell({**document, "budget": {"simulations": simulations}}) as campaign:
        while True:
            trials = [study.ask() for _ in range(8)]
            sets = [
                {
                    each["name"]: trial.suggest_float(each["name"], each["lower"], each["upper"])
                    for each in document["parameters"]
                }
                for trial in trials
            ]
            for trial, answer in zip(trials, campaign.evaluate(sets), strict=True):
                study.tell(trial, answer.loss)
    best = campaign.result().best
    return float("nan") if best is None else best.objective


if __name__ == "__main__":
    with Client() as connected:
        print(search(connected, sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 200))
