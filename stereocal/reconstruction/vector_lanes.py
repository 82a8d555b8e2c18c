"""More operations on vectors: neighbouring lanes, saturation, bits.

What semi-global matching asks of :mod:`stereocal.reconstruction.vector_primitives` beyond sums and the smallest of
them. A vector holds one number for each disparity, so a neighbouring lane is a neighbouring disparity:

    from_below(v, first)      lane i holds v[i − 1], lane 0 holds first[0]
    from_above(v, last)       lane i holds v[i + 1], the last lane holds last[0]
    last_lane(v)              the last of v
    less_smallest(v)          v − the smallest of v

and 8 bits are enough for the cost of a path if a sum that does not fit stays at 255 (saturation) in place of starting
again from 0, which is what :func:`add_saturated` does. Each operation is one instruction of the machine, or a few.

As there: nothing checks bounds, and the kernels' files must be touched after a change here.
"""

# mypy: ignore-errors

from __future__ import annotations

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from stereocal.reconstruction.vector_primitives import (
    Vector,
    _binary,
    _by_chunk,
    _call,
    _chunks,
    _extreme,
    _join,
    _reduce_min,
    _splat,
)

INDEX = ir.IntType(32)

minimum = intrinsic(_binary(lambda builder, a, b: _extreme(builder, "umin", a, b)))
add_saturated = intrinsic(_binary(lambda builder, a, b: _extreme(builder, "uadd.sat", a, b)))
subtract_saturated = intrinsic(_binary(lambda builder, a, b: _extreme(builder, "usub.sat", a, b)))
bits_in_both = intrinsic(_binary(lambda builder, a, b: builder.and_(a, b)))


def _differing_bits(builder, a, b):
    count, bits = a.type.count, a.type.element.width
    return _call(builder, f"llvm.ctpop.v{count}i{bits}", a.type, builder.xor(a, b))


def _high_half(builder, a, b):
    bits = a.type.element.width
    wide = ir.VectorType(ir.IntType(2 * bits), a.type.count)
    product = builder.mul(builder.zext(a, wide), builder.zext(b, wide))
    return builder.trunc(builder.lshr(product, ir.Constant(wide, [bits] * a.type.count)), a.type)


def _mean(builder, a, b, up):
    count, bits = a.type.count, a.type.element.width
    wide = ir.VectorType(ir.IntType(2 * bits), count)
    total = builder.add(builder.zext(a, wide), builder.zext(b, wide))
    total = builder.add(total, ir.Constant(wide, [up] * count))
    return builder.trunc(builder.lshr(total, ir.Constant(wide, [1] * count)), a.type)


mean_rounded_down = intrinsic(_binary(lambda builder, a, b: _mean(builder, a, b, 0)))
mean_rounded_up = intrinsic(_binary(lambda builder, a, b: _mean(builder, a, b, 1)))

count_differing_bits = intrinsic(_binary(_differing_bits))
"""How many bits differ between each number of one vector and its partner in the other: the Hamming distance."""

high_product = intrinsic(_binary(_high_half))
"""The upper half of each product: (a · b) >> 16 for numbers of 16 bits."""


def _pick(builder, first, second, lanes):
    """The given lanes of `first` followed by `second`, two chunks of one length."""
    return builder.shuffle_vector(first, second, ir.Constant(ir.VectorType(INDEX, len(lanes)), list(lanes)))


def _roll_in(builder, chunk, number, *, at_front):
    """`chunk` moved by one lane, with `number` in the lane that has become free."""
    count = chunk.type.count
    lanes = [0, *range(count - 1)] if at_front else [*range(1, count), 0]
    rolled = _pick(builder, chunk, chunk, lanes)
    return builder.insert_element(rolled, number, INDEX(0 if at_front else count - 1))


@intrinsic
def from_below(typingctx, vector, first):
    """Lane i holds vector[i − 1]; lane 0 holds first[0]."""

    def codegen(context, builder, signature, args):
        carried = builder.extract_element(_chunks(builder, args[1])[0], INDEX(0))
        moved = []
        for chunk in _chunks(builder, args[0]):
            moved.append(_roll_in(builder, chunk, carried, at_front=True))
            carried = builder.extract_element(chunk, INDEX(chunk.type.count - 1))
        return _join(builder, moved)

    return vector(vector, first), codegen


@intrinsic
def from_above(typingctx, vector, last):
    """Lane i holds vector[i + 1]; the last lane holds last[0]."""

    def codegen(context, builder, signature, args):
        carried = builder.extract_element(_chunks(builder, args[1])[0], INDEX(0))
        moved = []
        for chunk in reversed(_chunks(builder, args[0])):
            moved.append(_roll_in(builder, chunk, carried, at_front=False))
            carried = builder.extract_element(chunk, INDEX(0))
        return _join(builder, moved[::-1])

    return vector(vector, last), codegen


@intrinsic
def last_lane(typingctx, vector):
    """The number in the last lane."""

    def codegen(context, builder, signature, args):
        chunk = _chunks(builder, args[0])[-1]
        return builder.extract_element(chunk, INDEX(chunk.type.count - 1))

    return types.Integer.from_bitwidth(vector.bits, False)(vector), codegen


def _smallest_of_chunks(builder, chunks):
    """A chunk of 16 lanes that hold the smallest of the numbers 16 lanes apart."""
    wide = [chunk for chunk in chunks if chunk.type.count > 16]
    narrow = [chunk for chunk in chunks if chunk.type.count == 16]
    if wide:
        least = wide[0]
        for chunk in wide[1:]:
            least = _extreme(builder, "umin", least, chunk)
        narrow += [_pick(builder, least, least, range(16)), _pick(builder, least, least, range(16, 32))]
    least = narrow[0]
    for chunk in narrow[1:]:
        least = _extreme(builder, "umin", least, chunk)
    return least


@intrinsic
def less_smallest(typingctx, vector):
    """vector[i] − min vector, of 8 bits each.

    LLVM finds the smallest of 16 bytes by halving four times. x86 has an instruction for the smallest of eight words,
    and the lesser byte of each pair makes a word; so there, and there alone, it is asked for by name. A sixth of the
    time of semi-global matching lies in it.
    """

    def codegen(context, builder, signature, args):
        chunks = _chunks(builder, args[0])
        least = _smallest_of_chunks(builder, chunks)
        if "+sse4.1" in context.codegen()._get_host_cpu_features():
            words = ir.VectorType(ir.IntType(16), 8)
            upper = builder.lshr(builder.bitcast(least, words), ir.Constant(words, [8] * 8))
            pairs = _extreme(builder, "umin", least, builder.bitcast(upper, least.type))
            pairs = _call(builder, "llvm.x86.sse41.phminposuw", words, builder.bitcast(pairs, words))
            least = builder.bitcast(pairs, least.type)
        else:
            least = _splat(builder, _reduce_min(builder, least), 16)
        return _join(builder, [builder.sub(c, _pick(builder, least, least, [0] * c.type.count)) for c in chunks])

    return vector(vector), codegen


@intrinsic
def narrow(typingctx, vector, like):
    """The low bits of each number, as many as `like` has."""

    def codegen(context, builder, signature, args):
        def trunc(chunk):
            return builder.trunc(chunk, ir.VectorType(ir.IntType(like.bits), chunk.type.count))

        return _by_chunk(builder, trunc, args[0]) if vector.bits > like.bits else args[0]

    return Vector(like.bits, vector.lanes)(vector, like), codegen
