"""Eight numbers side by side in compiled code: `Lanes` add, multiply and compare lane by lane, in vector registers.

numba's own vectoriser keeps sums in memory, and computes one by one what does not fill a vector. `Lanes` are LLVM vectors without any
fast-math flag: each lane has the bits of the same operations on single numbers, on every processor. `load` and `store` check no bounds,
like all compiled code here.
"""

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.core.cgutils import get_or_insert_function
from numba.extending import intrinsic, lower_builtin, models, register_model, type_callable

LANES = 8

_DOUBLES, _BITS = ir.VectorType(ir.DoubleType(), LANES), ir.VectorType(ir.IntType(1), LANES)
_INT32 = ir.IntType(32)


class LanesType(types.Type):  # type: ignore[misc]  # numba ships no types
    """Eight float64."""

    def __init__(self) -> None:
        super().__init__(name="Lanes")


class Mask(types.Type):  # type: ignore[misc]  # as above
    """Eight truth values."""

    def __init__(self) -> None:
        super().__init__(name="Mask")


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]  # as above
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _DOUBLES)


@register_model(Mask)
class _MaskModel(models.PrimitiveModel):  # type: ignore[misc]  # as above
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _BITS)


_lanes, _mask = LanesType(), Mask()
Build = Callable[..., Any]


def _all(builder: Any, kind: Any, value: Any) -> Any:
    """Returns the value if it is Lanes already, else a number in all lanes."""
    if kind == _lanes:
        return value
    first = builder.insert_element(ir.Constant(_DOUBLES, ir.Undefined), value, ir.Constant(_INT32, 0))
    return builder.shuffle_vector(first, first, ir.Constant(ir.VectorType(_INT32, LANES), [0] * LANES))


def _operator(function: Any, result: Any, build: Build) -> None:
    """Defines an operator of Lanes with Lanes and with numbers."""

    @type_callable(function)
    def typed(_context: Any) -> Any:
        def resolve(left: Any, right: Any) -> Any:
            kinds = {left, right}
            return result if _lanes in kinds and kinds <= {_lanes, types.float64} else None

        return resolve

    for left, right in ((_lanes, _lanes), (_lanes, types.float64), (types.float64, _lanes)):

        @lower_builtin(function, left, right)
        def lowered(_context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return build(builder, *(_all(builder, *each) for each in zip(signature.args, arguments, strict=True)))


_operator(operator.add, _lanes, lambda builder, left, right: builder.fadd(left, right))
_operator(operator.sub, _lanes, lambda builder, left, right: builder.fsub(left, right))
_operator(operator.mul, _lanes, lambda builder, left, right: builder.fmul(left, right))
_operator(operator.truediv, _lanes, lambda builder, left, right: builder.fdiv(left, right))
_operator(operator.lt, _mask, lambda builder, left, right: builder.fcmp_ordered("<", left, right))
_operator(operator.le, _mask, lambda builder, left, right: builder.fcmp_ordered("<=", left, right))
_operator(operator.gt, _mask, lambda builder, left, right: builder.fcmp_ordered(">", left, right))


@type_callable(operator.or_)
def _typed_or(_context: Any) -> Any:
    return lambda left, right: _mask if left == right == _mask else None


@lower_builtin(operator.or_, _mask, _mask)
def _lowered_or(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
    return builder.or_(*arguments)


@intrinsic
def spread(_context: Any, value: Any) -> Any:
    """Returns the number `value` in all lanes."""

    def build(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return _all(builder, types.float64, arguments[0])

    return _lanes(value), build


def _address(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    array = context.make_array(signature.args[0])(context, builder, arguments[0])
    return builder.bitcast(builder.gep(array.data, [arguments[1]]), _DOUBLES.as_pointer())


@intrinsic
def load(_context: Any, array: Any, at: Any) -> Any:
    """Returns eight successive numbers of an array in C order."""
    del at

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_address(context, builder, signature, arguments), align=8)

    return _lanes(array, types.intp), build


@intrinsic
def store(_context: Any, array: Any, at: Any, value: Any) -> Any:
    """Writes eight successive numbers of an array in C order."""
    del at

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        value = _all(builder, signature.args[2], arguments[2])
        builder.store(value, _address(context, builder, signature, arguments), align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), build


@intrinsic
def where(_context: Any, condition: Any, yes: Any, no: Any) -> Any:
    """Returns `yes` in the lanes where the condition holds, else `no`; both may be Lanes or numbers."""

    def build(_context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pair = zip(signature.args[1:], arguments[1:], strict=True)
        return builder.select(arguments[0], *(_all(builder, *each) for each in pair))

    return _lanes(condition, yes, no), build


def _unary(name: str) -> Any:
    @intrinsic
    def function(_context: Any, value: Any) -> Any:
        def build(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            kind = ir.FunctionType(_DOUBLES, [_DOUBLES])
            return builder.call(get_or_insert_function(builder.module, kind, f"{name}.v{LANES}f64"), arguments)

        return _lanes(value), build

    return function


floor, absolute = _unary("llvm.floor"), _unary("llvm.fabs")


def _chosen(sign: str) -> Any:
    @intrinsic
    def function(_context: Any, left: Any, right: Any) -> Any:
        def build(_context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            first, second = (_all(builder, *each) for each in zip(signature.args, arguments, strict=True))
            return builder.select(builder.fcmp_ordered(sign, first, second), first, second)

        return _lanes(left, right), build

    return function


larger, smaller = _chosen(">"), _chosen("<")


@intrinsic
def bits(_context: Any, condition: Any) -> Any:
    """Returns the lanes where a condition holds as the bits of a whole number, the first lane lowest."""

    def build(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.zext(builder.bitcast(arguments[0], ir.IntType(LANES)), ir.IntType(64))

    return types.int64(condition), build


@intrinsic
def lowest_bit(_context: Any, number: Any) -> Any:
    """Returns the place of the lowest bit of a whole number that is set."""
    del number

    def build(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return types.int64(types.int64), build
