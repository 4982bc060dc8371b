"""The vehicle as a plug-in."""

from __future__ import annotations

import subprocess
import sys

from drivecal.highway.vehicle.model import SingleTrackModel
from drivecal.highway.vehicle.parameters import NOMINAL
from drivecal.highway.vehicle.single_track import SINGLE_TRACK
from drivecal.plugins import registry


def test_the_vehicle_is_found_by_its_entry_point() -> None:
    assert registry.vehicle("single_track") is SINGLE_TRACK


def test_it_creates_a_model_with_the_values_given() -> None:
    model = SINGLE_TRACK.create({parameter.name: parameter.nominal for parameter in SINGLE_TRACK.parameters})
    assert isinstance(model, SingleTrackModel)
    assert model.parameters == NOMINAL


def test_the_coordinator_can_load_it_without_numba_and_scipy() -> None:
    program = """
import sys
from drivecal.highway.vehicle.single_track import SINGLE_TRACK
assert not {"numba", "scipy"} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", program], check=True)
