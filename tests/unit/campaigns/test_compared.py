"""Histograms of validations: limited, and wrong where R_err says so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.support.scales import COST

from drivecal.campaigns.stages.validation import compared
from drivecal.domain.scales import COMFORT, Scale

SCALES = [COMFORT, COST, *(replace(COST, tolerance=tolerance) for tolerance in (0.0, 1e-9, 0.3, 0.5, 3.0, 70.0))]


@pytest.mark.parametrize("scale", SCALES)
def test_a_bar_is_wrong_exactly_if_its_differences_are(scale: Scale) -> None:
    drawn = np.random.default_rng(3).uniform(-2, 2, 2_000) * scale.span
    near = np.array([-1, 1])[:, None] * (scale.tolerance + np.array([-1e-3, -1e-12, 0, 1e-12, 1e-5, 1e-3]) * scale.span)
    differences = np.concatenate([drawn, near.ravel(), [0.0]])
    if scale.step is not None:
        differences = np.rint(differences)
    row = compared(differences, scale)
    bars = {int(number): count for number, count in row["histogram"].items()}
    assert sum(bars.values()) == row["compared"]
    assert sum(count for number, count in bars.items() if scale.is_wrong(number * row["histogram_step"])) == row["wrong"]


@pytest.mark.parametrize("scale", SCALES)
def test_differences_beyond_the_span_share_a_bar(scale: Scale) -> None:
    row = compared(np.array([-1e300, -1e15, 0.0, 3 * scale.span + 9 * scale.tolerance, 1e18, np.inf]), scale)
    last = scale.last_bar + 1
    assert row["histogram"] == {str(-last): 2, "0": 1, str(last): 3}
    assert last <= 101
