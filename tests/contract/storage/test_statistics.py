from collections import Counter

from sqlalchemy import Connection, update
from tests.support.storage import begun, campaign, cell

from drivecal.contracts.campaign import CellCounts
from drivecal.domain.campaigns import CampaignState, StageName
from drivecal.storage import campaigns, evaluations, leases, processes
from drivecal.storage.engine.database import Database
from drivecal.storage.engine.tables import campaigns as table
from drivecal.storage.engine.types import now
from drivecal.storage.maintenance import statistics
from drivecal.storage.maintenance.deletion import delete_campaign, removal
from drivecal.storage.maintenance.statistics import Statistics


def look(database: Database) -> Statistics:
    with database.read() as connection:
        return statistics.read(connection)


def count(connection: Connection, sequence: int, **cells: dict[str, int]) -> None:
    counted = {StageName(stage): CellCounts(**each) for stage, each in cells.items()}
    campaigns.save_counts(connection, sequence, counted)


def ended(connection: Connection, sequence: int, simulated: int) -> None:
    cells = {"simulated": simulated, "requested": simulated, "pending": 7}
    count(connection, sequence, calibration=cells)
    connection.execute(update(table).where(table.c.sequence == sequence).values(simulating_seconds=0.5 * simulated))
    campaigns.end(connection, sequence, CampaignState.SUCCEEDED)


def test_sums_are_over_all_campaigns_and_cells_wait_in_open_ones_only(database: Database) -> None:
    with database.transaction() as connection:
        sequences = [campaign(connection, str(number)).sequence for number in range(8)]
        for simulated, sequence in enumerate(sequences[:5]):
            ended(connection, sequence, simulated)
        count(connection, sequences[5], calibration={"simulated": 3, "pending": 4, "reused": 1}, sensitivity={"pending": 2})
        count(connection, sequences[6], robustness={"repeated": 8}, validation={"failed": 1, "pending": 6})
    result = look(database)
    assert result.campaigns == {("calibration", "succeeded"): 5, ("calibration", "queued"): 3}
    assert result.cells["calibration", "simulated"] == 10 + 3
    assert result.cells["calibration", "reused"] == 1
    assert result.cells["robustness", "repeated"] == 8
    assert result.cells["validation", "failed"] == 1
    assert result.pending == Counter(calibration=4, sensitivity=2, validation=6)
    assert result.simulating_seconds == 5.0
    with database.transaction() as connection:
        for sequence in sequences[5:7]:
            ended(connection, sequence, 100)
    result = look(database)
    assert result.cells["calibration", "simulated"] == 10 + 200
    assert result.campaigns["calibration", "succeeded"] == 7
    assert result.pending.total() == 0
    with database.transaction() as connection:
        delete_campaign(connection, campaigns.by_sequence(connection, sequences[4]).id)
    assert all(removal(database))
    assert look(database).cells == result.cells, "counters do not fall"
    assert look(database).campaigns["calibration", "succeeded"] == 6


def test_single_evaluations_are_counted_apart(connection: Connection) -> None:
    stored = campaigns.insert(connection, name="one", spec={}, kind="evaluation")
    count(connection, stored.sequence, calibration={"repeated": 2, "pending": 1})
    result = statistics.read(connection)
    assert result.campaigns == {("evaluation", "queued"): 1}
    assert result.cells["evaluation", "repeated"] == 2
    assert result.pending["evaluation"] == 1


def test_leases_of_the_current_term_are_those_at_workers(connection: Connection) -> None:
    assert statistics.read(connection).leases == 0
    processes.elect(connection, processes.DISPATCHER, 1, now())
    sequence, setup, sets = begun(connection, 4)
    ids = evaluations.insert(connection, sequence, [cell(n, setup, one) for n, one in enumerate(sets)])
    leases.take(connection, dict.fromkeys(ids, 0))
    leases.give_back(connection, {ids[0]: 1})
    result = statistics.read(connection)
    assert result.leases == 3
    assert result.dispatcher is not None
    processes.elect(connection, processes.DISPATCHER, 2, now())
    assert statistics.read(connection).leases == 0
