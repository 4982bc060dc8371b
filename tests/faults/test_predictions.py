"""Kills of real processes while predictions answer cells, on a model that takes long enough for predictions to pay."""

import time
from collections.abc import Callable
from typing import Any

import pytest
from tests.support.faults.coordinator import Coordinator
from tests.support.faults.findings import Found, found
from tests.support.faults.lives import kill_dispatcher
from tests.support.problems import store
from tests.support.serve import until

from drivecal.client import Client

MODEL = """
import time

def evaluate(parameters, scenario):
    time.sleep(0.1)  # some four times of what pays
    return {"miss": sum((x - 0.4) ** 2 for x in parameters.values())}
"""
MANIFEST: dict[str, Any] = {
    "parameters": {place: {"lower": 0, "upper": 1, "step": 0.01} for place in "xyz"},
    "simulator": {"kind": "python", "file": "model.py", "function": "evaluate", "deterministic": True},
    "measures": {"miss": "1"},
    "scores": {"best": {"formula": "miss", "direction": "minimise", "range": [0, 2], "tolerance": 0.1}},
}
SEARCH = {"kind": "genetic", "population": 150, "iterations": 4, "seed": 3}


def kill_worker(server: Coordinator) -> None:
    until(lambda: bool(server.workers()), "a worker that can be killed")
    server.workers()[0].kill()


def search(server: Coordinator, name: str, kills: dict[str, Callable[[Coordinator], None]]) -> Found:
    """Carries out a campaign on a new problem, and each of the kills, by outcome, after cells with that outcome."""
    problem = store(server.database, MANIFEST | {"problem": name, "scenarios": {"S1": {"of": name}}}, {"model.py": MODEL})
    with Client(server.url) as client:
        campaign = client.submit({"problem": problem, "optimizer": SEARCH, "reduction": {"mode": "predicted"}}).id
        for outcome, kill in kills.items():
            while not getattr(client.campaign(campaign).cells, outcome):
                time.sleep(0.05)
            kill(server)
        until(lambda: server.ready and client.campaign(campaign).ended_at is not None, "the end of the campaign")
    return found(server, campaign)


@pytest.mark.slow
def test_a_campaign_with_predictions_finds_the_same_whoever_is_killed(server_on: Callable[..., Coordinator]) -> None:
    server = server_on("sqlite", DRIVECAL_BACKEND="processes", DRIVECAL_WORKERS="3")
    server.start_ready()
    expected = search(server, "left-alone", {})
    ours = search(server, "killed", {"simulated": kill_worker, "sampled": kill_dispatcher, "predicted": kill_worker})
    assert expected.campaign["stages"]["calibration"]["predicted"] > 0
    assert (ours.campaign, ours.tables) == (expected.campaign, expected.tables)
