"""Formulas of scores and constraints on parameters: whitelisted arithmetic, parsed once into closures.

A formula has numbers, names, + - * / **, parentheses and the functions of `FUNCTIONS`. A constraint compares such formulas by <=, <, >=,
>, == or != (chains are allowed), joins comparisons by `and` or `or`, and compares choices with a quoted text. Nothing else parses, and
no text is ever executed.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt

from drivecal.bundles.arithmetic import ARRAY, COMPARISONS, SCALAR, SIGNS, Arithmetic, compared, joined
from drivecal.contracts.input_errors import nearest
from drivecal.contracts.strict_json import shown
from drivecal.domain.constraints import Inequality
from drivecal.domain.errors import DrivecalError, InvalidInputError, Problem

LONGEST = 2000
"""Characters of an expression."""
DEEPEST = 100
"""Levels of an expression; a sum of n terms has n levels."""
LARGEST_EXPONENT = 100
FUNCTIONS: Mapping[str, tuple[int, int]] = {
    "min": (2, 100),
    "max": (2, 100),
    "abs": (1, 1),
    "sqrt": (1, 1),
    "exp": (1, 1),
    "log": (1, 1),
    "clip": (3, 3),
}
"""Fewest and most arguments; `log` is the natural logarithm, `clip(x, lower, upper)` limits x."""
_TOKEN = re.compile(
    r"\s+|(?P<number>(?>\d+\.?\d*|\.\d+)(?>[eE][+-]?\d+)?+)(?![\w.])|(?P<name>[^\W\d]\w*)(?!['\"])"
    r"|'[^'\\\n]*'|\"[^\"\\\n]*\"|\*\*(?!\*)|[<>=!]=|[-+*/(),<>.]"
)
_REMEDIES = {
    "=": "write == for equality",
    "&": "write `and`",
    "|": "write `or`",
    "^": "write ** for powers",
    "'": "close the quotes",
    '"': "close the quotes",
}
Evaluation = Callable[[Mapping[str, Any]], Any]


class UndefinedError(DrivecalError):
    """An expression has no value, e.g. because it divides by zero. `values`: numbers of its names."""

    def __init__(self, expression: str, reason: str, values: Mapping[str, float]) -> None:
        super().__init__(expression, reason, dict(values))
        self.expression, self.reason, self.values = expression, reason, dict(values)

    def __str__(self) -> str:
        given = ", ".join(f"{name} = {value!r}" for name, value in self.values.items())
        return f"{shown(self.expression, 200)} has no value: {self.reason}" + (f" ({given})" if given else "")


class Formula:
    """Arithmetic over named numbers. `names`: the numbers that it uses."""

    __slots__ = ("_evaluation", "names", "text")

    def __init__(self, text: str, known: Iterable[str] | None = None, field: str = "formula") -> None:
        """Parses a formula over `known` names; None allows any. Raises InvalidInputError naming `field` and the column of each fault."""
        parser = _Parser(text, None if known is None else dict.fromkeys(known, ()), field, "measure")
        tree = parser.parsed()
        parser.check_number(tree)
        parser.finish()
        self.text, self.names = text, frozenset(parser.names)
        self._evaluation = _compiled(tree, SCALAR)

    def __call__(self, values: Mapping[str, float]) -> float:
        """Returns the finite value. Raises UndefinedError, including if a name has no finite value."""
        try:
            return float(self._evaluation(values))
        except (ArithmeticError, ValueError) as error:
            reason = str(error)
        except KeyError as error:
            reason = f"there is no value of {error.args[0]}"
        raise UndefinedError(self.text, reason, {name: values[name] for name in sorted(self.names) if name in values})

    @property
    def canonical(self) -> str:
        """Text without white space, which changes no value."""
        return "".join(self.text.split())


class Constraint:
    """A condition on parameters. A comparison of something undefined does not hold; numbers within 1e-12 of each other are equal."""

    __slots__ = ("_evaluation", "inequalities", "names", "text")

    def __init__(self, text: str, known: Mapping[str, Sequence[str]] | None = None, field: str = "constraint") -> None:
        """Parses a constraint over `known` parameters with their choices, empty for numbers; None allows any.

        Raises InvalidInputError naming `field` and the column of each fault.
        """
        parser = _Parser(text, known, field, "parameter")
        tree = parser.parsed()
        parser.check_condition(tree)
        if not parser.names and not parser.problems:
            parser.refuse(tree, "the constraint names no parameter", f"known are {', '.join(known or ('none',))}")
        parser.finish()
        self.text, self.names = text, frozenset(parser.names)
        self._evaluation = _condition(tree)
        self.inequalities = tuple(_inequalities(tree))

    def holds(self, values: Mapping[str, float | str]) -> bool:
        """Returns whether a parameter set keeps the constraint. `values`: numbers, and choices as their text."""
        return bool(self({name: np.array([value]) for name, value in values.items()})[0])

    def __call__(self, columns: Mapping[str, npt.NDArray[Any]]) -> npt.NDArray[np.bool_]:
        """Returns whether each row of a population keeps the constraint, shape (n,).

        `columns`: values of shape (n,) by name: floats, and choices as arrays of text.
        """
        with np.errstate(all="ignore"):
            result = self._evaluation(columns)
        return np.broadcast_to(np.asarray(result, dtype=bool), columns[next(iter(self.names))].shape)


class _Parser:
    """Checks one expression and collects its problems."""

    def __init__(self, text: str, known: Mapping[str, Sequence[str]] | None, field: str, noun: str) -> None:
        self.text, self.known, self.field, self.noun = text, known or {}, field, noun
        self.allows_any = known is None
        self.names: dict[str, None] = {}
        self.problems: list[Problem] = []

    def parsed(self) -> ast.expr:
        """Returns the syntax tree. Raises InvalidInputError for text that is too long, too deep or no expression."""
        if len(self.text) > LONGEST:
            self._fail(f"{len(self.text):,} characters are too many", f"give at most {LONGEST:,}")
        self._check_tokens()
        line = re.sub(r"\s", " ", self.text)
        try:
            tree = ast.parse(line.strip(), mode="eval").body
        except SyntaxError as error:
            column = (error.offset or 1) + len(line) - len(line.lstrip())
            self._fail(f"column {column}: the expression cannot be read: {error.msg}", "correct it there, e.g. 2*a + min(b, 1)")
        except (ValueError, MemoryError, RecursionError):
            self._fail("the expression cannot be read", "write a simpler one")
        self._check_depth(tree)
        return tree

    def _fail(self, message: str, remedy: str) -> NoReturn:
        raise InvalidInputError(Problem(self.field, message, remedy)) from None

    def finish(self) -> None:
        """Raises InvalidInputError if there are problems."""
        if self.problems:
            raise InvalidInputError(*dict.fromkeys(self.problems))

    def refuse(self, node: ast.expr, message: str, remedy: str) -> None:
        """Adds a problem at the place of `node`."""
        before = " ".join(self.text.split("\n")).lstrip()
        column = len(before.encode()[: node.col_offset].decode(errors="ignore")) + len(self.text) - len(self.text.lstrip()) + 1
        self.problems.append(Problem(self.field, f"column {column}: {message}", remedy))

    def _check_tokens(self) -> None:
        position = 0
        while position < len(self.text):
            token = _TOKEN.match(self.text, position)
            if token is None:
                sign = self.text[position]
                remedy = _REMEDIES.get(sign, "use numbers, names, + - * / **, parentheses and " + ", ".join(FUNCTIONS))
                self._fail(f"column {position + 1}: `{shown(sign)}` is not supported", remedy)
            position = token.end()
        if not self.text.strip():
            self._fail("the expression is empty", "write one, e.g. 2*a + min(b, 1)")

    def _check_depth(self, tree: ast.expr) -> None:
        waiting: list[tuple[ast.AST, int]] = [(tree, 1)]
        while waiting:
            node, depth = waiting.pop()
            if depth > DEEPEST:
                self._fail(f"the expression has more than {DEEPEST} levels", "write a flatter one")
            waiting.extend((child, depth + 1) for child in ast.iter_child_nodes(node))

    def check_condition(self, node: ast.expr) -> None:
        """Collects the problems of a condition."""
        if isinstance(node, ast.BoolOp):
            for part in node.values:
                self.check_condition(part)
        elif isinstance(node, ast.Compare) and all(type(operator) in COMPARISONS for operator in node.ops):
            sides = [node.left, *node.comparators]
            if any(isinstance(side, ast.Constant) and isinstance(side.value, str) for side in sides) or any(
                self.known.get(_name(side) or "") for side in sides
            ):
                self._check_choice(node)
            else:
                for side in sides:
                    self.check_number(side)
        else:
            self.refuse(node, "this is not a comparison", "compare two values, e.g. a <= b")

    def _check_choice(self, node: ast.Compare) -> None:
        sides = [node.left, *node.comparators]
        names = [name for name in map(_name, sides) if name and (name in self.known or self.allows_any)]
        texts = [side.value for side in sides if isinstance(side, ast.Constant) and isinstance(side.value, str)]
        for side in sides:
            unknown = _name(side)
            if unknown is not None and unknown not in self.known and not self.allows_any:
                self._check_name(side, unknown, [])
                return
        if not isinstance(node.ops[0], ast.Eq | ast.NotEq) or len(sides) != 2 or len(names) != 1 or len(texts) != 1:
            self.refuse(node, "a choice compares with a text by == or != only", "write e.g. mode == 'eco'")
            return
        self.names[names[0]] = None
        if not self.allows_any and texts[0] not in self.known[names[0]]:
            if not self.known[names[0]]:
                self.refuse(node, f"{names[0]} is a number", "compare it with a number, without quotes")
            else:
                self.refuse(
                    node, f"{names[0]} has no choice '{shown(texts[0])}'", nearest(texts[0], list(self.known[names[0]]))
                )

    def check_number(self, node: ast.expr) -> None:
        """Collects the problems of an arithmetic expression."""
        name = _name(node)
        if name is not None:
            self._check_name(node, name, [key for key, choices in self.known.items() if choices])
        elif isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool):
            if not abs(node.value) < 1e300:
                self.refuse(node, "the number is too large", "give a smaller one")
        elif isinstance(node, ast.UnaryOp) and type(node.op) in SIGNS:
            self.check_number(node.operand)
        elif isinstance(node, ast.BinOp) and type(node.op) in SCALAR.binary:
            self.check_number(node.left)
            self.check_number(node.right)
            self._check_exponent(node)
        elif isinstance(node, ast.Call):
            self._check_call(node)
        elif isinstance(node, ast.Compare | ast.BoolOp):
            self.refuse(node, "a comparison is not a number", "leave it out")
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            self.refuse(node, "a text is not a number", "leave the quotes out")
        else:
            self.refuse(node, "this is not supported", "use numbers, names, + - * / ** and " + ", ".join(FUNCTIONS))

    def _check_name(self, node: ast.expr, name: str, choices: Sequence[str]) -> None:
        if name in choices:
            first = self.known[name][0]
            self.refuse(node, f"{name} is a choice, no number", f"compare it, e.g. {name} == '{first}'")
        elif name in self.known or (self.allows_any and name not in FUNCTIONS):
            self.names[name] = None
        else:
            self.refuse(node, f"there is no {self.noun} {shown(name)}", self._nearest(name))

    def _nearest(self, name: str) -> str:
        if name in FUNCTIONS:
            return f"write {name}(...) for the function"
        if any(name in choices for choices in self.known.values()):
            return f"put a choice in quotes: '{name}'"
        if name in {"not", "True", "False", "None", "if", "lambda", "in", "is"}:
            return "leave it out"
        dashed = get_close_matches(name, [key for key in self.known if "-" in key], n=1, cutoff=0.4)
        if dashed:
            return f"{dashed[0]} cannot be used in formulas, as - subtracts: rename it with _"
        return nearest(name, list(self.known)) if self.known else f"there is no {self.noun} at all"

    def _check_exponent(self, node: ast.BinOp) -> None:
        exponent = node.right.operand if isinstance(node.right, ast.UnaryOp) else node.right
        value = exponent.value if isinstance(exponent, ast.Constant) else None
        if isinstance(node.op, ast.Pow) and isinstance(value, int | float) and abs(value) > LARGEST_EXPONENT:
            self.refuse(node.right, "the exponent is too large", f"give at most {LARGEST_EXPONENT}")

    def _check_call(self, node: ast.Call) -> None:
        name = _name(node.func)
        if name is None or name not in FUNCTIONS:
            remedy = nearest(name, list(FUNCTIONS)) if name else f"known are {', '.join(FUNCTIONS)}"
            self.refuse(node, f"there is no function {shown(name)}" if name else "this is not a function", remedy)
            return
        fewest, most = FUNCTIONS[name]
        if node.keywords or any(isinstance(argument, ast.Starred) for argument in node.args):
            self.refuse(node, f"{name} takes plain arguments only", f"write e.g. {name}({', '.join('abc'[:fewest])})")
            return
        if not fewest <= len(node.args) <= most:
            wanted = str(fewest) if fewest == most else f"{fewest} to {most}"
            self.refuse(node, f"{name} has {len(node.args)} arguments", f"give {wanted}")
        for argument in node.args:
            self.check_number(argument)


def _name(node: ast.expr) -> str | None:
    """Returns the name that a node stands for, with dots as in `engine.mass`."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute):
        owner = _name(node.value)
        return None if owner is None else f"{owner}.{node.attr}"
    return None


def _inequalities(node: ast.expr) -> Iterator[Inequality]:
    """Yields linear inequalities that a condition implies: of all its parts if `and` joins them."""
    if isinstance(node, ast.BoolOp) and isinstance(node.op, ast.And):
        for part in node.values:
            yield from _inequalities(part)
    if isinstance(node, ast.Compare):
        sides = [_linear(side) for side in (node.left, *node.comparators)]
        for operator, left, right in zip(node.ops, sides, sides[1:], strict=False):
            if left is None or right is None or isinstance(operator, ast.NotEq):
                continue
            strict = isinstance(operator, ast.Lt | ast.Gt)
            if not isinstance(operator, ast.Gt | ast.GtE):
                yield from _inequality(_combined(left, right, -1.0), strict=strict)
            if not isinstance(operator, ast.Lt | ast.LtE):
                yield from _inequality(_combined(right, left, -1.0), strict=strict)


def _inequality(terms: Mapping[str, float], *, strict: bool) -> Iterator[Inequality]:
    """Yields the inequality that a sum is at most 0, if its squares are finite; the constant stands under ""."""
    coefficients = {name: factor for name, factor in terms.items() if name and factor}
    usable = all(1e-60 < abs(factor) < 1e60 for factor in coefficients.values()) and abs(terms.get("", 0.0)) < 1e60
    if coefficients and usable:
        yield Inequality(coefficients, -terms.get("", 0.0), strict)


def _linear(node: ast.expr) -> dict[str, float] | None:
    """Returns the coefficients of a linear expression by name, its constant under ""; None for others."""
    name = _name(node)
    if name is not None:
        return {name: 1.0}
    match node:
        case ast.Constant(value=int() | float() as value):
            return {"": float(value)}
        case ast.UnaryOp(op=operator, operand=operand) if (inner := _linear(operand)) is not None:
            return inner if isinstance(operator, ast.UAdd) else _combined({}, inner, -1.0)
        case ast.BinOp(op=operator, left=one, right=other):
            left, right = _linear(one), _linear(other)
            if left is None or right is None:
                return None
            match operator:
                case ast.Add():
                    return _combined(left, right, 1.0)
                case ast.Sub():
                    return _combined(left, right, -1.0)
                case ast.Mult() if left.keys() <= {""}:
                    return _combined({}, right, left.get("", 0.0))
                case ast.Mult() if right.keys() <= {""}:
                    return _combined({}, left, right.get("", 0.0))
                case ast.Div() if right.keys() <= {""} and right.get(""):
                    return _combined({}, left, 1 / right[""])
    return None


def _combined(left: Mapping[str, float], right: Mapping[str, float], factor: float) -> dict[str, float]:
    """Returns left + factor * right."""
    return {name: left.get(name, 0.0) + factor * right.get(name, 0.0) for name in (*left, *right)}


def _compiled(node: ast.expr, arithmetic: Arithmetic) -> Evaluation:
    """Returns a closure that evaluates a checked tree."""
    name = _name(node)
    if name is not None:
        return arithmetic.variable(name)
    match node:
        case ast.Constant(value=value):
            number = float(value)  # type: ignore[arg-type]  # a checked tree has only numbers here
            return lambda _: number
        case ast.UnaryOp(op=operator, operand=operand):
            return _applied(SIGNS[type(operator)], [_compiled(operand, arithmetic)])
        case ast.BinOp(left=left, op=binary, right=right):
            return _applied(arithmetic.binary[type(binary)], [_compiled(left, arithmetic), _compiled(right, arithmetic)])
        case ast.Call(func=function, args=arguments):
            called = arithmetic.functions[_name(function) or ""]
            return _applied(called, [_compiled(argument, arithmetic) for argument in arguments])
    raise AssertionError(ast.dump(node))


def _applied(function: Callable[..., Any], operands: Sequence[Evaluation]) -> Evaluation:
    if len(operands) == 1:
        [only] = operands
        return lambda values: function(only(values))
    if len(operands) == 2:
        left, right = operands
        return lambda values: function(left(values), right(values))
    return lambda values: function(*[operand(values) for operand in operands])


def _condition(node: ast.expr) -> Evaluation:
    """Returns a closure that evaluates a checked condition on arrays."""
    if isinstance(node, ast.BoolOp):
        return joined([_condition(part) for part in node.values], conjunction=isinstance(node.op, ast.And))
    if not isinstance(node, ast.Compare):
        raise TypeError(ast.dump(node))
    sides = [node.left, *node.comparators]
    for side, other in (sides[:2], sides[1::-1]):
        if isinstance(other, ast.Constant) and isinstance(other.value, str):
            return _chosen(_name(side) or "", other.value, equal=isinstance(node.ops[0], ast.Eq))
    operands = [_compiled(side, ARRAY) for side in sides]
    links = zip(node.ops, operands, operands[1:], strict=False)
    return joined([compared(COMPARISONS[type(sign)], left, right) for sign, left, right in links], conjunction=True)


def _chosen(name: str, choice: str, *, equal: bool) -> Evaluation:
    return (lambda values: values[name] == choice) if equal else (lambda values: values[name] != choice)
