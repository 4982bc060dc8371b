"""Classes of manoeuvres, by which comfort is rated (Section IV-A of the paper)."""

from enum import StrEnum


class Manoeuvre(StrEnum):
    """Class by which the evaluators of the motorway rate a scenario: its `rated_as`."""

    LANE_CHANGE = "lane_change"
    LANE_KEEPING = "lane_keeping"
    SPEED_CHANGE = "speed_change"
