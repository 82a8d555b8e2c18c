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

from stereocal.reconstruction.vector_lanes import add_saturated, from_above, from_below, minimum
from stereocal.reconstruction.vector_primitives import (
    count_at_most,
    fill,
    first_equal,
    load,
    smallest,
    store,
    widen,
)


@njit(cache=True, nogil=True)
def extend_path(cost, before, P1, P2, most):
    """L of a pixel, from its cost and the N of the pixel before it on the path."""
    stepped = add_saturated(minimum(from_below(before, most), from_above(before, most)), P1)
    return add_saturated(cost, minimum(minimum(before, P2), stepped))


@njit(cache=True, nogil=True)
def sweep_rows(
    cost, guide, penalties, P1, top, rows, with_vertical, with_diagonals, lanes, state, total, mode,
    count, min_disparity, uniqueness_ratio, subpixel, tolerance, start, inside, beyond, right_least, winner,
    out,
):  # fmt: skip
    """Follow the paths that come from the left and from above over some rows; or those from the right and from below.

    Parameters
    ----------
    cost : (rows · W · lanes,) uint8
        C of a strip of rows, 255 in the lanes that are no disparities.
    guide : (H, W) uint8
        The left image.
    penalties : (256,) uint8
        P2 by the difference of grey values between the two pixels.
    P1 : int
    top : int
        The strip's topmost row.
    rows : (first, end)
        The rows in the order in which they are visited, `end` not included: downwards if first < end, with x going
        right; upwards otherwise, with x going left.
    with_vertical, with_diagonals : bool
        Whether the path along the column, and the two diagonal ones, are among the paths.
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
    count, …, winner
        As in :func:`select_row`.
    out : (H, W) float32
        The disparity.
    """
    first, end = rows
    step = 1 if first < end else -1
    height, width = guide.shape
    D = len(beyond)
    behind, vertical, ahead = D, (width + 3) * D, (2 * width + 5) * D  # where x = 0 stands in `state`
    none = load(cost, 0, lanes)
    none = none - none
    wide = widen(none, load(beyond, 0, lanes))
    most = fill(255, none)
    small = fill(P1, none)
    for y in range(first, end, step):
        y_before = min(max(y - step, 0), height - 1)
        row = (y - top) * width * D
        along = none
        from_behind = none
        for k in range(width):
            x = k if step > 0 else width - 1 - k
            at = x * D
            x_before, x_next = min(max(x - step, 0), width - 1), min(max(x + step, 0), width - 1)
            value = np.int64(guide[y, x])
            C = load(cost, row + at, lanes)

            P2 = fill(penalties[abs(value - np.int64(guide[y, x_before]))], none)
            L = extend_path(C, along, small, P2, most)
            along = L - fill(smallest(L), none)
            S = widen(L, wide)
            if with_vertical:
                P2 = fill(penalties[abs(value - np.int64(guide[y_before, x]))], none)
                L = extend_path(C, load(state, vertical + at, lanes), small, P2, most)
                store(L - fill(smallest(L), none), state, vertical + at)
                S = S + widen(L, wide)
            if with_diagonals:
                P2 = fill(penalties[abs(value - np.int64(guide[y_before, x_before]))], none)
                L = extend_path(C, from_behind, small, P2, most)
                from_behind = load(state, behind + at, lanes)
                store(L - fill(smallest(L), none), state, behind + at)
                S = S + widen(L, wide)
                P2 = fill(penalties[abs(value - np.int64(guide[y_before, x_next]))], none)
                L = extend_path(C, load(state, ahead + at + step * D, lanes), small, P2, most)
                store(L - fill(smallest(L), none), state, ahead + at)
                S = S + widen(L, wide)

            if mode == 2:
                store(S + load(total, row + at, lanes), total, row + at)
            elif mode == 1:
                store(S, total, row + at)
        if mode == 2:
            select_row(
                total, row, count, min_disparity, uniqueness_ratio, subpixel, tolerance, start, inside, beyond,
                right_least, winner, lanes, out[y],
            )  # fmt: skip


@njit(cache=True, nogil=True)
def select_rows(
    sums, count, min_disparity, uniqueness_ratio, subpixel, tolerance, start, inside, beyond, right_least, winner,
    lanes, out,
):  # fmt: skip
    """Take the winner of each pixel of some rows: :func:`select_row` for each of them."""
    for y in range(len(out)):
        select_row(
            sums, y * out.shape[1] * len(beyond), count, min_disparity, uniqueness_ratio, subpixel, tolerance, start,
            inside, beyond, right_least, winner, lanes, out[y],
        )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def select_row(
    sums, offset, count, min_disparity, uniqueness_ratio, subpixel, tolerance, start, inside, beyond,
    right_least, winner, lanes, out,
):  # fmt: skip
    """Take the winner of each pixel of a row: the rules of :mod:`stereocal.reconstruction.winner`.

    Parameters
    ----------
    sums : (· lanes,) uint16
        S.
    offset : int
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
    winner : (W,) int32
        Scratch.
    out : (W,) float32
    """
    D = len(beyond)
    none = load(beyond, 0, lanes)
    if tolerance >= 0:
        right_least[:] = 65535
    for x in range(len(out)):
        at = offset + x * D
        there = start - x
        S = load(sums, at, lanes) | none
        least = smallest(S)
        i = first_equal(S, least)
        if tolerance >= 0:
            store(minimum(load(right_least, there, lanes), S), right_least, there)
        value = np.float32(np.nan)
        winner[x] = -1
        if inside[there + i] > 0:
            interior = 0 < i < count - 1
            below = np.int64(sums[at + max(i - 1, 0)])
            above = np.int64(sums[at + min(i + 1, count - 1)])
            limit = min(max((100 * least - 1) // (100 - uniqueness_ratio), least), 65534)
            beside = (1 if i > 0 and below <= limit else 0) + (1 if i < count - 1 and above <= limit else 0)
            if count_at_most(S, limit) <= 1 + beside:  # no rival but the neighbours
                d = np.float64(min_disparity + i)
                rise = max(below, above) - least
                if subpixel and interior and rise > 0:
                    d += (below - above) / (2.0 * rise)
                value = np.float32(d)
                winner[x] = i
        out[x] = value
    if tolerance >= 0:
        for x in range(len(out)):
            i = winner[x]
            # Most pixels are their partner's best as well: that settles it.
            if i >= 0 and right_least[start - x + i] != sums[offset + x * D + i]:
                low, high = np.int64(np.floor(out[x])), np.int64(np.ceil(out[x]))
                agrees = False
                for d in range(low - min_disparity, high - min_disparity + 1):
                    here = start - x + d
                    if inside[here] > 0:
                        # The left pixels x − d + k that this right pixel might be matched to, |k − d| ≤ tolerance.
                        for k in range(max(d - tolerance, 0), min(d + tolerance + 1, count)):
                            partner = x - d + k
                            if 0 <= partner < len(out) and sums[offset + partner * D + k] == right_least[here]:
                                agrees = True
                if not agrees:
                    out[x] = np.nan
