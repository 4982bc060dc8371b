"""The time of simulations before they are submitted."""

import pytest

from drivecal.api.expectation import Pace


def test_workers_share_the_simulations() -> None:
    assert Pace(10.0, measured=True, workers=4).seconds(400) == pytest.approx(1.0)
    assert Pace(10.0, measured=True, workers=None).seconds(400) is None
