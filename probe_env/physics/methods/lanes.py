"""Numba values that hold one number for each of several probes and live in a vector register.

LLVM's own vectoriser gives up on the sweeps of the fast scheme (it cannot prove that factors and state do not
overlap), so the vector type is made explicit: arithmetic on ``Lanes`` values compiles to vector instructions.
Every lane sees the same instructions, so a probe's result does not depend on the lane or on its neighbours.
A register of 256 bits holds four doubles or eight singles; the element type of the arrays decides.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

REGISTER = 32  # bytes
_FLAGS = ("contract",)
_IR: dict[types.Type, ir.Type] = {types.float64: ir.DoubleType(), types.float32: ir.FloatType()}


def lane_count(precision: npt.DTypeLike) -> int:
    """Probes side by side with numbers of a precision."""
    return REGISTER // np.dtype(precision).itemsize


class LanesType(types.Type):
    """Numba's type of a value with one number a lane."""

    def __init__(self, element: types.Float) -> None:
        self.element = element
        self.count = REGISTER * 8 // element.bitwidth
        self.alignment = element.bitwidth // 8
        self.vector = ir.VectorType(_IR[element], self.count)
        super().__init__(name=f"Lanes({element} x {self.count})")


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, type_: LanesType) -> None:
        super().__init__(manager, type_, type_.vector)


def _address(context: Any, builder: Any, array_type: Any, array: Any, row: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    pointer = builder.bitcast(data, LanesType(array_type.dtype).vector.as_pointer())
    return builder.gep(pointer, [row])


@intrinsic
def load(typing_context: Any, array: Any, row: Any) -> Any:
    """``load(array, row)``: a row of a contiguous (rows, lanes) array."""
    lanes = LanesType(array.dtype)

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_address(context, builder, signature.args[0], *arguments), align=lanes.alignment)

    return lanes(array, types.intp), code


@intrinsic
def store(typing_context: Any, array: Any, row: Any, value: Any) -> Any:
    """``store(array, row, value)``: write a row of a contiguous (rows, lanes) array."""
    lanes = LanesType(array.dtype)

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array_value, position, vector = arguments
        address = _address(context, builder, signature.args[0], array_value, position)
        builder.store(vector, address, align=lanes.alignment)
        return context.get_dummy_value()

    return types.void(array, types.intp, lanes), code


@intrinsic
def splat(typing_context: Any, like: Any, value: Any) -> Any:
    """``splat(like, value)``: the same number in every lane; ``like`` is a lanes value or an array of rows."""
    lanes = like if isinstance(like, LanesType) else LanesType(like.dtype)

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number = context.cast(builder, arguments[1], types.float64, lanes.element)
        vector = ir.Constant(lanes.vector, ir.Undefined)
        for lane in range(lanes.count):
            vector = builder.insert_element(vector, number, ir.Constant(ir.IntType(32), lane))
        return vector

    return lanes(like, types.float64), code


@intrinsic
def where_less(typing_context: Any, a: Any, b: Any, yes: Any, no: Any) -> Any:
    """``where_less(a, b, yes, no)``: ``yes`` in the lanes with a < b, else ``no`` (also where either is NaN)."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first, second, chosen, other = arguments
        return builder.select(builder.fcmp_ordered("<", first, second), chosen, other)

    return a(a, a, a, a), code


@intrinsic
def square_root(typing_context: Any, value: Any) -> Any:
    """``square_root(value)``: of every lane."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = arguments[0].type
        suffix = f"v{vector.count}{vector.element.intrinsic_name}"
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(vector, [vector]), f"llvm.sqrt.{suffix}"
        )
        return builder.call(function, arguments)

    return value(value), code


@intrinsic
def any_less(typing_context: Any, a: Any, b: Any) -> Any:
    """``any_less(a, b)``: whether a < b in any lane."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        bits = ir.IntType(signature.args[0].count)
        mask = builder.bitcast(builder.fcmp_ordered("<", *arguments), bits)
        return builder.icmp_unsigned("!=", mask, ir.Constant(bits, 0))

    return types.boolean(a, a), code


def _neighbours(first: int) -> Any:
    """An intrinsic of two lanes values one after the other: as many lanes of both as one has, from ``first`` on."""

    def neighbours(typing_context: Any, a: Any, b: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            count = signature.args[0].count
            start = first % count
            picked = ir.Constant(ir.VectorType(ir.IntType(32), count), [start + lane for lane in range(count)])
            return builder.shuffle_vector(*arguments, picked)

        return a(a, a), code

    return neighbours


from_behind = intrinsic(_neighbours(-1))
"""``from_behind(a, b)``: b moved one lane on; the first lane has the last of a."""
from_ahead = intrinsic(_neighbours(1))
"""``from_ahead(a, b)``: a moved one lane back; the last lane has the first of b."""


def _arithmetic(symbol: Any, instruction: str) -> None:
    @intrinsic
    def vector_operation(typing_context: Any, a: Any, b: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, instruction)(*arguments, flags=_FLAGS)

        return a(a, a), code

    @overload(symbol, inline="always")
    def operation(a, b):  # numba compares signatures: no annotations
        if isinstance(a, LanesType) and isinstance(b, LanesType):
            return lambda a, b: vector_operation(a, b)
        if isinstance(a, LanesType) and isinstance(b, types.Float):
            return lambda a, b: vector_operation(a, splat(a, b))
        if isinstance(a, types.Float) and isinstance(b, LanesType):
            return lambda a, b: vector_operation(splat(b, a), b)
        return None


for _symbol, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _arithmetic(_symbol, _instruction)
