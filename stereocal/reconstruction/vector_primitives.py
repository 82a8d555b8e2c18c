"""Explicit vectors in Numba: a row of D sums as ONE value that the machine adds in a few instructions.

A block matcher does the same few operations on D numbers side by side, one for each disparity: D differences, D sums,
the smallest of D. Written as a loop over k, the compiler must prove for itself that the loop may be turned into vector
instructions, and between two such loops the numbers go through memory. Here the D numbers are a value of the type
:class:`Vector`, on which ``+`` and ``-`` work and which stays in registers from one pixel to the next:

    window = window + entering - leaving        # D additions and D subtractions
    least = smallest(window)                    # the smallest of the D numbers

That is about three times as fast as the loops. It is still Python, and no machine is named: each primitive below emits
the instruction of LLVM (the compiler behind Numba) for vectors of any length, and LLVM lowers it to what the machine
has: AVX-512, AVX2, SSE, NEON.

How it is made. ``@intrinsic`` functions are given the types of their arguments and return a function that emits code.
A vector of D lanes is held as a tuple of chunks of 32 lanes, and one of 16 if D/16 is odd, because LLVM is at its best
on powers of two; :func:`_by_chunk` runs an operation over them. D must be known when the kernel is compiled, so it is
passed as the LENGTH of a tuple, which Numba makes part of the type: :func:`lanes_of`.

Nothing checks bounds. Kernels that use these functions are cached by Numba under the date of their own file, so that
after a change HERE their file must be touched.
"""

# mypy: ignore-errors

from __future__ import annotations

import operator

from llvmlite import ir
from numba.core import types
from numba.core.datamodel import models
from numba.core.extending import register_model
from numba.extending import intrinsic, overload

CHUNK = 32
"""Lanes in a chunk: 32 numbers of 16 bits fill a register of AVX-512."""


class Vector(types.Type):
    """`lanes` unsigned integers of `bits` bits each."""

    def __init__(self, bits, lanes):
        self.bits = bits
        self.lanes = lanes
        super().__init__(name=f"Vector(uint{bits} x {lanes})")

    @property
    def chunks(self):
        """The lanes of each chunk."""
        return [CHUNK] * (self.lanes // CHUNK) + [16] * (self.lanes % CHUNK // 16)

    def widened(self, bits):
        return Vector(bits, self.lanes)


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        chunks = [ir.VectorType(ir.IntType(fe_type.bits), lanes) for lanes in fe_type.chunks]
        super().__init__(dmm, fe_type, ir.LiteralStructType(chunks))


def lanes_of(count):
    """Return `count` (a multiple of 16) as an argument for kernels: a tuple whose length tells it at compile time."""
    return (0,) * (count // 16)


def _chunks(builder, vector):
    return [builder.extract_value(vector, i) for i in range(len(vector.type.elements))]


def _join(builder, chunks):
    vector = ir.Constant(ir.LiteralStructType([chunk.type for chunk in chunks]), ir.Undefined)
    for i, chunk in enumerate(chunks):
        vector = builder.insert_value(vector, chunk, i)
    return vector


def _by_chunk(builder, operation, *vectors):
    """Apply `operation` to the first chunk of each vector, the second of each, and so on."""
    return _join(builder, [operation(*parts) for parts in zip(*(_chunks(builder, v) for v in vectors), strict=True)])


def _call(builder, name, result, *arguments):
    """Call the LLVM intrinsic function `name`."""
    kind = ir.FunctionType(result, [argument.type for argument in arguments])
    return builder.call(builder.module.declare_intrinsic(name, fnty=kind), arguments)


def _splat(builder, value, lanes):
    """A chunk with `value` in each lane."""
    kind = ir.VectorType(value.type, lanes)
    one = builder.insert_element(ir.Constant(kind, ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes))


def _resize(builder, value, bits):
    have = value.type.width
    if have == bits:
        return value
    return builder.trunc(value, ir.IntType(bits)) if have > bits else builder.zext(value, ir.IntType(bits))


def _address(context, builder, array_type, array, index):
    data = context.make_array(array_type)(context, builder, array).data
    return builder.gep(data, [index])


@intrinsic
def load(typingctx, array, index, lanes):
    """Vector of array[index], array[index + 1], …, of a one-dimensional contiguous array."""
    kind = Vector(array.dtype.bitwidth, 16 * len(lanes))

    def codegen(context, builder, signature, args):
        address = _address(context, builder, signature.args[0], args[0], args[1])
        chunks = []
        for i, count in enumerate(kind.chunks):
            part = builder.gep(address, [ir.Constant(ir.IntType(64), i * CHUNK)])
            pointer = builder.bitcast(part, ir.VectorType(ir.IntType(kind.bits), count).as_pointer())
            chunks.append(builder.load(pointer, align=1))
        return _join(builder, chunks)

    return kind(array, types.intp, lanes), codegen


@intrinsic
def store(typingctx, vector, array, index):
    """array[index], array[index + 1], … = vector."""

    def codegen(context, builder, signature, args):
        address = _address(context, builder, signature.args[1], args[1], args[2])
        for i, chunk in enumerate(_chunks(builder, args[0])):
            part = builder.gep(address, [ir.Constant(ir.IntType(64), i * CHUNK)])
            builder.store(chunk, builder.bitcast(part, chunk.type.as_pointer()), align=1)
        return context.get_dummy_value()

    return types.void(vector, array, types.intp), codegen


@intrinsic
def element(typingctx, array, index):
    """array[index], where a negative index does not count from the end; that question is not even asked."""

    def codegen(context, builder, signature, args):
        return builder.load(_address(context, builder, signature.args[0], args[0], args[1]))

    return array.dtype(array, types.intp), codegen


@intrinsic
def copy_four(typingctx, source, index, target, to):
    """target[to], …, target[to + 3] = source[index], …, source[index + 3], in one step."""
    bits = source.dtype.bitwidth

    def codegen(context, builder, signature, args):
        kind = ir.VectorType(ir.IntType(bits), 4).as_pointer()
        there = _address(context, builder, signature.args[0], args[0], args[1])
        here = _address(context, builder, signature.args[2], args[2], args[3])
        builder.store(builder.load(builder.bitcast(there, kind), align=1), builder.bitcast(here, kind), align=1)
        return context.get_dummy_value()

    return types.void(source, types.intp, target, types.intp), codegen


@intrinsic
def fill(typingctx, value, like):
    """Vector of the kind of `like` with `value` in every lane."""

    def codegen(context, builder, signature, args):
        number = _resize(builder, args[0], like.bits)
        return _join(builder, [_splat(builder, number, count) for count in like.chunks])

    return like(value, like), codegen


@intrinsic
def fill_from(typingctx, array, index, like):
    """Vector of the kind of `like` with array[index] in every lane."""

    def codegen(context, builder, signature, args):
        number = builder.load(_address(context, builder, signature.args[0], args[0], args[1]))
        number = _resize(builder, number, like.bits)
        return _join(builder, [_splat(builder, number, count) for count in like.chunks])

    return like(array, types.intp, like), codegen


@intrinsic
def widen(typingctx, vector, like):
    """The same numbers with as many bits as `like` has."""

    def codegen(context, builder, signature, args):
        def zext(chunk):
            return builder.zext(chunk, ir.VectorType(ir.IntType(like.bits), chunk.type.count))

        return _by_chunk(builder, zext, args[0]) if vector.bits < like.bits else args[0]

    return vector.widened(like.bits)(vector, like), codegen


@intrinsic
def widen_signed(typingctx, vector, like):
    """The same numbers, taken as signed, with as many bits as `like` has."""

    def codegen(context, builder, signature, args):
        def sext(chunk):
            return builder.sext(chunk, ir.VectorType(ir.IntType(like.bits), chunk.type.count))

        return _by_chunk(builder, sext, args[0]) if vector.bits < like.bits else args[0]

    return vector.widened(like.bits)(vector, like), codegen


def _binary(emit):
    """An intrinsic of two vectors of one kind; `emit(builder, a, b)` works on a chunk."""

    def function(typingctx, a, b):
        def codegen(context, builder, signature, args):
            return _by_chunk(builder, lambda p, q: emit(builder, p, q), *args)

        return (a(a, b), codegen) if a == b else None

    return function


def _extreme(builder, name, a, b):
    return _call(builder, f"llvm.{name}.v{a.type.count}i{a.type.element.width}", a.type, a, b)


_add = intrinsic(_binary(lambda builder, a, b: builder.add(a, b)))
_subtract = intrinsic(_binary(lambda builder, a, b: builder.sub(a, b)))
_or = intrinsic(_binary(lambda builder, a, b: builder.or_(a, b)))
absolute_difference = intrinsic(
    _binary(lambda builder, a, b: builder.sub(_extreme(builder, "umax", a, b), _extreme(builder, "umin", a, b)))
)
maximum = intrinsic(_binary(lambda builder, a, b: _extreme(builder, "umax", a, b)))


def _signed_size(builder, a, b):
    kind = a.type
    name = f"llvm.abs.v{kind.count}i{kind.element.width}"
    return _call(builder, name, kind, builder.sub(a, b), ir.Constant(ir.IntType(1), 0))


absolute_difference_of_halves = intrinsic(_binary(_signed_size))
"""The same of numbers in the lower half of their range: their difference fits with its sign, one step less."""


@overload(operator.add)
def _overload_add(a, b):
    if isinstance(a, Vector):
        return lambda a, b: _add(a, b)
    return None


@overload(operator.sub)
def _overload_subtract(a, b):
    if isinstance(a, Vector):
        return lambda a, b: _subtract(a, b)
    return None


@overload(operator.or_)
def _overload_or(a, b):
    if isinstance(a, Vector):
        return lambda a, b: _or(a, b)
    return None


@intrinsic
def smallest(typingctx, vector):
    """The smallest number of a vector."""

    def codegen(context, builder, signature, args):
        chunks = _chunks(builder, args[0])
        wide = [chunk for chunk in chunks if chunk.type.count == CHUNK]
        least = None
        if wide:
            best = wide[0]
            for chunk in wide[1:]:
                best = _extreme(builder, "umin", best, chunk)
            least = _reduce_min(builder, best)
        if len(wide) < len(chunks):
            last = _reduce_min(builder, chunks[-1])
            least = last if least is None else builder.select(builder.icmp_unsigned("<", last, least), last, least)
        return _resize(builder, least, 64)

    return types.int64(vector), codegen


def _reduce_min(builder, chunk):
    element = chunk.type.element
    return _call(builder, f"llvm.vector.reduce.umin.v{chunk.type.count}i{element.width}", element, chunk)


def _words(builder, comparison, vector, value):
    """The comparison of each lane with `value` as bits, lane 0 lowest: 64 lanes a word."""
    bits = []
    for chunk in _chunks(builder, vector):
        number = _resize(builder, value, chunk.type.element.width)
        truth = builder.icmp_unsigned(comparison, chunk, _splat(builder, number, chunk.type.count))
        bits.append(builder.zext(builder.bitcast(truth, ir.IntType(chunk.type.count)), ir.IntType(64)))
    words = []
    for low, high in zip(bits[::2], [*bits[1::2], None] if len(bits) % 2 else bits[1::2], strict=True):
        words.append(low if high is None else builder.or_(low, builder.shl(high, ir.Constant(ir.IntType(64), CHUNK))))
    return words


def _first(builder, words):
    """The position of the lowest bit that is set; one of them is."""
    i64 = ir.IntType(64)
    index = None
    for i, word in reversed(list(enumerate(words))):
        zeros = _call(builder, "llvm.cttz.i64", i64, word, ir.Constant(ir.IntType(1), 0))
        here = builder.add(zeros, ir.Constant(i64, 64 * i))
        found = builder.icmp_unsigned("!=", word, ir.Constant(i64, 0))
        index = here if index is None else builder.select(found, here, index)
    return index


def _count(builder, words):
    """How many bits are set."""
    counts = [_call(builder, "llvm.ctpop.i64", ir.IntType(64), word) for word in words]
    total = counts[0]
    for count in counts[1:]:
        total = builder.add(total, count)
    return total


@intrinsic
def first_equal(typingctx, vector, value):
    """The first lane that equals `value`, which must be there."""

    def codegen(context, builder, signature, args):
        return _first(builder, _words(builder, "==", *args))

    return types.int64(vector, value), codegen


@intrinsic
def count_at_most(typingctx, vector, limit):
    """How many lanes are ≤ `limit`."""

    def codegen(context, builder, signature, args):
        return _count(builder, _words(builder, "<=", *args))

    return types.int64(vector, limit), codegen


@intrinsic
def first_and_count_at_most(typingctx, vector, limit):
    """The first lane that is ≤ `limit`, of which there is one, and how many are: both from one comparison."""

    def codegen(context, builder, signature, args):
        words = _words(builder, "<=", *args)
        return context.make_tuple(builder, signature.return_type, [_first(builder, words), _count(builder, words)])

    return types.UniTuple(types.int64, 2)(vector, limit), codegen


@intrinsic
def bits_equal(typingctx, vector, value):
    """Which of at most 64 lanes equal `value`, as the bits of an uint64, lane 0 lowest."""

    def codegen(context, builder, signature, args):
        return _words(builder, "==", *args)[0]

    return types.uint64(vector, value), codegen


@intrinsic
def where_at_most(typingctx, a, b, then, otherwise):
    """Lane by lane: `then` where a ≤ b, `otherwise` elsewhere."""

    def codegen(context, builder, signature, args):
        return _by_chunk(builder, lambda p, q, r, s: builder.select(builder.icmp_unsigned("<=", p, q), r, s), *args)

    return then(a, b, then, otherwise), codegen


@intrinsic
def lowest_bit(typingctx, word):
    """The position of the lowest bit that is set in an uint64; 64 if none is."""

    def codegen(context, builder, signature, args):
        return _call(builder, "llvm.cttz.i64", ir.IntType(64), args[0], ir.Constant(ir.IntType(1), 0))

    return types.int64(types.uint64), codegen


@intrinsic
def count_bits(typingctx, word):
    """How many bits are set in an uint64."""

    def codegen(context, builder, signature, args):
        return _call(builder, "llvm.ctpop.i64", ir.IntType(64), args[0])

    return types.int64(types.uint64), codegen
