"""Roads for tests, computed from a design in the place of a network."""

from drivecal.domain.scenarios import Road
from drivecal.highway.scenarios.designs import CurvatureKnot, RoadDesign, line_of


def road_of(length: float, lanes: int, lane_width: float, knots: tuple[CurvatureKnot, ...]) -> Road:
    return Road(line_of(RoadDesign(length, lanes, lane_width, knots)), length, lanes, lane_width)
