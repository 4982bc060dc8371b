"""What a rerun under other weights still simulates: `python tests/benchmarks/run.py rerun [--weights S1=2,S2=2] [--population N] [...]`.

For each weighting: a campaign of the paper's size (1,000 individuals, 20 iterations, six scenarios) with predictions and certificates, on
a database of its own, and then its rerun under the weights, on the same server. Of the rerun's requested cells those are counted that
were simulated: samples, rejected lots, checked certificates and confirmation are among them. A weighting takes three to four minutes on
two cores.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from tests.benchmarks.certified import wait_for_workers

from drivecal.cli.commands.demo.coordinator import coordinator, fresh_folder
from drivecal.client.client import Client
from drivecal.contracts.campaign import Campaign

HOME = Path(".drivecal/bench/rerun").absolute()
TARGET = Path(".drivecal/bench/rerun.json")
WEIGHTS = ("S1=2,S2=2", "S1=3,S5=0", "S3=2,S4=2")
WANTED = 0.20
"""Largest mean share of a rerun's requested cells that is simulated, at the paper's size."""
COUNTED = ("requested", "repeated", "predicted", "certified", "simulated", "failed", "sampled")


@dataclass(frozen=True, slots=True)
class Outcome:
    """A campaign or its rerun: cells by outcome, wall seconds, the confirmed optimum."""

    weights: str
    cells: Mapping[str, int]
    wall: float
    best: float | None

    @property
    def share(self) -> float:
        """Share of the requested cells that was simulated."""
        return (self.cells["simulated"] + self.cells["failed"]) / self.cells["requested"]


def measured(weights: str, population: int, iterations: int) -> Iterator[Outcome]:
    """Yields the first campaign and its rerun."""
    specification = {
        "name": "first",
        "sensitivity": None,
        "optimizer": {"kind": "genetic", "population": population, "iterations": iterations, "seed": 1},
        "reduction": {"mode": "predicted", "confirm": 20},
    }
    with fresh_folder(HOME), coordinator(HOME) as client:
        wait_for_workers(client)
        first = ended(client, client.submit(specification))
        yield outcome("none", first)
        named = {name: float(value) for name, value in (pair.split("=") for pair in weights.split(","))}
        yield outcome(weights, ended(client, client.rerun(first.id, {"weights": named})))


def ended(client: Client, campaign: Campaign) -> Campaign:
    """Returns the campaign at its end. Raises RuntimeError if it did not succeed."""
    while campaign.state not in {"succeeded", "failed", "cancelled"}:
        time.sleep(1.0)
        campaign = client.campaign(campaign.id)
    if campaign.state != "succeeded":
        raise RuntimeError(f"the campaign ended as {campaign.state}: {campaign.error}")
    return campaign


def outcome(weights: str, campaign: Campaign) -> Outcome:
    """Returns the counts of an ended campaign."""
    cells = {name: getattr(campaign.cells, name) for name in COUNTED}
    best = None if campaign.best is None else campaign.best.objective
    return Outcome(weights, cells, campaign.seconds.wall, best)


def main(arguments: list[str]) -> int:
    """Prints the table; 1 if the reruns simulate more than wanted in the mean."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--weights", action="append", help=f"S1=2,...; else in turn {' '.join(WEIGHTS)}")
    parser.add_argument("--population", type=int, default=1000)
    parser.add_argument("--iterations", type=int, default=20)
    given = parser.parse_args(arguments)
    print(f"{given.population} individuals, {given.iterations} iterations; shares of the requested cells")
    print(f"{'weights':12}" + "".join(f"{name:>11}" for name in COUNTED) + f"{'wall s':>11}{'best':>11}")
    outcomes = []
    for weights in given.weights or WEIGHTS:
        for one in measured(weights, given.population, given.iterations):
            outcomes.append(one)
            shares = "".join(f"{one.cells[name] / one.cells['requested']:>11.1%}" for name in COUNTED[1:])
            print(f"{one.weights:12}{one.cells['requested']:>11,}{shares}{one.wall:>11.0f}{one.best or 0:>11.4f}", flush=True)
    reruns = [one.share for one in outcomes if one.weights != "none"]
    mean = sum(reruns) / len(reruns)
    print(f"simulated in reruns: {mean:.1%} in the mean, {max(reruns):.1%} at most; at most {WANTED:.0%} in the mean wanted")
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(
        json.dumps({"settings": vars(given), "mean": mean, "campaigns": [asdict(one) for one in outcomes]}, indent=1)
    )
    return int(mean > WANTED)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
