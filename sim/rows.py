"""Arrays of lanes for compiled code: a row holds a number of each of eight flights; see :mod:`sim.lanes`.

Indexing gives lanes, or a row of a table without a copy. Where each flight has come to another row, :func:`pick` and
:func:`place` read and write a number per lane.
"""

# pyright: reportOptionalCall=false, reportCallIssue=false, reportGeneralTypeIssues=false
# Numba's decorators of extensions have no types.

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.extending import (
    NativeValue,
    intrinsic,
    lower_builtin,
    models,
    overload,
    register_model,
    typeof_impl,
    unbox,
)
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numpy.typing import NDArray

from sim.lanes import DOUBLE, LANES, NUMBERS, VECTOR, WIDTH, as_vector, integer_attribute, nearest, select


class Rows:
    """An array of numbers of each flight, shape (k, 8) or (k, c, 8); compiled code reads and writes it in place."""

    def __init__(self, values: NDArray[np.float64]):
        if not (values.flags.c_contiguous and values.dtype == np.float64 and values.shape[-1] == WIDTH):
            raise ValueError(f"rows of lanes are contiguous doubles of shape (..., {WIDTH}), not {values.shape}")
        self.values = values
        self.address = int(values.ctypes.data)
        self.rows = values.shape[0]
        self.columns = values.shape[1] if values.ndim == 3 else 1

    def __len__(self) -> int:
        return self.rows

    def __getitem__(self, index: int | tuple[int, int]) -> NDArray[np.float64]:
        return self.values[index]

    def __setitem__(self, index: int | tuple[int, int], value: NDArray[np.float64]) -> None:
        self.values[index] = value


class RowsType(types.Type):
    """Numba's type of :class:`Rows`."""

    def __init__(self, ndim: int):
        self.ndim = ndim
        super().__init__(f"Rows({ndim})")


@register_model(RowsType)
class _RowsModel(models.StructModel):
    def __init__(self, dmm, fe_type):
        members = [("data", types.voidptr), ("rows", types.intp), ("columns", types.intp)]
        super().__init__(dmm, fe_type, members)


@typeof_impl.register(Rows)
def _typeof_rows(value: Rows, context) -> types.Type:
    return RowsType(value.values.ndim - 1)


@unbox(RowsType)
def _unbox_rows(typ, obj, c) -> NativeValue:
    struct = cgutils.create_struct_proxy(typ)(c.context, c.builder)
    struct.data = c.builder.inttoptr(integer_attribute(c, obj, "address"), cgutils.voidptr_t)
    struct.rows, struct.columns = integer_attribute(c, obj, "rows"), integer_attribute(c, obj, "columns")
    return NativeValue(struct._getvalue(), is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred()))


def _cell(context, builder, typ, rows, row, column):
    """Pointer to the lanes in a row and column."""
    struct = cgutils.create_struct_proxy(typ)(context, builder, rows)
    number = row if typ.ndim == 1 else builder.add(builder.mul(row, struct.columns), column)
    return builder.gep(builder.bitcast(struct.data, VECTOR.as_pointer()), [number])


def _indices(context, builder, sig, args):
    if isinstance(sig.args[1], types.Integer):
        return context.cast(builder, args[1], sig.args[1], types.intp), None
    parts = cgutils.unpack_tuple(builder, args[1], 2)
    row, column = (context.cast(builder, v, t, types.intp) for v, t in zip(parts, sig.args[1], strict=True))
    return row, column


def _names_cell(typ, index) -> bool:
    if isinstance(index, types.Integer):
        return typ.ndim == 1
    return isinstance(index, types.BaseTuple) and typ.ndim == 2 and all(isinstance(i, types.Integer) for i in index)


@infer_global(operator.getitem)
class _GetRow(AbstractTemplate):
    def generic(self, args, kws):
        if not isinstance(args[0], RowsType):
            return None
        return signature(LANES if _names_cell(*args) else RowsType(1), *args)


@infer_global(operator.setitem)
class _SetRow(AbstractTemplate):
    def generic(self, args, kws):
        if isinstance(args[0], RowsType) and _names_cell(args[0], args[1]) and isinstance(args[2], NUMBERS):
            return signature(types.none, *args)
        return None


@lower_builtin(operator.getitem, RowsType, types.Integer)
@lower_builtin(operator.getitem, RowsType, types.BaseTuple)
def _get_row(context, builder, sig, args):
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


def _set_row(context, builder, sig, args):
    row, column = _indices(context, builder, sig, args)
    pointer = _cell(context, builder, sig.args[0], args[0], row, column)
    builder.store(as_vector(context, builder, sig.args[2], args[2]), pointer, align=8)
    return context.get_dummy_value()


for _index in (types.Integer, types.BaseTuple):
    for _number in NUMBERS:
        lower_builtin(operator.setitem, RowsType, _index, _number)(_set_row)


@overload(len)
def _length(rows):
    return (lambda rows: _row_count(rows)) if isinstance(rows, RowsType) else None


@intrinsic
def _row_count(typingctx, rows):
    def lowered(context, builder, sig, args):
        return cgutils.create_struct_proxy(sig.args[0])(context, builder, args[0]).rows

    return signature(types.intp, rows), lowered


def _addresses(context, builder, sig, args):
    """Pointers to the numbers of each lane, each in a row of its own."""
    struct = cgutils.create_struct_proxy(sig.args[0])(context, builder, args[0])
    data = builder.bitcast(struct.data, DOUBLE.as_pointer())
    column = context.cast(builder, args[2], sig.args[2], types.intp)
    for i in range(WIDTH):
        row = builder.fptosi(builder.extract_element(args[1], ir.Constant(ir.IntType(32), i)), ir.IntType(64))
        cell = builder.add(builder.mul(row, struct.columns), column)
        number = builder.add(builder.mul(cell, ir.Constant(ir.IntType(64), WIDTH)), ir.Constant(ir.IntType(64), i))
        yield ir.Constant(ir.IntType(32), i), builder.gep(data, [number])


@intrinsic
def pick(typingctx, rows, number, column):
    """Of each lane the number in a row of its own."""

    def lowered(context, builder, sig, args):
        result = ir.Constant(VECTOR, ir.Undefined)
        for lane, pointer in _addresses(context, builder, sig, args):
            result = builder.insert_element(result, builder.load(pointer), lane)
        return result

    return signature(LANES, rows, LANES, column), lowered


@intrinsic
def place(typingctx, rows, number, column, value):
    """Write each lane's number into a row of its own."""

    def lowered(context, builder, sig, args):
        vector = as_vector(context, builder, sig.args[3], args[3])
        for lane, pointer in _addresses(context, builder, sig, args):
            builder.store(builder.extract_element(vector, lane), pointer)
        return context.get_dummy_value()

    return signature(types.none, rows, LANES, column, value), lowered


def past(ring, step: int, back, column: int):
    """What a ring of one row per step held ``back`` steps ago, to the nearest one."""
    return ring[(step - round(back)) % len(ring), column]


@overload(past)
def _past_overload(ring, step, back, column):
    if back != LANES:
        return lambda ring, step, back, column: ring[(step - round(back)) % len(ring), column]

    def lanes_ago(ring, step, back, column):
        row = step % len(ring) - nearest(back)
        return pick(ring, select(row < 0.0, row + len(ring), row), column)

    return lanes_ago
