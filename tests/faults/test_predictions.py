"""Kills of real processes while predictions answer cells: a program whose runs take long enough for predictions to pay."""

import json
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.support.faults.coordinator import Coordinator
from tests.support.faults.findings import Found, found
from tests.support.faults.lives import kill_dispatcher
from tests.support.serve import until

from drivecal.client import Client
from drivecal.contracts.campaign import Campaign

PROGRAM = """
import json, sys, time

for line in sys.stdin:
    request = json.loads(line)
    if "parameters" in request:
        time.sleep(0.1)  # some four times of what pays
        miss = sum((x - 0.4) ** 2 for x in request["parameters"].values())
        print(json.dumps({"id": request["id"], "measures": {"miss": miss}}), flush=True)
    elif "quit" not in request:
        print(json.dumps({"ready": True}), flush=True)
"""
SEARCH = {"kind": "genetic", "population": 150, "iterations": 4, "seed": 3}


def search(server: Coordinator, client: Client, name: str, meanwhile: Callable[[str], None]) -> Found:
    """Carries out a campaign on the files of a `name`, whose results are not stored yet; returns what it found."""
    folder = server.folder / name
    folder.mkdir()
    (folder / "program.py").write_text(PROGRAM)
    manifest = {
        "problem": name,
        "parameters": {place: {"lower": 0, "upper": 1, "step": 0.01} for place in "xyz"},
        "simulator": {"kind": "process", "command": [sys.executable, "./program.py"], "deterministic": True},
        "scenarios": {"S1": {"of": name}},
        "measures": {"miss": "1"},
        "scores": {"best": {"formula": "miss", "direction": "minimise", "range": [0, 2], "tolerance": 0.1}},
    }
    (folder / "problem.yaml").write_text(json.dumps(manifest))
    client.push_problem(folder)
    campaign = client.submit({"name": name, "problem": name, "optimizer": SEARCH, "reduction": {"mode": "predicted"}})
    meanwhile(campaign.id)
    until(lambda: server.ready and client.campaign(campaign.id).ended_at is not None, "the end of the campaign")
    return found(server, campaign.id)


def kill_worker(server: Coordinator) -> None:
    """SIGKILL to the first worker that is found."""
    until(lambda: bool(server.workers()), "a worker that can be killed")
    server.workers()[0].kill()


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_campaign_with_predictions_finds_the_same_whoever_is_killed(
    server_on: Callable[..., Coordinator], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("DRIVECAL_HOME", str(tmp_path / "home"))  # whose secret pushes problems
    server = server_on("sqlite", DRIVECAL_BACKEND="processes", DRIVECAL_WORKERS="3")
    server.start_ready()

    with Client(server.url) as client:

        def when(campaign: str, condition: Callable[[Campaign], bool], kill: Callable[[], None]) -> None:
            until(lambda: condition(client.campaign(campaign)), "what a kill waits for")
            assert client.campaign(campaign).ended_at is None
            kill()

        def kills(campaign: str) -> None:
            when(campaign, lambda now: now.cells.simulated > 20, lambda: kill_worker(server))
            when(campaign, lambda now: now.cells.sampled > 0, lambda: kill_dispatcher(server))
            when(campaign, lambda now: now.cells.predicted > 0, lambda: kill_worker(server))

        expected = search(server, client, "left-alone", lambda _: None)
        ours = search(server, client, "killed", kills)
    assert int(expected.campaign["stages"]["calibration"]["predicted"]) > 0
    assert ours.tables["evaluations"] == expected.tables["evaluations"]
    assert ours.campaign == expected.campaign
    assert ours.tables == expected.tables
