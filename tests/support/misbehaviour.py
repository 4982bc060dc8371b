"""Setup and cells for the driving functions in `plugins`, as a coordinator that has them installed would send them."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from tests.support.fake_backend import Behaviour
from tests.support.setups import driven
from tests.support.tree import loaded

from drivecal.bundles.installed import installed_problems
from drivecal.contracts.work import Cell, SetupRequest

FOLDER = Path(__file__).parent / "plugins"
ARCHIVES = {problem.digest: problem.archive for problem in installed_problems().values()}
"""Problem bundles that the real backends of the tests know, by digest."""


@cache
def plug_in(name: str) -> Any:
    """The module of one of them."""
    return loaded(name, FOLDER / f"{name}.py")


def misbehaving_setup(scenario: str = "S1", evaluator: str = "reference", name: str = "misbehaving") -> SetupRequest:
    return driven(scenario, evaluator=evaluator, function=getattr(plug_in(name), name.upper()))


def misbehaving_cells(behaviours: Sequence[Behaviour], first: int = 1) -> tuple[Cell, ...]:
    """No two are identical: they would be simulated once."""
    return tuple(
        Cell(first + index, {"behaviour": float(one), "value": float(first + index)}) for index, one in enumerate(behaviours)
    )
