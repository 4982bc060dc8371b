"""What certificates save on the paper's settings: `python tests/benchmarks/run.py certified [--population N] [--iterations N] [...]`.

`deploy/examples/paper.yaml` is carried out twice by a coordinator as a user starts it, each time on a new database: with certificates
and without. Both must find the same, bit for bit. A fifth of the cells that a certificate or a reference answers is simulated all the
same and compared; shares are told as they were, and as they would be without that. What that costs is in the times with certificates.
Some ten minutes on two cores; smaller with the arguments, which changes the shares.
"""

from __future__ import annotations

import argparse
import json
import sqlite3
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from drivecal.cli.commands.demo.coordinator import coordinator, fresh_folder
from drivecal.client.client import Client
from drivecal.contracts.campaign import Campaign
from drivecal.contracts.inventory import WorkerAnswer
from drivecal.domain.campaigns import StageName
from drivecal.highway.planner.candidates import lateral_ends, longitudinal_ends
from drivecal.highway.planner.planner import PERIOD
from drivecal.storage.engine.types import STAGES

HOME = Path(".drivecal/bench/certified").absolute()
TARGET = Path(".drivecal/bench/certified.json")
PAPER = Path("deploy/examples/paper.yaml")
ANSWERED, ANSWERED_IN_ANALYSIS, CHECKED = 0.5, 0.7, 2000
"""Wanted: shares of requested cells that are answered without a simulation, and cells whose certificate was checked."""

OUTCOMES = ("repeated", "reused", "certified", "simulated")
COUNTS = ("requested", *OUTCOMES, "failed", "held_back", "checked", "different")
SECONDS = ("seconds", "check_seconds")
"""CPU time of the workers: all of it, and for cells that were simulated only to see."""
CELLS = """
    SELECT stage, scenario, outcome, count(*), avg(milliseconds), sum(audited), sum(proof_agrees IS NOT NULL),
           coalesce(sum(proof_agrees = 0), 0), sum(audited AND proof_agrees IS NOT NULL), coalesce(sum(milliseconds), 0),
           coalesce(sum(CASE WHEN audited OR proof_agrees IS NOT NULL THEN milliseconds END), 0)
    FROM evaluations WHERE outcome IS NOT NULL GROUP BY stage, scenario, outcome"""
FOUND = """
    SELECT stage, iteration, individual, scenario, score, rating, failure FROM evaluations
    ORDER BY stage, iteration, individual, scenario"""


@dataclass(frozen=True, slots=True)
class Ended:
    """A campaign, who worked for it in the end, and the folder of its database."""

    campaign: Campaign
    workers: Sequence[WorkerAnswer]
    home: Path


def carry_out(specification: Mapping[str, Any], home: Path) -> Ended:
    """The campaign on a new database, from its start to its end; workers are ready before."""
    with fresh_folder(home), coordinator(home) as client:
        wait_for_workers(client)
        campaign = client.submit(dict(specification))
        while campaign.state not in {"succeeded", "failed", "cancelled"}:
            time.sleep(1.0)
            campaign = client.campaign(campaign.id)
        if campaign.state != "succeeded":
            raise RuntimeError(f"the campaign ended as {campaign.state}: {campaign.error}")
        return Ended(campaign, client.workers().items, home)


def wait_for_workers(client: Client) -> None:
    """Returns when every worker is ready."""
    while not (workers := client.workers().items) or any(worker.state != "idle" for worker in workers):
        time.sleep(0.2)


def ask(home: Path, query: str) -> list[tuple[Any, ...]]:
    """Rows of a coordinator's database."""
    with closing(sqlite3.connect(home / "drivecal.db")) as connection:
        return list(connection.execute(query))


def by_scenario(home: Path, stage: StageName) -> dict[str, dict[str, float]]:
    """Counts of one stage: cells by outcome, audited, checked, different; mean milliseconds of a walk and of a simulation."""
    table: dict[str, dict[str, float]] = {}
    for position, scenario, outcome, cells, milliseconds, audited, checked, different, both, spent, seeing in ask(home, CELLS):
        if STAGES[position] is not stage:
            continue
        row = table.setdefault(scenario, dict.fromkeys((*COUNTS, *SECONDS), 0.0))
        row["seconds"] += spent / 1e3
        row["check_seconds"] += seeing / 1e3
        row["requested"] += cells
        row[outcome] += cells
        row["checked"] += checked
        row["different"] += different
        row["held_back"] += audited + checked - both  # would have been answered, and was simulated to see
        if outcome in {"certified", "simulated"}:
            row[f"{outcome}_ms"] = milliseconds or 0.0
    return dict(sorted(table.items()))


def summed(rows: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Over all scenarios; milliseconds weighted by cells."""
    total = {name: sum(row[name] for row in rows.values()) for name in (*COUNTS, *SECONDS)}
    for outcome in ("certified", "simulated"):
        spent = sum(row[outcome] * row.get(f"{outcome}_ms", 0.0) for row in rows.values())
        total[f"{outcome}_ms"] = spent / total[outcome] if total[outcome] else 0.0
    return total


def answered(row: Mapping[str, float]) -> float:
    """The share of requested cells that took no simulation, checks not counted as such."""
    free = row["repeated"] + row["reused"] + row["certified"] + row["held_back"]
    return free / row["requested"] if row["requested"] else 0.0


def show(title: str, rows: Mapping[str, Mapping[str, float]], without: Mapping[str, Mapping[str, float]]) -> None:
    """Prints a table of one stage; `without`: the same stage without certificates."""
    print(f"\n{title}")
    head = (
        "requested",
        "repeated",
        "reused",
        "certified",
        "simulated",
        "checks",
        "no need",
        "checked",
        "differ",
        "walk ms",
        "run ms",
        "CPU s with",
        "for checks",
        "without",
    )
    print(f"{'':6}" + "".join(f"{name:>11}" for name in head))
    others = {**without, "sum": summed(without)}
    for name, row in [*rows.items(), ("sum", summed(rows))]:
        print(
            f"{name:6}{row['requested']:11,.0f}"
            + "".join(f"{row[outcome] / max(row['requested'], 1):11.1%}" for outcome in OUTCOMES)
            + f"{row['held_back']:11,.0f}{answered(row):11.1%}{row['checked']:11,.0f}{row['different']:11.0f}"
            + f"{row.get('certified_ms', 0.0):11.2f}{row.get('simulated_ms', 0.0):11.2f}"
            + f"{row['seconds']:11.1f}{row['check_seconds']:11.1f}{others[name]['seconds']:11.1f}"
        )


def main() -> int:
    """Measures, prints, writes; 0 where certificates reach what is wanted and are never wrong."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--population", type=int, default=1000)
    parser.add_argument("--iterations", type=int, default=20)
    parser.add_argument("--samples", type=int, default=20, help="of the sensitivity analysis")
    chosen = parser.parse_args()
    paper = yaml.safe_load(PAPER.read_text(encoding="utf-8"))
    paper["optimizer"] |= {"population": chosen.population, "iterations": chosen.iterations}
    paper["sensitivity"] |= {"samples": chosen.samples}
    ended = {}
    for name, certified in (("with", True), ("without", False)):
        ended[name] = carry_out(paper | {"reduction": paper["reduction"] | {"certified": certified}}, HOME / name)
    one, other = ended["with"], ended["without"]
    n_lateral, n_longitudinal = lateral_ends(3.75, 0, 1).shape[1], longitudinal_ends().shape[1]
    candidates = f"{n_lateral} x {n_longitudinal} = {n_lateral * n_longitudinal} candidates"
    print(
        f"{chosen.population} individuals, {chosen.iterations} iterations, {chosen.samples} samples per interval;"
        f" a plan every {PERIOD} s among {candidates}"
    )
    both = StageName.SENSITIVITY, StageName.CALIBRATION
    stages, without = ({stage: by_scenario(each.home, stage) for stage in both} for each in (one, other))
    names = {StageName.SENSITIVITY: f"sensitivity stage, design {paper['sensitivity'].get('design', 'lines')}"}
    for stage, rows in stages.items():
        title = (
            f"{names.get(stage, f'{stage} stage')}; a plan every {PERIOD} s among {candidates}; shares of the requested cells"
        )
        show(title, rows, without[stage])
    for worker in one.workers:
        states, used = worker.states or 0, worker.state_mb or 0.0
        each = f"{2**20 * used / states:,.0f} bytes each" if states else "none"
        print(
            f"{worker.id} remembers {states:,} planning states, {each}, {used:,.0f} of {worker.state_mb_at_most or 0.0:,.0f} MB"
        )
    for name, campaign in ((name, each.campaign) for name, each in ended.items()):
        print(
            f"{name} certificates: {campaign.seconds.wall:.1f} s, of them {campaign.seconds.simulating:.1f} s of CPU in calibration"
        )
    rows_of = [ask(each.home, FOUND) for each in (one, other)]
    differences = sum(first != second for first, second in zip(*rows_of, strict=False)) + abs(len(rows_of[0]) - len(rows_of[1]))
    print(f"cells whose result is not the same to the bit with and without certificates: {differences} of {len(rows_of[0]):,}")
    analysis, search = summed(stages[StageName.SENSITIVITY]), summed(stages[StageName.CALIBRATION])
    checked, wrong = analysis["checked"] + search["checked"], analysis["different"] + search["different"]
    reached = {
        f"cells of the search answered without a simulation, {ANSWERED:.0%} wanted": (
            answered(search),
            answered(search) >= ANSWERED,
        ),
        f"runs of the analysis certified or repeated, {ANSWERED_IN_ANALYSIS:.0%} wanted": (
            answered(analysis),
            answered(analysis) >= ANSWERED_IN_ANALYSIS,
        ),
    }
    for name, (share, good) in reached.items():
        print(f"{name}: {share:.1%}{'' if good else ' (missed)'}")
    print(f"certificates checked by a simulation: {checked:,.0f}, {wrong:.0f} of them wrong")
    document = {
        "settings": vars(chosen) | {"period_s": PERIOD, "candidates": n_lateral * n_longitudinal},
        "stages": stages,
        "stages_without": without,
        "sums": {"sensitivity": analysis, "calibration": search},
        "workers": [worker.model_dump(mode="json") for worker in one.workers],
        "wall_seconds": {name: each.campaign.seconds.wall for name, each in ended.items()},
        "differences": differences,
        "checked": checked,
        "wrong": wrong,
    }
    TARGET.parent.mkdir(parents=True, exist_ok=True)
    TARGET.write_text(json.dumps(document, indent=1))
    enough = checked >= CHECKED or chosen.population < 1000
    return int(bool(wrong) or bool(differences) or not enough or not all(good for _, good in reached.values()))


if __name__ == "__main__":
    sys.exit(main())
