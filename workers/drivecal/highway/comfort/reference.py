"""The reference comfort scale: rates metrics on 0..7, transparently. Pure Python, so that the coordinator can re-rate stored metrics.

Every criterion is mapped to z = clip((m - comfortable) / (unacceptable - comfortable), 0, 1.2). The rating is
7 (1 - min(1, (sum z^4)^(1/4))), so that the worst criterion dominates and several bad ones add up. The score is the rating rounded half up.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from drivecal.domain.evaluations import Rating
from drivecal.plugins.ports import Evaluator

BEST = 7


class Manoeuvre(StrEnum):
    """Class of a scenario for the evaluators of the motorway (Section IV-A of the paper): its `rated_as`."""

    LANE_CHANGE = "lane_change"
    LANE_KEEPING = "lane_keeping"
    SPEED_CHANGE = "speed_change"


@dataclass(frozen=True, slots=True)
class Criterion:
    """A metric with its anchors in the metric's unit: no deduction up to `comfortable`, rating 0 from `unacceptable` on."""

    metric: str
    comfortable: float
    unacceptable: float

    def badness(self, measured: float) -> float:
        """Returns z in 0..1.2."""
        return min(1.2, max(0.0, (measured - self.comfortable) / (self.unacceptable - self.comfortable)))


MOTION = (
    Criterion("peak_lateral_acceleration_mps2", 0.9, 3.0),
    Criterion("peak_lateral_jerk_mps3", 0.6, 5.0),
    Criterion("peak_longitudinal_acceleration_mps2", 0.9, 3.5),
    Criterion("peak_longitudinal_jerk_mps3", 0.6, 2.5),
)
"""Criteria of every manoeuvre. The unacceptable anchors are limits of standards: 3 m/s^2 and 5 m/s^3 laterally (UN R79, ISO 11270),
3.5 m/s^2 and 2.5 m/s^3 longitudinally (ISO 15622). The comfortable anchors are our choice."""

LANE_KEEPING = (
    Criterion("offset_rms_m", 0.10, 0.60),
    Criterion("offset_overshoot_m", 0.10, 0.60),
    Criterion("steering_reversals_per_minute", 12.0, 60.0),
)
"""Additional criteria of lane keeping, our choice: standards define none. At 0.6 m off the centre of a 3.75 m lane a car of 1.9 m has 0.3 m
left; a car that reverses its steering every second oscillates."""


def criteria(manoeuvre: Manoeuvre) -> tuple[Criterion, ...]:
    """Returns the criteria of a class of manoeuvres."""
    return MOTION + LANE_KEEPING if manoeuvre is Manoeuvre.LANE_KEEPING else MOTION


def rate(manoeuvre: Manoeuvre, metrics: Mapping[str, float]) -> Rating:
    """Rates a run that did not fail. Raises KeyError if a metric is missing and ValueError if it is not finite."""
    total = 0.0
    for criterion in criteria(manoeuvre):
        measured = metrics[criterion.metric]
        if not math.isfinite(measured):
            raise ValueError(f"{criterion.metric} is {measured}; only finite metrics can be rated")
        total += criterion.badness(measured) ** 4
    rating = BEST * (1.0 - min(1.0, total**0.25))
    return Rating(rating=rating, score=math.floor(rating + 0.5))


class ReferenceEvaluator:
    """Rates by the reference comfort scale, see `drivecal.highway.comfort.reference`."""

    name = "reference"
    version = "1"

    def rate(self, rated_as: str, metrics: Mapping[str, float]) -> Rating:
        """Rates a run that did not fail."""
        return rate(Manoeuvre(rated_as), metrics)


REFERENCE: Evaluator = ReferenceEvaluator()
