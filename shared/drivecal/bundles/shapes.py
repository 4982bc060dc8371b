"""Curves and maps as parameters: few coefficients that a search moves, and the values at the support points that a simulator gets.

A curve of n points with k coefficients is a B-spline of at most degree 2 (Schoenberg's variation-diminishing spline): its values are
weighted means of the coefficients, and it is monotone, convex or at most so steep if the polygon of its coefficients is. Each coefficient
belongs to a place on the axis, its Greville abscissa. A map is the tensor product. Without `coefficients` every support point is one.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from typing import Annotated, Any, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import AfterValidator, Field, model_validator

from drivecal.bundles.expressions import Constraint
from drivecal.bundles.simulators import Text, Unit
from drivecal.contracts.setup import points_at
from drivecal.contracts.specification import Given, Model
from drivecal.contracts.strict_json import Number
from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.values import Argument, Points, Setting

Floats = npt.NDArray[np.float64]
Ranges = Mapping[str, tuple[float, float, float]]
"""Lower and upper bound of parameters by name, and the distance of their values; 0: continuous."""
DEGREE = 2
"""Degree of the splines: smooth, and a coefficient acts on few points."""
DECIMALS = 9
"""Decimals of values at support points, as of all parameters."""
MOST_COEFFICIENTS = 200
INEXACT = 1e-8
"""Difference from given values that is reported: beyond the rounding of their decimals."""
LINKS = 24
"""Most comparisons of one constraint on the course."""


def _rising(axis: list[float]) -> list[float]:
    for lower, upper in pairwise(axis):
        if not lower < upper:
            raise ValueError(f"{upper:g} does not lie above {lower:g}; give the support points in rising order, each once")
    return axis


Axis = Annotated[list[Number], Field(min_length=2, max_length=1000), AfterValidator(_rising)]
Course = Literal["increasing", "decreasing"]


class CurveAxis(Model):
    """The axis of a curve."""

    axis: Axis
    """Support points, rising."""
    axis_unit: Unit = "1"
    """For readers; 1 is none."""


class MapAxes(Model):
    """The axes of a map. A value stands at [x][y]."""

    x: Axis
    """Support points, rising."""
    y: Axis
    """Support points, rising."""
    x_unit: Unit = "1"
    """For readers; 1 is none."""
    y_unit: Unit = "1"
    """For readers; 1 is none."""


class CourseOfMap(Model):
    """How a map runs along its axes."""

    x: Course | None = None
    y: Course | None = None


class SlopeOfMap(Model):
    """The largest change of a map for each unit of its axes."""

    x: Annotated[float, Field(gt=0, le=1e12)] | None = None
    y: Annotated[float, Field(gt=0, le=1e12)] | None = None


class ShapeEntry(Model):
    """A curve or a map: numbers over one or two axes. The simulation gets a list, or a list of lists."""

    curve: CurveAxis | None = None
    """Its axis; or `map`."""
    map: MapAxes | None = None
    """Its axes; or `curve`."""
    lower: Number
    """Smallest value."""
    upper: Number
    """Largest value."""
    step: Annotated[float, Field(gt=0, le=1e6)] | None = None
    """Distance of two values; null: continuous."""
    coefficients: Annotated[int, Field(ge=1, le=MOST_COEFFICIENTS)] | None = None
    """How many numbers the search moves, at most; null: each support point by itself."""
    monotone: Course | CourseOfMap | None = None
    """Course along the axis; of a map `{x: ..., y: ...}`."""
    convex: bool = False
    """Curves only: the slope never falls."""
    concave: bool = False
    """Curves only: the slope never rises."""
    slope: Annotated[float, Field(gt=0, le=1e12)] | SlopeOfMap | None = None
    """Largest change for each unit of the axis; of a map `{x: ..., y: ...}`."""
    unit: Unit = "1"
    """For readers; 1 is none."""
    description: Text = ""
    """For readers."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if (self.curve is None) == (self.map is None):
            raise ValueError("a parameter is a curve or a map; give one of them")
        of_map = [isinstance(each, CourseOfMap | SlopeOfMap) for each in (self.monotone, self.slope) if each is not None]
        if any(each != (self.map is not None) for each in of_map):
            raise ValueError("`monotone` and `slope` are one value of a curve, and {x: ..., y: ...} of a map; give them so")
        if self.map is not None and (self.convex or self.concave):
            raise ValueError("`convex` and `concave` are for curves; leave them out")
        if self.convex and self.concave:
            raise ValueError("a curve that is convex and concave is a line; give one of them")
        if self.step is not None and self.coefficients is not None and (self.convex or self.concave or self.slope is not None):
            raise ValueError("rounding breaks convex, concave and slope between coefficients; omit `step` or `coefficients`")
        sizes = [len(axis) for axis in self.axes]
        if self.coefficients is not None and self.coefficients < len(sizes) and self.map is not None:
            raise ValueError(f"{self.coefficients} coefficients are too few for a map; give at least 2")
        if self.coefficients is None and int(np.prod(sizes)) > MOST_COEFFICIENTS:
            raise ValueError(f"{int(np.prod(sizes))} support points are too many to search one by one; give `coefficients`")
        return self

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """Support points along each axis."""
        return (tuple(self.curve.axis),) if self.curve else (tuple(self.map.x), tuple(self.map.y)) if self.map else ()

    @property
    def axis_units(self) -> tuple[str, ...]:
        """Unit of each axis."""
        return (self.curve.axis_unit,) if self.curve else (self.map.x_unit, self.map.y_unit) if self.map else ()


@dataclass(frozen=True)
class Shape:
    """A curve or map by its name, with `counts[i]` coefficients along axis i."""

    name: str
    axes: tuple[tuple[float, ...], ...]
    counts: tuple[int, ...]
    lower: float
    upper: float
    step: float | None = None
    courses: tuple[Course | None, ...] = (None, None)
    """Course along each axis."""
    conditions: tuple[str, ...] = ()
    """Constraints that keep the form."""

    @classmethod
    def declared(cls, name: str, entry: ShapeEntry) -> Self:
        """Creates the shape of a manifest's entry."""
        sizes = tuple(len(axis) for axis in entry.axes)
        counts = _counts(sizes, entry.coefficients)
        free = cls(name, entry.axes, counts, entry.lower, entry.upper, entry.step, _along_axes(entry.monotone))
        return replace(free, conditions=tuple(_conditions(free, entry)))

    @classmethod
    def from_document(cls, name: str, document: Mapping[str, Any]) -> Self:
        """Inverts `document`."""
        if "sizes" in document:
            return cls(name, tuple(tuple(range(size)) for size in document["sizes"]), tuple(document["sizes"]), -np.inf, np.inf)
        axes = tuple(map(tuple, document["axes"]))
        return cls(name, axes, tuple(document["counts"]), document["lower"], document["upper"], document["step"])

    @property
    def document(self) -> dict[str, Any]:
        """Inputs that decide the values at given coefficients, JSON-ready. Single points depend on their number alone."""
        sizes = [len(axis) for axis in self.axes]
        if sizes == list(self.counts):
            return {"sizes": sizes}
        axes = [list(axis) for axis in self.axes]
        return {"axes": axes, "counts": list(self.counts), "lower": self.lower, "upper": self.upper, "step": self.step}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the coefficients, of a map along its second axis first: `gain_1`, `torque_1_2`."""
        places = product(*(range(1, count + 1) for count in self.counts))
        return tuple("_".join((self.name, *map(str, place))) for place in places)

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the values at the support points for simulators that take numbers alone: `gain[1]`, `torque[1,2]`."""
        points = product(*(range(1, len(axis) + 1) for axis in self.axes))
        return tuple(f"{self.name}[{','.join(map(str, point))}]" for point in points)

    def described(self, units: Sequence[str]) -> Iterator[tuple[str, str]]:
        """Yields each coefficient's name and its place in words.

        Args:
            units: a unit for each axis.
        """
        for name, place in zip(self.names, product(*(each.tolist() for each in self.places)), strict=True):
            texts = (f"{value:g}{'' if unit == '1' else f' {unit}'}" for value, unit in zip(place, units, strict=True))
            yield name, ", ".join(texts)

    @cached_property
    def places(self) -> tuple[Floats, ...]:
        """Places of the coefficients along each axis, in its unit."""
        return tuple(_greville(axis, count) for axis, count in zip(self.axes, self.counts, strict=True))

    @cached_property
    def weights(self) -> tuple[Floats, ...]:
        """Weights of the coefficients at the support points of each axis, shape (n_points, n_coefficients); rows sum up to 1."""
        return tuple(_weights(axis, count) for axis, count in zip(self.axes, self.counts, strict=True))

    @property
    def grid(self) -> float | None:
        """Step of the values that coefficients give; single points are taken as they are."""
        return None if self.counts == tuple(map(len, self.axes)) else self.step

    def values(self, settings: Mapping[str, Setting]) -> Points:
        """Returns the values at the support points: a list, of a map a list for each point of x.

        Args:
            settings: the values of a set by name.
        """
        return points_at(self.weights, [settings[name] for name in self.names], self.lower, self.upper, self.grid)

    def settings(self, points: Points, field: str, ranges: Ranges | None = None) -> dict[str, float]:
        """Returns the coefficients of the nearest curve or map (least squares) of the form, or the values as single points.

        Raises InvalidInputError naming `field` if the values have another shape, leave the range or break the course. Coefficients
        have the shape's own range if `ranges` has none of their name.
        """
        sizes = tuple(len(axis) for axis in self.axes)
        try:
            given = np.array(points, dtype=np.float64)
        except ValueError:
            given = np.zeros(0)
        if given.shape != sizes:
            wanted = f"{sizes[0]} numbers" if len(sizes) == 1 else f"{sizes[0]} lists of {sizes[1]} numbers"
            raise InvalidInputError(Problem(field, f"the values do not fit the axes of {self.name}", f"give {wanted}"))
        for axis, course in zip(range(given.ndim), self.courses, strict=False):
            if course is not None and (np.diff(given, axis=axis) * (-1 if course == "decreasing" else 1)).min() < 0:
                remedy = f"give {course} values" + (f" along {'xy'[axis]}" if given.ndim > 1 else "")
                raise InvalidInputError(Problem(field, f"the values of {self.name} are not {course}", remedy))
        if self.counts != sizes:
            own = self.lower, self.upper, self.step or 0.0
            lower, upper, step = np.array([(ranges or {}).get(name, own) for name in self.names]).T
            beyond = given[(given < lower.min()) | (given > upper.max())]
            if beyond.size:
                remedy = f"give values from {lower.min():g} to {upper.max():g}"
                raise InvalidInputError(Problem(field, f"{beyond[0]:g} lies outside the range", remedy))
            given = self._fitted(given, lower, upper, step)
        return dict(zip(self.names, given.ravel().tolist(), strict=True))

    def _fitted(self, values: Floats, lower: Floats, upper: Floats, step: Floats) -> Floats:
        """Returns the coefficients between bounds that have the form and give the nearest values: least distance programming by
        nonnegative least squares (Lawson and Hanson, Solving Least Squares Problems, chapter 23)."""
        from scipy.optimize import nnls  # a tenth of a second, which only curves take

        span, (form, least), units = self.upper - self.lower, self._form, np.eye(len(self.names))
        at_least = least - form.sum(axis=1) * self.lower
        factor, target = np.eye(1), (values - self.lower) / span
        for orthogonal, upper_right in (np.linalg.qr(weights) for weights in self.weights):
            factor, target = np.kron(factor, upper_right), np.moveaxis(np.tensordot(orthogonal, target, axes=(0, 0)), 0, -1)
        inverse = np.linalg.inv(factor)
        free = inverse @ target.ravel()
        for margin in (0.0, 10.0**-DECIMALS, span * 10.0**-DECIMALS):  # rounding may break a form that is kept exactly
            limits = np.concatenate([lower - self.lower, self.lower - upper, at_least + margin * abs(form).sum(axis=1)]) / span
            rows = np.concatenate([units, -units, form])
            system, unit = np.vstack([(rows @ inverse).T, limits - rows @ free]), np.append(0 * free, 1.0)
            residual = system @ nnls(system, unit)[0] - unit
            has_form = residual[-1] <= -1e-12  # else nothing within the bounds has the form
            away = -residual[:-1] / residual[-1] if has_form else 0 * free
            fitted = self.lower + span * (free + inverse @ away)
            fitted = np.clip(_on_grid(fitted, lower, step), lower, upper)
            if (form @ fitted >= least - 1e-12).all():
                break
        return fitted

    @cached_property
    def _form(self) -> tuple[Floats, Floats]:
        """Rows and limits of the conditions: a row times the coefficients is at least its limit."""
        rows = [row for text in self.conditions for row in Constraint(text).inequalities]
        factors = np.array([[-row.coefficients.get(name, 0.0) for name in self.names] for row in rows])
        return factors.reshape(-1, len(self.names)), np.array([-row.bound for row in rows])


def _on_grid(values: Floats, lower: Floats | float, step: Floats | float) -> Floats:
    """Returns values of a grid from `lower` on, with the decimals of parameters. A step of 0 is none."""
    if np.any(step):
        values = np.where(step, lower + np.rint((values - lower) / np.where(step, step, 1.0)) * step, values)
    return np.round(values, DECIMALS) + 0.0  # never -0.0


def _conditions(shape: Shape, entry: ShapeEntry) -> Iterator[str]:
    """Yields constraints on the coefficients that keep the course, curvature and slope of a shape."""
    slopes = _along_axes(entry.slope)
    grid = np.array(shape.names, dtype=object).reshape(shape.counts)
    for axis, (places, course, slope) in enumerate(zip(shape.places, shape.courses, slopes, strict=False)):
        widths = np.diff(places).tolist()
        for line in np.moveaxis(grid, axis, -1).reshape(-1, shape.counts[axis]).tolist():
            for first in range(0, len(line) - 1 if course is not None else 0, LINKS):  # an expression's length is limited
                yield (" <= " if course == "increasing" else " >= ").join(line[first : first + LINKS + 1])
            for (lower, upper), width in zip(pairwise(line), widths, strict=True):
                if slope is not None:
                    yield f"{upper} - {lower} <= {_number(slope * width)}"
                    yield f"{lower} - {upper} <= {_number(slope * width)}"
            if entry.convex or entry.concave:
                for (first, middle, last), before, after in zip(
                    zip(line, line[1:], line[2:], strict=False), widths, widths[1:], strict=False
                ):
                    sign = ">=" if entry.convex else "<="
                    yield f"{_number(before)}*({last} - {middle}) {sign} {_number(after)}*({middle} - {first})"


def _along_axes(value: Any) -> tuple[Any, ...]:
    return (value.x, value.y) if isinstance(value, CourseOfMap | SlopeOfMap) else (value, None)


def _number(value: float) -> str:
    return f"{value:.12g}"


def _counts(sizes: tuple[int, ...], coefficients: int | None) -> tuple[int, ...]:
    """Returns the number of coefficients along each axis: of a map the most that the product allows, more along the longer axis."""
    if coefficients is None:
        return sizes
    if len(sizes) == 1:
        return (min(coefficients, sizes[0]),)
    pairs = [(x, min(coefficients // x, sizes[1])) for x in range(1, min(coefficients, sizes[0]) + 1)]
    return max(pairs, key=lambda pair: (pair[0] * pair[1], -abs(pair[0] / sizes[0] - pair[1] / sizes[1]), pair))


def _knots(axis: Sequence[float], count: int) -> tuple[Floats, int]:
    """Returns the knots of a spline with `count` coefficients, and its degree: single points have a knot each."""
    degree = 1 if count == len(axis) else min(DEGREE, count - 1)
    inner = np.interp(np.linspace(0, len(axis) - 1, count - degree + 1), np.arange(len(axis)), axis)
    return np.concatenate([np.full(degree, axis[0]), inner, np.full(degree, axis[-1])]), degree


def _greville(axis: Sequence[float], count: int) -> Floats:
    if count == 1:
        return np.array([(axis[0] + axis[-1]) / 2])
    knots, degree = _knots(axis, count)
    return np.array([knots[place + 1 : place + degree + 1].mean() for place in range(count)])


def _weights(axis: Sequence[float], count: int) -> Floats:
    if count in (1, len(axis)):
        return np.eye(len(axis)) if count > 1 else np.ones((len(axis), 1))
    from scipy.interpolate import BSpline  # a tenth of a second, which only curves take

    knots, degree = _knots(axis, count)
    weights: Floats = BSpline.design_matrix(np.array(axis), knots, degree).toarray()
    return weights


Shapes = Mapping[str, Shape]


def takes_elements(section: Mapping[str, Any]) -> bool:
    """Returns whether a simulator takes numbers alone, as FMUs do. `section`: the manifest's."""
    return "fmu" in (section["kind"], (section.get("controller") or {}).get("kind"))


def with_points(
    settings: Mapping[str, Setting], shapes: Mapping[str, Shape], section: Mapping[str, Any]
) -> dict[str, Argument]:
    """Returns what a simulator gets: each shape's values in the place of its coefficients.

    Args:
        settings: a value per coefficient and other parameter.
        shapes: curves and maps by name.
        section: the simulator's section of the manifest.
    """
    coefficients = {name for shape in shapes.values() for name in shape.names}
    arguments: dict[str, Argument] = {name: value for name, value in settings.items() if name not in coefficients}
    for name, shape in shapes.items():
        points = shape.values(settings)
        if takes_elements(section):
            arguments |= zip(shape.elements, np.ravel(points).tolist(), strict=True)
        else:
            arguments[name] = points
    return arguments


def with_coefficients(
    given: Mapping[str, Given],
    shapes: Mapping[str, Shape],
    field: str,
    ranges: Ranges | None = None,
    notes: list[str] | None = None,
) -> dict[str, Setting]:
    """Returns a user's set with coefficients in the place of curves and maps; adds a note for each list that they give only nearly.

    Raises InvalidInputError, at `field` and the name, for lists that do not fit an axis, one number in the place of a list, and for
    coefficients that a list gives as well.
    """
    settings: dict[str, Setting] = {}
    for name, value in given.items():
        where = f"{field}.{name}"
        if isinstance(value, list):
            if name not in shapes:
                raise InvalidInputError(Problem(where, f"{name} is no curve or map", "give one value"))
            own = shapes[name].settings(value, where, ranges)
            if twice := sorted(own.keys() & given.keys()):
                raise InvalidInputError(Problem(where, f"{', '.join(twice)} is given too", "give the list or its coefficients"))
            settings |= own
            shape = shapes[name]
            off = float(np.abs(np.asarray(value) - shape.values(own)).max())
            if notes is not None and len(notes) < 20 and off > INEXACT * max(1.0, shape.upper - shape.lower):
                taken = f"{len(own)} coefficients give no such values; the nearest ones are taken, off by at most {off:.3g}"
                notes.append(f"{where}: {taken}")
        elif name in shapes:
            raise InvalidInputError(Problem(where, "one value is no curve or map", "give a list of its values"))
        else:
            settings[name] = value
    return settings
