"""Operations of expressions on single floats and on arrays, with equal results bit by bit; comparisons of arrays.

Every result is finite: a float that would not be raises ArithmeticError or ValueError; in an array it is NaN, and stays so.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, TypeAlias

import numpy as np

Values: TypeAlias = Any
"""A float, or an array of floats of shape (n,)."""
Evaluated = Callable[[Mapping[str, Any]], Any]
Comparison = Callable[[Values, Values, Values], Any]
"""Compares two numbers, given the largest difference of equal ones."""
ROUNDING = 1e-12
"""Numbers closer than this share of the larger one are equal: 0.3 <= 3*0.1 holds, as it does in decimals."""


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """Operations by syntax node and name."""

    binary: Mapping[type[ast.AST], Callable[[Values, Values], Values]]
    functions: Mapping[str, Callable[..., Values]]
    variable: Callable[[str], Evaluated]


def _finite(value: float) -> float:
    if value - value != 0.0:
        raise OverflowError("a result is too large")
    return value


def _divided(left: float, right: float) -> float:
    if right == 0.0:
        raise ZeroDivisionError("division by zero")
    return _finite(left / right)


def _power(base: float, exponent: float) -> float:
    try:
        return math.pow(base, exponent)
    except OverflowError:
        raise OverflowError("a power is too large") from None
    except ValueError:
        reason = "zero to a negative power" if base == 0.0 else "a negative number to a fractional power"
        raise ArithmeticError(reason) from None


def _root(value: float) -> float:
    if value < 0.0:
        raise ArithmeticError("square root of a negative number")
    return math.sqrt(value)


def _exponential(value: float) -> float:
    try:
        return math.exp(value)
    except OverflowError:
        raise OverflowError("exp of a large number") from None


def _logarithm(value: float) -> float:
    if value <= 0.0:
        raise ArithmeticError("log of a number that is not positive")
    return math.log(value)


def _variable(name: str) -> Evaluated:
    def value(values: Mapping[str, Any]) -> float:
        given = float(values[name])
        if given - given != 0.0:
            raise ArithmeticError(f"{name} is not finite")
        return given

    return value


def compared(comparison: Comparison, left: Evaluated, right: Evaluated) -> Evaluated:
    """Returns the comparison of two arrays: NaN compares as false."""

    def holds(values: Mapping[str, Any]) -> Any:
        number, other = left(values), right(values)
        defined = ~(np.isnan(number) | np.isnan(other))
        return comparison(number, other, ROUNDING * np.maximum(np.abs(number), np.abs(other))) & defined

    return holds


def joined(conditions: Sequence[Evaluated], *, conjunction: bool) -> Evaluated:
    """Returns the conjunction of conditions on arrays, or else their disjunction."""
    joint = np.logical_and if conjunction else np.logical_or
    return lambda values: reduce(joint, [condition(values) for condition in conditions])


def _cleaned(values: Values) -> Values:
    return np.where(np.isfinite(values), values, np.nan)


def _in_arrays(function: Callable[..., Values]) -> Callable[..., Values]:
    return lambda *operands: _cleaned(function(*operands))


def _element_by_element(function: Callable[..., float], n_operands: int) -> Callable[..., Values]:
    """Returns the function for arrays. NumPy's own differ from `math` in the last bit, and by machine."""

    def value(*operands: float) -> float:
        try:
            return function(*operands) if not any(map(math.isnan, operands)) else math.nan
        except (ArithmeticError, ValueError):
            return math.nan

    applied = np.frompyfunc(value, n_operands, 1)
    return lambda *operands: np.asarray(applied(*operands), dtype=float)


SIGNS: Mapping[type[ast.AST], Callable[[Values], Values]] = {ast.USub: operator.neg, ast.UAdd: operator.pos}
COMPARISONS: Mapping[type[ast.AST], Comparison] = {
    ast.LtE: lambda left, right, room: left - right <= room,
    ast.Lt: lambda left, right, room: left - right < -room,
    ast.GtE: lambda left, right, room: left - right >= -room,
    ast.Gt: lambda left, right, room: left - right > room,
    ast.Eq: lambda left, right, room: abs(left - right) <= room,
    ast.NotEq: lambda left, right, room: abs(left - right) > room,
}

SCALAR = Arithmetic(
    binary={
        ast.Add: lambda left, right: _finite(left + right),
        ast.Sub: lambda left, right: _finite(left - right),
        ast.Mult: lambda left, right: _finite(left * right),
        ast.Div: _divided,
        ast.Pow: _power,
    },
    functions={
        "min": min,
        "max": max,
        "abs": abs,
        "sqrt": _root,
        "exp": _exponential,
        "log": _logarithm,
        "clip": lambda value, lower, upper: min(max(value, lower), upper),
    },
    variable=_variable,
)
ARRAY = Arithmetic(
    binary={
        ast.Add: _in_arrays(np.add),
        ast.Sub: _in_arrays(np.subtract),
        ast.Mult: _in_arrays(np.multiply),
        ast.Div: _in_arrays(np.divide),
        ast.Pow: _element_by_element(_power, 2),
    },
    functions={
        "min": lambda *operands: reduce(np.minimum, operands),
        "max": lambda *operands: reduce(np.maximum, operands),
        "abs": np.abs,
        "sqrt": _in_arrays(np.sqrt),
        "exp": _element_by_element(_exponential, 1),
        "log": _element_by_element(_logarithm, 1),
        "clip": lambda value, lower, upper: np.minimum(np.maximum(value, lower), upper),
    },
    variable=lambda name: lambda values: _cleaned(np.asarray(values[name], dtype=float)),
)
