"""The reference comfort scale: from metrics to a rating 0..7, transparent and without any dependency.

Every criterion is mapped to z = clip((m - comfortable) / (unacceptable - comfortable), 0, 1.2); the rating is
7 (1 - min(1, (sum z^4)^(1/4))), so the worst criterion dominates and several bad ones add up. The score is the rating rounded half up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from drivecal.domain.evaluations import Rating
from drivecal.domain.scenarios import Manoeuvre

BEST = 7


@dataclass(frozen=True, slots=True)
class Criterion:
    """One metric with its anchors, in the metric's unit: at most `comfortable` costs nothing, `unacceptable` costs everything."""

    metric: str
    comfortable: float
    unacceptable: float

    def badness(self, measured: float) -> float:
        """z in 0..1.2."""
        return min(1.2, max(0.0, (measured - self.comfortable) / (self.unacceptable - self.comfortable)))


MOTION = (
    Criterion("peak_lateral_acceleration_mps2", 0.9, 3.0),
    Criterion("peak_lateral_jerk_mps3", 0.6, 5.0),
    Criterion("peak_longitudinal_acceleration_mps2", 0.9, 3.5),
    Criterion("peak_longitudinal_jerk_mps3", 0.6, 2.5),
)
"""For every manoeuvre. The unacceptable ends are limits of standards: 3 m/s^2 and 5 m/s^3 laterally (UN R79, ISO 11270), 3.5 m/s^2 and
2.5 m/s^3 longitudinally (ISO 15622); the comfortable ends are ours."""

LANE_KEEPING = (
    Criterion("offset_rms_m", 0.10, 0.60),
    Criterion("offset_overshoot_m", 0.10, 0.60),
    Criterion("steering_reversals_per_minute", 12.0, 60.0),
)
"""For lane keeping besides: our own choices, no standard gives them. With 0.6 m off the centre of a 3.75 m lane a car of 1.9 m has 0.3 m
left; a reversal every second is a car that hunts."""


def criteria(manoeuvre: Manoeuvre) -> tuple[Criterion, ...]:
    """What is rated in a manoeuvre of this class."""
    return MOTION + LANE_KEEPING if manoeuvre is Manoeuvre.LANE_KEEPING else MOTION


def rate(manoeuvre: Manoeuvre, metrics: Mapping[str, float]) -> Rating:
    """The rating of a run that did not fail. Raises KeyError where a metric is missing, ValueError where one is not finite."""
    total = 0.0
    for criterion in criteria(manoeuvre):
        measured = metrics[criterion.metric]
        if not math.isfinite(measured):
            raise ValueError(f"{criterion.metric} is {measured}; only finite metrics can be rated")
        total += criterion.badness(measured) ** 4
    rating = BEST * (1.0 - min(1.0, total**0.25))
    return Rating(rating=rating, score=math.floor(rating + 0.5))
