"""Carriageways: routes whose lanes are equally wide and all go from the begin to the end, as the roads of the built-in motorway are."""

from functools import lru_cache

import numpy as np

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.roads import Road, resampled
from drivecal.roads.corridor import Corridor, corridor
from drivecal.roads.network import read_network

SPACING = 0.5
"""Metres between rows of the reference line, exactly: a power of two, so that the row of an s is computed without rounding."""
LANE_TOLERANCE = 0.1
"""Largest distance (m) of a lane's centre from its expected place: the points of a curve are joined by chords."""
WIDTH_TOLERANCE = 0.01
"""Largest difference (m) of the widths of lanes."""
MEASURED = 32
"""Networks that stay measured, for roads and simulations that ask again."""


@lru_cache(MEASURED)
def corridor_of(network: bytes, route: tuple[str, ...], name: str) -> Corridor:
    """Returns the corridor of a route through a network file. `name`: the file in messages. Raises InvalidInputError."""
    return corridor(read_network(network, name), route, name)


@lru_cache(MEASURED)
def carriageway(network: bytes, route: tuple[str, ...], name: str) -> Road:
    """Returns the road of a route through a network file.

    Raises InvalidInputError if the file or the route cannot be used, or the lanes do not form a carriageway.
    """
    measured = corridor_of(network, route, name)
    lanes, width = len(measured.tracks), float(measured.widths[0, 0])
    if any(track.begin > 0.0 or track.end < measured.length for track in measured.tracks):
        raise _refused(name, "has lanes that begin or end on the way")
    if not measured.parallel:
        raise _refused(name, "has a lane that leads to two others, or two that lead to one")
    if float(np.max(np.abs(measured.widths - width))) > WIDTH_TOLERANCE:
        raise _refused(name, "has lanes of different widths")
    if float(np.max(np.abs(measured.centres - np.arange(lanes) * width))) > LANE_TOLERANCE:
        raise _refused(name, f"has lanes that do not lie beside each other at their width of {width:g} m")
    limits = measured.limits[:, 0]
    if np.any(measured.limits != limits[:, None]):
        raise _refused(name, "has lanes with limits of their own")
    changes = np.flatnonzero(np.diff(limits, prepend=-1.0))
    knots = tuple((float(measured.line[row, 0]), float(limits[row])) for row in changes)
    return Road(resampled(measured.line, measured.length, SPACING), measured.length, lanes, width, knots)


def _refused(name: str, message: str) -> InvalidInputError:
    return InvalidInputError(Problem("route", f"{name}: the route {message}", "give a carriageway, or the kind highway"))
