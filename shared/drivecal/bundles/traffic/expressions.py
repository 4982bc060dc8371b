"""Expressions of OpenSCENARIO 1.1 to 1.3, `${...}`: arithmetic, functions and truth values. No text is ever executed.

As in C, round goes away from zero at a half, and the rest of a division has the sign of its first operand.
"""

import ast
import math
import operator
import re
from collections.abc import Callable, Mapping

from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown

LONGEST, DEEPEST = 2000, 100
"""Characters of an expression, and its levels."""
FUNCTIONS: Mapping[str, tuple[int, Callable[..., float]]] = {
    "round": (1, lambda value: math.copysign(math.floor(abs(value) + 0.5), value)),
    "floor": (1, math.floor),
    "ceil": (1, math.ceil),
    "sign": (1, lambda value: (value > 0.0) - (value < 0.0)),
    "pow": (2, math.pow),
    "max": (2, max),
    "min": (2, min),
    "abs": (1, abs),
    **{name: (1, getattr(math, name)) for name in ("sqrt", "sin", "cos", "tan", "asin", "acos", "atan")},
}
"""Number of arguments, and the function."""
CONSTANTS: Mapping[str, float | bool] = {"pi": math.pi, "PI": math.pi, "e": math.e, "E": math.e, "true": True, "false": False}
_BINARY: Mapping[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Mod: math.fmod,
}
_COMPARED: Mapping[type[ast.cmpop], Callable[[float, float], bool]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}
_TOKEN = re.compile(
    r"\s+|(?>\d+\.?\d*|\.\d+)(?>[eE][+-]?\d+)?+(?![\w.])|[A-Za-z_]\w*|[<>=!]=|\*(?!\*)|/(?!/)|[-+%(),]|[<>](?![<>])"
)
_REMEDY = f"use numbers, $parameters, + - * / %, not, and, or, pi, {', '.join(FUNCTIONS)}"


class ExpressionError(ValueError):
    """An expression cannot be read, or has no value: the fault, and what would be right."""

    def __init__(self, message: str, remedy: str = _REMEDY) -> None:
        super().__init__(message, remedy)
        self.message, self.remedy = message, remedy


def evaluated(text: str, values: Mapping[str, float | bool]) -> float | bool:
    """Returns the finite number or the truth value of an expression over named values. Raises ExpressionError."""
    end = 0
    while end < len(text) <= LONGEST and (token := _TOKEN.match(text, end)):
        end = token.end()
    if end < len(text):
        raise ExpressionError(f"it cannot be read at {shown(text[end : end + 10])}", "at most 2000 characters, and " + _REMEDY)
    try:
        tree = ast.parse(" ".join(text.split()), mode="eval").body
        value = _value(tree, {**values, **CONSTANTS}, 1)
    except (SyntaxError, MemoryError, RecursionError):
        raise ExpressionError("it cannot be read") from None
    except (ArithmeticError, ValueError) as error:
        if isinstance(error, ExpressionError):
            raise
        raise ExpressionError(f"it has no value: {error}", "give other parameters") from None
    if not math.isfinite(value):
        raise ExpressionError("its value is not finite", "give other parameters")
    return value


def _value(node: ast.expr, values: Mapping[str, float | bool], level: int) -> float | bool:
    if level > DEEPEST:
        raise ExpressionError(f"it has more than {DEEPEST} levels", "write a flatter one")

    def number(inner: ast.expr) -> float:
        value = _value(inner, values, level + 1)
        if isinstance(value, bool):
            raise ExpressionError("a truth value is no number")
        return value

    def truth(inner: ast.expr) -> bool:
        value = _value(inner, values, level + 1)
        if not isinstance(value, bool):
            raise ExpressionError(f"{value:g} is no truth value", "give true or false")
        return value

    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return float(value)
        case ast.Name(id=name) if name in values:
            return values[name]
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -number(operand)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return number(operand)
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return not truth(operand)
        case ast.BinOp(left=left, op=sign, right=right) if type(sign) in _BINARY:
            return _BINARY[type(sign)](number(left), number(right))
        case ast.BoolOp(op=joint, values=parts):
            truths = [truth(part) for part in parts]
            return all(truths) if isinstance(joint, ast.And) else any(truths)
        case ast.Compare(left=left, ops=[sign], comparators=[right]) if type(sign) in _COMPARED:
            return _COMPARED[type(sign)](_value(left, values, level + 1), _value(right, values, level + 1))
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]) if name in FUNCTIONS:
            wanted, function = FUNCTIONS[name]
            if len(arguments) != wanted:
                raise ExpressionError(f"{name} has {len(arguments)} arguments", f"give {wanted}")
            return float(function(*(number(argument) for argument in arguments)))
        case ast.Name(id=name) | ast.Call(func=ast.Name(id=name)):
            raise ExpressionError(f"OpenSCENARIO has no {shown(name)}", nearest(name, [*FUNCTIONS, "pi", "not", "and", "or"]))
    raise ExpressionError("it is no arithmetic")
