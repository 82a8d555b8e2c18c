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

The kernel comes twice, :func:`match_rows` in plain loops and :func:`match_rows_vector` with the D sums as ONE value
(:mod:`stereocal.reconstruction.vector_primitives`) that stays in registers along the row; the tests hold them equal.

**How the second finds the winner.** To find the smallest of D numbers and then where it is, and then who else is near,
takes long not because it is much work but because each step waits for the one before. So it is done in phases over a
tile of pixels, in which the pixels do not wait for each other: the sums and their minimum m; the limit of uniqueness
ℓ = m + ⌊m u/100⌋; the first lane t with S ≤ ℓ and the number c of such lanes, from one comparison; then the four sums
around t. That is enough: if the winner is unique, all lanes with S ≤ ℓ lie within 1 of it, so it is t or t + 1.

Arguments that both kernels share:

left, right : (H, W) uint8
    Grey or prefiltered images. For the vector kernel `right` has room for `lanes` candidates at each start.
left_column, right_start : (n + 2r,) uintp
    For each column of sums: where it stands in `left`, and where its candidate k = 0 stands in `right`.
radius : int
    r.
rows : (first, last)
    The rows y of `out` to write, last not included.
search : (first_x, d_max, count, uniqueness_ratio, subpixel, left_right), all int
    Where the first of the n matched pixels stands in `out`; the largest disparity; D; u: no disparity where
    S(k) ≤ m + ⌊m u/100⌋ for some k more than 1 away from the best, 0 does not ask; 0 no subpixel, 1 OpenCV's,
    2 parabola; the largest |d − d_right| between the best disparities of the two images, −1 does not ask.
winners : (n,) int32
    Scratch: k of the winner, −1 for none.
right_sum, right_winner : (W,)
    Scratch: the smallest S that a pixel of the right image has met, and the x of the left pixel it met there.
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
    fill,
    fill_from,
    first_and_count_at_most,
    load,
    smallest,
    store,
    where_at_most,
    widen,
    widen_signed,
)

TILE = 32
"""Pixels of which the vector kernel takes a step together."""


@njit(cache=True, nogil=True, error_model="numpy")
def refined(k, below, least, above, d_max, count, subpixel):
    """The disparity of winner k from S(d − 1), S(d), S(d + 1); all in float64, which holds these integers exactly."""
    d = np.float64(d_max - k)
    slope = below - above
    curvature = below + above - 2.0 * least
    inside = (k > 0) & (k < count - 1)
    if subpixel == 1:  # OpenCV's, in sixteenths of a pixel
        fraction = np.trunc(256.0 * slope / max(curvature + abs(slope), 1.0))
        value = np.floor((256.0 * d + (fraction if inside else 0.0) + 15.0) * 0.0625) * 0.0625
    elif subpixel == 2:
        fraction = 0.5 * slope / max(curvature, 1.0)
        value = d + (fraction if inside & (curvature > 0.0) else 0.0)
    else:
        value = d
    return np.float32(value if k >= 0 else np.nan)


@njit(cache=True, nogil=True)
def check_left_right(winners, right_winner, d_max, tolerance, y, first_x, out):
    """Withdraw the disparities that the right image contradicts: |d − d_R(x − d)| > tolerance."""
    for x in range(len(winners)):
        if winners[x] >= 0:
            d = d_max - winners[x]
            there = first_x + x - d
            if abs(d - (np.int64(right_winner[there]) - there)) > tolerance:
                out[y, first_x + x] = np.nan


@njit(cache=True, nogil=True)
def match_rows(
    left, right, left_column, right_start, radius, rows, search,
    columns, window, winners, right_sum, right_winner, out, cost,
):  # fmt: skip
    """Match rows by the smallest S: plain loops.

    Parameters
    ----------
    columns : (n + 2r, D) int32
        Scratch: C.
    window : (D,) int32
        Scratch: S.
    """
    first_x, d_max, count, uniqueness_ratio, subpixel, left_right = search
    first, last = rows
    n = len(left_column) - 2 * radius
    columns[:] = 0
    for y in range(first - radius - 1, first + radius):
        for j in range(n + 2 * radius):
            value = np.int64(left[max(y, 0), left_column[j]])
            for k in range(count):
                columns[j, k] += abs(value - np.int64(right[max(y, 0), np.intp(right_start[j]) + k]))

    for y in range(first, last):
        entering, leaving = y + radius, max(y - radius - 1, 0)
        window[:] = 0
        right_sum[:] = 2147483647
        for j in range(n + 2 * radius):
            new, old = np.int64(left[entering, left_column[j]]), np.int64(left[leaving, left_column[j]])
            start = np.intp(right_start[j])
            for k in range(count):
                columns[j, k] += abs(new - np.int64(right[entering, start + k])) - abs(
                    old - np.int64(right[leaving, start + k])
                )
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
            winners[x] = -1
            if not np.isnan(out[y, first_x + x]):
                winner = 0
                for k in range(1, count):
                    if window[k] < window[winner]:
                        winner = k
                winners[x] = winner
                if uniqueness_ratio > 0:
                    limit = window[winner] + np.int64(window[winner]) * uniqueness_ratio // 100
                    for k in range(count):
                        if window[k] <= limit and abs(k - winner) > 1:
                            winners[x] = -1
                            break
                below, above = np.float64(window[min(winner + 1, count - 1)]), np.float64(window[max(winner - 1, 0)])
                least = np.float64(window[winner])
                out[y, first_x + x] = refined(winners[x], below, least, above, d_max, count, subpixel)
                if cost.size > 0:
                    cost[y, first_x + x] = window[winner]
            for k in range(count):
                window[k] -= columns[x, k]
        if left_right >= 0:
            check_left_right(winners, right_winner, d_max, left_right, y, first_x, out)


@njit(cache=True, nogil=True, error_model="numpy")
def choose_winners(tile, size, unique, winners, disparity):
    """Turn the finds about a tile's pixels into winners: t or t + 1, or −1 for none.

    Parameters
    ----------
    tile : (8 T,) int32
        T numbers each of m, ℓ, t, c, and S at t − 1, t, t + 1, t + 2.
    unique : bool
        Whether the winner must be unique.
    winners : (size,) int32
        Where to.
    disparity : (size,) float32
        NaN where no disparity is wanted.
    """
    for i in range(size):
        limit, t, found = tile[TILE + i], tile[2 * TILE + i], tile[3 * TILE + i]
        s1, s2, s3 = tile[5 * TILE + i], tile[6 * TILE + i], tile[7 * TILE + i]
        later = s2 < s1  # t + 1 rather than t
        near = np.int32(1) + np.int32(s2 <= limit) + np.int32(later & (s3 <= limit))
        rejected = unique & ((found > near) | (s3 < s1) & (s3 < s2)) | (disparity[i] != disparity[i])
        winners[i] = np.int32(-1) if rejected else (t + np.int32(1) if later else t)


@njit(cache=True, nogil=True, error_model="numpy")
def refine_tile(tile, size, winners, d_max, count, subpixel, disparity):
    """Write the disparities of a tile; `tile` and `winners` as in :func:`choose_winners`."""
    for i in range(size):
        s0, s1 = np.float64(tile[4 * TILE + i]), np.float64(tile[5 * TILE + i])
        s2, s3 = np.float64(tile[6 * TILE + i]), np.float64(tile[7 * TILE + i])
        later = s2 < s1
        below, least, above = (s3 if later else s2), (s2 if later else s1), (s1 if later else s0)
        disparity[i] = refined(winners[i], below, least, above, d_max, count, subpixel)


@njit(cache=True, nogil=True, error_model="numpy")
def match_rows_vector(
    left, right, left_column, right_start, radius, rows, search,
    lanes, columns, windows, beyond, signed, tile, winners, right_sum, right_winner, out, cost,
):  # fmt: skip
    """Match rows by the smallest S: the D sums as one value.

    Parameters
    ----------
    lanes : tuple
        D, rounded up to a multiple of 16, as a type: see ``vector_primitives.lanes_of``.
    columns : ((n + 2r) · lanes,) uint16
        Scratch: C.
    windows : (32 + T (lanes + 32),) uint16 or uint32
        Scratch: S of the T pixels of a tile, 32 guards before and after each, which no sum reaches. Enters filled
        with the guard.
    beyond : (lanes,) of the type of S, or None
        The guard in the lanes k ≥ D, so that they never win; None if there are no such lanes.
    signed : True or None
        True if no image value is above 127, so that the difference of two differences fits into 8 bits.
    tile : (8 T,) int32
        Scratch: what is found about each pixel of a tile, see :func:`choose_winners`.
    right_sum, right_winner : (W + lanes,)
        None if `left_right` is −1; `right_sum` has the type of S.
    """
    first_x, d_max, count, uniqueness_ratio, subpixel, left_right = search
    first, last = rows
    size = 16 * len(lanes)
    pitch = size + 32
    stride, left_stride = right.shape[1], left.shape[1]
    reference, candidates = left.ravel(), right.ravel()
    n = len(left_column) - 2 * radius
    never = np.int64(windows[0])

    columns[:] = 0
    zero = load(columns, 0, lanes)
    for y in range(first - radius - 1, first + radius):
        source = max(y, 0)
        for j in range(n + 2 * radius):
            new = load(candidates, source * stride + np.intp(right_start[j]), lanes)
            new = absolute_difference(new, fill_from(reference, source * left_stride + np.intp(left_column[j]), new))
            store(load(columns, j * size, lanes) + widen(new, zero), columns, j * size)

    for y in range(first, last):
        entering, leaving = y + radius, max(y - radius - 1, 0)
        enter, leave = entering * stride, leaving * stride
        enter_left, leave_left = entering * left_stride, leaving * left_stride
        if right_sum is not None:
            right_sum[:] = never
        sums = load(windows, 32, lanes)
        sums = sums - sums
        begin = -2 * radius
        while begin < n:
            # up to the first pixel the window only gains columns; from there on, tile by tile, it also loses them
            pixels = 2 * radius if begin < 0 else min(TILE, n - begin)
            for i in range(pixels):
                j = begin + 2 * radius + i
                start, column = np.intp(right_start[j]), np.intp(left_column[j])
                new, old = load(candidates, enter + start, lanes), load(candidates, leave + start, lanes)
                new = absolute_difference(new, fill_from(reference, enter_left + column, new))
                old = absolute_difference(old, fill_from(reference, leave_left + column, old))
                if signed is None:
                    gained = load(columns, j * size, lanes) + widen(new, zero) - widen(old, zero)
                else:
                    gained = load(columns, j * size, lanes) + widen_signed(new - old, zero)
                store(gained, columns, j * size)
                sums = sums + widen(gained, sums)
                if begin >= 0:
                    ranked = sums
                    if beyond is not None:
                        ranked = sums | load(beyond, 0, lanes)
                    store(ranked, windows, 32 + i * pitch)
                    tile[i] = smallest(ranked)
                    sums = sums - widen(load(columns, (begin + i) * size, lanes), sums)
            if begin >= 0:
                if right_sum is not None:
                    for i in range(pixels):
                        there = first_x + begin + i - d_max
                        ranked = load(windows, 32 + i * pitch, lanes)
                        met, before = load(right_sum, there, lanes), load(right_winner, there, lanes)
                        here = fill(first_x + begin + i, before)
                        store(where_at_most(ranked, met, here, before), right_winner, there)
                        store(where_at_most(ranked, met, ranked, met), right_sum, there)
                for i in range(pixels):
                    limit = tile[i] + np.floor(np.float64(tile[i]) * uniqueness_ratio / 100.0)
                    tile[TILE + i] = np.int32(min(limit, np.float64(never - 1)))
                for i in range(pixels):
                    ranked = load(windows, 32 + i * pitch, lanes)
                    tile[2 * TILE + i], tile[3 * TILE + i] = first_and_count_at_most(ranked, tile[TILE + i])
                for i in range(pixels):
                    around = np.uintp(31 + i * pitch) + np.uintp(tile[2 * TILE + i])  # unsigned: not from the end
                    for s in range(4):
                        tile[(4 + s) * TILE + i] = windows[around + np.uintp(s)]
                chosen = winners[begin : begin + pixels]
                disparity = out[y, first_x + begin : first_x + begin + pixels]
                choose_winners(tile, pixels, uniqueness_ratio > 0, chosen, disparity)
                refine_tile(tile, pixels, chosen, d_max, count, subpixel, disparity)
                if cost.size > 0:
                    cost[y, first_x + begin : first_x + begin + pixels] = tile[:pixels]
            begin += pixels
        if right_winner is not None:
            check_left_right(winners, right_winner, d_max, left_right, y, first_x, out)
