"""The time left follows the newer half of the answers, and is told once there is something to judge it by."""

import json
from pathlib import Path

import pytest

from drivecal.campaigns.stages.stage import EtaEstimate

RECORDED = json.loads((Path(__file__).parent / "recorded_progress.json").read_text())
"""Progress of campaigns: seconds, done, total, answered by workers; the last one at the end of the stage. A slow start, stored answers
in bursts, failures that end early, random simulators, swarms, several objectives, two cores that others used as well."""


def test_the_first_cells_tell_nothing_about_the_time_left() -> None:
    now = 100.0
    estimate = EtaEstimate(lambda: now, done=0, worked=0)
    now = 101.0
    assert estimate.progress(500, 1000, 400).eta_seconds is None, "workers may still be starting"
    now = 110.0
    estimate = EtaEstimate(lambda: now, done=0, worked=0)
    now = 120.0
    assert estimate.progress(15, 2000, 14).eta_seconds is None, "less than a percent"
    estimate = EtaEstimate(lambda: now, done=0, worked=0)
    now = 130.0
    assert estimate.progress(1000, 2000, 9).eta_seconds is None, "copies alone"


def test_copies_count_towards_the_percent() -> None:
    now = 0.0
    estimate = EtaEstimate(lambda: now, done=20_000, worked=0)
    now = 500.0
    assert estimate.progress(70_000, 120_000, 500).eta_seconds == 500.0


def test_the_time_left_follows_from_the_newer_half_since_the_stage_was_taken_up() -> None:
    now = 0.0
    estimate = EtaEstimate(lambda: now, done=600, worked=200)
    assert estimate.progress(700, 1000, 200).eta_seconds is None, "copies alone"
    for moment, done, worked in ((50.0, 720, 220), (60.0, 740, 240)):  # the first answers waited for a worker to start
        now = moment
        progress = estimate.progress(done, 1000, worked)
    assert (progress.done, progress.total, progress.eta_seconds) == (740, 1000, 130.0)


@pytest.mark.parametrize("name", RECORDED)
def test_the_time_left_is_never_less_than_half_of_what_it_took(name: str) -> None:
    now = 0.0
    estimate = EtaEstimate(lambda: now, done=0, worked=0)
    end = RECORDED[name][-1][0]
    shares = []
    for moment, done, total, worked in RECORDED[name]:
        now = moment
        left = estimate.progress(done, total, worked).eta_seconds
        if left is not None and end - now > 5:
            shares.append(left / (end - now))
    assert len(shares) > 5
    assert min(shares) > 0.5
