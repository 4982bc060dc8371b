"""A reader of OpenDRIVE of its own, for comparison: reference lines by numerical quadrature, and lane centres from widths and offsets."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import cos, sin
from xml.etree import ElementTree as ET

import numpy as np
import numpy.typing as npt
from scipy.integrate import quad

Floats = npt.NDArray[np.float64]


def _number(element: ET.Element, key: str) -> float:
    return float(element.attrib[key])


def _cubic(element: ET.Element, ds: float, names: Iterable[str] = "abcd") -> float:
    a, b, c, d = (_number(element, name) for name in names)
    return a + ds * (b + ds * (c + ds * d))


def _last(elements: list[ET.Element], key: str, s: float) -> ET.Element | None:
    before = [element for element in elements if _number(element, key) <= s + 1e-9]
    return before[-1] if before else None


@dataclass(frozen=True)
class RoadFile:
    """A road of the file."""

    element: ET.Element

    @property
    def id(self) -> str:
        """Id of the road."""
        return self.element.get("id", "")

    @property
    def length(self) -> float:
        """Length of its reference line."""
        return _number(self.element, "length")

    def reference(self, s: float) -> tuple[float, float, float]:
        """x, y and heading of the reference line."""
        geometry = _last(self.element.findall("planView/geometry"), "s", s)
        assert geometry is not None
        ds, heading = min(s - _number(geometry, "s"), _number(geometry, "length")), _number(geometry, "hdg")
        u, v, turn = _local(geometry, ds)
        x, y = _number(geometry, "x"), _number(geometry, "y")
        return x + u * cos(heading) - v * sin(heading), y + u * sin(heading) + v * cos(heading), heading + turn

    def sections(self) -> list[tuple[float, float, ET.Element]]:
        """Begin, end and element of each lane section."""
        sections = self.element.findall("lanes/laneSection")
        begins = [_number(section, "s") for section in sections]
        return list(zip(begins, [*begins[1:], self.length], sections, strict=True))

    def offset(self, s: float) -> float:
        """The lane offset."""
        element = _last(self.element.findall("lanes/laneOffset"), "s", s)
        return 0.0 if element is None else _cubic(element, s - _number(element, "s"))

    def centre(self, section: ET.Element, lane: int, s: float) -> tuple[float, float]:
        """x, y of a lane's centre."""
        side = 1 if lane > 0 else -1
        begin = _number(section, "s")
        lanes = {int(element.get("id", "0")): element for element in section.iter("lane")}
        t = self.offset(s)
        for index in range(side, lane + side, side):
            width = lane_width(lanes[index], s - begin)
            t += side * (width if index != lane else 0.5 * width)
        x, y, heading = self.reference(s)
        return x - t * sin(heading), y + t * cos(heading)


def lane_width(lane: ET.Element, ds: float) -> float:
    """Width of a lane at a distance from its section's begin."""
    element = _last(lane.findall("width"), "sOffset", ds)
    return 0.0 if element is None else _cubic(element, ds - _number(element, "sOffset"))


def _local(geometry: ET.Element, ds: float) -> tuple[float, float, float]:
    """u, v and turn in the frame of a geometry."""
    shape, length = geometry[0], _number(geometry, "length")
    if shape.tag == "line":
        return ds, 0.0, 0.0
    if shape.tag in {"arc", "spiral"}:
        first = _number(shape, "curvature" if shape.tag == "arc" else "curvStart")
        last = _number(shape, "curvature" if shape.tag == "arc" else "curvEnd")

        def turn(u: float) -> float:
            return first * u + 0.5 * (last - first) / length * u * u

        u, v = (quad(lambda w, function=function: function(turn(w)), 0.0, ds, limit=200)[0] for function in (cos, sin))
        return u, v, turn(ds)
    if shape.tag == "poly3":
        b, c, d = (_number(shape, name) for name in "bcd")
        u = ds
        for _ in range(50):  # u whose arc length is ds
            long = quad(lambda w: (1 + (b + 2 * c * w + 3 * d * w * w) ** 2) ** 0.5, 0.0, u)[0]
            u -= (long - ds) / (1 + (b + 2 * c * u + 3 * d * u * u) ** 2) ** 0.5
        return u, _cubic(shape, u), float(np.arctan(b + 2 * c * u + 3 * d * u * u))
    assert shape.tag == "paramPoly3"
    p = ds / length if shape.get("pRange") == "normalized" else ds
    u, v = _cubic(shape, p, ("aU", "bU", "cU", "dU")), _cubic(shape, p, ("aV", "bV", "cV", "dV"))
    du, dv = (_number(shape, f"b{k}") + 2 * _number(shape, f"c{k}") * p + 3 * _number(shape, f"d{k}") * p * p for k in "UV")
    return u, v, float(np.arctan2(dv, du))


def roads(content: bytes) -> list[RoadFile]:
    """The roads of a file."""
    return [RoadFile(element) for element in ET.fromstring(content).findall("road")]


def lane_centres(content: bytes, kinds: frozenset[str]) -> dict[tuple[str, float, int], Floats]:
    """Points of the centre of each lane of some types, by road, begin of the section and lane, where it is wider than a hand."""
    centres: dict[tuple[str, float, int], Floats] = {}
    for road in roads(content):
        for begin, end, section in road.sections():
            stations = np.linspace(begin, end, max(2, int(end - begin) + 1))
            for lane in section.iter("lane"):
                if lane.get("type") in kinds and lane.get("id") != "0":
                    index = int(lane.get("id", "0"))
                    points = [road.centre(section, index, s) for s in stations if lane_width(lane, s - begin) > 0.1]
                    if len(points) > 1:
                        centres[road.id, begin, index] = np.array(points)
    return centres
