"""Builds the SUMO networks of the built-in scenarios: `python -m drivecal.highway.scenarios.build` (`make networks`).

Writes each design as plain nodes and edges, which netconvert turns into a network. Equal designs give equal bytes, because netconvert's
comment on time and place is removed. netconvert is part of `eclipse-sumo`, which only this module needs.
"""

import re
import sys
import tempfile
from collections.abc import Iterator
from itertools import pairwise
from math import ceil
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

from drivecal.domain.errors import UnavailableError
from drivecal.domain.roads import Floats, pose_on, to_cartesian
from drivecal.highway.scenarios.designs import DESIGNS, RoadDesign, line_of
from drivecal.roads.conversion import run_netconvert

POINT_SPACING = 5.0
"""Metres between points of a bent edge: on a radius of 480 m the chord stays within 7 mm of the arc."""
LONGEST_BENT_EDGE = 300.0
"""Metres, as in networks of motorways: vehicles pass from edge to edge."""
DECIMALS = 4
NETWORKS = Path(__file__).parents[1] / "problem"


def edge_ranges(road: RoadDesign, line: Floats) -> list[tuple[float, float, float]]:
    """Returns (begin, end, speed limit) of each edge, m and m/s: one edge per speed limit, several on bent roads."""
    ranges = []
    ends = [knot.s for knot in road.limits[1:]] + [road.length]
    for knot, end in zip(road.limits, ends, strict=True):
        bent = line[(line[:, 0] >= knot.s) & (line[:, 0] <= end), 4].any()
        parts = ceil((end - knot.s) / LONGEST_BENT_EDGE) if bent else 1
        borders = [knot.s + (end - knot.s) * part / parts for part in range(parts + 1)]
        ranges += [(first, second, knot.speed) for first, second in pairwise(borders)]
    return ranges


def plain_nodes(road: RoadDesign, line: Floats) -> Element:
    """Returns netconvert's nodes: begins and ends of edges, on the left border of the carriageway."""
    nodes = Element("nodes")
    for index, s in enumerate([begin for begin, _, _ in edge_ranges(road, line)] + [road.length]):
        x, y, _ = to_cartesian(line, s, road.left_edge)
        SubElement(nodes, "node", id=f"n{index}", x=f"{x:.{DECIMALS}f}", y=f"{y:.{DECIMALS}f}")
    return nodes


def plain_edges(road: RoadDesign, line: Floats) -> Element:
    """Returns netconvert's edges. The shape of an edge is the left border of its lanes."""
    edges = Element("edges")
    for index, (begin, end, speed) in enumerate(edge_ranges(road, line)):
        points = (to_cartesian(line, s, road.left_edge)[:2] for s in stations(line, begin, end))
        SubElement(
            edges,
            "edge",
            {
                "id": f"e{index}",
                "from": f"n{index}",
                "to": f"n{index + 1}",
                "numLanes": str(road.lanes),
                "width": str(road.lane_width),
                "speed": f"{speed:.{DECIMALS}f}",
                "shape": " ".join(f"{x:.{DECIMALS}f},{y:.{DECIMALS}f}" for x, y in points),
            },
        )
    return edges


def stations(line: Floats, begin: float, end: float) -> Iterator[float]:
    """Returns the arc lengths of an edge's points: its ends and, on bent roads, at least every `POINT_SPACING` metres."""
    parts = max(1, ceil((end - begin) / POINT_SPACING - 1e-9))
    for part in range(parts + 1):
        s = begin + (end - begin) * part / parts
        bends = any(pose_on(line, s + beside)[3] != 0.0 for beside in (-POINT_SPACING, 0.0, POINT_SPACING))
        if bends or part in {0, parts}:
            yield s


def build(road: RoadDesign) -> bytes:
    """Returns the network file of a design. Raises UnavailableError if netconvert is missing or fails."""
    line = line_of(road)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        (path / "road.nod.xml").write_bytes(tostring(plain_nodes(road, line)))
        (path / "road.edg.xml").write_bytes(tostring(plain_edges(road, line)))
        options = ["--no-internal-links", "--no-turnarounds", "--offset.disable-normalization", "--precision", str(DECIMALS)]
        process = run_netconvert([*options, "-n", "road.nod.xml", "-e", "road.edg.xml", "-o", "road.net.xml"], path)
        if process.returncode != 0:
            raise UnavailableError(f"netconvert failed: {process.stderr.strip()}")
        return without_origin((path / "road.net.xml").read_bytes())


def without_origin(network: bytes) -> bytes:
    """Removes the comment with time and place of the network's creation."""
    return re.sub(rb"<!-- generated on .*?-->\s*", b"", network, count=1, flags=re.DOTALL)


def main() -> int:
    """Writes the networks of all built-in scenarios."""
    NETWORKS.mkdir(exist_ok=True)
    for scenario, design in DESIGNS.items():
        path = NETWORKS / f"{scenario}.net.xml"
        path.write_bytes(build(design))
        sys.stdout.write(f"{path.name}: {path.stat().st_size / 1024:.1f} kB\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
