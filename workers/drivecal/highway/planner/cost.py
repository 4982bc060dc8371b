"""The magnitudes of the cost: all constants of the planner, none of them a calibration parameter.

J = base + sum of weight x feature over the terms P1..P11. A feature is a raw quantity divided by its `typical` magnitude, a weight
is the parameter divided by the `middle` of its range (P1: decibels), so that a typical situation at mid-range costs 1 per term.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivecal.plugins.ports import Floats


@dataclass(frozen=True, slots=True)
class Term:
    """A calibrated term: the raw magnitude at which its feature is 1 and the parameter value at which its weight is 1."""

    name: str
    typical: float
    unit: str
    middle: float
    quantity: str


TERMS = (
    Term("P1", 0.4, "m²/s⁶", 0.0, "mean square of lateral plus longitudinal jerk"),  # a lane change in 5 s has 0.43
    Term("P2", 0.2, "m²/s⁴", 1.0, "mean square of lateral acceleration, the curve's v²κ included"),  # 0.26 in 5 s
    Term("P3", 0.1, "1", 100.0, "mean of e²/(1 + e²), e = offset (m) to the nearest lane centre"),  # a third of a metre off
    Term("P4", 2e-4, "rad²", 1000.0, "mean square of the heading relative to the road"),  # a third of a lane change in 5 s
    Term("P5", 0.02, "m²", 750.0, "mean square of the distance to the lateral plan before, saturating at half a metre"),
    Term("P6", 1.0, "s", 0.5, "time until the target lane is reached"),  # what 1.5 s more of lane change cost
    Term("P7", 0.08, "1", 100.0, "mean shortfall of an ellipse of clear space around other vehicles"),  # passing side by side
    Term("P8", 0.02, "1/s²", 1000.0, "largest 1/TTC² to a vehicle ahead"),  # 7 s to collision
    Term("P9", 0.25, "1", 5.0, "mean of (shortfall of clear space to the lane boundary / 0.5 m)²"),  # 0.25 m too near
    Term("P10", 0.02, "1/s²", 10.0, "mean of (lateral closing speed / lateral gap)² to neighbours alongside"),
    Term("P11", 0.02, "1/s²", 100.0, "largest 1/TTC² of a follower in the target lane"),  # 7 s to collision
)

SPEED_ERROR = 0.4
"""Base cost per (m/s)² of mean square speed error: 1.6 m/s off the desired speed weigh as much as a typical term at mid-range."""
TERMINAL_OFFSET = 3.0
"""Base cost of a plan that ends 1 m (times 2) off the target lane's centre; grows linearly beyond a metre: about 9 for a lane."""
ACCELERATION = 0.1
"""Base cost per (m/s²)² of mean square longitudinal acceleration: breaks ties towards calm speed changes."""
COLLISION = 3000.0
"""Base cost of touching another vehicle along the whole horizon; a single sample of thirty costs 100, more than all terms together."""

CHANGE_ASIDE = 0.5
CHANGE_AHEAD = 0.2
"""Base cost of leaving the previous lateral or longitudinal plan before its end. Without it the planner changes plans for no benefit and
drives restlessly; with it a run depends on few clear decisions, which many parameter sets share."""

LATEST_DECELERATION = 3.0
"""Deceleration of the desired speed ahead of a lower limit, m/s²: below the 3.5 of ISO 15622. The parameters decide how much earlier and
more gently the vehicle slows down."""


def weights(parameters: Sequence[float]) -> Floats:
    """Returns the weights of base and terms, shape (12,), from the values of P1..P11: 1, 10^(P1/10), then P / middle."""
    smoothing, *others = parameters
    linear = [value / term.middle for value, term in zip(others, TERMS[1:], strict=True)]
    return np.array([1.0, 10.0 ** (smoothing / 10.0), *linear])


SCALES: Floats = np.array(
    [
        0.0, *(1.0 / term.typical for term in TERMS),
        SPEED_ERROR, TERMINAL_OFFSET, ACCELERATION, COLLISION, CHANGE_ASIDE, CHANGE_AHEAD,
    ]
)  # fmt: skip
"""Factors of raw quantities in the kernels, shape (18,): [0] unused, [1..11] 1 / typical of the terms, [12] speed error, [13] terminal
offset, [14] acceleration, [15] collision, [16] change of the lateral, [17] of the longitudinal plan."""
