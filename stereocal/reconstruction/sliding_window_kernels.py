# mypy: allow-untyped-defs
"""Kernels of block matching: a window slides over the image and the sums in it are updated, not summed anew.

The sum of absolute differences over the window of (2r + 1)² pixels around (x, y), at each disparity d,

    S(x, y, d) = Σ_{i,j = −r…r} |L(x + i, y + j) − R(x + i − d, y + j)|,

is a sum of column sums, C(x, y, d) = Σ_j |L(x, y + j) − R(x − d, y + j)|. Going down a row, each column gains one
pixel and loses one; going right by a pixel, the window gains one column and loses one:

    C(x, y, d) = C(x, y − 1, d) + |L(x, y + r) − R(x − d, y + r)| − |L(x, y − r − 1) − R(x − d, y − r − 1)|
    S(x, y, d) = S(x − 1, y, d) + C(x + r, y, d) − C(x − r − 1, y, d),

so that the work does not depend on the block size, and the memory is one row of columns, O(W·D). The differences of the
row that leaves are computed again: that is quicker than to have stored them. For the first window of a row there stand
2r + 1 columns of zeros before the first, so that the sum over the columns that enter needs no other loop.

Disparities are counted DOWN: k = 0 … D − 1 stands for d = d_max − k, because R(x − d) then lies in memory in the order
of k. The smallest k wins a tie: the largest disparity, as in OpenCV.

The kernel comes twice, :func:`match_rows` in plain loops and :func:`match_rows_vector` with the D sums as ONE value
(:mod:`stereocal.reconstruction.vector_primitives`) that stays in registers along the row; the tests hold them equal.

**How the second finds the winner.** To find the smallest of D numbers and then where it is, and then who else is near,
takes long not because it is much work but because each step waits for the one before. So it is done in phases over a
tile of pixels, in which the pixels do not wait for each other: the sums and their minimum m; the limit of uniqueness
ℓ = m + ⌊m u/100⌋; the first lane t with S ≤ ℓ, the number c of such lanes, from the same comparison, and the four sums
around t. That is enough: if the winner is unique, all lanes with S ≤ ℓ lie within 1 of it, so it is t or t + 1. What
remains is done for 16 pixels at once, with conditions joined by | and & instead of branches.

**16 bits or 32.** Numbers of 16 bits take half the registers and half the time of 32. Sums over large windows may not
fit into them, but mostly do: the images would have to differ everywhere. So the kernel tries, and watches. A step along
the row adds no more than the greatest column sum, c_max (2r + 1) with c_max the greatest pixel value; as long as no sum
has come within that of 2¹⁶, none has passed it unseen. If one comes that near, the kernel stops, and the rows from
there on are done with 32 bits.

Arguments that both kernels share:

left, right : (H, W) uint8
    Grey or prefiltered images. For the vector kernel `right` has room for `lanes` candidates at each start.
left_column, right_start : (n + 2r,) intp
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
    count_at_most,
    element,
    fill,
    fill_from,
    first_and_count_at_most,
    load,
    maximum,
    smallest,
    store,
    where_at_most,
    widen,
    widen_signed,
)

TILE = 48
"""Pixels of which the vector kernel takes a step together."""


@njit(cache=True, nogil=True, error_model="numpy")
def refined(k, below, least, above, d_max, count, subpixel):
    """The disparity of winner k from S(d − 1), S(d), S(d + 1); all in float64, which holds these integers exactly."""
    d = np.float64(d_max - k)
    slope = below - above
    inside = (k > 0) & (k < count - 1)
    if subpixel == 1:  # OpenCV's, in sixteenths of a pixel; p + n − 2m + |p − n| is 2 (max(p, n) − m)
        fraction = np.trunc(128.0 * slope / max(max(below, above) - least, 0.5))
        value = np.floor((256.0 * d + (fraction if inside else 0.0) + 15.0) * 0.0625) * 0.0625
    elif subpixel == 2:
        curvature = below + above - 2.0 * least
        fraction = 0.5 * slope / max(curvature, 1.0)
        value = d + (fraction if inside & (curvature > 0.0) else 0.0)
    else:
        value = d
    return np.float32(value if k >= 0 else np.nan)


@njit(cache=True, nogil=True, error_model="numpy")
def refined_narrow(k, below, least, above, d_max, count):
    """OpenCV's refinement of sums below 2¹⁶ in float32, sixteen pixels at a time: equal to :func:`refined`.

    The quotient a/b is not an integer unless b divides a, and then at least 1/b > 2⁻¹⁶ away from one, while rounding to
    float32 moves a number up to 128 by at most 2⁻¹⁸: it never carries the quotient over an integer.
    """
    d = np.float32(d_max - k)
    inside = (k > 0) & (k < count - 1)
    depth = max(max(below, above) - least, np.float32(0.5))
    fraction = np.trunc(np.float32(128.0) * (below - above) / depth)
    sixteenth = np.float32(0.0625)
    steps = np.float32(256.0) * d + (fraction if inside else np.float32(0.0)) + np.float32(15.0)
    value = np.floor(steps * sixteenth) * sixteenth
    return value if k >= 0 else np.float32(np.nan)


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
        one, two = s2 <= limit, later & (s3 <= limit)  # these neighbours are within the limit as they may be
        crowded = (found > 3) | ((found == 3) & ~(one & two)) | ((found == 2) & ~(one | two))
        rejected = unique & (crowded | (s3 < s1) & (s3 < s2)) | (disparity[i] != disparity[i])
        winners[i] = np.int32(-1) if rejected else (np.int32(t + 1) if later else t)


@njit(cache=True, nogil=True, error_model="numpy")
def refine_tile(tile, size, winners, d_max, count, subpixel, narrow, disparity):
    """Write the disparities of a tile; `tile` and `winners` as in :func:`choose_winners`."""
    for i in range(size):
        s0, s1 = tile[4 * TILE + i], tile[5 * TILE + i]
        s2, s3 = tile[6 * TILE + i], tile[7 * TILE + i]
        later = s2 < s1
        below, least, above = (s3 if later else s2), (s2 if later else s1), (s1 if later else s0)
        if narrow is None:
            disparity[i] = refined(
                winners[i], np.float64(below), np.float64(least), np.float64(above), d_max, count, subpixel
            )
        else:
            disparity[i] = refined_narrow(
                winners[i], np.float32(below), np.float32(least), np.float32(above), d_max, count
            )


@njit(cache=True, nogil=True)
def meet_right(windows, size, lanes, x, there, right_sum, right_winner):
    """Let each pixel of the right image keep the smallest S it has met, and where; a tie goes to the later x."""
    pitch = 16 * len(lanes) + 32
    for i in range(size):
        ranked = load(windows, 32 + i * pitch, lanes)
        met, before = load(right_sum, there + i, lanes), load(right_winner, there + i, lanes)
        store(where_at_most(ranked, met, fill(x + i, before), before), right_winner, there + i)
        store(where_at_most(ranked, met, ranked, met), right_sum, there + i)


@njit(cache=True, nogil=True, error_model="numpy")
def find_winners(windows, size, lanes, uniqueness_ratio, never, tile):
    """From the sums of a tile's pixels and their minima m: ℓ, t, c and the sums around t, see :func:`choose_winners`.

    The half in ℓ = m + ⌊(m u + ½)/100⌋ keeps the quotient, of which the floor is taken, clear of integers, so that it
    may be had by a multiplication.
    """
    pitch = 16 * len(lanes) + 32
    for i in range(size):
        limit = tile[i] + np.floor((np.float64(tile[i]) * uniqueness_ratio + 0.5) * 0.01)
        tile[TILE + i] = np.int32(min(limit, np.float64(never - 1)))
    for i in range(size):
        window = 32 + i * pitch
        t, found = first_and_count_at_most(load(windows, window, lanes), tile[TILE + i])
        tile[2 * TILE + i], tile[3 * TILE + i] = t, found
        tile[4 * TILE + i] = element(windows, window + t - 1)
        tile[5 * TILE + i] = element(windows, window + t)
        tile[6 * TILE + i] = element(windows, window + t + 1)
        tile[7 * TILE + i] = element(windows, window + t + 2)


@njit(cache=True, nogil=True)
def fill_columns(left, right, left_column, right_start, radius, first, lanes, blank, columns):
    """Write C as it is one row above the first: rows first − r − 1 … first + r − 1, and above the image row 0."""
    size = 16 * len(lanes)
    reference, candidates = left.ravel(), right.ravel()
    columns[:] = 0
    zero = load(columns, 0, lanes)
    for y in range(first - radius - 1, first + radius):
        here, there = max(y, 0) * left.shape[1], max(y, 0) * right.shape[1]
        for j in range(len(left_column)):
            new = load(candidates, there + element(right_start, j), lanes)
            new = absolute_difference(new, fill_from(reference, here + element(left_column, j), new))
            at = blank + j * size
            store(load(columns, at, lanes) + widen(new, zero), columns, at)


@njit(cache=True, nogil=True, error_model="numpy")
def match_rows_vector(
    left, right, left_column, right_start, radius, rows, search,
    lanes, columns, windows, beyond, signed, narrow, highest, tile, winners, right_sum, right_winner, out, cost,
):  # fmt: skip
    """Match rows by the smallest S, the D sums as one value; return the first row that was not done.

    Parameters
    ----------
    lanes : tuple
        D, rounded up to a multiple of 16, as a type: see ``vector_primitives.lanes_of``.
    columns : ((n + 4r + 1) · lanes,) uint16
        Scratch: 2r + 1 columns of zeros, then C.
    windows : (32 + T (lanes + 32),) uint16 or uint32
        Scratch: S of the T pixels of a tile, 32 guards before and after each, which no sum reaches. Enters filled
        with the guard.
    beyond : (lanes,) of the type of S, or None
        The guard in the lanes k ≥ D, so that they never win; None if there are no such lanes.
    signed : True or None
        True if no image value is above 127, so that the difference of two differences fits into 8 bits, and that of
        two columns into 16.
    narrow : True or None
        True to refine by :func:`refined_narrow`: S is uint16 and `subpixel` OpenCV's.
    highest : int or None
        Where S is uint16 and may not fit: the greatest S from which one step does not lead beyond 2¹⁶ − 1.
    tile : (8 T,) int32
        Scratch: what is found about each pixel of a tile, see :func:`choose_winners`.
    right_sum, right_winner : (W + lanes,)
        None if `left_right` is −1; `right_sum` has the type of S.
    """
    first_x, d_max, count, uniqueness_ratio, subpixel, left_right = search
    first, last = rows
    size = 16 * len(lanes)
    blank = (2 * radius + 1) * size
    stride, left_stride = right.shape[1], left.shape[1]
    reference, candidates = left.ravel(), right.ravel()
    n = len(left_column) - 2 * radius
    never = np.int64(windows[0])
    fill_columns(left, right, left_column, right_start, radius, first, lanes, blank, columns)
    zero = load(columns, 0, lanes)

    for y in range(first, last):
        entering, leaving = y + radius, max(y - radius - 1, 0)
        enter, leave = entering * stride, leaving * stride
        enter_left, leave_left = entering * left_stride, leaving * left_stride
        if right_sum is not None:
            right_sum[:] = never
        sums = load(windows, 32, lanes)
        sums = sums - sums
        seen = sums
        begin = -2 * radius
        while begin < n:
            # up to the first pixel the columns are only summed; from there on, tile by tile, the sums are ranked too
            pixels = 2 * radius if begin < 0 else min(TILE, n - begin)
            for i in range(pixels):
                j = begin + 2 * radius + i
                start, column = element(right_start, j), element(left_column, j)
                new, old = load(candidates, enter + start, lanes), load(candidates, leave + start, lanes)
                new = absolute_difference(new, fill_from(reference, enter_left + column, new))
                old = absolute_difference(old, fill_from(reference, leave_left + column, old))
                gained, lost = load(columns, blank + j * size, lanes), load(columns, j * size, lanes)
                if signed is None:
                    gained = gained + widen(new, zero) - widen(old, zero)
                    sums = sums + widen(gained, sums) - widen(lost, sums)
                else:
                    gained = gained + widen_signed(new - old, zero)
                    sums = sums + widen_signed(gained - lost, sums)
                store(gained, columns, blank + j * size)
                if highest is not None:
                    seen = maximum(seen, sums)
                if begin >= 0:
                    ranked = sums
                    if beyond is not None:
                        ranked = sums | load(beyond, 0, lanes)
                    store(ranked, windows, 32 + i * (size + 32))
                    tile[i] = smallest(ranked)
            if highest is not None and count_at_most(seen, highest) < size:
                return y
            if begin >= 0:
                if right_sum is not None:
                    x = first_x + begin
                    meet_right(windows, pixels, lanes, x, x - d_max, right_sum, right_winner)
                find_winners(windows, pixels, lanes, uniqueness_ratio, never, tile)
                chosen = winners[begin : begin + pixels]
                disparity = out[y, first_x + begin : first_x + begin + pixels]
                choose_winners(tile, pixels, uniqueness_ratio > 0, chosen, disparity)
                refine_tile(tile, pixels, chosen, d_max, count, subpixel, narrow, disparity)
                if cost.size > 0:
                    cost[y, first_x + begin : first_x + begin + pixels] = tile[:pixels]
            begin += pixels
        if right_winner is not None:
            check_left_right(winners, right_winner, d_max, left_right, y, first_x, out)
    return last
