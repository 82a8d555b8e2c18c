# mypy: allow-untyped-defs
"""Kernels of block matching: a window slides over the image and the sums in it are updated, not summed anew.

The sum of absolute differences over the window of (2r + 1)² pixels around (x, y), at each disparity d,

    S(x, y, d) = Σ_{i,j = −r…r} |L(x + i, y + j) − R(x + i − d, y + j)|,

is a sum of column sums, C(x, y, d) = Σ_j |L(x, y + j) − R(x − d, y + j)|. Going down a row, each column gains one
pixel and loses one; going right by a pixel, the window gains one column and loses one:

    C(x, y, d) = C(x, y − 1, d) + |L(x, y + r) − R(x − d, y + r)| − |L(x, y − r − 1) − R(x − d, y − r − 1)|
    S(x, y, d) = S(x − 1, y, d) + C(x + r, y, d) − C(x − r − 1, y, d),

so that the work does not depend on the block size, and the memory is one row of columns, O(W·D). The differences of the
row that leaves are computed again: that is quicker than to have stored them.

Disparities are counted DOWN: k = 0 … D − 1 stands for d = d_max − k, because R(x − d) then lies in memory in the order
of k. The smallest k wins a tie: the largest disparity, as in OpenCV.

The kernel comes twice, :func:`match_rows` in plain loops and :func:`match_rows_vector` with the D sums as one value
(:mod:`stereocal.reconstruction.vector_primitives`); the tests hold them equal. In the second, S stays in registers along the
row. Both leave S at the winner and its neighbours in rows of scratch, and :func:`refine_row` turns those into
disparities.

Arguments that both kernels share:

left, right : (H, W) uint8
    Grey or prefiltered images. For the vector kernel `right` has room for `lanes` candidates at each start.
left_column, right_start : (n + 2r,) intp
    For each column of sums: where it stands in `left`, and where its candidate k = 0 stands in `right`.
radius : int
    r.
rows : (first, last)
    The rows y of `out` to write, last not included.
first_x : int
    Where the first of the n matched pixels stands in `out`.
d_max, count : int
    The largest disparity, and D.
uniqueness_ratio : int
    u: no disparity where S(k) ≤ S_min + S_min u / 100 for some k more than 1 away from the best; 0 does not ask.
subpixel : int
    0 none, 1 OpenCV's, 2 parabola.
left_right : int
    The largest |d − d_right| between the best disparities of the two images; −1 does not ask.
row : (4, n) int32
    Scratch: k of the winner, −1 for none, and S(d − 1), S(d), S(d + 1).
out : (H, W) float32
    Enters as NaN where no disparity is wanted.
cost : (H, W) int32 or (0, 0)
    S(d) of the pixels matched, if wanted.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from stereocal.reconstruction.vector_primitives import (
    absolute_difference,
    count_at_most,
    fill,
    first_equal,
    load,
    smallest,
    store,
    where_at_most,
    widen,
)

@njit(cache=True, nogil=True, error_model="numpy")
def refine_row(row, d_max, count, subpixel, y, first_x, out, cost):
    """Write a row of disparities from the winners and the sums beside them."""
    n = row.shape[1]
    for x in range(n):
        k = row[0, x]
        below, least, above = row[1, x], row[2, x], row[3, x]
        inside = k > 0 and k < count - 1
        d = d_max - k
        if subpixel == 1:  # OpenCV's, in sixteenths of a pixel
            q = below + above - 2 * least + abs(below - above)
            fraction = np.int32(256.0 * (below - above) / max(q, 1)) if inside else 0
            value = np.float32((256 * d + fraction + 15) >> 4) * np.float32(0.0625)
        elif subpixel == 2:
            curvature = below + above - 2 * least
            value = np.float32(d)
            if inside and curvature > 0:
                value = np.float32(d + 0.5 * (below - above) / curvature)
        else:
            value = np.float32(d)
        out[y, first_x + x] = value if k >= 0 else np.float32(np.nan)
    if cost.size > 0:
        for x in range(n):
            cost[y, first_x + x] = row[2, x]


@njit(cache=True, nogil=True)
def check_left_right(row, right_winner, d_max, tolerance, first_x):
    """Withdraw the winners that the right image contradicts: |d − d_R(x − d)| > tolerance."""
    for x in range(row.shape[1]):
        if row[0, x] >= 0:
            d = d_max - row[0, x]
            there = first_x + x - d
            if abs(d - (np.int64(right_winner[there]) - there)) > tolerance:
                row[0, x] = -1


@njit(cache=True, nogil=True)
def match_rows(
    left, right, left_column, right_start, radius, rows, first_x, d_max, count, uniqueness_ratio, subpixel, left_right,
    columns, window, right_sum, right_winner, row, out, cost,
):  # fmt: skip
    """Match rows by the smallest S: plain loops.

    Parameters
    ----------
    columns : (n + 2r, D) int32
        Scratch: C.
    window : (D,) int32
        Scratch: S.
    right_sum, right_winner : (W,) int32
        Scratch: the smallest S that a pixel of the right image has met, and the x of the left pixel it met there.
    """
    first, last = rows
    n = len(left_column) - 2 * radius
    columns[:] = 0
    for y in range(first - radius - 1, first + radius):
        for j in range(n + 2 * radius):
            value = int(left[max(y, 0), left_column[j]])
            for k in range(count):
                columns[j, k] += abs(value - int(right[max(y, 0), right_start[j] + k]))

    for y in range(first, last):
        entering, leaving = y + radius, max(y - radius - 1, 0)
        window[:] = 0
        right_sum[:] = 2147483647
        for j in range(n + 2 * radius):
            new, old = int(left[entering, left_column[j]]), int(left[leaving, left_column[j]])
            start = right_start[j]
            for k in range(count):
                columns[j, k] += abs(new - int(right[entering, start + k])) - abs(old - int(right[leaving, start + k]))
                window[k] += columns[j, k]
            x = j - 2 * radius
            if x < 0:
                continue
            if left_right >= 0:
                there = first_x + x - d_max
                for k in range(count):
                    if window[k] <= right_sum[there + k]:  # a tie goes to the larger disparity: the later x
                        right_sum[there + k] = window[k]
                        right_winner[there + k] = first_x + x
            row[0, x] = -1
            if not np.isnan(out[y, first_x + x]):
                winner = 0
                for k in range(1, count):
                    if window[k] < window[winner]:
                        winner = k
                least = window[winner]
                unique = True
                if uniqueness_ratio > 0:
                    limit = least + np.int64(least) * uniqueness_ratio // 100
                    for k in range(count):
                        if window[k] <= limit and abs(k - winner) > 1:
                            unique = False
                            break
                if unique:
                    row[0, x] = winner
                    row[1, x] = window[min(winner + 1, count - 1)]
                    row[2, x] = least
                    row[3, x] = window[max(winner - 1, 0)]
            for k in range(count):
                window[k] -= columns[x, k]
        if left_right >= 0:
            check_left_right(row, right_winner, d_max, left_right, first_x)
        refine_row(row, d_max, count, subpixel, y, first_x, out, cost)


@njit(cache=True, nogil=True)
def match_rows_vector(
    left, right, left_column, right_start, radius, rows, first_x, d_max, count, uniqueness_ratio, subpixel, left_right,
    lanes, columns, window, beyond, right_sum, right_winner, row, out, cost,
):  # fmt: skip
    """Match rows by the smallest S: the D sums as one value.

    Parameters
    ----------
    lanes : tuple
        D, rounded up to a multiple of 16, as a type: see ``vector_primitives.lanes_of``.
    columns : ((n + 2r) · lanes,) uint16
        Scratch: C.
    window : (lanes + 2,) uint16 or uint32
        Scratch: S, between two guards which hold the largest number. Its type is that of S.
    beyond : (lanes,) of the type of S, or None
        All bits set in the lanes k ≥ D, so that they never win; None if there are no such lanes.
    right_sum, right_winner : (W + lanes,) of the type of S
        Scratch, as in :func:`match_rows`; None if `left_right` is −1.
    """
    first, last = rows
    radius2 = 2 * radius
    width = len(window) - 2
    n = len(left_column) - radius2
    stride = right.shape[1]
    candidates = right.ravel()
    guard = np.int64(window[0])

    columns[:] = 0
    zero = load(columns, 0, lanes)
    for y in range(first - radius - 1, first + radius):
        source = max(y, 0)
        for j in range(n + radius2):
            new = load(candidates, source * stride + right_start[j], lanes)
            difference = absolute_difference(fill(left[source, left_column[j]], new), new)
            store(load(columns, j * width, lanes) + widen(difference, zero), columns, j * width)

    for y in range(first, last):
        entering, leaving = y + radius, max(y - radius - 1, 0)
        above, below = entering * stride, leaving * stride
        if right_sum is not None:
            right_sum[:] = guard
        sums = load(window, 1, lanes)
        sums = sums - sums
        for j in range(n + radius2):
            new = load(candidates, above + right_start[j], lanes)
            old = load(candidates, below + right_start[j], lanes)
            new = absolute_difference(fill(left[entering, left_column[j]], new), new)
            old = absolute_difference(fill(left[leaving, left_column[j]], old), old)
            column = load(columns, j * width, lanes) + widen(new, zero) - widen(old, zero)
            store(column, columns, j * width)
            sums = sums + widen(column, sums)
            x = j - radius2
            if x < 0:
                continue
            ranked = sums
            if beyond is not None:
                ranked = ranked | load(beyond, 0, lanes)
            if right_sum is not None:
                there = first_x + x - d_max
                met, winners = load(right_sum, there, lanes), load(right_winner, there, lanes)
                store(where_at_most(ranked, met, fill(first_x + x, winners), winners), right_winner, there)
                store(where_at_most(ranked, met, ranked, met), right_sum, there)
            row[0, x] = -1
            if not np.isnan(out[y, first_x + x]):
                least = smallest(ranked)
                winner = first_equal(ranked, least)
                store(ranked, window, 1)
                less, more = np.int64(window[winner + 2]), np.int64(window[winner])
                unique = True
                if uniqueness_ratio > 0:
                    limit = min(least + least * uniqueness_ratio // 100, guard - 1)
                    unique = count_at_most(ranked, limit) == 1 + (less <= limit) + (more <= limit)
                if unique:
                    row[0, x] = winner
                    row[1, x] = less
                    row[2, x] = least
                    row[3, x] = more
            sums = sums - widen(load(columns, x * width, lanes), sums)
        if right_winner is not None:
            check_left_right(row, right_winner, d_max, left_right, first_x)
        refine_row(row, d_max, count, subpixel, y, first_x, out, cost)
