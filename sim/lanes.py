"""Eight numbers that compiled code treats as one: a lane of a vector register for each of eight flights.

The formulas of the simulator are written once. Given numbers they compile to scalar code; given :class:`Lanes` and
:class:`Rows` the same functions compile to vector code. Both do the same IEEE operations in the same order, so a
lane's result is the scalar one to the last bit. Sines and the like call the same library function lane by lane. A branch
on a number becomes :func:`select`, of which both sides are worked out.

Numba's extension interface is used as its manual says ("Extending Numba", low level): a type, its LLVM
representation (a vector of doubles), the operators on it, and how a Python object is taken apart.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.extending import (
    NativeValue,
    intrinsic,
    lower_builtin,
    lower_cast,
    models,
    overload,
    register_model,
    typeof_impl,
    unbox,
)
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numpy.typing import NDArray

WIDTH = 8
"""Doubles of the widest vector registers; narrower machines take two or four registers for it."""

_DOUBLE = ir.DoubleType()
_VECTOR = ir.VectorType(_DOUBLE, WIDTH)
_BITS = ir.VectorType(ir.IntType(1), WIDTH)


class Lanes:
    """One number of each flight, shape (8,)."""

    def __init__(self, values: NDArray[np.float64]):
        self.values = np.ascontiguousarray(values, dtype=np.float64)
        self.address = int(self.values.ctypes.data)


class Rows:
    """An array of numbers of each flight, shape (k, 8) or (k, c, 8); compiled code reads and writes it in place."""

    def __init__(self, values: NDArray[np.float64]):
        if not (values.flags.c_contiguous and values.dtype == np.float64 and values.shape[-1] == WIDTH):
            raise ValueError(f"rows of lanes are contiguous doubles of shape (..., {WIDTH}), not {values.shape}")
        self.values = values
        self.address = int(values.ctypes.data)
        self.rows = values.shape[0]
        self.columns = values.shape[1] if values.ndim == 3 else 1


class LanesType(types.Type):
    """Numba's type of :class:`Lanes`."""

    def __init__(self) -> None:
        super().__init__("Lanes")

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Conversion | None:
        """A number stands for eight equal ones."""
        return Conversion.safe if isinstance(other, (types.Float, types.Integer)) else None


class MaskType(types.Type):
    """Eight truth values."""

    def __init__(self) -> None:
        super().__init__("LanesMask")

    def can_convert_from(self, typingctx: Any, other: types.Type) -> Conversion | None:
        """One truth value stands for eight equal ones."""
        return Conversion.safe if isinstance(other, types.Boolean) else None


class RowsType(types.Type):
    """Numba's type of :class:`Rows`."""

    def __init__(self, ndim: int):
        self.ndim = ndim
        super().__init__(f"Rows({ndim})")


LANES, MASK = LanesType(), MaskType()


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any):
        super().__init__(dmm, fe_type, _VECTOR)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any):
        super().__init__(dmm, fe_type, _BITS)


@register_model(RowsType)
class _RowsModel(models.StructModel):
    def __init__(self, dmm: Any, fe_type: Any):
        members = [("data", types.voidptr), ("rows", types.intp), ("columns", types.intp)]
        super().__init__(dmm, fe_type, members)


@typeof_impl.register(Lanes)
def _typeof_lanes(value: Lanes, context: Any) -> types.Type:
    return LANES


@typeof_impl.register(Rows)
def _typeof_rows(value: Rows, context: Any) -> types.Type:
    return RowsType(value.values.ndim - 1)


def _integer(c: Any, obj: Any, name: str) -> Any:
    attribute = c.pyapi.object_getattr_string(obj, name)
    value = c.pyapi.number_as_ssize_t(attribute)
    c.pyapi.decref(attribute)
    return value


@unbox(LanesType)
def _unbox_lanes(typ: Any, obj: Any, c: Any) -> NativeValue:
    pointer = c.builder.inttoptr(_integer(c, obj, "address"), _VECTOR.as_pointer())
    return NativeValue(c.builder.load(pointer, align=8), is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred()))


@unbox(RowsType)
def _unbox_rows(typ: Any, obj: Any, c: Any) -> NativeValue:
    struct = cgutils.create_struct_proxy(typ)(c.context, c.builder)
    struct.data = c.builder.inttoptr(_integer(c, obj, "address"), cgutils.voidptr_t)
    struct.rows, struct.columns = _integer(c, obj, "rows"), _integer(c, obj, "columns")
    return NativeValue(struct._getvalue(), is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred()))


# --- numbers and masks become lanes -----------------------------------------------------------------------------------


def _spread(builder: Any, value: Any, vector: Any) -> Any:
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)


def _vector(context: Any, builder: Any, typ: Any, value: Any) -> Any:
    """The operand as a vector of doubles."""
    if isinstance(typ, LanesType):
        return value
    return _spread(builder, context.cast(builder, value, typ, types.float64), _VECTOR)


def _mask(context: Any, builder: Any, typ: Any, value: Any) -> Any:
    return value if isinstance(typ, MaskType) else _spread(builder, value, _BITS)


@lower_cast(types.Float, LanesType)
@lower_cast(types.Integer, LanesType)
def _cast_number(context: Any, builder: Any, fromty: Any, toty: Any, value: Any) -> Any:
    return _vector(context, builder, fromty, value)


@lower_cast(types.Boolean, MaskType)
def _cast_truth(context: Any, builder: Any, fromty: Any, toty: Any, value: Any) -> Any:
    return _mask(context, builder, fromty, value)


# --- operators --------------------------------------------------------------------------------------------------------

_NUMBERS = (LanesType, types.Float, types.Integer)


def _binary(function: Callable[..., Any], result: types.Type, make: Callable[[Any, Any, Any], Any]) -> None:
    """Define an operator on two numbers of which at least one is lanes."""

    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            if len(args) == 2 and LANES in args and all(isinstance(a, _NUMBERS) for a in args):
                return signature(result, *args)
            return None

    infer_global(function)(Template)

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, b = (_vector(context, builder, t, v) for t, v in zip(sig.args, args, strict=True))
        return make(builder, a, b)

    for left in _NUMBERS:
        lower_builtin(function, left, LanesType)(lowered)
    for right in _NUMBERS[1:]:
        lower_builtin(function, LanesType, right)(lowered)


def _compare(sign: str) -> Callable[[Any, Any, Any], Any]:
    return lambda builder, a, b: builder.fcmp_ordered(sign, a, b)


def _choose(sign: str) -> Callable[[Any, Any, Any], Any]:
    """Numba's ``max`` and ``min`` of two floats: the second one where it is beyond the first."""
    return lambda builder, a, b: builder.select(builder.fcmp_ordered(sign, b, a), b, a)


for _function, _make in (
    (operator.add, lambda builder, a, b: builder.fadd(a, b)),
    (operator.sub, lambda builder, a, b: builder.fsub(a, b)),
    (operator.mul, lambda builder, a, b: builder.fmul(a, b)),
    (operator.truediv, lambda builder, a, b: builder.fdiv(a, b)),
    (max, _choose(">")),
    (min, _choose("<")),
):
    _binary(_function, LANES, _make)
for _function, _sign in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
):
    _binary(_function, MASK, _compare(_sign))
_binary(operator.ne, MASK, lambda builder, a, b: builder.fcmp_unordered("!=", a, b))

for _function, _plain in (
    (operator.iadd, lambda builder, a, b: builder.fadd(a, b)),
    (operator.isub, lambda builder, a, b: builder.fsub(a, b)),
    (operator.imul, lambda builder, a, b: builder.fmul(a, b)),
    (operator.itruediv, lambda builder, a, b: builder.fdiv(a, b)),
):
    _binary(_function, LANES, _plain)


def _logic(function: Callable[..., Any], make: Callable[[Any, Any, Any], Any]) -> None:
    """Define ``&`` or ``|`` of two truths of which at least one is a mask."""

    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            if len(args) == 2 and MASK in args and all(isinstance(a, (MaskType, types.Boolean)) for a in args):
                return signature(MASK, *args)
            return None

    infer_global(function)(Template)

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, b = (_mask(context, builder, t, v) for t, v in zip(sig.args, args, strict=True))
        return make(builder, a, b)

    for pair in ((MaskType, MaskType), (MaskType, types.Boolean), (types.Boolean, MaskType)):
        lower_builtin(function, *pair)(lowered)


_logic(operator.and_, lambda builder, a, b: builder.and_(a, b))
_logic(operator.or_, lambda builder, a, b: builder.or_(a, b))


def _unary(function: Callable[..., Any], make: Callable[[Any, Any], Any]) -> None:
    """Define a function of lanes."""

    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            return signature(LANES, LANES) if args == (LANES,) else None

    infer_global(function)(Template)

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return make(builder, args[0])

    lower_builtin(function, LanesType)(lowered)


def _intrinsic_of(name: str) -> Callable[[Any, Any], Any]:
    """A vector instruction of the processor, exact as the scalar one."""

    def make(builder: Any, value: Any) -> Any:
        function = ir.FunctionType(_VECTOR, [_VECTOR])
        return builder.call(cgutils.get_or_insert_function(builder.module, function, f"llvm.{name}.v{WIDTH}f64"), [value])

    return make


_unary(operator.neg, lambda builder, value: builder.fsub(ir.Constant(_VECTOR, [-0.0] * WIDTH), value))
_unary(math.sqrt, _intrinsic_of("sqrt"))
_unary(abs, _intrinsic_of("fabs"))


def _library(function: Callable[..., Any], count: int) -> None:
    """Define a function of the C library: called lane by lane, so that its bits are those of the scalar code."""

    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            if len(args) == count and LANES in args and all(isinstance(a, _NUMBERS) for a in args):
                return signature(LANES, *args)
            return None

    infer_global(function)(Template)

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        scalar = context.get_function(function, signature(types.float64, *[types.float64] * count))
        vectors = [_vector(context, builder, t, v) for t, v in zip(sig.args, args, strict=True)]
        result = ir.Constant(_VECTOR, ir.Undefined)
        for i in range(WIDTH):
            lane = ir.Constant(ir.IntType(32), i)
            value = scalar(builder, [builder.extract_element(v, lane) for v in vectors])
            result = builder.insert_element(result, value, lane)
        return result

    patterns = [(LanesType,)] if count == 1 else [(a, b) for a in _NUMBERS for b in _NUMBERS if LanesType in (a, b)]
    for pattern in patterns:
        lower_builtin(function, *pattern)(lowered)


for _function in (math.sin, math.cos, math.asin, math.atan, math.exp, math.tanh):
    _library(_function, 1)
for _function in (math.atan2, operator.pow):
    _library(_function, 2)


# --- what formulas need beside operators ------------------------------------------------------------------------------


def _python_only(*_: Any) -> Any:
    raise NotImplementedError("only in compiled code")


@intrinsic
def _select(typingctx: Any, mask: Any, a: Any, b: Any) -> Any:
    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        _, left, right = (_vector(context, builder, t, v) if i else v for i, (t, v) in enumerate(zip(sig.args, args, strict=True)))
        return builder.select(args[0], left, right)

    return signature(LANES, MASK, a, b), lowered


def select(condition: Any, a: Any, b: Any) -> Any:
    """``a`` where the condition holds, else ``b``; both are worked out."""
    return a if condition else b


@overload(select)
def _select_overload(condition, a, b):
    if condition == MASK:
        return lambda condition, a, b: _select(condition, a, b)
    if LANES in (a, b):
        return lambda condition, a, b: _select(_spread_truth(condition), a, b)
    return lambda condition, a, b: a if condition else b


@intrinsic
def _spread_truth(typingctx: Any, truth: Any) -> Any:
    return signature(MASK, truth), lambda context, builder, sig, args: _mask(context, builder, sig.args[0], args[0])


@intrinsic
def _flip(typingctx: Any, mask: Any) -> Any:
    return signature(MASK, MASK), lambda context, builder, sig, args: builder.not_(args[0])


def negate(condition: Any) -> Any:
    """Where the condition does not hold."""
    return not condition


@overload(negate)
def _negate_overload(condition):
    return (lambda condition: _flip(condition)) if condition == MASK else (lambda condition: not condition)


@intrinsic
def _any(typingctx: Any, mask: Any) -> Any:
    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        bits = builder.bitcast(args[0], ir.IntType(WIDTH))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(WIDTH), 0))

    return signature(types.boolean, MASK), lowered


def any_of(condition: Any) -> bool:
    """Whether the condition holds in any lane."""
    return bool(condition)


@overload(any_of)
def _any_overload(condition):
    return (lambda condition: _any(condition)) if condition == MASK else (lambda condition: condition)


_nearest = _intrinsic_of("rint")


@intrinsic
def _rint(typingctx: Any, value: Any) -> Any:
    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return builder.fadd(_nearest(builder, args[0]), ir.Constant(_VECTOR, [0.0] * WIDTH))  # no negative zero

    return signature(LANES, LANES), lowered


def nearest(value: Any) -> Any:
    """The nearest whole number."""
    return round(value)


@overload(nearest)
def _nearest_overload(value):
    return (lambda value: _rint(value)) if value == LANES else (lambda value: round(value))


# --- rows -------------------------------------------------------------------------------------------------------------


def _cell(context: Any, builder: Any, typ: Any, rows: Any, row: Any, column: Any) -> Any:
    """Pointer to the lanes in a row and column."""
    struct = cgutils.create_struct_proxy(typ)(context, builder, rows)
    number = row if typ.ndim == 1 else builder.add(builder.mul(row, struct.columns), column)
    return builder.gep(builder.bitcast(struct.data, _VECTOR.as_pointer()), [number])


def _indices(context: Any, builder: Any, sig: Any, args: Any) -> tuple[Any, Any]:
    if isinstance(sig.args[1], types.Integer):
        return context.cast(builder, args[1], sig.args[1], types.intp), None
    parts = cgutils.unpack_tuple(builder, args[1], 2)
    row, column = (context.cast(builder, v, t, types.intp) for v, t in zip(parts, sig.args[1], strict=True))
    return row, column


def _names_cell(typ: Any, index: Any) -> bool:
    if isinstance(index, types.Integer):
        return typ.ndim == 1
    return isinstance(index, types.BaseTuple) and typ.ndim == 2 and all(isinstance(i, types.Integer) for i in index)


@infer_global(operator.getitem)
class _GetRow(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        if not isinstance(args[0], RowsType):
            return None
        return signature(LANES if _names_cell(*args) else RowsType(1), *args)


@infer_global(operator.setitem)
class _SetRow(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        if isinstance(args[0], RowsType) and _names_cell(args[0], args[1]) and isinstance(args[2], _NUMBERS):
            return signature(types.none, *args)
        return None


@lower_builtin(operator.getitem, RowsType, types.Integer)
@lower_builtin(operator.getitem, RowsType, types.BaseTuple)
def _get_row(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    row, column = _indices(context, builder, sig, args)
    zero = ir.Constant(ir.IntType(64), 0)
    pointer = _cell(context, builder, sig.args[0], args[0], row, zero if column is None else column)
    if sig.return_type == LANES:
        return builder.load(pointer, align=8)
    whole = cgutils.create_struct_proxy(sig.args[0])(context, builder, args[0])
    struct = cgutils.create_struct_proxy(sig.return_type)(context, builder)
    struct.data = builder.bitcast(pointer, cgutils.voidptr_t)
    struct.rows, struct.columns = whole.columns, ir.Constant(ir.IntType(64), 1)
    return struct._getvalue()


def _set_row(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    row, column = _indices(context, builder, sig, args)
    pointer = _cell(context, builder, sig.args[0], args[0], row, column)
    builder.store(_vector(context, builder, sig.args[2], args[2]), pointer, align=8)
    return context.get_dummy_value()


for _index in (types.Integer, types.BaseTuple):
    for _number in _NUMBERS:
        lower_builtin(operator.setitem, RowsType, _index, _number)(_set_row)


@overload(len)
def _length(rows):
    return (lambda rows: _row_count(rows)) if isinstance(rows, RowsType) else None


@intrinsic
def _row_count(typingctx: Any, rows: Any) -> Any:
    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return cgutils.create_struct_proxy(sig.args[0])(context, builder, args[0]).rows

    return signature(types.intp, rows), lowered


def _addresses(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """Pointers to the numbers of each lane, each in a row of its own."""
    struct = cgutils.create_struct_proxy(sig.args[0])(context, builder, args[0])
    data = builder.bitcast(struct.data, _DOUBLE.as_pointer())
    column = context.cast(builder, args[2], sig.args[2], types.intp)
    for i in range(WIDTH):
        row = builder.fptosi(builder.extract_element(args[1], ir.Constant(ir.IntType(32), i)), ir.IntType(64))
        cell = builder.add(builder.mul(row, struct.columns), column)
        number = builder.add(builder.mul(cell, ir.Constant(ir.IntType(64), WIDTH)), ir.Constant(ir.IntType(64), i))
        yield ir.Constant(ir.IntType(32), i), builder.gep(data, [number])


@intrinsic
def pick(typingctx: Any, rows: Any, number: Any, column: Any) -> Any:
    """Of each lane the number in a row of its own."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        result = ir.Constant(_VECTOR, ir.Undefined)
        for lane, pointer in _addresses(context, builder, sig, args):
            result = builder.insert_element(result, builder.load(pointer), lane)
        return result

    return signature(LANES, rows, LANES, column), lowered


@intrinsic
def place(typingctx: Any, rows: Any, number: Any, column: Any, value: Any) -> Any:
    """Write each lane's number into a row of its own."""

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        vector = _vector(context, builder, sig.args[3], args[3])
        for lane, pointer in _addresses(context, builder, sig, args):
            builder.store(builder.extract_element(vector, lane), pointer)
        return context.get_dummy_value()

    return signature(types.none, rows, LANES, column, value), lowered


def past(ring: Any, step: int, back: Any, column: int) -> Any:
    """What a ring of one row per step held ``back`` steps ago, to the nearest one."""
    return ring[(step - round(back)) % len(ring), column]


@overload(past)
def _past_overload(ring, step, back, column):
    if back != LANES:
        return lambda ring, step, back, column: ring[(step - round(back)) % len(ring), column]

    def lanes_ago(ring, step, back, column):
        row = step % len(ring) - _rint(back)
        return pick(ring, select(row < 0.0, row + len(ring), row), column)

    return lanes_ago
