"""Calibration parameters on integer grids.

A value is an exact decimal with at most nine decimals. Inside drivecal it is a grid index (relative to one campaign's bounds) or an
integer number of billionths (absolute). Both are exact; only the driving function computes with floats. The key of a stored parameter
set is therefore independent of bounds and steps, so that campaigns with narrower bounds reuse old results.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cached_property

import numpy as np
import numpy.typing as npt

from drivecal.domain.errors import InvalidInputError, Problem

BILLION = 1_000_000_000
LARGEST_VALUE = Decimal(1_000_000)
"""Largest magnitude of a bound: its billionths are exact in a float64, which keeps the JSON form of a value exact too."""
LARGEST_GRID = 1_000_000
"""Most values of a grid: each of them is tabulated."""

Indices = npt.NDArray[np.int64]


def decimal(value: float | str | Decimal) -> Decimal:
    """Returns the exact decimal that the user typed: 0.1 means 1/10, not the nearest binary fraction."""
    return value if isinstance(value, Decimal) else Decimal(str(value))


def billionths(value: Decimal) -> int:
    """Returns `value` as an integer number of billionths. Raises ValueError if it is not finite or has more than nine decimals."""
    if not value.is_finite():
        raise ValueError(f"{value} is not a finite number")
    numerator, denominator = value.as_integer_ratio()  # exact; Decimal's own product would round to 28 digits
    scaled, rest = divmod(numerator * BILLION, denominator)
    if rest:
        raise ValueError(f"{value} has more than nine decimals")
    return scaled


def from_billionths(value: int) -> Decimal:
    """Inverts `billionths`, in lowest terms (0.5, not 0.500000000)."""
    return Decimal(value).scaleb(-9).normalize() + Decimal(0)


def text(value: Decimal) -> str:
    """Formats a value without exponent, trailing zeros or negative zero; equal values give equal texts."""
    return _text(billionths(value))


def _text(value: int) -> str:
    whole, rest = divmod(abs(value), BILLION)
    sign, decimals = "-" * (value < 0), f"{rest:09d}".rstrip("0")
    return f"{sign}{whole}.{decimals}" if decimals else f"{sign}{whole}"


def _refused(name: str, attribute: str, message: str, remedy: str) -> InvalidInputError:
    return InvalidInputError(Problem(f"{name}.{attribute}", message, remedy))


def _check_bounds(name: str, lower: Decimal, upper: Decimal, **others: Decimal) -> None:
    """Raises InvalidInputError if a number is unusable or the range is empty."""
    for attribute, value in {"lower": lower, "upper": upper, **others}.items():
        if not value.is_finite() or abs(value) > LARGEST_VALUE:
            raise _refused(name, attribute, f"{value} is not a usable number", f"give a number within ±{LARGEST_VALUE}")
        try:
            billionths(value)
        except ValueError as error:
            raise _refused(name, attribute, str(error), "round it") from error
    if upper <= lower:
        message = f"the grid is empty: upper {upper} is not above lower {lower}"
        raise _refused(name, "upper", message, "to hold a parameter, name it in `fixed`")


@dataclass(frozen=True, slots=True)
class Parameter:
    """A calibration parameter: `n_values` equally spaced values from `lower` to `upper`, both included, in `unit`."""

    name: str
    lower: Decimal
    upper: Decimal
    n_values: int
    unit: str = "1"
    description: str = ""

    @classmethod
    def from_step(
        cls, name: str, lower: Decimal, upper: Decimal, step: Decimal, unit: str = "1", description: str = ""
    ) -> Parameter:
        """Creates the grid lower, lower + step, ... upper. Raises InvalidInputError naming the faulty field."""
        _check_bounds(name, lower, upper, step=step)
        if step == 0:
            raise _refused(name, "step", "continuous parameters are not supported yet", "give the step of the grid, e.g. 0.01")
        if step < 0:
            raise _refused(name, "step", f"{step} is negative", "give a positive step")
        if (upper - lower) % step != 0:
            below = lower + (upper - lower) // step * step
            fitting = [text(below)] if below > lower else []
            remedy = f"give e.g. upper {' or '.join([*fitting, text(below + step)])}"
            raise _refused(name, "step", f"upper {upper} is not lower {lower} plus a multiple of step {step}", remedy)
        n_values = int((upper - lower) / step) + 1
        if n_values > LARGEST_GRID:
            raise _refused(name, "step", f"{n_values} values are too many", f"give a step that makes at most {LARGEST_GRID:,}")
        return cls(name, lower, upper, n_values, unit, description)

    @classmethod
    def from_bits(
        cls, name: str, lower: Decimal, upper: Decimal, bits: int, unit: str = "1", description: str = ""
    ) -> Parameter:
        """Creates the paper's lattice (Section II-B): the range split into 2**bits values, rounded to nine decimals.

        Raises InvalidInputError naming the faulty field, including if rounding would make values coincide.
        """
        _check_bounds(name, lower, upper)
        if bits < 1 or 2**bits > LARGEST_GRID:
            raise _refused(name, "bits", f"{bits} is not a usable number of bits", f"give 1 to {LARGEST_GRID.bit_length() - 1}")
        if billionths(upper) - billionths(lower) < 2**bits - 1:
            message = f"{2**bits} values from {lower} to {upper} lie closer than the ninth decimal"
            raise _refused(name, "bits", message, "give fewer bits or a wider range")
        return cls(name, lower, upper, 2**bits, unit, description)

    def billionths(self, index: int) -> int:
        """Returns the value at a grid index, in billionths. Raises IndexError off the grid."""
        if not 0 <= index < self.n_values:
            raise IndexError(f"{self.name} has grid indices 0 to {self.n_values - 1}, not {index}")
        return self._table(range(index, index + 1))[0]

    def _table(self, indices: range) -> list[int]:
        low, high = billionths(self.lower), billionths(self.upper)
        last = self.n_values - 1
        return [low + (2 * (high - low) * index + last) // (2 * last) for index in indices]

    @property
    def all_billionths(self) -> npt.NDArray[np.int64]:
        """All values of the grid in billionths, shape (n_values,)."""
        return np.array(self._table(range(self.n_values)), dtype=np.int64)

    def value(self, index: int) -> Decimal:
        """Returns the value at a grid index. Raises IndexError off the grid."""
        return from_billionths(self.billionths(index))

    def index(self, value: Decimal, field_name: str | None = None) -> int:
        """Returns the grid index of a value. Raises InvalidInputError naming the nearest values if it is off the grid."""
        path = field_name or self.name
        if not value.is_finite() or not self.lower <= value <= self.upper:
            remedy = f"give a value from {text(self.lower)} to {text(self.upper)}"
            raise InvalidInputError(Problem(path, f"{value} lies outside the range", remedy))
        position = (value - self.lower) / (self.upper - self.lower) * (self.n_values - 1)
        index = int(position.to_integral_value())
        if self.value(index) != value:
            below = max(0, min(int(position), self.n_values - 2))
            neighbours = f"{text(self.value(below))} or {text(self.value(below + 1))}"
            raise InvalidInputError(Problem(path, f"{value} is not on the grid", f"the nearest values are {neighbours}"))
        return index


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """A value per parameter, in billionths, in the driving function's order of names."""

    names: tuple[str, ...]
    billionths: tuple[int, ...]

    @classmethod
    def of(cls, values: Mapping[str, Decimal]) -> ParameterSet:
        """Creates a parameter set from exact decimals by name."""
        return cls(tuple(values), tuple(billionths(value) for value in values.values()))

    @classmethod
    def from_json(cls, document: str) -> ParameterSet:
        """Inverts `to_json`."""
        values: dict[str, Decimal] = json.loads(document, parse_float=Decimal, parse_int=Decimal)
        return cls.of(values)

    @property
    def values(self) -> dict[str, Decimal]:
        """Exact decimals by name."""
        return {name: from_billionths(value) for name, value in zip(self.names, self.billionths, strict=True)}

    @property
    def floats(self) -> dict[str, float]:
        """Nearest floats by name, as used by the driving function, JSON and tables."""
        # A quotient of integers is rounded once, like the decimal, in a tenth of the time.
        return {name: value / BILLION for name, value in zip(self.names, self.billionths, strict=True)}

    def to_json(self) -> str:
        """Returns exact, readable JSON: `{"P1": 0.5, ...}`."""
        pairs = zip(self.names, self.billionths, strict=True)
        return "{" + ", ".join(f"{json.dumps(name)}: {_text(value)}" for name, value in pairs) + "}"

    @property
    def key(self) -> bytes:
        """Key of 16 bytes that identifies the set, independent of bounds, steps and order of names."""
        canonical = ";".join(f"{name}={value}" for name, value in sorted(zip(self.names, self.billionths, strict=True)))
        return hashlib.blake2b(canonical.encode(), digest_size=16).digest()


@dataclass(frozen=True)
class ParameterSpace:
    """Search space of a campaign: `parameters` on their grids; parameters in `fixed` keep their value and are not searched.

    Populations are integer arrays of shape (n, n_searched) in the order of `searched`.
    """

    parameters: tuple[Parameter, ...]
    fixed: Mapping[str, Decimal] = field(default_factory=dict)

    @cached_property
    def searched(self) -> tuple[Parameter, ...]:
        """Parameters that the optimizer may change."""
        return tuple(parameter for parameter in self.parameters if parameter.name not in self.fixed)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters, searched and fixed, in order."""
        return tuple(parameter.name for parameter in self.parameters)

    @cached_property
    def n_values(self) -> Indices:
        """Grid sizes of the searched parameters, shape (n_searched,)."""
        return np.array([parameter.n_values for parameter in self.searched], dtype=np.int64)

    @cached_property
    def _tables(self) -> dict[str, list[int]]:
        return {parameter.name: parameter.all_billionths.tolist() for parameter in self.searched}

    def parameter_set(self, indices: Iterable[int]) -> ParameterSet:
        """Returns the parameter set at one row of grid indices, shape (n_searched,)."""
        searched = {
            parameter.name: self._tables[parameter.name][index] for parameter, index in zip(self.searched, indices, strict=True)
        }
        fixed = {name: billionths(value) for name, value in self.fixed.items()}
        return ParameterSet(self.names, tuple(searched[name] if name in searched else fixed[name] for name in self.names))

    def parameter_sets(self, population: Indices) -> list[ParameterSet]:
        """Returns the parameter sets of a population, shape (n, n_searched). Raises IndexError if an index is off its grid."""
        off_grid = np.argwhere((population < 0) | (population >= self.n_values))
        if len(off_grid):
            row, column = off_grid[0].tolist()
            parameter = self.searched[column]
            index = population[row, column]
            raise IndexError(f"{parameter.name} has grid indices 0 to {parameter.n_values - 1}, not {index} (individual {row})")
        return [self.parameter_set(row) for row in population.tolist()]

    def indices(self, values: Mapping[str, Decimal], field_name: str = "parameters") -> Indices:
        """Returns grid indices of the searched parameters, shape (n_searched,). Raises InvalidInputError naming each faulty value."""
        problems = [
            Problem(f"{field_name}.{name}", "there is no such parameter", f"one of {', '.join(self.names)}")
            for name in values
            if name not in self.names
        ]
        indices: list[int] = []
        for parameter in self.searched:
            path = f"{field_name}.{parameter.name}"
            if parameter.name not in values:
                problems.append(Problem(path, "the value is missing", "give one value per parameter"))
                continue
            try:
                indices.append(parameter.index(values[parameter.name], path))
            except InvalidInputError as error:
                problems.extend(error.problems)
        for name, fixed in self.fixed.items():
            if name in values and values[name] != fixed:
                problems.append(
                    Problem(f"{field_name}.{name}", f"{values[name]} differs from the fixed value", f"give {text(fixed)}")
                )
        if problems:
            raise InvalidInputError(*problems)
        return np.array(indices, dtype=np.int64)
