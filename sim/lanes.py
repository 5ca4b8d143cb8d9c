"""Eight numbers that compiled code treats as one: a lane of a vector register for each of eight flights.

The formulas of the simulator are written once. Given numbers they compile to scalar code; given :class:`Lanes` and
:class:`sim.rows.Rows` the same functions compile to vector code. Both do the same IEEE operations in the same order,
so a lane's result is the scalar one to the last bit. Sines and the like call the same library function lane by lane. A
branch on a number becomes :func:`select`, of which both sides are worked out.

Numba's extension interface is used as its manual says ("Extending Numba", low level): a type, its LLVM
representation (a vector of doubles), the operators on it, and how a Python object is taken apart.
"""

# pyright: reportOptionalCall=false, reportCallIssue=false
# Numba's decorators of extensions have no types.

from __future__ import annotations

import math
import operator
from collections.abc import Callable

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
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numpy.typing import NDArray

WIDTH = 8
"""Doubles of the widest vector registers; narrower machines take two or four registers for it."""

DOUBLE = ir.DoubleType()
VECTOR = ir.VectorType(DOUBLE, WIDTH)
Make = Callable[..., object]
"""Emits what an operator does, given numba's builder and the operands."""
_BITS = ir.VectorType(ir.IntType(1), WIDTH)


class Lanes:
    """One number of each flight, shape (8,)."""

    def __init__(self, values: NDArray[np.float64]):
        self.values = np.ascontiguousarray(values, dtype=np.float64)
        self.address = int(self.values.ctypes.data)


class LanesType(types.Type):
    """Numba's type of :class:`Lanes`."""

    def __init__(self) -> None:
        super().__init__("Lanes")

    def can_convert_from(self, typingctx, other: types.Type) -> Conversion | None:
        """A number stands for eight equal ones."""
        return Conversion.safe if isinstance(other, (types.Float, types.Integer)) else None


class MaskType(types.Type):
    """Eight truth values."""

    def __init__(self) -> None:
        super().__init__("LanesMask")

    def can_convert_from(self, typingctx, other: types.Type) -> Conversion | None:
        """One truth value stands for eight equal ones."""
        return Conversion.safe if isinstance(other, types.Boolean) else None


LANES, MASK = LanesType(), MaskType()


@register_model(LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, VECTOR)


@register_model(MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _BITS)


@typeof_impl.register(Lanes)
def _typeof_lanes(value: Lanes, context) -> types.Type:
    return LANES


def integer_attribute(c, obj, name: str):
    attribute = c.pyapi.object_getattr_string(obj, name)
    value = c.pyapi.number_as_ssize_t(attribute)
    c.pyapi.decref(attribute)
    return value


@unbox(LanesType)
def _unbox_lanes(typ, obj, c) -> NativeValue:
    pointer = c.builder.inttoptr(integer_attribute(c, obj, "address"), VECTOR.as_pointer())
    return NativeValue(
        c.builder.load(pointer, align=8), is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred())
    )


# --- numbers and masks become lanes -----------------------------------------------------------------------------------


def _spread(builder, value, vector):
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), zeros)


def as_vector(context, builder, typ, value):
    """The operand as a vector of doubles."""
    if isinstance(typ, LanesType):
        return value
    return _spread(builder, context.cast(builder, value, typ, types.float64), VECTOR)


def _mask(context, builder, typ, value):
    return value if isinstance(typ, MaskType) else _spread(builder, value, _BITS)


@lower_cast(types.Float, LanesType)
@lower_cast(types.Integer, LanesType)
def _cast_number(context, builder, fromty, toty, value):
    return as_vector(context, builder, fromty, value)


@lower_cast(types.Boolean, MaskType)
def _cast_truth(context, builder, fromty, toty, value):
    return _mask(context, builder, fromty, value)


# --- operators --------------------------------------------------------------------------------------------------------

NUMBERS = (LanesType, types.Float, types.Integer)


def _binary(function: Callable[..., object], result: types.Type, make: Make) -> None:
    """Define an operator on two numbers of which at least one is lanes."""

    class Template(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 2 and LANES in args and all(isinstance(a, NUMBERS) for a in args):
                return signature(result, *args)
            return None

    infer_global(function)(Template)

    def lowered(context, builder, sig, args):
        a, b = (as_vector(context, builder, t, v) for t, v in zip(sig.args, args, strict=True))
        return make(builder, a, b)

    for left in NUMBERS:
        lower_builtin(function, left, LanesType)(lowered)
    for right in NUMBERS[1:]:
        lower_builtin(function, LanesType, right)(lowered)


def _compare(sign: str) -> Make:
    return lambda builder, a, b: builder.fcmp_ordered(sign, a, b)


def _choose(sign: str) -> Make:
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


def _logic(function: Callable[..., object], make: Make) -> None:
    """Define ``&`` or ``|`` of two truths of which at least one is a mask."""

    class Template(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == 2 and MASK in args and all(isinstance(a, (MaskType, types.Boolean)) for a in args):
                return signature(MASK, *args)
            return None

    infer_global(function)(Template)

    def lowered(context, builder, sig, args):
        a, b = (_mask(context, builder, t, v) for t, v in zip(sig.args, args, strict=True))
        return make(builder, a, b)

    for pair in ((MaskType, MaskType), (MaskType, types.Boolean), (types.Boolean, MaskType)):
        lower_builtin(function, *pair)(lowered)


_logic(operator.and_, lambda builder, a, b: builder.and_(a, b))
_logic(operator.or_, lambda builder, a, b: builder.or_(a, b))


def _unary(function: Callable[..., object], make: Make) -> None:
    """Define a function of lanes."""

    class Template(AbstractTemplate):
        def generic(self, args, kws):
            return signature(LANES, LANES) if args == (LANES,) else None

    infer_global(function)(Template)

    def lowered(context, builder, sig, args):
        return make(builder, args[0])

    lower_builtin(function, LanesType)(lowered)


def _intrinsic_of(name: str) -> Make:
    """A vector instruction of the processor, exact as the scalar one."""

    def make(builder, value):
        function = ir.FunctionType(VECTOR, [VECTOR])
        return builder.call(
            cgutils.get_or_insert_function(builder.module, function, f"llvm.{name}.v{WIDTH}f64"), [value]
        )

    return make


_unary(operator.neg, lambda builder, value: builder.fsub(ir.Constant(VECTOR, [-0.0] * WIDTH), value))
_unary(math.sqrt, _intrinsic_of("sqrt"))
_unary(abs, _intrinsic_of("fabs"))


def _library(function: Callable[..., object], count: int) -> None:
    """Define a function of the C library: called lane by lane, so that its bits are those of the scalar code."""

    class Template(AbstractTemplate):
        def generic(self, args, kws):
            if len(args) == count and LANES in args and all(isinstance(a, NUMBERS) for a in args):
                return signature(LANES, *args)
            return None

    infer_global(function)(Template)

    def lowered(context, builder, sig, args):
        scalar = context.get_function(function, signature(types.float64, *[types.float64] * count))
        vectors = [as_vector(context, builder, t, v) for t, v in zip(sig.args, args, strict=True)]
        result = ir.Constant(VECTOR, ir.Undefined)
        for i in range(WIDTH):
            lane = ir.Constant(ir.IntType(32), i)
            value = scalar(builder, [builder.extract_element(v, lane) for v in vectors])
            result = builder.insert_element(result, value, lane)
        return result

    patterns = [(LanesType,)] if count == 1 else [(a, b) for a in NUMBERS for b in NUMBERS if LanesType in (a, b)]
    for pattern in patterns:
        lower_builtin(function, *pattern)(lowered)


for _function in (math.sin, math.cos, math.asin, math.atan, math.exp, math.tanh):
    _library(_function, 1)
for _function in (math.atan2, operator.pow):
    _library(_function, 2)


# --- what formulas need beside operators ------------------------------------------------------------------------------


@intrinsic
def _select(typingctx, mask, a, b):
    def lowered(context, builder, sig, args):
        _, left, right = (
            as_vector(context, builder, t, v) if i else v for i, (t, v) in enumerate(zip(sig.args, args, strict=True))
        )
        return builder.select(args[0], left, right)

    return signature(LANES, MASK, a, b), lowered


def select(condition, a, b):
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
def _spread_truth(typingctx, truth):
    return signature(MASK, truth), lambda context, builder, sig, args: _mask(context, builder, sig.args[0], args[0])


@intrinsic
def _flip(typingctx, mask):
    return signature(MASK, MASK), lambda context, builder, sig, args: builder.not_(args[0])


def negate(condition):
    """Where the condition does not hold."""
    return not condition


@overload(negate)
def _negate_overload(condition):
    return (lambda condition: _flip(condition)) if condition == MASK else (lambda condition: not condition)


@intrinsic
def _any(typingctx, mask):
    def lowered(context, builder, sig, args):
        bits = builder.bitcast(args[0], ir.IntType(WIDTH))
        return builder.icmp_unsigned("!=", bits, ir.Constant(ir.IntType(WIDTH), 0))

    return signature(types.boolean, MASK), lowered


def any_of(condition) -> bool:
    """Whether the condition holds in any lane."""
    return bool(condition)


@overload(any_of)
def _any_overload(condition):
    return (lambda condition: _any(condition)) if condition == MASK else (lambda condition: condition)


_nearest = _intrinsic_of("rint")


@intrinsic
def _rint(typingctx, value):
    def lowered(context, builder, sig, args):
        return builder.fadd(_nearest(builder, args[0]), ir.Constant(VECTOR, [0.0] * WIDTH))  # no negative zero

    return signature(LANES, LANES), lowered


def nearest(value):
    """The nearest whole number."""
    return round(value)


@overload(nearest)
def _nearest_overload(value):
    return (lambda value: _rint(value)) if value == LANES else (lambda value: round(value))
