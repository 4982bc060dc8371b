"""Setup and cells for the driving functions in `plugins`, as a coordinator that has them installed would send them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from tests.support.fake_backend import Behaviour
from tests.support.tree import loaded

from drivecal.contracts.work import Cell, DriveRequest
from drivecal.plugins import registry
from drivecal.plugins.setups import setup_of

FOLDER = Path(__file__).parent / "plugins"


@cache
def plug_in(name: str) -> Any:
    """The module of one of them."""
    return loaded(name, FOLDER / f"{name}.py")


def misbehaving_setup(scenario: str = "S1", evaluator: str = "reference", name: str = "misbehaving") -> DriveRequest:
    vehicle = registry.vehicle("single_track")
    function = getattr(plug_in(name), name.upper())
    setup = setup_of(registry.catalogue("highway").scenarios[scenario], function, vehicle, {})
    return DriveRequest(
        "highway",
        scenario,
        name,
        "single_track",
        setup.vehicle_parameters,
        evaluator,
        setup.fingerprint,
        setup.document,
    )


def misbehaving_cells(behaviours: Sequence[Behaviour], first: int = 1) -> tuple[Cell, ...]:
    """No two are identical: they would be simulated once."""
    return tuple(
        Cell(first + index, {"behaviour": float(one), "value": float(first + index)}) for index, one in enumerate(behaviours)
    )
