"""The tables of the model cards describe the shipped arrays: the tests drive and rate the held-out data again, and train nothing.

`make train` writes both anew. Another processor, libm or integrator may move a figure's last digit.
"""

import re

import numpy as np
import pytest
from tests.golden import held_out

from drivecal.highway.comfort import regressions
from drivecal.highway.training import comfort, multibody, vehicle
from drivecal.highway.training.multibody import TRAINED, UNSEEN, draw
from drivecal.highway.training.tables import read_table
from drivecal.highway.training.vehicle import Drives
from drivecal.highway.vehicle import residual

VEHICLE_CARD = residual.FILE.with_suffix(".md")
COMFORT_CARD = regressions.FILE.with_suffix(".md")
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def assert_alike(table: str, written: str) -> None:
    """The same words, and the same figures but for the last digit."""
    assert NUMBER.sub("#", table) == NUMBER.sub("#", written)
    for ours, theirs in zip(NUMBER.findall(table), NUMBER.findall(written), strict=True):
        digits = len(theirs.partition(".")[2])
        slack = 1.01 * 10.0**-digits if digits else 0.5
        assert float(ours) == pytest.approx(float(theirs), abs=slack, rel=0.02)


@pytest.mark.slow
def test_the_hybrid_vehicle_errs_on_held_out_manoeuvres_as_its_card_says_and_half_as_much_as_the_plain_one() -> None:
    (kinds, drives), shipped = held_out.read(), residual.shipped()
    assert_alike(vehicle.error_table(shipped, kinds, drives), read_table(VEHICLE_CARD, vehicle.ERRORS))
    errors = vehicle.errors(shipped, kinds, drives)
    assert np.all(errors["hybrid"] <= 0.5 * errors["plain"])
    assert np.all(errors["plain"] <= errors["converted"])


@pytest.mark.slow
def test_the_multi_body_vehicle_drives_as_it_was_recorded() -> None:
    """The first two manoeuvres represent all forty."""
    recordings = vehicle.record_all((*TRAINED, UNSEEN), 2, vehicle.SEED + 1000)
    kinds, recorded = held_out.read()
    driven = Drives.of(recordings)
    assert [recording.manoeuvre.kind for recording in recordings] == kinds[:2]
    np.testing.assert_allclose(recorded.inputs[:2], driven.inputs, atol=1e-5)
    np.testing.assert_allclose(recorded.starts[:2], driven.starts, atol=1e-5)
    np.testing.assert_allclose(recorded.truth[:2], driven.truth, atol=3e-4)
    assert len(kinds) == vehicle.HELD_OUT + vehicle.HELD_OUT // len(TRAINED)


def test_the_hybrid_vehicles_range_is_what_its_card_says() -> None:
    assert_alike(vehicle.range_table(residual.shipped()), read_table(VEHICLE_CARD, vehicle.RANGE))


@pytest.mark.slow
def test_the_learned_evaluator_agrees_with_the_panel_on_held_out_manoeuvres_as_its_card_says() -> None:
    drives = comfort.drives(held_out=True)
    ratings = comfort.ratings(regressions.shipped(), drives)
    assert_alike(comfort.agreement_table(ratings, drives), read_table(COMFORT_CARD, comfort.AGREEMENT))
    assert_alike(comfort.calibration_table(ratings, drives), read_table(COMFORT_CARD, comfort.CALIBRATION))


def test_no_held_out_manoeuvre_of_the_vehicle_is_one_that_it_learned_from() -> None:
    """Drawn from seeds that differ: not one speed occurs twice."""
    wheelbase = multibody.converted().wheelbase
    speeds = []
    for seed, kinds in ((vehicle.SEED, TRAINED), (vehicle.SEED + 1000, (*TRAINED, UNSEEN))):
        rng = np.random.default_rng(seed)
        speeds.append({draw(kinds[number % len(kinds)], rng, wheelbase).speed for number in range(200)})
    assert not speeds[0] & speeds[1]
