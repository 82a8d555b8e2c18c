"""Eight numbers of 64 bits as one value in Numba kernels: the arithmetic of a row of pixels without a loop over them.

A kernel that does the same sums for every pixel of a row is at its best when the machine does eight pixels with one
instruction. A plain loop leaves that to the compiler, and what one pass hands to the next then goes through memory.
Here eight neighbouring pixels are a value of the type :class:`Doubles`, which stays in registers. ``+``, ``-``, ``*``
and ``/`` work lane by lane, and a plain number stands for eight equal lanes:

    x = x0 + lanes(step)                    # x0, x0 + step, …, x0 + 7 step
    y = multiply_add(slope, x, offset)      # slope · x + offset, rounded once
    store(y, out, at, 8)                    # out[at : at + 8] = y, rounded to float32

It is still Python, and names no machine: each function emits the instruction of LLVM (the compiler behind Numba) for a
vector of eight, which LLVM lowers to what the machine has, one register of AVX-512, two of AVX2, four of NEON.

Nothing checks bounds. Kernels that use these functions are cached by Numba under the date of their own file, so that
after a change HERE their file must be touched. (Whole numbers have a module of their own, in the room
``reconstruction``, where the length of a vector is a choice of the kernel.)
"""

# mypy: ignore-errors

from __future__ import annotations

import operator

from llvmlite import ir
from numba.core import types
from numba.core.datamodel import models
from numba.core.extending import register_model
from numba.extending import intrinsic, overload

LANES = 8
_INDEX = ir.IntType(32)
_KIND = ir.VectorType(ir.DoubleType(), LANES)
_SINGLES = ir.VectorType(ir.FloatType(), LANES)


class Doubles(types.Type):
    """Eight numbers of 64 bits."""

    def __init__(self):
        super().__init__(name="Doubles")


@register_model(Doubles)
class _DoublesModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _KIND)


_DOUBLES = Doubles()


def _splat(builder, value):
    """Eight lanes of one number; a vector stays as it is."""
    if value.type == _KIND:
        return value
    one = builder.insert_element(ir.Constant(_KIND, ir.Undefined), value, _INDEX(0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES))


@intrinsic
def fill(typingctx, value):
    """Eight lanes of one number."""

    def codegen(context, builder, signature, args):
        return _splat(builder, args[0])

    return _DOUBLES(types.float64), codegen


@intrinsic
def lanes(typingctx, step):
    """0, step, 2 step, …, 7 step."""

    def codegen(context, builder, signature, args):
        return builder.fmul(_splat(builder, args[0]), ir.Constant(_KIND, [float(q) for q in range(LANES)]))

    return _DOUBLES(types.float64), codegen


@intrinsic
def multiply_add(typingctx, a, b, c):
    """a * b + c, rounded once."""

    def codegen(context, builder, signature, args):
        function = builder.module.declare_intrinsic(f"llvm.fma.v{LANES}f64", fnty=ir.FunctionType(_KIND, [_KIND] * 3))
        return builder.call(function, [_splat(builder, value) for value in args])

    return _DOUBLES(a, b, c), codegen


def _lane_by_lane(emit):
    """An intrinsic of two arguments, vectors or plain numbers; `emit(builder, a, b)` works on vectors."""

    def function(typingctx, a, b):
        def codegen(context, builder, signature, args):
            return emit(builder, *(_splat(builder, value) for value in args))

        return _DOUBLES(a, b), codegen

    return intrinsic(function)


_add = _lane_by_lane(lambda builder, a, b: builder.fadd(a, b))
_subtract = _lane_by_lane(lambda builder, a, b: builder.fsub(a, b))
_multiply = _lane_by_lane(lambda builder, a, b: builder.fmul(a, b))
_divide = _lane_by_lane(lambda builder, a, b: builder.fdiv(a, b))


@overload(operator.add)
def _overload_add(a, b):
    return (lambda a, b: _add(a, b)) if isinstance(a, Doubles) or isinstance(b, Doubles) else None


@overload(operator.sub)
def _overload_subtract(a, b):
    return (lambda a, b: _subtract(a, b)) if isinstance(a, Doubles) or isinstance(b, Doubles) else None


@overload(operator.mul)
def _overload_multiply(a, b):
    return (lambda a, b: _multiply(a, b)) if isinstance(a, Doubles) or isinstance(b, Doubles) else None


@overload(operator.truediv)
def _overload_divide(a, b):
    return (lambda a, b: _divide(a, b)) if isinstance(a, Doubles) or isinstance(b, Doubles) else None


@intrinsic
def store(typingctx, vector, out, at, count):
    """out[at : at + count] = the first `count` lanes, rounded to float32; `out` is contiguous, one-dimensional."""

    def codegen(context, builder, signature, args):
        singles = builder.fptrunc(args[0], _SINGLES)
        data = context.make_array(signature.args[1])(context, builder, args[1]).data
        pointer = builder.bitcast(builder.gep(data, [args[2]]), _SINGLES.as_pointer())
        whole = builder.icmp_signed(">=", args[3], ir.IntType(64)(LANES))
        with builder.if_else(whole, likely=True) as (all_lanes, some):
            with all_lanes:
                builder.store(singles, pointer).align = 4
            with some:
                _store_some(builder, singles, pointer, args[3])
        return context.get_dummy_value()

    return types.void(vector, out, types.intp, types.intp), codegen


def _store_some(builder, singles, pointer, count):
    """Store the lanes below `count`, and touch no memory of the others."""
    numbers = ir.VectorType(ir.IntType(64), LANES)
    one = builder.insert_element(ir.Constant(numbers, ir.Undefined), count, _INDEX(0))
    counts = builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES))
    wanted = builder.icmp_signed("<", ir.Constant(numbers, list(range(LANES))), counts)
    kinds = [_SINGLES, pointer.type, _INDEX, wanted.type]
    function = builder.module.declare_intrinsic(
        f"llvm.masked.store.v{LANES}f32.p0", fnty=ir.FunctionType(ir.VoidType(), kinds)
    )
    builder.call(function, [singles, pointer, _INDEX(4), wanted])
