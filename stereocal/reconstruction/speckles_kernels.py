# mypy: allow-untyped-defs
"""Kernels of the speckle filter: components of pixels by union-find, on pixels and on runs of pixels.

:func:`component_sizes` is the plain one: union-find on pixels, in loops.

:func:`label_runs` does the same with as little work a pixel as can be. Whether neighbours are joined is worked out for
a whole row at once, and kept as bits, 64 pixels a word:

    V  has a disparity      J  joined to the right      B  joined below.

A maximal row of joined pixels is a **run**. It starts at the bits S = V & ~(J << 1), and its number is the count of S
up to there, so that no label a pixel is ever stored. Two runs one below the other are joined once, not once a pixel:
at those bits of B whose left neighbour does not already join the same two runs, B & ~((B & J & J_below) << 1). And
pixels that are joined to nothing, which is most of them where the map is noise, are told at once from the bits and
never become runs.

Union-find keeps the smallest number as the root, so that a parent always comes before its children and one pass in
ascending order flattens every tree.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from stereocal.reconstruction.vector_primitives import bits_equal, count_bits, load, lowest_bit

# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True)
def component_sizes(disparity, valid, max_difference, parent, sizes):
    """Write the size of each pixel's component into `sizes`, (H·W,) int32, which enters as zeros: plain loops."""
    height, width = disparity.shape
    for y in range(height):
        for x in range(width):
            p = y * width + x
            parent[p] = p
            if not valid[y, x]:
                continue
            root = p
            if x > 0 and valid[y, x - 1] and abs(float(disparity[y, x]) - float(disparity[y, x - 1])) <= max_difference:
                root = p - 1
                while parent[root] != root:
                    parent[root] = parent[parent[root]]
                    root = parent[root]
                parent[p] = root
            if y > 0 and valid[y - 1, x] and abs(float(disparity[y, x]) - float(disparity[y - 1, x])) <= max_difference:
                other = p - width
                while parent[other] != other:
                    parent[other] = parent[parent[other]]
                    other = parent[other]
                if other < root:
                    parent[root] = other
                elif root < other:
                    parent[other] = root
    for p in range(height * width):
        parent[p] = parent[parent[p]]
        if valid[p // width, p % width]:
            sizes[parent[p]] += 1
    for p in range(height * width - 1, -1, -1):
        sizes[p] = sizes[parent[p]] if valid[p // width, p % width] else 0


@njit(cache=True, nogil=True, **INNER)
def joined(here, there, none, limit, out):
    """Write 1 into the bytes of `out` where two pixels have a disparity and differ by at most `limit`, else 0.

    Integers (int16) are subtracted modulo 2¹⁶, larger minus smaller, so that no difference overflows; `none` marks
    those without a disparity. Floats (`none` is None) are compared as float64, and NaN is joined to nothing.
    """
    for x in range(len(there)):
        a, b = here[x], there[x]
        if none is None:
            out[x] = np.uint8(abs(np.float64(a) - np.float64(b)) <= limit)
        else:
            difference = np.uint16(np.uint16(max(a, b)) - np.uint16(min(a, b)))
            out[x] = np.uint8((difference <= limit) & (a != none) & (b != none))


@njit(cache=True, nogil=True, **INNER)
def present(row, none, out):
    """Write 1 into the bytes of `out` where there is a disparity, else 0."""
    for x in range(len(row)):
        if none is None:
            out[x] = np.uint8(row[x] == row[x])
        else:
            out[x] = np.uint8(row[x] != none)


@njit(cache=True, nogil=True, **INNER)
def pack_bits(flags, words):
    """Pack (64 · len(words),) bytes of 0 and 1 into words of 64 bits, the first lowest."""
    for w in range(len(words)):
        words[w] = bits_equal(load(flags, 64 * w, (0, 0, 0, 0)), 1)  # 4 · 16 lanes


@njit(cache=True, nogil=True, **INNER)
def find_root(parent, run):
    """Return the root of a run's tree, halving the path on the way."""
    while parent[run] != run:
        parent[run] = parent[parent[run]]
        run = parent[run]
    return run


@njit(cache=True, nogil=True, **INNER)
def run_at(starts, before, x):
    """Return the number of the run that pixel x lies in: the runs before its word, and the starts up to x in it."""
    w = x >> 6
    upto = ~np.uint64(0) >> np.uint64(63 - (x & 63))
    return before[w] + count_bits(starts[w] & upto) - 1


@njit(cache=True, nogil=True)
def label_runs(disparity, none, limit, alone, flags, words, before, start, length, parent, out):
    """Find the runs and join them into components; pixels that are joined to nothing are written to `out` at once.

    Parameters
    ----------
    disparity : (H, W) int16, with `none` its marker, or float, with None
    limit : uint16 or float64
        The largest difference between joined neighbours.
    alone : scalar of the type of `out`
        What is written for a pixel that is joined to nothing.
    flags : (64 n,) uint8, n ≥ (W + 63) // 64
        Scratch; its bytes from W on enter as 0.
    words : (8, n) uint64
        Scratch: of two rows each V, J, B and S.
    before : (2, n) int32
        Scratch: of two rows, the runs before each word.
    start, length, parent : (H·W,) int32
        Written: the first pixel, counted through the map, the pixels, and the root of each run.
    out : (H·W,)
        Enters as the caller likes.

    Returns
    -------
    int
        The number of runs.
    """
    height, width = disparity.shape
    pixels = disparity.ravel()
    n = words.shape[1]
    one, top = np.uint64(1), np.uint64(63)
    runs = 0
    words[:] = 0
    for y in range(height):
        this, last = 4 * (y & 1), 4 - 4 * (y & 1)
        V, J, B, S = words[this], words[this + 1], words[this + 2], words[this + 3]
        J_above, B_above, S_above = words[last + 1], words[last + 2], words[last + 3]
        row = disparity[y]
        present(row, none, flags)
        pack_bits(flags, V)
        # the last pixel meets the first of the next row, so that whole registers remain, and is parted from it
        joined(row, pixels[y * width + 1 : (y + 1) * width + 1], none, limit, flags)
        flags[width - 1] = 0
        pack_bits(flags, J)
        if y + 1 < height:
            joined(row, disparity[y + 1], none, limit, flags)
            pack_bits(flags, B)
        else:
            B[:] = 0

        carry = np.uint64(0)
        for w in range(n):
            from_left = (J[w] << one) | carry
            carry = J[w] >> top
            lonely = V[w] & ~(from_left | J[w] | B[w] | B_above[w])
            V[w] &= ~lonely
            S[w] = V[w] & ~from_left
            before[y & 1, w] = runs
            while lonely != 0:
                out[y * width + 64 * w + lowest_bit(lonely)] = alone
                lonely &= lonely - one
            opening = S[w]
            while opening != 0:
                start[runs] = y * width + 64 * w + lowest_bit(opening)
                parent[runs] = runs
                runs += 1
                opening &= opening - one
        run = before[y & 1, 0]
        for w in range(n):
            closing = V[w] & ~J[w]
            while closing != 0:
                length[run] = y * width + 64 * w + lowest_bit(closing) - start[run] + 1
                run += 1
                closing &= closing - one

        carry = np.uint64(0)
        for w in range(n):
            same = B_above[w] & J_above[w] & J[w]
            meet = B_above[w] & ~((same << one) | carry)
            carry = same >> top
            while meet != 0:
                x = 64 * w + lowest_bit(meet)
                meet &= meet - one
                a = find_root(parent, run_at(S_above, before[1 - (y & 1)], x))
                b = find_root(parent, run_at(S, before[y & 1], x))
                if a < b:
                    parent[b] = a
                elif b < a:
                    parent[a] = b
    return runs


@njit(cache=True, nogil=True)
def sum_sizes(runs, length, parent, size):
    """Flatten the trees and sum the pixels of each component at its root; `size` (runs,) int32."""
    for run in range(runs):
        parent[run] = parent[parent[run]]
        size[run] = 0
        size[parent[run]] += length[run]


@njit(cache=True, nogil=True)
def write_sizes(runs, start, length, parent, size, out):
    """Write the size of each run's component over its pixels."""
    for run in range(runs):
        out[start[run] : start[run] + length[run]] = size[parent[run]]


@njit(cache=True, nogil=True)
def erase_small(runs, start, length, parent, size, max_size, none, out):
    """Write `none` over the pixels of each run whose component has at most `max_size` pixels."""
    for run in range(runs):
        if size[parent[run]] <= max_size:
            for p in range(start[run], start[run] + length[run]):
                out[p] = none
