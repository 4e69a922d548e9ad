"""Numbers of several probes in a vector register, and functions of them that are traced when a kernel is compiled.

LLVM's vectoriser does not vectorise the sweeps of the fast methods, because it cannot prove that factors and state do
not overlap. So the vector type is explicit: arithmetic on lanes compiles to vector instructions. Every lane sees the
same instructions, so the result of a probe does not depend on the lane or on the other probes. A register of 256 bits
holds four doubles or eight singles, according to the type of the arrays.

A ``traced`` function is called in compiled kernels, and is itself not compiled by numba: while the kernel that calls it
is compiled, it runs once, and every operation on its arguments (``Value``) emits an instruction. So it may call other
traced functions and branch on the lengths of tuples, but not on values. This compiles three times as fast as numba
functions inlined into the kernel.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
import numpy.typing as npt
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import lower_builtin, models, register_model, type_callable

compiled: Any = njit  # numba's annotations lack some of its options
kernel = compiled(cache=True, nogil=True, error_model="numpy", no_cfunc_wrapper=True)
"""Decorator of functions that are called from Python."""
PART = {"nogil": True, "error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
part = compiled(**PART)
"""Decorator of functions that are called from kernels only; without a wrapper for Python they compile faster."""
REGISTER = 32  # bytes
_IR: dict[types.Type, ir.Type] = {
    types.float64: ir.DoubleType(), types.float32: ir.FloatType(), types.intp: ir.IntType(64)
}  # fmt: skip


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


class Value:
    """A value of a traced function: lanes, a float, an integer, or an array of rows of lanes.

    Attributes:
        builder: emits the instructions.
        type: of numba.
        ir: LLVM's value; of an array the address of its first row.
    """

    def __init__(self, builder: Any, type_: types.Type, ir_value: Any) -> None:
        self.builder, self.type, self.ir = builder, type_, ir_value

    def of(self, ir_value: Any) -> Value:
        """Another value of this type."""
        return Value(self.builder, self.type, ir_value)

    def cast(self, value: Any, type_: types.Type) -> Any:
        """LLVM's value of a number as another type: a float in every lane, or an integer as float."""
        known = value.type if isinstance(value, Value) else types.float64 if isinstance(value, float) else types.intp
        number = value.ir if isinstance(value, Value) else ir.Constant(_IR[known], value)
        if known == type_:
            return number
        if not isinstance(type_, LanesType):
            return self.builder.sitofp(number, _IR[type_])
        if type_.element != types.float64:
            number = self.builder.fptrunc(number, _IR[type_.element])
        vector = ir.Constant(type_.vector, ir.Undefined)
        for lane in range(type_.count):
            vector = self.builder.insert_element(vector, number, ir.Constant(ir.IntType(32), lane))
        return vector


def _operator(symbol: str, real: str, whole: str | None) -> Callable[[Any, Any], Value]:
    def operation(a: Any, b: Any) -> Value:
        both = [value for value in (a, b) if isinstance(value, Value)]
        floats = any(isinstance(value, float) or getattr(value, "type", None) == types.float64 for value in (a, b))
        scalar = types.float64 if floats else types.intp
        type_: Any = next((value.type for value in both if isinstance(value.type, LanesType)), scalar)
        builder, arguments = both[0].builder, [both[0].cast(value, type_) for value in (a, b)]
        flags = ("contract",) if isinstance(type_, LanesType) else ()
        emitted = (
            getattr(builder, whole)(*arguments)
            if type_ == types.intp and whole
            else getattr(builder, real)(*arguments, flags=flags)
        )
        return Value(builder, type_, emitted)

    setattr(Value, f"__{symbol}__", operation)
    setattr(Value, f"__r{symbol}__", lambda self, other: operation(other, self))
    return operation


def traced(function: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator of a function of lanes that is run while the calling kernel is compiled; see the module."""

    @wraps(function)
    def result(*arguments: types.Type) -> Any:
        block = ir.Function(ir.Module(), ir.FunctionType(ir.VoidType(), ()), "trial").append_basic_block()
        values = (_values(ir.IRBuilder(block), type_, None, None) for type_ in arguments)
        return _type_of(function(*values))

    type_callable(function)(lambda typing_context: result)
    lower_builtin(function, types.VarArg(types.Any))(_lowering(function))
    return function


def _lowering(function: Callable[..., Any]) -> Any:
    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        values = [
            _values(builder, type_, value, context) for type_, value in zip(signature.args, arguments, strict=True)
        ]
        return _packed(context, builder, function(*values))

    return code


def _values(builder: Any, type_: types.Type, value: Any, context: Any) -> Any:
    """An argument as ``Value`` or tuple of values; undefined without a context, to find the type of a result."""
    if isinstance(type_, types.BaseTuple):
        extract = (lambda k: None) if context is None else lambda k: builder.extract_value(value, k)
        parts: Any = type_
        return tuple(_values(builder, part, extract(k), context) for k, part in enumerate(parts))
    if isinstance(type_, types.Array):
        pointer = LanesType(type_.dtype).vector.as_pointer()
        if context is None:
            return Value(builder, type_, ir.Constant(pointer, ir.Undefined))
        return Value(builder, type_, builder.bitcast(context.make_array(type_)(context, builder, value).data, pointer))
    if not isinstance(type_, LanesType):
        scalar = types.float64 if isinstance(type_, types.Float) else types.intp
        if context is None:
            return Value(builder, scalar, ir.Constant(_IR[scalar], ir.Undefined))
        return Value(builder, scalar, context.cast(builder, value, type_, scalar))
    return Value(builder, type_, ir.Constant(type_.vector, ir.Undefined) if context is None else value)


def _type_of(result: Any) -> Any:
    if isinstance(result, tuple):
        return types.BaseTuple.from_types(tuple(_type_of(part) for part in result))
    return types.void if result is None else result.type


def _packed(context: Any, builder: Any, result: Any) -> Any:
    if isinstance(result, tuple):
        return context.make_tuple(builder, _type_of(result), [_packed(context, builder, part) for part in result])
    return context.get_dummy_value() if result is None else result.ir


@traced
def load(array, row):
    """A row of a contiguous (rows, lanes) array."""
    lanes, builder = LanesType(array.type.dtype), array.builder
    address = builder.gep(array.ir, [array.cast(row, types.intp)])
    return Value(builder, lanes, builder.load(address, align=lanes.alignment))


@traced
def store(array, row, value):
    """Write a row of a contiguous (rows, lanes) array."""
    address = array.builder.gep(array.ir, [array.cast(row, types.intp)])
    array.builder.store(value.ir, address, align=value.type.alignment)


@traced
def load3(array, row):
    """Three rows from ``row`` on."""
    return load(array, row), load(array, row + 1), load(array, row + 2)


@traced
def store3(array, row, x, y, t):
    """Write three rows from ``row`` on."""
    store(array, row, x)
    store(array, row + 1, y)
    store(array, row + 2, t)


@traced
def splat(like, value):
    """The same number in every lane; ``like`` is a lanes value or an array of rows."""
    lanes = like.type if isinstance(like.type, LanesType) else LanesType(like.type.dtype)
    return Value(like.builder, lanes, like.cast(value, lanes))


@traced
def where_less(a, b, yes, no):
    """``yes`` in the lanes with a < b, else ``no`` (also where either is NaN)."""
    return a.of(a.builder.select(a.builder.fcmp_ordered("<", a.ir, b.ir), yes.ir, no.ir))


@traced
def square_root(value):
    """Square root of every lane."""
    vector = value.type.vector
    name = f"llvm.sqrt.v{vector.count}{vector.element.intrinsic_name}"
    function = cgutils.get_or_insert_function(value.builder.module, ir.FunctionType(vector, [vector]), name)
    return value.of(value.builder.call(function, [value.ir]))


@traced
def multiply_add(a, b, c):
    """A b + c; processors with fused multiply-add do not round a b.

    In the sum of two products the compiler chooses which is not rounded, which may differ between kernels.
    """
    vector = a.type.vector
    name = f"llvm.fmuladd.v{vector.count}{vector.element.intrinsic_name}"
    function = cgutils.get_or_insert_function(a.builder.module, ir.FunctionType(vector, [vector] * 3), name)
    return a.of(a.builder.call(function, [a.ir, b.ir, c.ir]))


@traced
def any_less(a, b):
    """Whether a < b in any lane."""
    bits = ir.IntType(a.type.count)
    mask = a.builder.bitcast(a.builder.fcmp_ordered("<", a.ir, b.ir), bits)
    return Value(a.builder, types.boolean, a.builder.icmp_unsigned("!=", mask, ir.Constant(bits, 0)))


def _neighbours(first: int) -> Any:
    """A function of two lanes values one after the other: as many lanes of both as one has, from ``first`` on."""

    def neighbours(a, b):
        count = a.type.count
        picked = ir.Constant(ir.VectorType(ir.IntType(32), count), [first % count + lane for lane in range(count)])
        return a.of(a.builder.shuffle_vector(a.ir, b.ir, picked))

    return traced(neighbours)


from_behind = _neighbours(-1)
"""``from_behind(a, b)``: b moved one lane on; the first lane has the last of a."""
from_ahead = _neighbours(1)
"""``from_ahead(a, b)``: a moved one lane back; the last lane has the first of b."""


def _in_kernels(symbol: Any, operation: Any) -> None:
    """Arithmetic of lanes in functions that numba compiles."""

    @type_callable(symbol)
    def typed(typing_context: Any) -> Any:
        def result(a: Any, b: Any) -> Any:
            lanes = a if isinstance(a, LanesType) else b
            accepted = isinstance(a, LanesType | types.Float) and isinstance(b, LanesType | types.Float)
            return lanes if accepted and isinstance(lanes, LanesType) else None

        return result

    for pair in ((LanesType, LanesType), (LanesType, types.Float), (types.Float, LanesType)):
        lower_builtin(symbol, *pair)(_lowering(operation))


for _symbol, _name, _real, _whole in (
    (operator.add, "add", "fadd", "add"),
    (operator.sub, "sub", "fsub", "sub"),
    (operator.mul, "mul", "fmul", "mul"),
    (operator.truediv, "truediv", "fdiv", None),
):
    _in_kernels(_symbol, _operator(_name, _real, _whole))
