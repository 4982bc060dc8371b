"""Geometries of OpenDRIVE: lines, arcs, clothoids and polynomials, and records of cubic polynomials along a road."""

from dataclasses import dataclass, field
from math import ceil, cos, hypot, sin

import numpy as np

from drivecal.domain.roads import GAUSS_POINTS, GAUSS_WEIGHTS, Floats
from drivecal.roads.documents import Attributes

FARTHEST = 1e8
LONGEST = 1e6
LARGEST_COEFFICIENT = 1e9
SHARPEST = 10.0
"""Largest curvature (1/m)."""
PANEL = 1.0
"""Metres over which a clothoid is integrated by one rule of five points."""
MOST_PANELS = 1_000_000


@dataclass(slots=True)
class Cubics:
    """Records a + b ds + c ds² + d ds³, each from its begin on; 0 before the first."""

    records: list[tuple[float, float, float, float, float]] = field(default_factory=list)

    def append(self, attributes: Attributes, key: str) -> None:
        """Adds a record. `key`: the attribute of its begin."""
        coefficients = (attributes.number(name, -LARGEST_COEFFICIENT, LARGEST_COEFFICIENT) for name in "abcd")
        begin = attributes.number(key, 0.0, LONGEST)
        if self.records and begin < self.records[-1][0]:
            raise attributes.fault(f"the records of {attributes.element} are not in order", "order them")
        a, b, c, d = coefficients
        self.records.append((begin, a, b, c, d))

    def at(self, s: Floats) -> Floats:
        """Returns the values at each s."""
        if not self.records:
            return np.zeros(len(s))
        table = np.array(self.records)
        index = np.searchsorted(table[:, 0], s + 1e-9, side="right") - 1
        begin, a, b, c, d = table[np.maximum(index, 0)].T
        ds = s - begin
        return np.where(index >= 0, a + ds * (b + ds * (c + ds * d)), 0.0)


@dataclass(frozen=True, slots=True)
class Geometry:
    """A part of a reference line: its begin (s), pose, length, kind and coefficients."""

    begin: float
    x: float
    y: float
    heading: float
    length: float
    kind: str
    values: tuple[float, ...]

    def poses(self, ds: Floats) -> tuple[Floats, Floats, Floats]:
        """Returns x, y and heading at each distance from the begin."""
        u, v, turn = self._local(np.clip(ds, 0.0, self.length))
        forward, left = cos(self.heading), sin(self.heading)
        return self.x + u * forward - v * left, self.y + u * left + v * forward, self.heading + turn

    def _local(self, ds: Floats) -> tuple[Floats, Floats, Floats]:
        if self.kind == "line":
            return ds, np.zeros(len(ds)), np.zeros(len(ds))
        if self.kind in {"arc", "spiral"}:
            return self._clothoid(ds, *self.values)
        if self.kind == "poly3":
            return self._polynomial(ds, (0.0, 1.0, 0.0, 0.0), self.values)
        p = ds / self.length if self.values[8] else ds
        return _planar(p, self.values[:4], self.values[4:8])

    def _clothoid(self, ds: Floats, first: float, last: float) -> tuple[Floats, Floats, Floats]:
        """Integrates cos and sin of the turned angle by the rule of Gauss-Legendre with five points."""
        bend = (last - first) / self.length
        panels = min(MOST_PANELS, max(1, ceil(self.length / PANEL)))
        edges = np.unique(np.concatenate([np.linspace(0.0, self.length, panels + 1), ds]))
        steps = np.diff(edges)
        points = edges[:-1, None] + 0.5 * (1.0 + GAUSS_POINTS) * steps[:, None]
        angle = points * (first + 0.5 * bend * points)
        rows = np.searchsorted(edges, ds)
        u, v = (
            np.concatenate([[0.0], np.cumsum(0.5 * steps * (function(angle) @ GAUSS_WEIGHTS))])[rows]
            for function in (np.cos, np.sin)
        )
        return u, v, ds * (first + 0.5 * bend * ds)

    def _polynomial(self, ds: Floats, u: tuple[float, ...], v: tuple[float, ...]) -> tuple[Floats, Floats, Floats]:
        """Returns the points of v(u) at lengths along the curve."""
        panels = min(MOST_PANELS, max(1, ceil(self.length / PANEL)))
        edges = np.linspace(0.0, self.length, panels + 1)
        points = edges[:-1, None] + 0.5 * (1.0 + GAUSS_POINTS) * np.diff(edges)[:, None]
        slope = v[1] + points * (2.0 * v[2] + 3.0 * v[3] * points)
        length = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(edges) * (np.hypot(1.0, slope) @ GAUSS_WEIGHTS))])
        return _planar(np.interp(ds, length, edges), u, v)


def _planar(p: Floats, u: tuple[float, ...], v: tuple[float, ...]) -> tuple[Floats, Floats, Floats]:
    """Returns u, v and heading of two cubic polynomials of p."""
    values = [a + p * (b + p * (c + p * d)) for a, b, c, d in (u, v)]
    slopes = [b + p * (2.0 * c + 3.0 * d * p) for _, b, c, d in (u, v)]
    return values[0], values[1], np.arctan2(slopes[1], slopes[0])


def geometry_of(place: Attributes, shape: Attributes) -> Geometry:
    """Returns a geometry from its element and the shape in it. Raises InvalidInputError."""
    length = place.number("length", 0.0, LONGEST)
    values: tuple[float, ...] = ()
    if shape.element == "arc":
        values = (shape.number("curvature", -SHARPEST, SHARPEST),) * 2
    elif shape.element == "spiral":
        values = tuple(shape.number(key, -SHARPEST, SHARPEST) for key in ("curvStart", "curvEnd"))
    elif shape.element == "poly3":
        values = tuple(shape.number(key, -LARGEST_COEFFICIENT, LARGEST_COEFFICIENT) for key in "abcd")
    elif shape.element == "paramPoly3":
        keys = [name + axis for axis in "UV" for name in "abcd"]
        values = tuple(shape.number(key, -LARGEST_COEFFICIENT, LARGEST_COEFFICIENT) for key in keys)
        normalized = shape.text("pRange", "normalized") != "arcLength"
        values = (*values, float(normalized))
        if hypot(values[1], values[5]) == 0.0 and hypot(values[2], values[6]) == 0.0:
            raise shape.fault("the polynomial does not move", "export the file again")
    return Geometry(
        begin=place.number("s", 0.0, LONGEST),
        x=place.number("x", -FARTHEST, FARTHEST),
        y=place.number("y", -FARTHEST, FARTHEST),
        heading=place.number("hdg", -1e3, 1e3),
        length=max(length, 1e-6),
        kind=shape.element,
        values=values,
    )
