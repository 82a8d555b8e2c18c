"""Sixteen sums at once: the products of four rows with four rows, as one instruction of Numba kernels.

JᵀJ is most of the work of a calibration. Each of its entries is a sum over points of the product of two columns of J,
which are rows in memory here. Sum by sum, every number would be fetched once for each of its products; four rows times
four, eight points at a time, are 16 products of 8 numbers fetched, and the 16 sums stay in registers:

    S_ab = Σ_j x_a[j] y_b[j],        a, b = 0 … 3,        x_a = J[x_a :], y_b = J[y_b :].

Written as a loop, the compiler would have to find this out, and where it does it takes half of the machine's vector
(256 bits, on processors that have 512). :func:`add_tile` says it in the terms of LLVM, the compiler behind Numba, and
names no machine: a value is a vector of eight doubles, which is one register of AVX-512, two of AVX2, four of NEON.

A row has two parts (∂u and then ∂v of the same points): j runs over `count` numbers from its beginning and as many from
`second` on. `count` is a multiple of 8. Nothing checks bounds. Kernels that use this are cached by Numba under the date
of their own file: after a change HERE that file must be touched.
"""

# mypy: ignore-errors

from __future__ import annotations

from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic

LANES = 8
_TILE = 4
_NUMBER, _NUMBER_BYTES, _INDEX = ir.DoubleType(), 8, ir.IntType(64)
_VECTOR, _FOUR = ir.VectorType(_NUMBER, LANES), ir.VectorType(_NUMBER, _TILE)


@intrinsic
def add_tile(typingctx, J, rows, i, k, count, second, A):
    """A[i + a, k + b] += Σ x_a y_b for a, b = 0 … 3, with x_a = J[rows[i + a] :] and y_b = J[rows[k + b] :]."""

    def codegen(context, builder, signature, args):
        J, rows, i, k, count, second, A = args
        numbers = context.make_array(signature.args[0])(context, builder, J).data
        starts = context.make_array(signature.args[1])(context, builder, rows).data

        def begin(first, number):
            start = builder.load(builder.gep(starts, [builder.add(first, _INDEX(number))]))
            return builder.gep(numbers, [start])

        x, y = [begin(i, a) for a in range(_TILE)], [begin(k, b) for b in range(_TILE)]
        sums = [[cgutils.alloca_once_value(builder, ir.Constant(_VECTOR, [0.0] * LANES)) for _ in y] for _ in x]
        fma = builder.module.declare_intrinsic(f"llvm.fma.v{LANES}f64", fnty=ir.FunctionType(_VECTOR, [_VECTOR] * 3))
        with cgutils.for_range_slice(builder, _INDEX(0), count, _INDEX(LANES), inc=True) as (j, _):
            for part in (j, builder.add(j, second)):

                def fetch(row, at=part):
                    where = builder.bitcast(builder.gep(row, [at]), _VECTOR.as_pointer())
                    return builder.load(where, align=8)

                ys = [fetch(row) for row in y]
                for row, row_sums in zip(x, sums, strict=True):
                    number = fetch(row)
                    for other, total in zip(ys, row_sums, strict=True):
                        builder.store(builder.call(fma, [number, other, builder.load(total)]), total)
        out = context.make_array(signature.args[6])(context, builder, A)
        width = builder.sdiv(builder.extract_value(out.strides, 0), _INDEX(_NUMBER_BYTES))
        for a, row_sums in enumerate(sums):
            at = builder.add(builder.mul(builder.add(i, _INDEX(a)), width), k)
            to = builder.bitcast(builder.gep(out.data, [at]), _FOUR.as_pointer())
            four = _add_up(builder, [builder.load(total) for total in row_sums])
            builder.store(builder.fadd(builder.load(to, align=8), four), to, align=8)
        return context.get_dummy_value()

    index = types.intp
    return types.void(J, rows, index, index, index, index, A), codegen


def _add_up(builder, sums):
    """Four numbers, each the sum of the eight lanes of one of four vectors; two vectors at a time become one."""

    def halved(p, q, first, second):
        one, other = (
            builder.shuffle_vector(p, q, ir.Constant(ir.VectorType(ir.IntType(32), len(order)), order))
            for order in (first, second)
        )
        return builder.fadd(one, other)

    pairs = [halved(p, q, [0, 8, 2, 10, 4, 12, 6, 14], [1, 9, 3, 11, 5, 13, 7, 15]) for p, q in (sums[:2], sums[2:])]
    both = halved(*pairs, [0, 1, 8, 9, 4, 5, 12, 13], [2, 3, 10, 11, 6, 7, 14, 15])
    return halved(both, both, [0, 1, 2, 3], [4, 5, 6, 7])
