"""Simulators that wait: wall-clock time in the account, in predictions of cost, and in what a predictor may cost."""

from tests.integration.test_failures import Simulated, _pushed, run, submit

from drivecal.analysis.savings import account
from drivecal.contracts.work import Cell, CellResult
from drivecal.storage import campaigns, evaluations
from drivecal.storage.engine.database import Database
from drivecal.storage.references import runs

__all__ = ["_pushed"]


class Sleeping(Simulated):
    """Takes 90 s for 5 ms of CPU time."""

    def __call__(self, scenario: str, cell: Cell) -> CellResult:
        del scenario
        y = 1.0 + float(cell.parameters["x"])
        return CellResult(cell.id, None, None, {"y": y}, None, 5.0, wall_milliseconds=90_000.0)


def test_a_sleeping_simulator_saves_the_workers_time(database: Database) -> None:
    first = run(database, submit(database), Sleeping())
    again = run(database, submit(database), Sleeping())
    assert (first.cells.repeated, again.cells.simulated) == (0, 0)
    with database.read() as connection:
        accounts = [
            account(each.id, ["city", "road"], evaluations.costs_by_outcome(connection, each.sequence), None)
            for each in (first, again)
        ]
        setups = (campaigns.get(connection, first.id).resolution or {})["setups"]
        expected = runs.recent_milliseconds(connection, list(setups.values()))
        occupied, _ = evaluations.occupied(connection, again.sequence, after=0)
    assert [each.clock for each in accounts] == ["wall", "wall"]
    assert sum(scenario.simulated_seconds for scenario in accounts[0].scenarios) == 90 * first.cells.simulated
    assert accounts[1].saved_seconds == 90 * again.cells.repeated
    assert abs(first.simulating_seconds - 0.005 * first.cells.simulated) < 1e-9, "CPU time stays CPU time"
    assert expected == 90_000.0
    assert {name: seconds / cells for name, (cells, seconds) in occupied.items()} == {"city": 90e6, "road": 90e6}
