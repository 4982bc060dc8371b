"""SUMO networks for tests: of the package eclipse-sumo, or built here."""

import re
import subprocess
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from xml.etree import ElementTree as ET

import sumo

from drivecal.roads.corridor import Corridor, corridor
from drivecal.roads.network import Network, read_network

GAMES = Path(sumo.__file__).parent / "tools" / "game"
REAL: dict[str, tuple[str, tuple[str, ...]]] = {
    "motorway": ("A10KW/osm.net.xml", ("290296351", "240042212", "151495040", "264308374", "399250313", "264308373")),
    "exits": ("A10KW/osm.net.xml", ("264306385", "264308375", "264308383", "4054057", "264308376")),
    "entrance": ("A10KW/osm.net.xml", ("24498409", "4054057", "264308376")),
    "ramp": ("ramp/ramp.net.xml", ("offramp", "gneE3", "gneE7", "gneE8", "gneE11")),
    "merge": ("ramp/ramp.net.xml", ("gneE14", "gneE7", "gneE8", "gneE11")),
    "highway": ("highway/highway.net.xml", ("35136848", "17098081", "153189949")),
}
"""Files of eclipse-sumo, made of OpenStreetMap or by hand in formats 0.27, 1.9 and 1.16, and a route on each."""


def program(name: str) -> str:
    """Path of a program of eclipse-sumo."""
    return str(Path(sumo.__file__).parent / "bin" / name)


def real(name: str) -> Path:
    """Path of a real network."""
    return GAMES / REAL[name][0]


@cache
def real_network(file: str) -> Network:
    """A real network."""
    return read_network((GAMES / file).read_bytes(), file)


@cache
def real_corridor(name: str) -> Corridor:
    """The corridor of a real route."""
    file, route = REAL[name]
    return corridor(real_network(file), route, file)


def run(name: str, *options: str) -> bytes:
    """The network that netgenerate or netconvert makes."""
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "made.net.xml"
        subprocess.run([program(name), *options, "-o", str(output)], check=True, capture_output=True)
        return re.sub(rb"<!-- generated on .*?-->\s*", b"", output.read_bytes(), count=1, flags=re.DOTALL)


@cache
def generated(*options: str) -> bytes:
    """A network of netgenerate."""
    return run("netgenerate", *options)


def built(
    nodes: Sequence[dict[str, str]], edges: Sequence[dict[str, str]], connections: Sequence[dict[str, str]] = (), *options: str
) -> bytes:
    """A network that netconvert makes of nodes, edges and connections."""
    with tempfile.TemporaryDirectory() as folder:
        words = ["--no-turnarounds", *options]
        for kind, option, content in (("node", "-n", nodes), ("edge", "-e", edges), ("connection", "-x", connections)):
            root = ET.Element(f"{kind}s")
            for attributes in content:
                ET.SubElement(root, kind, attributes)
            path = Path(folder) / f"{kind}.xml"
            path.write_bytes(ET.tostring(root))
            words += [option, str(path)] if content else []
        return run("netconvert", *words)


def edge(name: str, begin: str, end: str, lanes: int, **others: str) -> dict[str, str]:
    """An edge from a node to another."""
    return {"id": name, "from": begin, "to": end, "numLanes": str(lanes), "speed": "33.33"} | others


def node(name: str, x: float, y: float, **others: str) -> dict[str, str]:
    """A node."""
    return {"id": name, "x": str(x), "y": str(y)} | others


def link(begin: str, end: str, first: int, second: int) -> dict[str, str]:
    """A connection."""
    return {"from": begin, "to": end, "fromLane": str(first), "toLane": str(second)}


@cache
def entrance(*options: str) -> bytes:
    """Two lanes, a ramp from the right, three lanes until the right lane ends, two lanes; widths 3.75, 3.5 and 3 m."""
    nodes = [node("a", 0, 0), node("b", 400, 0), node("c", 700, 0), node("d", 1200, 60), node("r", 150, -60)]
    edges = [
        edge("before", "a", "b", 2, width="3.75"),
        edge("ramp", "r", "b", 1, speed="22.22", shape="150,-60 250,-35 330,-16 400,-9", width="3.5"),
        edge("beside", "b", "c", 3, width="3.5"),
        edge("after", "c", "d", 2, speed="27.78", shape="700,0 800,0 900,5 1000,18 1100,36 1200,60", width="3"),
    ]
    links = [
        link("before", "beside", 0, 1),
        link("before", "beside", 1, 2),
        link("ramp", "beside", 0, 0),
        link("beside", "after", 1, 0),
        link("beside", "after", 2, 1),
    ]
    return built(nodes, edges, links, *options)


@cache
def crossing(kind: str = "priority") -> bytes:
    """Two roads that cross."""
    nodes = [node("a", -300, 0), node("b", 300, 0), node("c", 0, -300), node("d", 0, 300), node("m", 0, 0, type=kind)]
    names = (("west", "a", "m"), ("east", "m", "b"), ("south", "c", "m"), ("north", "m", "d"))
    return built(nodes, [edge(name, begin, end, 1, speed="13.89") for name, begin, end in names])


@cache
def bridges() -> bytes:
    """Two lanes under a bridge at x = 300, and an exit at x = 400 that crosses over them at x = 800; a road next to them back."""
    nodes = [
        node("a", 0, 0),
        node("b", 400, 0),
        node("c", 1200, 0),
        node("s", 300, -300),
        node("n", 300, 300),
        node("d", 800, 300),
    ]
    nodes += [node("e", 1200, 1), node("f", 0, 1)]
    edges = [
        edge("before", "a", "b", 2),
        edge("after", "b", "c", 2),
        edge("back", "e", "f", 2),
        edge("bridge", "s", "n", 1),
        edge("ramp", "b", "d", 1, shape="400,0 500,-20 600,-80 700,-150 760,-150 800,-100 800,300"),
    ]
    links = [link("before", "after", 0, 0), link("before", "after", 1, 1), link("before", "ramp", 0, 0)]
    return built(nodes, edges, links)


@cache
def roundabout() -> bytes:
    """A roundabout of four edges with an approach and an exit."""
    nodes = [node("w", -300, 0), node("e", 300, 0), node("s", 0, -300), node("n", 0, 300)]
    nodes += [node("1", -20, 0), node("2", 0, -20), node("3", 20, 0), node("4", 0, 20)]
    edges = [
        edge("in", "w", "1", 1),
        edge("out", "3", "e", 1),
        edge("from_south", "s", "2", 1),
        edge("to_north", "4", "n", 1),
        edge("r1", "1", "2", 1, shape="-20,0 -14,-14 0,-20"),
        edge("r2", "2", "3", 1, shape="0,-20 14,-14 20,0"),
        edge("r3", "3", "4", 1, shape="20,0 14,14 0,20"),
        edge("r4", "4", "1", 1, shape="0,20 -14,14 -20,0"),
    ]
    return built(nodes, edges)
