"""Setup and cells for the driving function in `plugins`, as a coordinator that has it installed would send them."""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from tests.support.fake_backend import Behaviour

from drivecal.contracts.work import Cell, SetupRequest
from drivecal.plugins import registry
from drivecal.plugins.setups import setup_of

FOLDER = Path(__file__).parent / "plugins"


@cache
def _plug_in() -> Any:
    specification = importlib.util.spec_from_file_location("misbehaving", FOLDER / "misbehaving.py")
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module.MISBEHAVING


def misbehaving_setup(scenario: str = "S1", evaluator: str = "reference") -> SetupRequest:
    vehicle = registry.vehicle("single_track")
    setup = setup_of(registry.catalogue("highway").scenarios[scenario], _plug_in(), vehicle, {})
    return SetupRequest(
        "highway",
        scenario,
        "misbehaving",
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
