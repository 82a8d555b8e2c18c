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
from stereocal.reconstruction.vector_primitives import fill, load, maximum, store, where_at_most, widen


@njit(cache=True, nogil=True)
def census_planes(padded, threshold, radius_y, radius_x, flipped, lanes, count, planes):
    """Write the census code of each pixel: bit b is set if neighbour b is darker than the centre by more than t.

    Parameters
    ----------
    padded : (H + 2 radius_y, W + 2 radius_x) uint8
        The image with a margin.
    threshold : int
        t.
    flipped : bool
        Whether the image is mirrored left to right; the code is that of the unflipped pixel.
    lanes : tuple
        How many pixels are done at a time, as a type.
    count : int
        The same as a number; W is a multiple of it.
    planes : (⌈bits / 8⌉, H, W) uint8
        Eight bits a plane, the first neighbour lowest, the window read row by row.
    """
    number, height, width = planes.shape
    stride = padded.shape[1]
    image, codes = padded.ravel(), planes.ravel()
    columns = 2 * radius_x + 1
    middle = radius_y * columns + radius_x
    neighbours = columns * (2 * radius_y + 1) - 1
    for y in range(height):
        for x in range(0, width, count):
            centre = load(image, (y + radius_y) * stride + x + radius_x, lanes)
            darker = subtract_saturated(centre, fill(threshold, centre))
            none = centre - centre
            for plane in range(number):
                code = none
                for bit in range(8 * plane, min(8 * plane + 8, neighbours)):
                    place = bit if bit < middle else bit + 1  # the centre is left out
                    row, column = place // columns, place % columns
                    if flipped:
                        column = columns - 1 - column
                    neighbour = load(image, (y + row) * stride + x + column, lanes)
                    code = code | where_at_most(darker, neighbour, none, fill(1 << (bit - 8 * plane), none))
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
    left_codes, right_codes, census_weight, left_levels, right_levels, cap, start, inside, outside, beyond,
    radius, shift, factor, rows, lanes, recent, columns, out,
):  # fmt: skip
    """Write the block's cost of every pixel of some rows, at every disparity.

    Parameters
    ----------
    left_codes, right_codes : (planes, H, ·) uint8
        Census codes; no planes if the census has no part in the cost.
    census_weight : int
        How often a differing bit counts.
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
    recent : (2r + 2, W · lanes) uint8
        Scratch: the single pixels' costs of the last rows.
    columns : (W · lanes,) uint16
        Scratch: their sums over 2r + 1 rows.
    out : ((last - first) · W · lanes,) uint8 or uint16
    """
    first, last = rows
    height = max(left_codes.shape[1], left_levels.shape[1])
    width = len(columns) // len(beyond)
    columns[:] = 0
    computed = max(first - radius, 0) - 1
    for v in range(first - radius, last + radius):
        entering = min(max(v, 0), height - 1)  # rows beyond the image are copies of its first and its last
        if entering > computed:
            cost_row(
                left_codes, right_codes, census_weight, left_levels, right_levels, cap, start, inside, outside,
                height, width, entering, lanes, recent[entering % len(recent)],
            )  # fmt: skip
            computed = entering
        leaving = -1
        if v - 2 * radius - 1 >= first - radius:
            leaving = max(v - 2 * radius - 1, 0) % len(recent)
        row = recent[entering % len(recent)]
        move_window_down(row, recent[leaving], leaving >= 0, width, len(beyond), lanes, columns)
        if v - radius >= first:
            to = (v - radius - first) * len(columns)
            sum_along_row(columns, radius, shift, factor, beyond, width, lanes, to, out)


@njit(cache=True, nogil=True)
def cost_row(
    left_codes, right_codes, census_weight, left_levels, right_levels, cap, start, inside, outside,
    height, width, y, lanes, row,
):  # fmt: skip
    """Write the cost of each pixel of row y on its own, at every disparity."""
    stride = len(inside)
    codes, levels = right_codes.ravel(), right_levels.ravel()
    D = len(row) // width
    zero = load(inside, 0, lanes)
    zero = zero - zero
    limit = fill(cap, zero)
    left_code, left_level = left_codes[:, y], left_levels[:, y]
    for x in range(width):
        there = start - x
        differing = zero
        for plane in range(len(left_codes)):
            candidates = load(codes, (plane * height + y) * stride + there, lanes)
            differing = differing + count_differing_bits(fill(left_code[plane, x], zero), candidates)
        cost = differing
        for _ in range(1, census_weight):
            cost = cost + differing
        if len(left_levels) > 0:
            at = y * stride + there
            value, low = load(levels, at, lanes), load(levels, height * stride + at, lanes)
            high = load(levels, 2 * height * stride + at, lanes)
            l_value = fill(left_level[0, x], zero)
            l_low, l_high = fill(left_level[1, x], zero), fill(left_level[2, x], zero)
            to_right = maximum(subtract_saturated(l_value, high), subtract_saturated(low, l_value))
            to_left = maximum(subtract_saturated(value, l_high), subtract_saturated(l_low, value))
            cost = cost + minimum(minimum(to_right, to_left), limit)
        cost = bits_in_both(cost, load(inside, there, lanes)) + load(outside, there, lanes)
        store(cost, row, x * D)


@njit(cache=True, nogil=True)
def move_window_down(entering, leaving, has_leaving, width, D, lanes, columns):
    """Add the row that enters the block to the column sums, and take the row away that leaves it."""
    for i in range(0, width * D, D):
        column = load(columns, i, lanes)
        column = column + widen(load(entering, i, lanes), column)
        if has_leaving:
            column = column - widen(load(leaving, i, lanes), column)
        store(column, columns, i)


@njit(cache=True, nogil=True)
def sum_along_row(columns, radius, shift, factor, beyond, width, lanes, to, out):
    """Write the sums over the block, scaled, of one row: columns beyond the image are copies of its outermost."""
    D = len(beyond)
    last = (width - 1) * D
    none = load(beyond, 0, lanes)
    total = load(columns, 0, lanes)
    total = total - total
    for j in range(-radius, radius):
        total = total + load(columns, min(max(j * D, 0), last), lanes)
    for x in range(width):
        total = total + load(columns, min((x + radius) * D, last), lanes)
        scaled = total
        if factor > 0:
            for _ in range(shift):
                scaled = scaled + scaled
            scaled = high_product(scaled, fill(factor, scaled))
        store(narrow(scaled, none) | none, out, to + x * D)
        total = total - load(columns, max((x - radius) * D, 0), lanes)
