# mypy: allow-untyped-defs
"""Kernels of semi-global matching: the recursion along the paths, and the winner of each pixel.

The D numbers of a pixel are one value (:mod:`stereocal.reconstruction.vector_primitives`), lane i standing for
d = min_disparity + i. Of a path's cost L only differences matter, so what is kept is N = L − min L, whose least
number is 0. The recursion is then three minima and two sums, in 8 bits:

    L(p, d) = C(p, d) + min(N(q, d), N(q, d − 1) + P1, N(q, d + 1) + P1, P2),      q the pixel before p on the path.

L never exceeds C + P2, which the façade keeps within 255, and where a sum would, it stays at 255 and loses every
minimum, as it should.

Paths that come from the row before need that row's N, one row for each of three directions. They are updated in
place: at x, the path from x − 1 asks for a number that has just been overwritten, so that one is carried along.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from stereocal.reconstruction.vector_lanes import (
    add_saturated,
    from_above,
    from_below,
    last_lane,
    less_smallest,
    minimum,
)
from stereocal.reconstruction.vector_primitives import (
    count_at_most,
    element,
    fill,
    fill_from,
    first_and_count_at_most,
    load,
    smallest,
    store,
    widen,
)

# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, **INNER)
def extend_path(cost, before, P1, P2, most):
    """L of a pixel, from its cost and the N of the pixel before it on the path."""
    stepped = add_saturated(minimum(from_below(before, most), from_above(before, most)), P1)
    return add_saturated(cost, minimum(minimum(before, P2), stepped))


@njit(cache=True, nogil=True)
def sweep_rows(
    cost, guide, penalties, P1, top, rows, with_diagonals, lanes, state, total, mode, sums,
    count, min_disparity, uniqueness_ratio, subpixel, tolerance, start, inside, beyond, right_least, found,
    out,
):  # fmt: skip
    """Follow the paths that come from the left and from above over some rows; or those from the right and from below.

    Parameters
    ----------
    cost : (rows · W · lanes,) uint8
        C of a strip of rows, 255 in the lanes that are no disparities.
    guide : ((H + 2) · (W + 2),) uint8
        The left image with a margin of one pixel, whose values do not matter.
    penalties : (511,) uint8
        P2 by the difference of grey values between the two pixels, −255 … 255.
    P1 : int
    top : int
        The strip's topmost row.
    rows : (first, end)
        The rows in the order in which they are visited, `end` not included: downwards if first < end, with x going
        right; upwards otherwise, with x going left.
    with_diagonals : bool
        Whether the two diagonal paths are followed beside those along the row and the column.
    lanes : tuple
        The lanes, as a type.
    state : (3 · (W + 2) · lanes,) uint8
        N of the row before, for the diagonal path from behind, the vertical one and the diagonal one from ahead, each
        with a pixel of zeros on both sides. Enters as zeros at the image's border; is left for the next call.
    total : (rows · W · lanes,) uint16
        The sums of L over the paths, of the strip.
    mode : int
        0: only the state is wanted; 1: the sums are written; 2: they are added to those that another sweep has written,
        and the disparity is taken.
    sums : (W · lanes,) uint16
        Scratch: the sums of a row over all paths.
    count, …, found
        As in :func:`select_row`.
    out : (H, W) float32
        The disparity.
    """
    first, end = rows
    step = 1 if first < end else -1
    width = out.shape[1]
    D = len(beyond)
    behind, vertical, ahead = D, (width + 3) * D, (2 * width + 5) * D  # where x = 0 stands in `state`
    none = load(cost, 0, lanes)
    none = none - none
    wide = widen(none, load(beyond, 0, lanes))
    most = fill(255, none)
    small = fill(P1, none)
    x_first = 0 if step > 0 else width - 1
    for y in range(first, end, step):
        row = (y - top) * width * D
        pixel = (y + 1) * (width + 2) + 1  # where x = 0 stands in `guide`, and …
        above = pixel - step * (width + 2)  # … the pixel of the row before
        along, from_behind = none, none
        x = x_first
        for _ in range(width):
            at = x * D
            value = 255 + np.int64(element(guide, pixel + x))
            C = load(cost, row + at, lanes)

            P2 = fill_from(penalties, value - np.int64(element(guide, pixel + x - step)), none)
            L = extend_path(C, along, small, P2, most)
            along = less_smallest(L)
            S = widen(L, wide)
            P2 = fill_from(penalties, value - np.int64(element(guide, above + x)), none)
            L = extend_path(C, load(state, vertical + at, lanes), small, P2, most)
            store(less_smallest(L), state, vertical + at)
            S = S + widen(L, wide)
            if with_diagonals:
                P2 = fill_from(penalties, value - np.int64(element(guide, above + x - step)), none)
                L = extend_path(C, from_behind, small, P2, most)
                from_behind = load(state, behind + at, lanes)
                store(less_smallest(L), state, behind + at)
                S = S + widen(L, wide)
                P2 = fill_from(penalties, value - np.int64(element(guide, above + x + step)), none)
                L = extend_path(C, load(state, ahead + at + step * D, lanes), small, P2, most)
                store(less_smallest(L), state, ahead + at)
                S = S + widen(L, wide)

            if mode == 1:
                store(S, total, row + at)
            elif mode == 2:
                store(S + load(total, row + at, lanes), sums, at)
            x += step
        if mode == 2:
            select_row(
                sums, 0, count, min_disparity, uniqueness_ratio, subpixel, tolerance, start, inside, beyond,
                right_least, found, lanes, out[y],
            )  # fmt: skip


@njit(cache=True, nogil=True)
def follow_from_right(cost, guide, penalties, P1, rows, width, lanes, total):
    """Follow the path that comes from the right alone, and write its L.

    Each pixel of a path waits for the one before it. So two rows are followed at once, and one is worked on while the
    other waits.

    Parameters
    ----------
    cost, guide, penalties, P1, lanes, total
        As in :func:`sweep_rows`.
    rows : (first, end)
        The rows of the strip.
    width : int
        W.
    """
    first, end = rows
    D = 16 * len(lanes)
    none = load(cost, 0, lanes)
    none = none - none
    wide = widen(none, load(total, 0, lanes))
    most = fill(255, none)
    small = fill(P1, none)
    for y in range(first, end, 2):
        y_other = min(y + 1, end - 1)  # the last row of an odd number is done twice
        row, row_other = (y - first) * width * D, (y_other - first) * width * D
        pixel, pixel_other = (y + 1) * (width + 2) + 1, (y_other + 1) * (width + 2) + 1
        along, along_other = none, none
        for x in range(width - 1, -1, -1):
            step = np.int64(element(guide, pixel + x)) - np.int64(element(guide, pixel + x + 1))
            P2 = fill_from(penalties, 255 + step, none)
            L = extend_path(load(cost, row + x * D, lanes), along, small, P2, most)
            along = less_smallest(L)
            store(widen(L, wide), total, row + x * D)
            step = np.int64(element(guide, pixel_other + x)) - np.int64(element(guide, pixel_other + x + 1))
            P2 = fill_from(penalties, 255 + step, none)
            L = extend_path(load(cost, row_other + x * D, lanes), along_other, small, P2, most)
            along_other = less_smallest(L)
            store(widen(L, wide), total, row_other + x * D)


@njit(cache=True, nogil=True)
def select_rows(
    sums, count, min_disparity, uniqueness_ratio, subpixel, tolerance, start, inside, beyond, right_least, found,
    lanes, out,
):  # fmt: skip
    """Take the winner of each pixel of some rows: :func:`select_row` for each of them."""
    for y in range(len(out)):
        select_row(
            sums, y * out.shape[1] * len(beyond), count, min_disparity, uniqueness_ratio, subpixel, tolerance, start,
            inside, beyond, right_least, found, lanes, out[y],
        )  # fmt: skip


@njit(cache=True, nogil=True, **INNER)
def select_row(
    sums, row, count, min_disparity, uniqueness_ratio, subpixel, tolerance, start, inside, beyond,
    right_least, found, lanes, out,
):  # fmt: skip
    """Take the winner of each pixel of a row: the rules of :mod:`stereocal.reconstruction.winner`.

    The right image's view goes along. The right pixel x' meets the candidate i of the left pixel x' + d, so the least
    sum that it has met so far moves on by one lane with each x, until it leaves at the last.

    Parameters
    ----------
    sums : (· lanes,) uint16
        S.
    row : int
        Where the row begins in `sums`.
    count, min_disparity : int
        The disparities.
    uniqueness_ratio : int
        u.
    subpixel : bool
        Whether to fit the V.
    tolerance : int
        t of the left-right check; -1 does not check.
    start : int
        Where the right pixel −min_disparity stands in a flipped row: the candidate i of x stands at start − x + i.
    inside : (flipped width,) uint8
        Whether there is a right pixel at that place of the flipped row.
    beyond : (lanes,) uint16
        All bits set in the lanes i ≥ count.
    right_least : (flipped width,) uint16
        Scratch: the least S that each right pixel has met.
    found : (4, W) int32
        Scratch: see :func:`note_winner`.
    lanes : tuple
        The lanes, as a type.
    out : (W,) float32
    """
    D = len(beyond)
    no_disparity = load(beyond, 0, lanes)
    never = fill(65535, no_disparity)
    right = never
    for x in range(len(out)):
        S = load(sums, row + x * D, lanes) | no_disparity
        note_winner(S, sums, row + x * D, x, start - x, count, uniqueness_ratio, inside, found)
        if tolerance >= 0:
            right = minimum(from_below(right, never), S)
            right_least[start - x + D - 1] = last_lane(right)
    refine_row(found, min_disparity, subpixel, out)
    if tolerance >= 0:
        store(right, right_least, start - len(out) + 1)
        check_row(found, sums, row, count, min_disparity, tolerance, start, inside, right_least, D, out)


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def note_winner(S, sums, at, x, there, count, uniqueness_ratio, inside, found):
    """Write what is known of the pixel x: the winner i (-1 if there is none), and S at i, at i − 1 and at i + 1.

    At either end of the disparities, where one neighbour is missing, both are given as S(i): no fraction.
    """
    least = smallest(S)
    i, close = first_and_count_at_most(S, least)
    limit = least
    if uniqueness_ratio > 0:
        limit = min(max((100 * least - 1) // (100 - uniqueness_ratio), least), 65534)
        close = count_at_most(S, limit)
    interior = (i > 0) & (i < count - 1)
    below = np.int64(element(sums, at + max(i - 1, 0)))
    above = np.int64(element(sums, at + min(i + 1, count - 1)))
    beside = np.int64((below <= limit) & (i > 0)) + np.int64((above <= limit) & (i < count - 1))
    alone = close <= 1 + beside  # no rival but the neighbours
    found[0, x] = i if alone & (element(inside, there + i) > 0) else -1
    found[1, x] = least
    found[2, x] = below if interior else least
    found[3, x] = above if interior else least


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def refine_row(found, min_disparity, subpixel, out):
    """Write the disparities of a row, with the fraction at which the V has its vertex; NaN where none has won."""
    for x in range(len(out)):
        d = np.float64(min_disparity + found[0, x])
        if subpixel:
            rise = max(found[2, x], found[3, x]) - found[1, x]
            d += np.float64(found[2, x] - found[3, x]) / np.float64(2 * max(rise, 1))
        out[x] = np.float32(d) if found[0, x] >= 0 else np.float32(np.nan)


@njit(cache=True, nogil=True, **INNER)
def check_row(found, sums, row, count, min_disparity, tolerance, start, inside, right_least, D, out):
    """Take the disparities back with which the right image does not agree."""
    for x in range(len(out)):
        i = np.int64(found[0, x])
        # Most pixels are their partner's best as well: that settles it.
        if i >= 0 and np.int64(element(right_least, start - x + i)) != found[1, x]:
            low, high = np.int64(np.floor(out[x])) - min_disparity, np.int64(np.ceil(out[x])) - min_disparity
            if not (
                right_agrees(low, x, len(out), sums, row, count, tolerance, start, inside, right_least, D)
                or right_agrees(high, x, len(out), sums, row, count, tolerance, start, inside, right_least, D)
            ):
                out[x] = np.nan


@njit(cache=True, nogil=True, **INNER)
def right_agrees(i, x, width, sums, row, count, tolerance, start, inside, right_least, D):
    """Whether the right pixel of the candidate i of x has a best candidate that is within the tolerance of i."""
    here = start - x + i
    if element(inside, here) == 0:
        return False
    least = element(right_least, here)
    for k in range(max(i - tolerance, 0), min(i + tolerance + 1, count)):
        partner = x - i + k  # the left pixel that this right one would be matched to
        if 0 <= partner < width and element(sums, row + partner * D + k) == least:
            return True
    return False
