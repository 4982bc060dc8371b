"""Printed savings beside true ones: `python tests/benchmarks/run.py savings [--reuse map] [--population N] [--iterations N] [...]`.

The same campaign is carried out with reuse off and on, side by side by two coordinators with a worker each, so that whatever else the
machine does slows both alike. Whichever ends first goes on with other simulations until the other has ended. Printed is the net saving that
`drivecal show` prints. True is the CPU time of the workers' simulating threads from submission to end, as the operating system counts it:
with reuse off less with reuse on. That includes what no clock of a worker sees.

Certificates change no result, so both campaigns request the same cells. References may (`--reuse map`, with an analysis); then the ratio is
shown only.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import psutil
from tests.benchmarks.certified import wait_for_workers

from drivecal.cli.commands.demo.coordinator import coordinator, fresh_folder
from drivecal.client.client import Client

HOME = Path(".drivecal/bench/savings").absolute()
TARGET = Path(".drivecal/bench/savings.json")
TOLERATED = 0.1
"""Largest share of the true saving by which the printed one may differ."""
REDUCTIONS: Mapping[str, Mapping[str, Any]] = {
    "off": {"mode": "off", "certified": False},
    "certificates": {"mode": "exact", "certified": True, "audit": 0.0},
    "map": {"mode": "influence", "certified": True},
}


@dataclass(frozen=True, slots=True)
class Cost:
    """An ended campaign: CPU seconds of its worker as measured and as the worker's clocks add them up, the net saving, cells."""

    reuse: str
    measured: float
    clocked: float
    net: float
    requested: int
    simulated: int
    savings: Mapping[str, float]
    deductions: Mapping[str, float]


def main() -> int:
    """Measures, prints, writes; 1 if the printed saving of certificates is too far from the true one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--reuse", choices=[name for name in REDUCTIONS if name != "off"], default="certificates")
    parser.add_argument("--population", type=int, default=600)
    parser.add_argument("--iterations", type=int, default=12)
    parser.add_argument("--samples", type=int, default=8, help="of the analysis that makes the map")
    parser.add_argument("--seed", type=int, default=1, help="of the first round; each further one has the next")
    parser.add_argument("--rounds", type=int, default=1)
    chosen = parser.parse_args()
    os.environ["DRIVECAL_WORKERS"] = "1"
    print(f"{chosen.population} individuals, {chosen.iterations} iterations; CPU seconds of the workers")
    print(f"{'seed':>4}  {'reuse':13}{'requested':>10}{'simulated':>10}{'measured':>10}{'clocked':>10}{'printed net':>12}")
    rounds = []
    for seed in range(chosen.seed, chosen.seed + chosen.rounds):
        costs = carry_out(seed, chosen)
        for cost in costs.values():
            print(
                f"{seed:4}  {cost.reuse:13}{cost.requested:10,}{cost.simulated:10,}{cost.measured:10.2f}{cost.clocked:10.2f}"
                f"{cost.net:12.2f}",
                flush=True,
            )
        rounds.append(costs)
    off, on = (sum(costs[name].measured for costs in rounds) for name in ("off", chosen.reuse))
    printed, true = sum(costs[chosen.reuse].net for costs in rounds), off - on
    print(f"printed {printed:+.1f} s, true {off:.1f} - {on:.1f} = {true:+.1f} s, printed / true {printed / true:.3f}")
    figures = {"printed": printed, "true": true, "off": off, "on": on, "ratio": printed / true}
    runs = [{name: asdict(cost) for name, cost in costs.items()} for costs in rounds]
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps({"settings": vars(chosen), "savings": figures, "rounds": runs}, indent=1))
    return int(chosen.reuse == "certificates" and abs(printed - true) > TOLERATED * abs(true))


def carry_out(seed: int, chosen: argparse.Namespace) -> dict[str, Cost]:
    """The campaign with reuse off and on, on new databases with workers that are ready."""
    costs: dict[str, Cost] = {}
    with ExitStack() as stack:
        clients = {}
        for name in ("off", chosen.reuse):
            stack.enter_context(fresh_folder(HOME / name))
            clients[name] = stack.enter_context(coordinator(HOME / name))
        for client in clients.values():
            wait_for_workers(client)
        running = {name: _submitted(name, client, seed, chosen) for name, client in clients.items()}
        while running:
            for name, steps in list(running.items()):
                cost = next(steps)
                if cost is not None:
                    costs[name] = cost
                    del running[name]
                    # as many simulations as before beside the other campaign, or it would run on a quieter machine than this one
                    clients[name].submit(specification("off", seed + 1000, chosen) | {"name": "keeps the machine busy"})
            time.sleep(0.1)
    return {name: costs[name] for name in clients}


def specification(reuse: str, seed: int, chosen: argparse.Namespace) -> dict[str, Any]:
    """The campaign with this reuse."""
    return {
        "name": f"savings, reuse {reuse}",
        "sensitivity": {"samples": chosen.samples} if reuse == "map" else None,
        "optimizer": {"kind": "genetic", "population": chosen.population, "iterations": chosen.iterations, "seed": seed},
        "reduction": REDUCTIONS[reuse],
    }


def _submitted(reuse: str, client: Client, seed: int, chosen: argparse.Namespace) -> Iterator[Cost | None]:
    """Submits the campaign; yields None while it runs, then its cost."""
    before = worker_seconds(HOME / reuse)
    campaign = client.submit(specification(reuse, seed, chosen))
    while campaign.state not in {"succeeded", "failed", "cancelled"}:
        yield None
        campaign = client.campaign(campaign.id)
    measured = worker_seconds(HOME / reuse) - before
    if campaign.state != "succeeded":
        raise RuntimeError(f"the campaign ended as {campaign.state}: {campaign.error}")
    account = client.accounting(campaign.id)
    yield Cost(
        reuse,
        measured,
        campaign.seconds.simulating,
        account.net_seconds,
        account.requested,
        account.simulated,
        account.savings,
        account.deductions,
    )


def worker_seconds(home: Path) -> float:
    """CPU time of the main threads, which simulate, of the workers of a coordinator, in seconds."""
    seconds = 0.0
    for process in psutil.Process().children(recursive=True):
        if not any("ray::" in word for word in process.cmdline()) or process.environ().get("DRIVECAL_HOME") != str(home):
            continue
        seconds += sum(thread.user_time + thread.system_time for thread in process.threads() if thread.id == process.pid)
    return seconds


if __name__ == "__main__":
    sys.exit(main())
