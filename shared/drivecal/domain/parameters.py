"""Calibration parameters on integer grids.

A value is an exact decimal with at most nine decimals, or a text that names a choice. Inside drivecal it is a grid index (relative to one
campaign's bounds or list of choices), or an integer number of billionths or the text (absolute). All are exact; only the driving function
computes with floats. The key of a stored parameter set is therefore independent of bounds, steps and lists of choices, so that campaigns
with narrower bounds reuse old results.
"""

from __future__ import annotations

import hashlib
import json
from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from drivecal.domain.errors import InvalidInputError, Problem
from drivecal.domain.values import (
    BILLION,
    LARGEST_VALUE,
    Setting,
    Value,
    billionths,
    billionths_text,
    code,
    decimal,
    entry,
    from_billionths,
    shown,
    text,
)

LARGEST_GRID = 1_000_000
"""Most values of a grid. Continuous parameters have up to 2e15: no code may make a table of all values."""
Indices = npt.NDArray[np.int64]
Kind = Literal["grid", "continuous", "integer", "choice"]


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
        message = f"the range is empty: upper {upper} is not above lower {lower}"
        remedy = "swap them" if upper < lower else "to hold a parameter, name it in `fixed`"
        raise _refused(name, "upper", message, remedy)


@dataclass(frozen=True, slots=True)
class Parameter:
    """A calibration parameter: `n_values` equally spaced values from `lower` to `upper`, both included, in `unit`.

    The values of a choice are its texts; a grid index is a position in `choices`, and so are `lower` and `upper`.
    """

    name: str
    lower: Decimal
    upper: Decimal
    n_values: int
    unit: str = "1"
    description: str = ""
    kind: Kind = "grid"
    choices: tuple[str, ...] = ()

    @classmethod
    def declared(
        cls,
        name: str,
        *,
        lower: float | None,
        upper: float | None,
        step: float | None = None,
        integer: bool = False,
        choices: Sequence[str] | None = None,
        unit: str = "1",
        description: str = "",
    ) -> Parameter:
        """Creates a parameter as files declare it: a grid (`step`), continuous (no step or 0), integer, or a choice.

        Raises InvalidInputError naming the faulty field.
        """
        if choices is not None:
            if integer or not lower is upper is step is None:
                raise _refused(name, "choices", "a choice is not a number", "leave lower, upper, step and integer out")
            return cls.choice(name, choices, unit, description)
        if lower is None or upper is None:
            missing = "lower" if lower is None else "upper"
            raise _refused(name, missing, "the value is missing", "give lower and upper, or choices")
        if not integer:
            return cls.from_step(name, decimal(lower), decimal(upper), decimal(step or 0), unit, description)
        if step not in {None, 0, 1}:
            raise _refused(name, "step", "the step of an integer is 1", "leave `step` or `integer` out")
        return cls.integer(name, decimal(lower), decimal(upper), unit, description)

    @classmethod
    def from_step(
        cls, name: str, lower: Decimal, upper: Decimal, step: Decimal | None, unit: str = "1", description: str = ""
    ) -> Parameter:
        """Creates the grid lower, lower + step, ... upper; without a step, or with 0, a continuous parameter: all decimals of nine places.

        Raises InvalidInputError naming the faulty field.
        """
        if not step:
            _check_bounds(name, lower, upper)
            n_values = billionths(upper) - billionths(lower) + 1
            return cls(name, lower, upper, n_values, unit, description, "continuous")
        _check_bounds(name, lower, upper, step=step)
        if step < 0:
            raise _refused(name, "step", f"{step} is negative", "give a positive step")
        if step > upper - lower:
            message = f"step {step} is wider than the range from {lower} to {upper}"
            raise _refused(name, "step", message, f"give a step of at most {text(upper - lower)}")
        if (upper - lower) % step != 0:
            below = lower + (upper - lower) // step * step
            remedy = f"give e.g. upper {text(below)} or {text(below + step)}"
            raise _refused(name, "step", f"upper {upper} is not lower {lower} plus a multiple of step {step}", remedy)
        n_values = int((upper - lower) / step) + 1
        if n_values > LARGEST_GRID:
            raise _refused(name, "step", f"{n_values} values are too many", f"give a step that makes at most {LARGEST_GRID:,}")
        return cls(name, lower, upper, n_values, unit, description)

    @classmethod
    def integer(cls, name: str, lower: Decimal, upper: Decimal, unit: str = "1", description: str = "") -> Parameter:
        """Creates the whole numbers from `lower` to `upper`. Raises InvalidInputError naming the faulty field."""
        _check_bounds(name, lower, upper)
        for attribute, value in (("lower", lower), ("upper", upper)):
            if value != value.to_integral_value():
                raise _refused(name, attribute, f"{value} is not a whole number", "give a whole number, or a step")
        return cls(name, lower, upper, int(upper - lower) + 1, unit, description, "integer")

    @classmethod
    def choice(cls, name: str, choices: Sequence[str], unit: str = "1", description: str = "") -> Parameter:
        """Creates an unordered choice between texts. Raises InvalidInputError if there are fewer than two different ones."""
        if len(choices) < 2 or len(set(map(code, choices))) < len(choices):
            raise _refused(name, "choices", f"{list(choices)} is not a list of choices", "give two or more different texts")
        return cls(name, Decimal(0), Decimal(len(choices) - 1), len(choices), unit, description, "choice", tuple(choices))

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
        """Returns the value at a grid index, in billionths; of a choice the position. Raises IndexError off the grid."""
        if not 0 <= index < self.n_values:
            raise IndexError(f"{self.name} has grid indices 0 to {self.n_values - 1}, not {index}")
        low, span, last = billionths(self.lower), billionths(self.upper) - billionths(self.lower), self.n_values - 1
        return low + (2 * span * index + last) // (2 * last)

    def billionths_at(self, indices: Indices) -> Indices:
        """Returns the values at grid indices, in billionths, shaped as `indices`; of a choice the positions."""
        low, last = billionths(self.lower), self.n_values - 1
        whole, rest = divmod(billionths(self.upper) - low, last)
        # The rest is 0 except on lattices of bits, which are small: no product exceeds 64 bits.
        values: Indices = low + whole * indices + (2 * rest * indices + last) // (2 * last)
        return values

    def first_from(self, value: int) -> int:
        """Returns the first grid index whose value is at least `value`, in billionths; `n_values` if there is none."""
        return bisect_left(range(self.n_values), value, key=self.billionths)

    def entries(self, indices: Indices) -> list[int] | list[str]:
        """Returns what parameter sets store for grid indices, shape (n,): billionths, or the texts of a choice."""
        if self.choices:
            return [self.choices[index] for index in indices.tolist()]
        values: list[int] = self.billionths_at(indices).tolist()
        return values

    @property
    def extent(self) -> str:
        """The values in words: `from 0 to 1`, `in eco, sport`."""
        return f"in {', '.join(self.choices)}" if self.choices else f"from {text(self.lower)} to {text(self.upper)}"

    def number(self, stored: int | str) -> int:
        """Returns a stored value in billionths, a text as its position in `choices`; texts that are not listed lie below them all."""
        if isinstance(stored, str):
            return BILLION * (self.choices.index(stored) if stored in self.choices else -1)
        return stored

    def value(self, index: int) -> Decimal:
        """Returns the number at a grid index, of a choice the position. Raises IndexError off the grid."""
        return from_billionths(self.billionths(index))

    def named(self, index: int) -> Value:
        """Returns the value at a grid index as users know it: a number, or the text of a choice. Raises IndexError off the grid."""
        number = self.value(index)
        return self.choices[index] if self.choices else number

    def index(self, value: Value, field_name: str | None = None) -> int:
        """Returns the grid index of a value. Raises InvalidInputError naming the nearest values or the choices if it is not on the grid."""
        path = field_name or self.name
        if self.choices:
            if value not in self.choices:
                message = f"{json.dumps(str(value))} is not a choice"
                raise InvalidInputError(Problem(path, message, f"one of {', '.join(self.choices)}"))
            return self.choices.index(str(value))
        if isinstance(value, str):
            remedy = f"give a number from {text(self.lower)} to {text(self.upper)}"
            raise InvalidInputError(Problem(path, f"{json.dumps(value)} is not a number", remedy))
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

    def nearest(self, value: Setting | None, *, clips: bool = False) -> int | None:
        """Returns the grid index nearest to a value; None if it has none: text that is no choice, or a number outside of the range.

        With `clips`, the ends of the range are nearest to numbers outside.
        """
        if isinstance(value, str) or value is None or self.choices:
            return self.choices.index(value) if value in self.choices else None
        lower, upper = float(self.lower), float(self.upper)
        if not clips and not lower <= value <= upper:
            return None
        return round((min(max(value, lower), upper) - lower) / (upper - lower) * (self.n_values - 1))


@dataclass(frozen=True, slots=True)
class ParameterSet:
    """A value per parameter, in billionths or as the text of a choice, in the driving function's order of names."""

    names: tuple[str, ...]
    billionths: tuple[int | str, ...]

    @classmethod
    def of(cls, values: Mapping[str, Value]) -> ParameterSet:
        """Creates a parameter set from exact decimals and texts by name."""
        return cls(tuple(values), tuple(map(entry, values.values())))

    @classmethod
    def from_json(cls, document: str) -> ParameterSet:
        """Inverts `to_json`."""
        values: dict[str, Value] = json.loads(document, parse_float=Decimal, parse_int=Decimal)
        return cls.of(values)

    @property
    def values(self) -> dict[str, Value]:
        """Exact decimals and texts by name."""
        pairs = zip(self.names, self.billionths, strict=True)
        return {name: value if isinstance(value, str) else from_billionths(value) for name, value in pairs}

    @property
    def floats(self) -> dict[str, Setting]:
        """Nearest floats by name, and the texts of choices, as used by simulators, JSON and tables."""
        # A quotient of integers is rounded once, like the decimal, in a tenth of the time.
        pairs = zip(self.names, self.billionths, strict=True)
        return {name: value if isinstance(value, str) else value / BILLION for name, value in pairs}

    @property
    def codes(self) -> tuple[int, ...]:
        """Integers that identify the values, see `code`."""
        return tuple(map(code, self.billionths))

    def to_json(self) -> str:
        """Returns exact, readable JSON: `{"P1": 0.5, "mode": "eco", ...}`."""
        pairs = zip(self.names, self.billionths, strict=True)
        texts = ((name, json.dumps(value) if isinstance(value, str) else billionths_text(value)) for name, value in pairs)
        return "{" + ", ".join(f"{json.dumps(name)}: {text}" for name, text in texts) + "}"

    @property
    def key(self) -> bytes:
        """Key of 16 bytes that identifies the set, independent of bounds, steps, lists of choices and order of names."""
        pairs = sorted(zip(self.names, self.billionths, strict=True), key=lambda pair: pair[0])
        # A text is quoted, so that no text reads like a number or like further parameters.
        canonical = ";".join(f"{name}={json.dumps(value) if isinstance(value, str) else value}" for name, value in pairs)
        return hashlib.blake2b(canonical.encode(), digest_size=16).digest()


@dataclass(frozen=True)
class ParameterSpace:
    """Search space of a campaign: `parameters` on their grids; parameters in `fixed` keep their value and are not searched.

    Populations are integer arrays of shape (n, n_searched) in the order of `searched`.
    """

    parameters: tuple[Parameter, ...]
    fixed: Mapping[str, Value] = field(default_factory=dict)

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
    def kinds(self) -> tuple[Kind, ...]:
        """Kinds of the searched parameters."""
        return tuple(parameter.kind for parameter in self.searched)

    def parameter_set(self, indices: Iterable[int]) -> ParameterSet:
        """Returns the parameter set at one row of grid indices, shape (n_searched,). Raises IndexError if an index is off its grid."""
        (only,) = self.parameter_sets(np.array([list(indices)], dtype=np.int64).reshape(1, -1))
        return only

    def parameter_sets(self, population: Indices) -> list[ParameterSet]:
        """Returns the parameter sets of a population, shape (n, n_searched). Raises IndexError if an index is off its grid."""
        off_grid = np.argwhere((population < 0) | (population >= self.n_values))
        if len(off_grid):
            row, column = off_grid[0].tolist()
            parameter = self.searched[column]
            index = population[row, column]
            raise IndexError(f"{parameter.name} has grid indices 0 to {parameter.n_values - 1}, not {index} (individual {row})")
        columns: dict[str, Sequence[int | str]] = {
            name: [entry(value)] * len(population) for name, value in self.fixed.items() if name in self.names
        }
        for column, parameter in enumerate(self.searched):
            columns[parameter.name] = parameter.entries(population[:, column])
        return [ParameterSet(self.names, row) for row in zip(*(columns[name] for name in self.names), strict=True)]

    def indices(
        self, values: Mapping[str, Value], field_name: str = "parameters", owners: Mapping[str, str] | None = None
    ) -> Indices:
        """Returns grid indices of the searched parameters, shape (n_searched,). Raises InvalidInputError naming each faulty value, and
        in the place of missing coefficients their `owners`, curves and maps."""
        problems = [
            Problem(f"{field_name}.{name}", "there is no such parameter", f"one of {', '.join(self.names)}")
            for name in values
            if name not in self.names
        ]
        indices, missing = list[int](), dict[str, None]()
        for parameter in self.searched:
            path = f"{field_name}.{parameter.name}"
            if parameter.name not in values:
                missing[(owners or {}).get(parameter.name, parameter.name)] = None
                continue
            try:
                indices.append(parameter.index(values[parameter.name], path))
            except InvalidInputError as error:
                problems.extend(error.problems)
        if missing:
            path = field_name if len(missing) > 1 else f"{field_name}.{next(iter(missing))}"
            problems.append(Problem(path, f"the value of {', '.join(missing)} is missing", "give one value per parameter"))
        for name, fixed in self.fixed.items():
            if name in values and values[name] != fixed:
                problems.append(Problem(f"{field_name}.{name}", f"{values[name]} is not the fixed one", f"give {shown(fixed)}"))
        if problems:
            raise InvalidInputError(*problems)
        return np.array(indices, dtype=np.int64)
