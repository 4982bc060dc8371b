"""The whole way, as a user goes it: `drivecal serve`, a campaign over HTTP, Ray and SUMO, its results, a rerun."""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from tests.support import server as api
from tests.support.faults.oracle import NAME, InThisProcess
from tests.support.runs import working
from tests.support.serve import serving, until

from drivecal.client.client import Client
from drivecal.contracts.campaign import Campaign, CellCounts
from drivecal.domain.evaluations import Failure
from drivecal.highway.episode.runner import EpisodeRunner
from drivecal.plugins import registry

pytestmark = pytest.mark.slow

OPTIMIZER: dict[str, Any] = {"kind": "genetic", "population": 12, "iterations": 3, "seed": 4}
OTHER_WEIGHTS = {"S1": 3, "S5": 0}
PARAMETERS = tuple(f"P{number}" for number in range(1, 12))
BOLD = {name: {"influential": False} for name in PARAMETERS[3:]}
"""A map that claims too much, so that even a small campaign reuses; what is reused wrongly may be."""
REDUCTION = {"mode": "influence", "audit": 0.2, "max_error": 1}
NOT_COMPARED = {"milliseconds", "worker", "proven_by", "proof_agrees"}
"""Columns of an evaluation that say who simulated it and how fast, not what came out."""


Row = dict[str, str]


@dataclass(frozen=True)
class Gone:
    """A campaign, its table of evaluations, and the client of the server that still has it."""

    client: Client
    campaign: Campaign
    rows: list[Row]


def _evaluations(client: Client, campaign: Campaign) -> list[Row]:
    content = b"".join(client.table(campaign.id, "evaluations", "csv")).decode()
    return sorted(csv.DictReader(content.splitlines()), key=lambda row: int(row["id"]))


def _ended(client: Client, campaign: Campaign) -> Campaign:
    *_, ended = client.watch(campaign.id)
    assert (ended.state, ended.error, ended.degraded) == ("succeeded", None, None)
    return ended


def _carry_out(url: str) -> Gone:
    client = Client(url)
    posted = client.post_influence_map({"scenarios": dict.fromkeys(("S1", "S2", "S3", "S4", "S5", "S6"), BOLD)})
    specification = {"sensitivity": {"map": posted.id}, "optimizer": OPTIMIZER, "reduction": REDUCTION}
    campaign = _ended(client, client.submit(specification))
    return Gone(client, campaign, _evaluations(client, campaign))


@pytest.fixture(scope="module")
def two_workers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gone]:
    with serving(tmp_path_factory.mktemp("two"), workers=2) as server:
        with Client(server.url) as client:
            until(lambda: [worker.state for worker in client.workers().items] == ["idle", "idle"], "two workers", 240)
        yield _carry_out(server.url)


def _check_cells(campaign: Campaign, rows: list[Row]) -> None:
    cells = campaign.cells
    assert cells.pending == cells.failed == 0
    assert cells.proposed == cells.carried_over + cells.requested
    assert cells.requested == cells.repeated + cells.reused + cells.certified + cells.simulated == len(rows)
    outcomes = Counter(row["outcome"] for row in rows)
    assert outcomes["simulated"] == cells.simulated
    assert outcomes["repeated"] == cells.repeated
    assert outcomes["reused"] == cells.reused
    assert sum(row["audited"] == "true" for row in rows) == cells.audited <= cells.simulated
    assert sum(rate.audited for rate in campaign.error_rate.values()) == cells.audited


def test_every_cell_has_its_answer_and_two_workers_gave_them(two_workers: Gone) -> None:
    campaign, rows = two_workers.campaign, two_workers.rows
    assert campaign.cells.proposed == OPTIMIZER["population"] * OPTIMIZER["iterations"] * 6
    _check_cells(campaign, rows)
    assert campaign.cells.simulated > 60
    assert campaign.cells.reused > 0
    assert len({row["worker"] for row in rows if row["outcome"] == "simulated"}) == 2
    assert len({row["score"] for row in rows}) >= 4, "a campaign in which everything is alike shows nothing"
    by_id = {row["id"]: row for row in rows}
    for row in rows:
        if row["outcome"] == "reused":
            reference = by_id[row["reference"]]
            assert reference["outcome"] == "simulated"
            assert (reference["scenario"], reference["score"]) == (row["scenario"], row["score"])


def test_a_plain_runner_in_another_process_gives_the_same_bits(two_workers: Gone) -> None:
    function, vehicle = registry.driving_function("frenet"), registry.vehicle("single_track")
    nominal = {parameter.name: parameter.nominal for parameter in vehicle.parameters}
    evaluator = registry.evaluator("reference")
    runners = {
        name: EpisodeRunner(scenario, function, vehicle.create(nominal), evaluator)
        for name, scenario in registry.catalogue("highway").scenarios.items()
    }
    simulated = [row for row in two_workers.rows if row["outcome"] == "simulated"]
    for row in reversed(simulated):  # any order will do
        result = runners[row["scenario"]].run([float(row[name]) for name in PARAMETERS])
        expected = (int(row["score"]), float(row["rating"]), row["failure"] or None)
        assert (result.rating.score, result.rating.rating, result.failure) == expected, row
    assert {row["failure"] for row in simulated} - {""} <= set(Failure)


def test_the_best_solution_is_the_best_of_the_table(two_workers: Gone) -> None:
    client, campaign, rows = two_workers.client, two_workers.campaign, two_workers.rows
    solutions = client.solutions(campaign.id).items
    assert campaign.best is not None
    assert (solutions[0].objective, solutions[0].scores) == (campaign.best.objective, campaign.best.scores)
    for better, one in pairwise(solutions):
        assert better.objective >= one.objective - 1e-9
        assert one.objective == pytest.approx(sum(one.scores.values()) / 6)
    scored = {(row["scenario"], *(float(row[name]) for name in PARAMETERS)): int(row["score"]) for row in rows}
    best = tuple(solutions[0].parameters[name] for name in PARAMETERS)
    assert {scenario: scored[scenario, *best] for scenario in solutions[0].scores} == solutions[0].scores


def test_a_rerun_with_other_weights_repeats_what_is_known(two_workers: Gone) -> None:
    client, first = two_workers.client, two_workers.campaign
    rerun = _ended(client, client.rerun(first.id, {"weights": OTHER_WEIGHTS}))
    rows = _evaluations(client, rerun)
    _check_cells(rerun, rows)
    assert rerun.rerun_of == first.id
    assert "S5" not in {row["scenario"] for row in rows}
    start = [row for row in rows if row["iteration"] == "0" and row["outcome"] == "simulated"]
    assert all(row["audited"] == "true" for row in start), "its first generation is the first campaign's"
    assert rerun.cells.repeated >= 0.8 * OPTIMIZER["population"] * 5
    before = {(row["scenario"], *(row[name] for name in PARAMETERS)): row["rating"] for row in two_workers.rows}
    for row in rows:
        if row["outcome"] == "repeated":
            assert row["rating"] == before[row["scenario"], *(row[name] for name in PARAMETERS)]


def what_came_out(row: Row) -> Row:
    """Which of its runs a worker could prove depends on what it had simulated before: a certified cell counts as simulated here."""
    found = {name: value for name, value in row.items() if name not in NOT_COMPARED}
    if found["outcome"] == "certified":
        found |= {"outcome": "simulated", "reference": ""}
    return found


def answered(cells: CellCounts) -> tuple[int, ...]:
    return cells.requested, cells.repeated, cells.reused, cells.certified + cells.simulated, cells.audited, cells.failed


def test_one_worker_without_ray_gives_the_same_evaluations_bit_for_bit(two_workers: Gone, tmp_path: Path) -> None:
    with api.serving(f"sqlite:///{tmp_path / 'drivecal.db'}") as running, working(running.database, InThisProcess()):
        one_worker = _carry_out(running.url)
    assert {row["worker"] for row in one_worker.rows if row["outcome"] == "simulated"} == {NAME}
    assert len(one_worker.rows) == len(two_workers.rows)
    for ours, theirs in zip(one_worker.rows, two_workers.rows, strict=True):
        assert what_came_out(ours) == what_came_out(theirs)
    assert answered(one_worker.campaign.cells) == answered(two_workers.campaign.cells)
    assert one_worker.campaign.best == two_workers.campaign.best
    assert one_worker.campaign.error_rate == two_workers.campaign.error_rate
