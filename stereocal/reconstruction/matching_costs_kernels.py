# mypy: allow-untyped-defs
"""Kernels of the matching costs: the census transform, and the cost of every pixel at every disparity.

The candidates of a left pixel x are the right pixels x − d. Disparities are counted UP, lane i stands for
d = min_disparity + i, so the right image is held FLIPPED: at `start − x + i` of its row stands the pixel x − d, and
the D candidates of a pixel are one load. The flipped rows are longer than the image; `inside` and `outside` say which
of their pixels are real.
"""

from __future__ import annotations

from numba import njit

from stereocal.reconstruction.vector_lanes import (
    bits_in_both,
    count_differing_bits,
    high_product,
    mean_rounded_down,
    mean_rounded_up,
    minimum,
    narrow,
    subtract_saturated,
)
from stereocal.reconstruction.vector_primitives import fill, fill_from, load, maximum, store, where_at_most, widen

# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True)
def census_planes(padded, threshold, radius_y, radius_x, offsets, lanes, count, planes):
    """Write the census code of each pixel: bit b is set if neighbour b is darker than the centre by more than t.

    Parameters
    ----------
    padded : (H + 2 radius_y, W + 2 radius_x) uint8
        The image with a margin.
    threshold : int
        t.
    offsets : (bits,) int64
        How far on from the centre each neighbour is in the padded image.
    lanes : tuple
        How many pixels are done at a time, as a type.
    count : int
        The same as a number; W is a multiple of it.
    planes : (⌈bits / 8⌉, H, W) uint8
        Eight bits a plane, the first neighbour lowest.
    """
    number, height, width = planes.shape
    stride = padded.shape[1]
    image, codes = padded.ravel(), planes.ravel()
    for y in range(height):
        for x in range(0, width, count):
            here = (y + radius_y) * stride + x + radius_x
            centre = load(image, here, lanes)
            darker = subtract_saturated(centre, fill(threshold, centre))
            none = centre - centre
            for plane in range(number):
                code, value = none, 1
                for bit in range(8 * plane, min(8 * plane + 8, len(offsets))):
                    neighbour = load(image, here + offsets[bit], lanes)
                    code = code | where_at_most(darker, neighbour, none, fill(value, none))
                    value *= 2
                store(code, codes, (plane * height + y) * width + x)


@njit(cache=True, nogil=True)
def half_pixel_levels(padded, lanes, count, levels):
    """Write I, and the least and the greatest of I, (I + I(x − 1)) / 2 and (I + I(x + 1)) / 2 (rounded outwards).

    Parameters
    ----------
    padded : (H, W + 2) uint8
        The image with a margin of one pixel left and right.
    lanes, count
        As in :func:`census_planes`.
    levels : (3, H, W) uint8
    """
    _, height, width = levels.shape
    image, out = padded.ravel(), levels.ravel()
    size = height * width
    for y in range(height):
        for x in range(0, width, count):
            at = y * (width + 2) + x
            before, value, after = load(image, at, lanes), load(image, at + 1, lanes), load(image, at + 2, lanes)
            low = mean_rounded_down(value, minimum(before, after))
            high = mean_rounded_up(value, maximum(before, after))
            store(value, out, y * width + x)
            store(minimum(value, low), out, size + y * width + x)
            store(maximum(value, high), out, 2 * size + y * width + x)


@njit(cache=True, nogil=True)
def cost_rows(
    left_codes, right_codes, left_levels, right_levels, cap, start, inside, outside, beyond,
    radius, shift, factor, rows, width, lanes, recent, columns, nought, out,
):  # fmt: skip
    """Write the block's cost of every pixel of some rows, at every disparity.

    The rows are cut into tiles, so that a tile's costs of the last rows are still in the cache when they are taken out
    of the sums again.

    Parameters
    ----------
    left_codes, right_codes : (planes, H, ·) uint8
        Census codes; no planes if the census has no part in the cost.
    left_levels, right_levels : (3, H, ·) uint8
        Grey value, the least and the greatest within half a pixel of it; the first dimension is 0 if grey values have
        no part in the cost.
    cap : int
        The largest difference of grey values that counts.
    start : int
        Where the candidate i = 0 of the left pixel 0 stands in a flipped row.
    inside, outside : (flipped width,) uint8
        255 and 0 at a real pixel, 0 and the cost of no pixel elsewhere.
    beyond : (lanes,) of the type of `out`
        All bits set in the lanes that are no disparities.
    radius : int
        r of the block of (2r + 1)² pixels.
    shift, factor : int
        out = (sum · 2^shift · factor) >> 16; a `factor` of 0 writes the sum as it is.
    rows : (first, last)
        The rows to write, last not included.
    width : int
        W.
    lanes : tuple
        The lanes, as a type.
    recent : (2r + 1, (tile + 2r) · lanes) uint8
        Scratch: the single pixels' costs of the last rows of a tile.
    columns : ((tile + 2r) · lanes,) uint8 or uint16
        Scratch: their sums. Its type, in which the block is summed too, has room for them.
    nought : (lanes,) uint16
        Zeros.
    out : ((last - first) · W · lanes,) uint8 or uint16
    """
    first, last = rows
    D = len(beyond)
    height = max(left_codes.shape[1], left_levels.shape[1])
    tile = len(columns) // D - 2 * radius
    for begin in range(0, width, tile):
        end = min(begin + tile, width)
        reach = (max(begin - radius, 0), min(end + radius, width))
        recent[:] = 0
        columns[:] = 0
        for v in range(first - radius, last + radius):
            y = min(max(v, 0), height - 1)  # rows beyond the image are copies of its first and its last
            add_row(
                left_codes, right_codes, left_levels, right_levels, cap, start, inside, outside,
                y, reach, lanes, recent[(v - first + radius) % len(recent)], columns,
            )  # fmt: skip
            if v - radius >= first:
                to = (v - radius - first) * width * D
                sum_along_row(
                    columns, radius, shift, factor, beyond, reach, (begin, end), lanes, nought, to, out
                )  # fmt: skip


@njit(cache=True, nogil=True, **INNER)
def add_row(
    left_codes, right_codes, left_levels, right_levels, cap, start, inside, outside,
    y, reach, lanes, row, columns,
):  # fmt: skip
    """Take what `row` holds out of the column sums, write the pixels' costs of row y into it, and add those."""
    first, last = reach
    stride = len(inside)
    planes, _, codes_width = left_codes.shape
    levels_width = left_levels.shape[2]
    height = max(left_codes.shape[1], left_levels.shape[1])
    l_codes, l_levels = left_codes.ravel(), left_levels.ravel()
    codes, levels = right_codes.ravel(), right_levels.ravel()
    zero = load(inside, 0, lanes)
    zero = zero - zero
    limit = fill(cap, zero)
    D = 16 * len(lanes)
    for x in range(first, last):
        there = start - x
        at = y * stride + there
        cost = zero
        own = y * codes_width + x
        for plane in range(planes):
            code = fill_from(l_codes, plane * height * codes_width + own, zero)
            cost = cost + count_differing_bits(code, load(codes, plane * height * stride + at, lanes))
        if cap > 0:
            value, low = load(levels, at, lanes), load(levels, height * stride + at, lanes)
            high = load(levels, 2 * height * stride + at, lanes)
            own = y * levels_width + x
            l_value = fill_from(l_levels, own, zero)
            l_low = fill_from(l_levels, height * levels_width + own, zero)
            l_high = fill_from(l_levels, 2 * height * levels_width + own, zero)
            to_right = maximum(subtract_saturated(l_value, high), subtract_saturated(low, l_value))
            to_left = maximum(subtract_saturated(value, l_high), subtract_saturated(l_low, value))
            cost = cost + minimum(minimum(to_right, to_left), limit)
        cost = bits_in_both(cost, load(inside, there, lanes)) + load(outside, there, lanes)
        i = (x - first) * D
        column = load(columns, i, lanes)
        column = column + widen(cost, column) - widen(load(row, i, lanes), column)
        store(cost, row, i)
        store(column, columns, i)


@njit(cache=True, nogil=True, **INNER)
def sum_along_row(columns, radius, shift, factor, beyond, reach, part, lanes, nought, to, out):
    """Write the sums over the block, scaled, of one row: columns beyond the image are copies of its outermost."""
    D = len(beyond)
    begin, end = part
    origin = reach[0] * D
    last = (reach[1] - reach[0] - 1) * D
    none = load(beyond, 0, lanes)
    wide = load(nought, 0, lanes)
    scale = fill(factor, wide)
    total = load(columns, 0, lanes)
    total = total - total
    for x in range(begin - radius, begin + radius):
        total = total + load(columns, min(max(x * D - origin, 0), last), lanes)
    for x in range(begin, end):
        total = total + load(columns, min((x + radius) * D - origin, last), lanes)
        scaled = widen(total, wide)
        if factor > 0:
            for _ in range(shift):
                scaled = scaled + scaled
            scaled = high_product(scaled, scale)
        store(narrow(scaled, none) | none, out, to + x * D)
        total = total - load(columns, max((x - radius) * D - origin, 0), lanes)
