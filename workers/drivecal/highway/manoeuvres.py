"""Classes of manoeuvres for the rating of comfort (Section IV-A of the paper)."""

from enum import StrEnum


class Manoeuvre(StrEnum):
    """Class of a scenario for the evaluators of the motorway: its `rated_as`."""

    LANE_CHANGE = "lane_change"
    LANE_KEEPING = "lane_keeping"
    SPEED_CHANGE = "speed_change"
