"""The time left is told once there is something to judge it by."""

from drivecal.campaigns.stages.stage import EtaEstimate


def test_the_first_cells_tell_nothing_about_the_time_left() -> None:
    now = 100.0
    estimate = EtaEstimate(lambda: now, done=0, worked=0)
    now = 101.0
    assert estimate.progress(500, 1000, 400).eta_seconds is None, "workers may still be starting"
    now = 110.0
    assert estimate.progress(5, 1000, 4).eta_seconds is None, "half a percent"
    assert estimate.progress(0, 1000, 0).eta_seconds is None


def test_the_time_left_follows_from_what_was_done_since_the_stage_was_taken_up() -> None:
    now = 0.0
    estimate = EtaEstimate(lambda: now, done=600, worked=200)
    now = 10.0
    assert estimate.progress(700, 1000, 200).eta_seconds is None, "copies alone"
    progress = estimate.progress(700, 1000, 201)
    assert (progress.done, progress.total, progress.eta_seconds) == (700, 1000, 30.0)
