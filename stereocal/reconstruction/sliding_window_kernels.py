# mypy: allow-untyped-defs
"""Kernels of block matching: a window slides over the image and the sums in it are updated, not summed anew.

The sum of absolute differences over the window of (2r + 1)² pixels around (x, y), at each disparity d, is

    S(x, y, d) = Σ_{i,j = −r…r} |L(x + i, y + j) − R(x + i − d, y + j)|.

When the window goes down a row, each of its columns gains a pixel below and loses one above. Let g be what column x
gains by that, and G what the window gains:

    g(x, d) = |L(x, y + r) − R(x − d, y + r)| − |L(x, y − r − 1) − R(x − d, y − r − 1)|
    G(x, d) = Σ_i g(x + i, d) = G(x − 1, d) + g(x + r, d) − g(x − r − 1, d)
    S(x, y, d) = S(x, y − 1, d) + G(x, d).

So the work does not depend on the block size, and the memory is the sums of one row, O(W·D), with the last 2r + 1 g's
in a ring. That g is small is what makes this quick: with StereoBM's filtered images a difference of two g's fits into
8 bits, so that half of the work is done on numbers of one byte. (The better known way keeps the column sums and adds
the one that enters and subtracts the one that leaves: twice the memory to pass by at each pixel, and all of 16 bits.)
The sums of the row above the first are had in the same way, with the sums down the columns in the place of g.

Disparities are counted DOWN: k = 0 … D − 1 stands for d = d_max − k, because R(x − d) then lies in memory in the order
of k. The smallest k wins a tie: the largest disparity, as in OpenCV.

The kernel comes twice, :func:`match_rows` in plain loops and :func:`match_rows_vector` with the D sums as ONE value
(:mod:`stereocal.reconstruction.vector_primitives`), G in registers along the row; the tests hold them equal.

**How the second finds the winner.** To find the smallest of D numbers and then where it is, and then who else is near,
takes long not because it is much work but because each step waits for the one before. So it is done in phases over a
tile of pixels, in which the pixels do not wait for each other: the sums and their minimum m; the limit of uniqueness
ℓ = m + ⌊m u/100⌋; the first lane t with S ≤ ℓ, the number c of such lanes, from the same comparison, and the four sums
around t. That is enough: if the winner is unique, all lanes with S ≤ ℓ lie within 1 of it, so it is t or t + 1. What
remains is done for 16 pixels at once, with conditions joined by | and & instead of branches.

**16 bits or 32.** Numbers of 16 bits take half the registers and half the time of 32. Sums over large windows may not
fit into them, but mostly do: the images would have to differ everywhere. So the kernel tries, and watches. A step, down
a row or along it, adds no more than the greatest column sum, c_max (2r + 1) with c_max the greatest pixel value; as
long as no sum has come within that of 2¹⁶, none has passed it unseen. If one comes that near, the kernel stops, and the
rows from there on are done with 32 bits.

Arguments that both kernels share:

left, right : (H, W) uint8
    Grey or prefiltered images. For the vector kernel `right` has room for `lanes` candidates at each start.
left_column, right_start : (n + 2r,) intp
    For each column of a window: where it stands in `left`, and where its candidate k = 0 stands in `right`.
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
    absolute_difference_of_halves,
    copy_four,
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

FAR = np.int32(2147483647)
"""More than any sum: what stands beside the first and the last disparity."""

# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy")
def refined_opencv(k, below, least, above, d_max, count):
    """OpenCV's disparity of winner k from S(d − 1), S(d), S(d + 1), in sixteenths; p + n − 2m + |p − n| is 2 (max − m).

    The sums come as float64, which holds these integers exactly, or as float32 if they are below 2¹⁶: the quotient a/b
    is not an integer unless b divides a, and then at least 1/b > 2⁻¹⁶ away from one, while rounding to float32 moves
    a number up to 128 by at most 2⁻¹⁸: it never carries the quotient over an integer.
    """
    d = np.float32(np.int32(d_max - k))
    inside = (k > 0) & (k < np.int32(count - 1))
    depth = max(max(below, above) - least, np.float32(0.5))
    fraction = np.float32(np.trunc(np.float32(128.0) * (below - above) / depth))
    sixteenth = np.float32(0.0625)
    steps = np.float32(256.0) * d + (fraction if inside else np.float32(0.0)) + np.float32(15.0)
    value = np.floor(steps * sixteenth) * sixteenth
    return value if k >= 0 else np.float32(np.nan)


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def refined(k, below, least, above, d_max, count, subpixel):
    """The disparity of winner k from S(d − 1), S(d), S(d + 1) in float64; `subpixel` as in :func:`match_rows`."""
    if subpixel == 1:
        return refined_opencv(k, below, least, above, d_max, count)
    curvature = below + above - 2.0 * least
    parabola = (subpixel == 2) & (k > 0) & (k < count - 1) & (curvature > 0.0)
    fraction = 0.5 * (below - above) / max(curvature, 1.0)
    value = np.float64(d_max - k) + (fraction if parabola else 0.0)
    return np.float32(value if k >= 0 else np.nan)


@njit(cache=True, nogil=True, **INNER)
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
    sums, window_gain, ring, winners, right_sum, right_winner, out, cost,
):  # fmt: skip
    """Match rows by the smallest S: plain loops.

    Parameters
    ----------
    sums : (n, D) int32
        Scratch: S.
    window_gain : (D,) int32
        Scratch: G.
    ring : (2r + 1, D) int32
        Scratch: the last g's.
    """
    first_x, d_max, count, uniqueness_ratio, subpixel, left_right = search
    first, last = rows
    n = len(left_column) - 2 * radius
    window_gain[:] = 0
    ring[:] = 0
    for j in range(n + 2 * radius):
        slot = j % (2 * radius + 1)
        for k in range(count):
            column = 0
            for y in range(first - radius - 1, first + radius):
                there = np.int64(right[max(y, 0), np.intp(right_start[j]) + k])
                column += abs(np.int64(left[max(y, 0), left_column[j]]) - there)
            window_gain[k] += column - ring[slot, k]
            ring[slot, k] = column
            if j >= 2 * radius:
                sums[j - 2 * radius, k] = window_gain[k]

    for y in range(first, last):
        entering, leaving = y + radius, max(y - radius - 1, 0)
        window_gain[:] = 0
        ring[:] = 0
        right_sum[:] = FAR
        for j in range(n + 2 * radius):
            new, old = np.int64(left[entering, left_column[j]]), np.int64(left[leaving, left_column[j]])
            start, slot = np.intp(right_start[j]), j % (2 * radius + 1)
            for k in range(count):
                gain = abs(new - np.int64(right[entering, start + k])) - abs(old - np.int64(right[leaving, start + k]))
                window_gain[k] += gain - ring[slot, k]
                ring[slot, k] = gain
            x = j - 2 * radius
            if x < 0:
                continue
            window = sums[x]
            for k in range(count):
                window[k] += window_gain[k]
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
        if left_right >= 0:
            check_left_right(winners, right_winner, d_max, left_right, y, first_x, out)


@njit(cache=True, nogil=True, **INNER)
def meet_right(sums, begin, size, lanes, beyond, first_x, d_max, right_sum, right_winner):
    """Let each pixel of the right image keep the smallest S it has met, and where; a tie goes to the later x."""
    for i in range(begin, begin + size):
        ranked = load(sums, 32 + i * 16 * len(lanes), lanes)
        if beyond is not None:
            ranked = ranked | load(beyond, 0, lanes)
        x = first_x + i
        met, before = load(right_sum, x - d_max, lanes), load(right_winner, x - d_max, lanes)
        store(where_at_most(ranked, met, fill(x, before), before), right_winner, x - d_max)
        store(where_at_most(ranked, met, ranked, met), right_sum, x - d_max)


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def find_winners(sums, begin, size, lanes, beyond, uniqueness_ratio, least, limit, first, found, around):
    """From the sums of a tile, pixels begin, begin + 1, … of a row, and their minima m: ℓ, t, c and the sums around t.

    The half in ℓ = m + ⌊(m u + ½)/100⌋ keeps the quotient, of which the floor is taken, clear of integers, so that it
    may be had by a multiplication.

    Parameters
    ----------
    least : (T,) int32
        m of each pixel.
    limit : (T,) of the type of S
        Written: ℓ.
    first, found : (T,) int32
        Written: t and c.
    around : (4 T,) of the type of S
        Written: S at t − 1, t, t + 1 and t + 2 of each pixel.
    """
    highest = 65534.0 if sums.itemsize == 2 else 2147483646.0
    for i in range(size):
        m = np.float64(least[i])
        limit[i] = min(m + np.floor((m * uniqueness_ratio + 0.5) * 0.01), highest)
    for i in range(size):
        window = 32 + (begin + i) * 16 * len(lanes)
        ranked = load(sums, window, lanes)
        if beyond is not None:
            ranked = ranked | load(beyond, 0, lanes)
        t, close = first_and_count_at_most(ranked, element(limit, i))
        first[i] = t
        found[i] = close
        copy_four(sums, window + t - 1, around, 4 * i)


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def refine_tile(limits, firsts, founds, around, unique, d_max, count, subpixel, opencv, winners, disparity):
    """Turn what was found about a tile's pixels into winners, t or t + 1 or −1 for none, and into disparities.

    Parameters
    ----------
    limits, firsts, founds, around
        As :func:`find_winners` leaves them.
    unique : bool
        Whether the winner must be unique.
    d_max, count : int32
    opencv : True or None
        True if `subpixel` is OpenCV's, which spares the loop the question.
    winners : (size,) int32 or None
        Written, if wanted.
    disparity : (size,) float32
        NaN where no disparity is wanted; written.
    """
    last = np.int32(count - 1)
    for i in range(len(disparity)):
        limit, t, found = np.int32(limits[i]), firsts[i], founds[i]
        s0, s1 = np.int32(around[4 * i]), np.int32(around[4 * i + 1])
        s2, s3 = np.int32(around[4 * i + 2]), np.int32(around[4 * i + 3])
        s2, s3 = (s2 if t < last else FAR), (s3 if t < np.int32(last - 1) else FAR)
        later = s2 < s1  # t + 1 rather than t
        one, two = s2 <= limit, later & (s3 <= limit)  # these neighbours are within the limit as they may be
        crowded = (found > 3) | ((found == 3) & ~(one & two)) | ((found == 2) & ~(one | two))
        rejected = unique & (crowded | (s3 < s1) & (s3 < s2)) | (disparity[i] != disparity[i])
        k = np.int32(-1) if rejected else np.int32(t + later)
        if winners is not None:
            winners[i] = k
        below, least, above = (s3 if later else s2), (s2 if later else s1), (s1 if later else s0)
        if opencv is None:
            p, m, q = np.float64(below), np.float64(least), np.float64(above)
            disparity[i] = refined(k, p, m, q, d_max, count, subpixel)
        elif limits.itemsize == 2:
            disparity[i] = refined_opencv(k, np.float32(below), np.float32(least), np.float32(above), d_max, count)
        else:
            disparity[i] = refined_opencv(k, np.float64(below), np.float64(least), np.float64(above), d_max, count)


@njit(cache=True, nogil=True, **INNER)
def distances(left, at, right, start, small, lanes):
    """|L − R| of the pixel left[at] and its candidates, which begin at right[start]."""
    candidates = load(right, start, lanes)
    if small is None:
        return absolute_difference(candidates, fill_from(left, at, candidates))
    return absolute_difference_of_halves(candidates, fill_from(left, at, candidates))


@njit(cache=True, nogil=True, **INNER)
def first_sums(left, right, left_column, right_start, radius, first, lanes, small, highest, columns, sums):
    """Write S one row above the first: rows first − r − 1 … first + r − 1, and above the image row 0.

    Returns whether all sums fit, see `highest` in :func:`match_rows_vector`.
    """
    size = 16 * len(lanes)
    reference, candidates = left.ravel(), right.ravel()
    columns[:] = 0
    zero = load(columns, 0, lanes)
    window = load(sums, 0, lanes)
    window = window - window
    seen = window
    slot = 0
    for j in range(len(left_column)):
        start, x = element(right_start, j), element(left_column, j)
        column = zero
        for y in range(first - radius - 1, first + radius):
            here, there = max(y, 0) * left.shape[1], max(y, 0) * right.shape[1]
            column = column + widen(distances(reference, here + x, candidates, there + start, small, lanes), zero)
        window = window + widen_signed(column - load(columns, slot, lanes), window)
        store(column, columns, slot)
        slot = slot + size if slot < 2 * radius * size else 0
        if highest is not None:
            seen = maximum(seen, window)
        if j >= 2 * radius:
            store(window, sums, 32 + (j - 2 * radius) * size)
    return highest is None or count_at_most(seen, highest) == size


@njit(cache=True, nogil=True, error_model="numpy")
def match_rows_vector(
    left, right, left_column, right_start, radius, rows, search,
    lanes, sums, columns, ring, beyond, small, opencv, highest, finds,
    winners, right_sum, right_winner, out, cost,
):  # fmt: skip
    """Match rows by the smallest S, the D sums as one value; return the first row that was not done.

    Parameters
    ----------
    lanes : tuple
        D, rounded up to a multiple of 16, as a type: see ``vector_primitives.lanes_of``.
    sums : (32 + n · lanes + 32,) uint16 or uint32
        Scratch: S of a row from 32 on.
    columns : ((2r + 1) · lanes,) uint16 or uint32
        Scratch: the last sums down a column; G has its type, for whose signed numbers c_max (2r + 1) is not too much.
    ring : ((2r + 1) · lanes,) uint8 or uint16
        Scratch: the last g's. uint8 if 2 c_max < 128.
    beyond : (lanes,) of the type of S, or None
        All ones in the lanes k ≥ D, so that they never win; None if there are no such lanes.
    small : True or None
        True if no image value is above 127.
    opencv : True or None
        True if `subpixel` is OpenCV's.
    highest : int or None
        Where S is uint16 and may not fit: the greatest S from which one step does not lead beyond 2¹⁶ − 1.
    finds : (least, limit, first, found, around)
        Scratch: what is found about each pixel of a tile, see :func:`find_winners`. T should be so small that the
        sums of a tile stay in the first cache.
    right_sum, right_winner : (W + lanes,)
        None if `left_right` is −1; `right_sum` has the type of S.
    """
    first_x, d_max, count, uniqueness_ratio, subpixel, left_right = search
    first, last = rows
    size = 16 * len(lanes)
    stride, left_stride = right.shape[1], left.shape[1]
    reference, candidates = left.ravel(), right.ravel()
    n = len(left_column) - 2 * radius
    if not first_sums(left, right, left_column, right_start, radius, first, lanes, small, highest, columns, sums):
        return first
    columns[:] = 0
    zero = load(columns, 0, lanes)
    least, limit, found_first, found, around = finds
    tile = len(least)

    for y in range(first, last):
        enter, leave = (y + radius) * stride, max(y - radius - 1, 0) * stride
        enter_left, leave_left = (y + radius) * left_stride, max(y - radius - 1, 0) * left_stride
        if right_sum is not None:
            right_sum[:] = -1  # all ones
        ring[:] = 0
        none = load(ring, 0, lanes)
        window_gain = zero
        for j in range(2 * radius):
            start, x = element(right_start, j), element(left_column, j)
            new = distances(reference, enter_left + x, candidates, enter + start, small, lanes)
            old = distances(reference, leave_left + x, candidates, leave + start, small, lanes)
            gain = widen(new, none) - widen(old, none)
            window_gain = window_gain + widen_signed(gain, zero)
            store(gain, ring, j * size)
        slot = 2 * radius * size
        seen = load(sums, 32, lanes)
        for begin in range(0, n, tile):
            pixels = min(tile, n - begin)
            for i in range(pixels):
                j, at = begin + 2 * radius + i, 32 + (begin + i) * size
                start, x = element(right_start, j), element(left_column, j)
                new = distances(reference, enter_left + x, candidates, enter + start, small, lanes)
                old = distances(reference, leave_left + x, candidates, leave + start, small, lanes)
                gain = widen(new, none) - widen(old, none)
                window_gain = window_gain + widen_signed(gain - load(ring, slot, lanes), zero)
                store(gain, ring, slot)
                slot = slot + size if slot < 2 * radius * size else 0
                S = load(sums, at, lanes)
                S = S + widen_signed(window_gain, S)
                store(S, sums, at)
                if highest is not None:
                    seen = maximum(seen, S)
                if beyond is not None:
                    S = S | load(beyond, 0, lanes)
                least[i] = smallest(S)
            if highest is not None and count_at_most(seen, highest) < size:
                return y
            find_winners(sums, begin, pixels, lanes, beyond, uniqueness_ratio, least, limit, found_first, found, around)
            disparity = out[y, first_x + begin : first_x + begin + pixels]
            chosen = None
            if right_winner is not None:
                meet_right(sums, begin, pixels, lanes, beyond, first_x, d_max, right_sum, right_winner)
                chosen = winners[begin : begin + pixels]
            refine_tile(
                limit, found_first, found, around, uniqueness_ratio > 0, np.int32(d_max), np.int32(count), subpixel,
                opencv, chosen, disparity,
            )  # fmt: skip
            if cost.size > 0:
                cost[y, first_x + begin : first_x + begin + pixels] = least[:pixels]
        if right_winner is not None:
            check_left_right(winners, right_winner, d_max, left_right, y, first_x, out)
    return last
