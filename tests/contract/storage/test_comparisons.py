"""Campaigns that are runs of a comparison: hidden, counted as one, and following it."""

from __future__ import annotations

import pytest
from sqlalchemy import Connection

from drivecal.contracts.campaign import CellCounts, Progress
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.domain.errors import ConflictError, OverloadError
from drivecal.storage import admission, campaigns, comparisons, events
from drivecal.storage.campaigns import Snapshot, StoredCampaign
from drivecal.storage.engine.database import Database
from drivecal.storage.maintenance import statistics
from drivecal.storage.maintenance.invariants import check_comparisons


def insert(connection: Connection) -> tuple[StoredCampaign, list[StoredCampaign]]:
    """A comparison with three runs, of which it has started two."""
    comparison = campaigns.insert(connection, name="compared", spec={}, kind="comparison")
    for number in range(3):
        campaigns.insert(connection, name=f"run {number}", spec={}, parent_sequence=comparison.sequence)
    campaigns.start(connection, comparison.sequence)
    runs = campaigns.runs_of(connection, comparison.sequence)
    for one in runs[:2]:
        campaigns.start(connection, one.sequence)
    return comparison, campaigns.runs_of(connection, comparison.sequence)


def states(connection: Connection, comparison: StoredCampaign) -> list[str]:
    return [one.state.value for one in campaigns.runs_of(connection, comparison.sequence)]


def test_runs_belong_to_their_comparison_and_see_nobody_elses_results(database: Database) -> None:
    with database.transaction() as connection:
        comparison, runs = insert(connection)
        assert [one.name for one in runs] == ["run 0", "run 1", "run 2"]
        assert [one.watermark for one in runs] == [0, 0, None]
        assert [one.id for one in campaigns.page(connection)[0]] == [comparison.id]
        assert [one.id for one in campaigns.active(connection)] == [comparison.id]
        assert comparisons.comparison_of(connection, runs[0].parent_sequence) == comparison.id
        assert comparisons.comparison_of(connection, comparison.parent_sequence) is None
        with pytest.raises(ConflictError, match=comparison.id):
            campaigns.request_action(connection, runs[0].id, "pause")


def test_a_comparison_takes_one_place_in_the_queue(database: Database) -> None:
    with database.transaction() as connection:
        waiting = campaigns.insert(connection, name="compared", spec={}, kind="comparison")
        for number in range(3):
            campaigns.insert(connection, name=f"run {number}", spec={}, parent_sequence=waiting.sequence)
        admission.admit(connection, 2, None)
        with pytest.raises(OverloadError):
            admission.admit(connection, 1, None)


def test_runs_rest_go_on_and_end_with_their_comparison(database: Database) -> None:
    with database.transaction() as connection:
        comparison, runs = insert(connection)
        campaigns.end(connection, runs[0].sequence, CampaignState.SUCCEEDED)
        campaigns.request_action(connection, comparison.id, "pause")
        assert states(connection, comparison) == ["succeeded", "running", "queued"]
        campaigns.pause(connection, comparison.sequence)
        assert states(connection, comparison) == ["succeeded", "paused", "queued"]
        campaigns.change_state(connection, comparison.sequence, [CampaignState.PAUSED], CampaignState.RUNNING)
        assert states(connection, comparison) == ["succeeded", "running", "queued"]
        campaigns.end(connection, comparison.sequence, CampaignState.FAILED, "of its own")
        assert states(connection, comparison) == ["succeeded", "cancelled", "cancelled"]
        ended = campaigns.runs_of(connection, comparison.sequence)
        assert all(one.ended_at is not None for one in ended)
        told = [one.kind for one in events.since(connection, runs[1].sequence, 0, 10)]
        assert told == ["queued", "running", "paused", "resumed", "cancelled"]


def test_what_makes_a_comparison_slow_is_said_of_its_runs_too(database: Database) -> None:
    def said() -> list[str | None]:
        return [
            one.degraded
            for one in (
                campaigns.by_sequence(connection, comparison.sequence),
                *campaigns.runs_of(connection, comparison.sequence),
            )
        ]

    with database.transaction() as connection:
        comparison, runs = insert(connection)
        campaigns.degrade(connection, [comparison.sequence], "no workers")
        assert said() == ["no workers", "no workers", "no workers", None], "the last one waits"
        campaigns.degrade(connection, [comparison.sequence], "no workers")
        campaigns.degrade(connection, [comparison.sequence], None)
        assert said() == [None] * 4
        assert [one.kind for one in events.since(connection, runs[0].sequence, 0, 10)][2:] == ["degraded", "recovered"]
        campaigns.degrade(connection, [comparison.sequence], "no workers")
        campaigns.request_action(connection, comparison.id, "pause")
        campaigns.pause(connection, comparison.sequence)
        assert said() == [None] * 4, "nothing that rests is slow"


def test_a_comparison_knows_its_runs_without_reading_all_of_them(database: Database, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparisons, "BATCH", 2)
    with database.transaction() as connection:
        comparison, runs = insert(connection)
        assert comparisons.open_runs(connection, comparison.sequence) == [one.sequence for one in runs]
        campaigns.end(connection, runs[0].sequence, CampaignState.SUCCEEDED)
        campaigns.end(connection, runs[1].sequence, CampaignState.FAILED, "a bug")
        assert comparisons.open_runs(connection, comparison.sequence) == [runs[2].sequence]
        assert comparisons.ended_of(connection, comparison.sequence) == (2, 3)
        assert comparisons.failed_runs(connection, comparison.sequence, 1) == (2, [("run 1", "a bug")])
        found = list(comparisons.tallies(connection, comparison.sequence))
        assert [(one.name, one.begun) for one in found] == [("run 0", True), ("run 1", True), ("run 2", False)]


@pytest.mark.slow("postgresql")
@pytest.mark.parametrize(
    ("statement", "sentence"),
    [
        ("UPDATE campaigns SET watermark = 5 WHERE name = 'run 0'", "is a run of a comparison, and sees results of others"),
        ("UPDATE campaigns SET kind = 'evaluation' WHERE name = 'run 2'", "is a run of a comparison, and no calibration"),
        ("UPDATE campaigns SET kind = 'calibration' WHERE name = 'compared'", "belongs to no comparison that is there"),
        ("UPDATE campaigns SET state = 'paused' WHERE name = 'compared'", "runs, and its comparison rests"),
        ("UPDATE campaigns SET state = 'failed' WHERE name = 'compared'", "goes on, and its comparison has ended"),
        ("UPDATE campaigns SET started_at = NULL WHERE name = 'compared'", "has begun, and its comparison has not"),
        ("UPDATE campaigns SET parent_sequence = NULL", "has no runs"),
        (
            (
                "UPDATE campaigns SET state = 'succeeded' WHERE name = 'compared'; INSERT INTO campaign_stages"
                " SELECT sequence, 2, '{\"requested\": 3}' FROM campaigns WHERE name = 'compared'"
            ),
            "counts 3 requested in its calibration, its runs 0",
        ),
    ],
)
def test_a_comparison_that_does_not_fit_its_runs_is_found(database: Database, statement: str, sentence: str) -> None:
    with database.transaction() as connection:
        insert(connection)
        assert list(check_comparisons(connection)) == []
        for each in statement.split(";"):
            connection.exec_driver_sql(each)
        assert any(sentence in one for one in check_comparisons(connection))


def test_cells_that_a_comparison_sums_up_are_counted_once(database: Database) -> None:
    snapshot = Snapshot(
        stage=StageName.CALIBRATION,
        iteration=0,
        cells={StageName.CALIBRATION: CellCounts(proposed=5, requested=5, simulated=5)},
        progress=Progress(),
        error_rate={},
        best=None,
        baseline=None,
        simulating_seconds=2.0,
        notes=(),
    )
    with database.transaction() as connection:
        comparison, runs = insert(connection)
        for one in (comparison, runs[0]):
            campaigns.save_progress(connection, one.sequence, snapshot)
        found, _ = statistics.read(connection, statistics.Tally())
    assert sum(found.sums.cells.values()) == 5
    assert found.sums.simulating_seconds == 2.0
    assert found.sums.campaigns[statistics.CampaignKey("comparison", "running")] == 1
