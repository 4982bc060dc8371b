"""Builds the SUMO networks of the built-in scenarios: `python -m drivecal.scenarios.build` (`make networks`).

Plain nodes and edges are written from each scenario's road and turned into a network by netconvert. The same roads give the same
bytes: what netconvert adds about time and place is left out. netconvert comes with `eclipse-sumo`, which only this module needs.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Iterator
from itertools import pairwise
from math import ceil
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

from drivecal.domain.errors import UnavailableError
from drivecal.domain.roads import Floats, pose_on, reference_line, to_cartesian
from drivecal.domain.scenarios import Road
from drivecal.scenarios.definitions import DEFINITIONS
from drivecal.scenarios.highway import network_name

POINT_SPACING = 20.0
"""Metres between points of an edge that bends: on a radius of 900 m the chord stays within 6 cm of the arc."""
LONGEST_BENT_EDGE = 300.0
"""Metres. SUMO searches all points of nearby edges each time the ego vehicle is placed; shorter edges cost at their joints."""
DECIMALS = 4
NETWORKS = Path(__file__).parent / "networks"


def edge_ranges(road: Road, line: Floats) -> list[tuple[float, float, float]]:
    """(begin, end, speed limit) of each edge, m and m/s: one per speed limit, several where the road bends."""
    ranges = []
    ends = [knot.s for knot in road.limits[1:]] + [road.length]
    for knot, end in zip(road.limits, ends, strict=True):
        bent = line[(line[:, 0] >= knot.s) & (line[:, 0] <= end), 4].any()
        parts = ceil((end - knot.s) / LONGEST_BENT_EDGE) if bent else 1
        borders = [knot.s + (end - knot.s) * part / parts for part in range(parts + 1)]
        ranges += [(first, second, knot.speed) for first, second in pairwise(borders)]
    return ranges


def plain_nodes(road: Road, line: Floats) -> Element:
    """netconvert's nodes: where edges begin and end, on the left border of the carriageway."""
    nodes = Element("nodes")
    for index, s in enumerate([begin for begin, _, _ in edge_ranges(road, line)] + [road.length]):
        x, y, _ = to_cartesian(line, s, road.left_edge)
        SubElement(nodes, "node", id=f"n{index}", x=f"{x:.{DECIMALS}f}", y=f"{y:.{DECIMALS}f}")
    return nodes


def plain_edges(road: Road, line: Floats) -> Element:
    """netconvert's edges. An edge's shape is the left border of its lanes."""
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
    """Where an edge gets a point: at its ends and, where the road bends, every `POINT_SPACING` metres or closer."""
    parts = max(1, ceil((end - begin) / POINT_SPACING - 1e-9))
    for part in range(parts + 1):
        s = begin + (end - begin) * part / parts
        bends = any(pose_on(line, s + beside)[3] != 0.0 for beside in (-POINT_SPACING, 0.0, POINT_SPACING))
        if bends or part in {0, parts}:
            yield s


def netconvert() -> str:
    """The path of netconvert, of this environment first. Raises UnavailableError where there is none."""
    beside = shutil.which("netconvert", path=sysconfig.get_path("scripts")) or shutil.which("netconvert")
    if beside is None:
        raise UnavailableError("netconvert is not installed, which builds the networks; install eclipse-sumo")
    return beside


def build(road: Road) -> bytes:
    """The network file of a road.

    Raises UnavailableError where netconvert is missing or fails.
    """
    line = reference_line(road)
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        (here / "road.nod.xml").write_bytes(tostring(plain_nodes(road, line)))
        (here / "road.edg.xml").write_bytes(tostring(plain_edges(road, line)))
        options = ["--no-internal-links", "--no-turnarounds", "--offset.disable-normalization", "--precision", str(DECIMALS)]
        command = [netconvert(), *options, "-n", "road.nod.xml", "-e", "road.edg.xml", "-o", "road.net.xml"]
        done = subprocess.run(command, cwd=here, capture_output=True, text=True, check=False)  # noqa: S603  # nothing of a user's
        if done.returncode != 0:
            raise UnavailableError(f"netconvert failed: {done.stderr.strip()}")
        return without_origin((here / "road.net.xml").read_bytes())


def without_origin(network: bytes) -> bytes:
    """The network without the comment that says when and from where it was made."""
    return re.sub(rb"<!-- generated on .*?-->\s*", b"", network, count=1, flags=re.DOTALL)


def main() -> int:
    """Writes the networks of all built-in scenarios."""
    NETWORKS.mkdir(exist_ok=True)
    for scenario in DEFINITIONS:
        path = NETWORKS / network_name(scenario)
        path.write_bytes(build(scenario.road))
        sys.stdout.write(f"{path.name}: {path.stat().st_size / 1024:.1f} kB\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
