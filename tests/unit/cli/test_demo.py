"""The demo's own coordinator; the demo as a whole is run by `make demo`."""

import json
import os
import subprocess
from pathlib import Path

import pytest

from drivecal.campaigns.resolve.problem import resolve
from drivecal.cli.commands.demo import (
    ANNOUNCEMENT,
    CAMPAIGN,
    MARKS,
    OTHER_WEIGHTS,
    PAPER,
    coordinator,
    fresh_folder,
    url_when_ready,
)
from drivecal.contracts.input_errors import validated
from drivecal.contracts.specification import CampaignSpecification
from drivecal.domain.errors import ConflictError, DatabaseError, DrivecalError
from drivecal.storage.engine import server_lock


def test_the_campaigns_can_run_within_their_budgets() -> None:
    problem = resolve(validated(CampaignSpecification, dict(CAMPAIGN)))
    assert problem.expected_runs().calibration_at_most == MARKS[-1]
    assert resolve(validated(CampaignSpecification, dict(PAPER))).expected_runs().calibration_at_most > 10 * MARKS[-1]
    assert set(OTHER_WEIGHTS) < set(problem.scenarios) == {"S1", "S2", "S3", "S4", "S5", "S6"}


def test_each_demo_begins_with_an_empty_folder(tmp_path: Path) -> None:
    folder = tmp_path / "home" / "demo"
    for _ in range(2):
        with fresh_folder(folder):
            assert list(folder.iterdir()) == []
            (folder / "left behind").touch()


def test_two_demos_do_not_share_a_folder(tmp_path: Path) -> None:
    with fresh_folder(tmp_path / "demo"):
        (tmp_path / "demo" / "summary.json").touch()
        with pytest.raises(ConflictError), fresh_folder(tmp_path / "demo"):
            pass
        assert (tmp_path / "demo" / "summary.json").exists()


def test_results_that_a_server_shows_are_not_deleted_by_a_new_demo(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    with fresh_folder(folder):
        (folder / "summary.json").touch()
    with server_lock.hold(f"sqlite:///{folder / 'drivecal.db'}"):
        with pytest.raises(DatabaseError, match=rf"\b{os.getpid()}\b.*DRIVECAL_HOME"), fresh_folder(folder):
            pass
        assert (folder / "summary.json").exists()
    with fresh_folder(folder):
        assert list(folder.iterdir()) == []


def test_a_coordinator_that_does_not_start_says_why(tmp_path: Path) -> None:
    with (
        server_lock.hold(f"sqlite:///{tmp_path / 'drivecal.db'}"),
        pytest.raises(DrivecalError, match=r"exit status 1"),
        coordinator(tmp_path),
    ):
        pass


def test_a_start_that_takes_long_gives_signs_of_life(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivecal.cli.commands.demo.SECONDS_BETWEEN_SIGNS", 0.0)
    url, said = "http://127.0.0.1:4321", []
    (tmp_path / ANNOUNCEMENT).touch()

    def say(message: str) -> None:
        said.append(message)
        if len(said) == 2:
            (tmp_path / ANNOUNCEMENT).write_text(json.dumps({"url": url}) + "\n")

    with subprocess.Popen(["sleep", "600"]) as process:
        assert url_when_ready(process, tmp_path, say) == url
        process.kill()
    assert [url in message for message in said] == [False, False, True]
