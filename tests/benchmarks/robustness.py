"""How busy a robustness study keeps the workers: `python tests/benchmarks/run.py robustness [--samples N] [--steps N] [--solutions N]`.

A coordinator as a user starts it searches a few good sets (`deploy/examples/robustness_paper.yaml`); then a campaign of its own makes the
study, which is measured: 11 sets x 10 boxes x 30 vehicles x 6 scenarios, some 20,000 runs. A box is asked for when the one before it is
answered, so workers could wait in between. Utilisation = time that workers have a batch in hand / (wall x workers), from the server's own
metrics; where processors are shared, a worker has its batch in hand for longer, so the share of CPU time stands beside it.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import yaml
from tests.benchmarks.efficiency import processor_seconds, wait_for_workers

from drivecal.cli.commands.demo.coordinator import coordinator, fresh_folder
from drivecal.client.client import Client
from drivecal.contracts.campaign import Campaign

EXAMPLE = Path("deploy/examples/robustness_paper.yaml")
HOME = Path(".drivecal/bench/robustness")
TARGET = Path(".drivecal/bench/robustness.json")
AT_LEAST = 0.90
POLL_SECONDS = 0.5


def ended(client: Client, specification: dict[str, Any]) -> Campaign:
    """A campaign, carried out to its end."""
    campaign = client.submit(specification)
    while campaign.state not in {"succeeded", "failed", "cancelled"}:
        time.sleep(POLL_SECONDS)
        campaign = client.campaign(campaign.id)
    if campaign.state != "succeeded":
        raise RuntimeError(f"the campaign ended as {campaign.state}: {campaign.error}")
    return campaign


def batch_seconds(url: str) -> tuple[float, int]:
    """How long workers have had batches in hand so far, all together, and how many there were."""
    found = dict(
        line.rsplit(" ", 1)
        for line in httpx.get(f"{url}/metrics").text.splitlines()
        if line.startswith("drivecal_batch_seconds_")
    )
    return float(found["drivecal_batch_seconds_sum"]), int(float(found["drivecal_batch_seconds_count"]))


def settled(url: str) -> tuple[float, int]:
    """As `batch_seconds`, once the dispatcher's heartbeat has told of all that is over."""
    time.sleep(2.5)
    return batch_seconds(url)


def main() -> int:
    """Measures, prints, writes; 0 where the workers were busy enough."""
    example = yaml.safe_load(EXAMPLE.read_text())
    study = example["robustness"]
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("samples", "steps", "solutions"):
        parser.add_argument(f"--{name}", type=int, default=study[name])
    chosen = vars(parser.parse_args())
    with fresh_folder(HOME), coordinator(HOME) as client:
        wait_for_workers(client)
        workers = len(client.workers().items)
        searched = ended(client, {**example, "robustness": None})
        busy, batches = settled(client.url)
        before = processor_seconds()
        made = ended(client, {**example, "optimizer": None, "robustness": study | chosen | {"of": searched.id}})
        used = {role: seconds - before.get(role, 0.0) for role, seconds in processor_seconds().items()}
        after = settled(client.url)
        rows = client.robustness(made.id)
    busy, batches = after[0] - busy, after[1] - batches
    cells, wall = made.robustness_cells, made.seconds.wall
    figures = {
        **chosen,
        "sets": len(rows),
        "workers": workers,
        "cells": cells.model_dump(),
        "batches": batches,
        "wall_seconds": wall,
        "utilisation": busy / (wall * workers),
        "worker_processor_share": used.get("workers", 0.0) / (wall * workers),
        "simulating_seconds": made.seconds.simulating,
        "processor_seconds": used,
        "degrees": [row.degree for row in rows],
    }
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(figures, indent=2) + "\n")
    answers = f"{cells.simulated:,} simulated, {cells.certified:,} certified, {cells.repeated:,} repeated"
    print(f"{len(rows)} sets, {cells.requested:,} cells ({answers}) in {wall:.1f} s by {workers} workers, {batches:,} batches")
    print(f"workers have a batch in hand for {busy / (wall * workers):.1%} of the time (at least {AT_LEAST:.0%} wanted)")
    print(f"and take {figures['worker_processor_share']:.1%} of as many processors")
    print("degrees of robustness: " + ", ".join(str(row.degree) for row in rows))
    print("processor time, s: " + ", ".join(f"{role} {seconds:.1f}" for role, seconds in sorted(used.items())))
    return 0 if busy / (wall * workers) >= AT_LEAST else 1


if __name__ == "__main__":
    sys.exit(main())
