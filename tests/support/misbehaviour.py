"""Setup and cells for the driving functions in `plugins`, as a coordinator that has them installed would send them."""

from collections.abc import Sequence
from pathlib import Path

from tests.support.fake_backend import Behaviour
from tests.support.plugins.misbehaving import MISBEHAVING
from tests.support.setups import driven

from drivecal.bundles.installed import installed_problems
from drivecal.contracts.work import Cell, SetupRequest
from drivecal.plugins.ports import DrivingFunction

FOLDER = Path(__file__).parent / "plugins"
ARCHIVES = {problem.digest: problem.archive for problem in installed_problems().values()}
"""Problem bundles that the real backends of the tests know, by digest."""


def misbehaving_setup(scenario: str = "S1", function: DrivingFunction = MISBEHAVING) -> SetupRequest:
    return driven(scenario, function=function)


def misbehaving_cells(behaviours: Sequence[Behaviour], first: int = 1) -> tuple[Cell, ...]:
    """No two are identical: they would be simulated once."""
    return tuple(
        Cell(first + index, {"behaviour": float(one), "value": float(first + index)}) for index, one in enumerate(behaviours)
    )
