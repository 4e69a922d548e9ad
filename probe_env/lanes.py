"""Numba values that hold one double for each of four probes and live in a vector register.

LLVM's own vectoriser gives up on the sweeps of the fast scheme (it cannot prove that factors and state do not
overlap), so the vector type is made explicit: arithmetic on ``Lanes`` values compiles to vector instructions.
Every lane sees the same instructions, so a probe's result does not depend on the lane or on its neighbours.
"""

from __future__ import annotations

import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, models, overload, register_model

LANES = 4
_FLAGS = ("contract",)
_VECTOR = ir.VectorType(ir.DoubleType(), LANES)


class LanesType(types.Type):
    """Numba's type of a value with one double a lane."""

    def __init__(self) -> None:
        super().__init__(name=f"Lanes{LANES}")


LANES_TYPE = LanesType()


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, type_: LanesType) -> None:
        super().__init__(manager, type_, _VECTOR)


def _address(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), _VECTOR.as_pointer())


@intrinsic
def load(typing_context: Any, array: Any, index: Any) -> Any:
    """``load(array, index)``: the four doubles of a flat array from ``index`` on."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.load(_address(context, builder, signature.args[0], *arguments), align=8)

    return LANES_TYPE(array, types.intp), code


@intrinsic
def store(typing_context: Any, array: Any, index: Any, value: Any) -> Any:
    """``store(array, index, value)``: write four doubles of a flat array from ``index`` on."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array_value, position, vector = arguments
        builder.store(vector, _address(context, builder, signature.args[0], array_value, position), align=8)
        return context.get_dummy_value()

    return types.void(array, types.intp, LANES_TYPE), code


@intrinsic
def splat(typing_context: Any, value: Any) -> Any:
    """``splat(value)``: the same double in every lane."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        vector = ir.Constant(_VECTOR, ir.Undefined)
        for lane in range(LANES):
            vector = builder.insert_element(vector, arguments[0], ir.Constant(ir.IntType(32), lane))
        return vector

    return LANES_TYPE(types.float64), code


@intrinsic
def where_less(typing_context: Any, a: Any, b: Any, yes: Any, no: Any) -> Any:
    """``where_less(a, b, yes, no)``: ``yes`` in the lanes with a < b, else ``no`` (also where either is NaN)."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        first, second, chosen, other = arguments
        return builder.select(builder.fcmp_ordered("<", first, second), chosen, other)

    return LANES_TYPE(LANES_TYPE, LANES_TYPE, LANES_TYPE, LANES_TYPE), code


def _arithmetic(symbol: Any, instruction: str) -> None:
    @intrinsic
    def vector_operation(typing_context: Any, a: Any, b: Any) -> Any:
        def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return getattr(builder, instruction)(*arguments, flags=_FLAGS)

        return LANES_TYPE(LANES_TYPE, LANES_TYPE), code

    @overload(symbol, inline="always")
    def operation(a, b):  # numba compares signatures: no annotations
        if isinstance(a, LanesType) and isinstance(b, LanesType):
            return lambda a, b: vector_operation(a, b)
        if isinstance(a, LanesType) and isinstance(b, types.Float):
            return lambda a, b: vector_operation(a, splat(b))
        if isinstance(a, types.Float) and isinstance(b, LanesType):
            return lambda a, b: vector_operation(splat(a), b)
        return None


for _symbol, _instruction in (
    (operator.add, "fadd"),
    (operator.sub, "fsub"),
    (operator.mul, "fmul"),
    (operator.truediv, "fdiv"),
):
    _arithmetic(_symbol, _instruction)
