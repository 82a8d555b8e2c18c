"""Growth of a grid by local prediction, and how far the squares beyond its border reach.

A corner that is missing next to known ones is **predicted** from them: the last step again, corrected by the change of
the step in the row beside,

    P(i, j) = P(i-1, j) + P(i, j') - P(i-1, j'),   j' = j - 1 or j + 1,

or by the change of the step before, P(i-1) + [P(i-1) - P(i-2)] + [P(i-1) - 2 P(i-2) + P(i-3)] / 2: exact for any smooth
map to first order in the change. All predictions that its known neighbours allow are averaged.

Near that place, within 0.3 of the narrower step, Newton's method **settles** on the saddle point of G; there must be
one (det H < 0 all the way). Then the four **squares** around must show their colours: with samples g at 0.3 steps
along both directions, the evidence

    (min of the two light samples - max of the two dark samples) / 2

has to reach a share of the mean evidence of the known corners around. So a corner may fade as slowly as light does, but
none is invented on a blank wall.

**Reach.** The same colours, followed outwards square by square from a border line, say how far its outer squares reach:
1 where they are whole, less where the print or a hand cuts them off, more where a further line of squares follows.

Source: growth by local prediction follows the idea of Geiger et al., ICRA 2012, who minimise an energy for each
proposed line.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.board.ring import bilinear

Known = NDArray[np.bool_]
_AXES = ((1, 0), (0, 1))
_EDGE = (10, 11)  # tenths of a step: where the colours change if the board goes on, nothing can be judged


def grow_corners(
    G: NDArray[np.float32],
    points: Float,
    known: Known,
    evidence: Float,
    parity: int,
    share: float,
    *,
    backend: str = "numba",
) -> int:
    """Add corners next to known ones, in place, where the image shows them, until nothing is added.

    Parameters
    ----------
    G : ndarray of shape (H, W), float32
        The smoothed image.
    points : ndarray of shape (I, J, 2), C-contiguous
        x, y of corner (i, j), written where one is added.
    known : ndarray of shape (I, J), bool
        Whether it is known.
    evidence : ndarray of shape (I, J)
        Half the contrast of its squares, grey levels.
    parity : int
        The square between +i and +j of corner (i, j) is dark if (i + j) % 2 == parity.
    share : float
        Least evidence as a share of the neighbours' mean.
    backend : {"numba", "numpy"}
        The kernel, or the readable reference (they agree to rounding).

    Returns
    -------
    int
        How many were added.
    """
    if backend == "numba":
        from stereocal.board.growth_kernels import grow_grid

        return int(grow_grid(G, points, known, evidence, parity, share))
    gray, before = G.astype(np.float64), int(known.sum())
    columns, rows = known.shape
    again = True
    while again:
        again = False
        for j in range(rows):
            for i in range(columns):
                if known[i, j]:
                    continue
                around = np.s_[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
                if known[around].sum() < 2:
                    continue
                sign = 1 if (i + j) % 2 == parity else -1
                corner = _corner_at(gray, points, known, (i, j), sign)
                if corner is not None and corner[1] > share * evidence[around][known[around]].mean():
                    points[i, j], evidence[i, j] = corner
                    known[i, j] = again = True
    return int(known.sum()) - before


def _corner_at(gray: Float, points: Float, known: Known, at: tuple[int, int], sign: int) -> tuple[Float, float] | None:
    """The corner near the predicted place of (i, j), and its evidence; None if there is none."""
    place = _predicted(points, known, at)
    steps = None if place is None else _local_steps(points, known, at, place)
    if place is None or steps is None:
        return None
    narrow = abs(np.linalg.det(steps)) / np.linalg.norm(steps, axis=1).max()
    if narrow < 3.0:
        return None
    found = _settled(gray, place, max(1.5, 0.3 * narrow), min(max(0.2 * narrow, 1.0), 3.0))
    return None if found is None else (found, _square_evidence(gray, found, steps, sign))


def _is_known(known: Known, i: int, j: int) -> bool:
    return 0 <= i < known.shape[0] and 0 <= j < known.shape[1] and bool(known[i, j])


def _predicted(points: Float, known: Known, at: tuple[int, int]) -> Float | None:
    """Weighted mean of all predictions; None where their weight is less than 2."""
    total, weights = np.zeros(2), 0.0
    for step in _AXES:
        beside = np.array(step[::-1])
        for sign in (1, -1):
            d = sign * np.array(step)
            a = np.array(at) - d  # the neighbour whose step is made again
            if not _is_known(known, *a):
                continue
            for side in (1, -1):
                b, c = a + side * beside, np.array(at) + side * beside
                if _is_known(known, *b) and _is_known(known, *c):
                    total, weights = total + points[tuple(a)] + points[tuple(c)] - points[tuple(b)], weights + 1
            b, c = a - d, a - 2 * d
            if _is_known(known, *b):
                p, weight = 2 * points[tuple(a)] - points[tuple(b)], 1.0
                if _is_known(known, *c):
                    p, weight = p + 0.5 * (points[tuple(a)] - 2 * points[tuple(b)] + points[tuple(c)]), 1.5
                total, weights = total + weight * p, weights + weight
    return total / weights if weights >= 2 else None


def _local_steps(points: Float, known: Known, at: tuple[int, int], place: Float) -> Float | None:
    """Steps (2, 2) along i and along j: to the known neighbours, or else those of the rows beside; None if unknown."""
    steps = []
    for step in _AXES:
        d, beside, here = np.array(step), np.array(step[::-1]), np.array(at)
        found = [
            sign * (points[tuple(here + sign * d)] - place) for sign in (1, -1) if _is_known(known, *here + sign * d)
        ]
        if not found:
            for a in (here + beside, here - beside):
                if _is_known(known, *a):
                    ends = [(sign, a + sign * d) for sign in (1, -1)]
                    found += [s * (points[tuple(b)] - points[tuple(a)]) for s, b in ends if _is_known(known, *b)]
        if not found:
            return None
        steps.append(np.mean(found, axis=0))
    return np.array(steps)


def _square_evidence(gray: Float, p: Float, steps: Float, sign: int) -> float:
    """(least light - most dark) / 2 of the four squares; `sign` is +1 where the one between +i and +j is dark."""
    u = 0.3 * np.array([[-1, -1], [1, 1], [-1, 1], [1, -1]])
    g = bilinear(gray, *(p + u @ steps).T)
    dark, light = (g[:2], g[2:]) if sign > 0 else (g[2:], g[:2])
    return float((light.min() - dark.max()) / 2)


def _settled(gray: Float, start: Float, reach: float, h: float) -> Float | None:
    """Newton's steps to the saddle point of G near `start`, differences over h pixels; None if none is in reach."""
    height, width = gray.shape
    p = start.copy()
    for _ in range(8):
        if not (h <= p[0] < width - 1 - h and h <= p[1] < height - 1 - h):
            return None
        y, x = np.mgrid[-1:2, -1:2] * h
        g = bilinear(gray, p[0] + x, p[1] + y)
        gradient = np.array([g[1, 2] - g[1, 0], g[2, 1] - g[0, 1]]) / (2 * h)
        xx, yy = (g[1, 2] - 2 * g[1, 1] + g[1, 0]) / h**2, (g[2, 1] - 2 * g[1, 1] + g[0, 1]) / h**2
        xy = (g[2, 2] - g[0, 2] - g[2, 0] + g[0, 0]) / (4 * h**2)
        if xx * yy - xy * xy >= 0:
            return None
        step = -np.linalg.solve([[xx, xy], [xy, yy]], gradient)
        length = np.hypot(*step)
        p = p + step * min(1.0, h / max(length, 1e-30))
        if np.hypot(*(p - start)) > reach:
            return None
        if length < 0.02:
            break
    return p


def outer_reach(G: NDArray[np.float32], points: Float, side: int, *, backend: str = "numba") -> float:
    """Mean reach of the squares beyond a border line, in steps, 0.1 to 1.5.

    Half a square inside the line the squares show their colours; outside, the square across the line shows the other
    one, up to its end at 1, and beyond 1 the first again if the board goes on. Each is followed in tenths of a step,
    against the mean of its neighbours, until the contrast falls below 0.3 of that inside; at 1 and 1.1, where the
    colours change, nothing is judged. Whole squares reach to 0.8 to 1.1, those of a board that goes on further.

    Parameters
    ----------
    G : ndarray of shape (H, W), float32
        The smoothed image.
    points : ndarray of shape (I, J, 2), C-contiguous
        A full grid.
    side : int
        The line: i = 0, i = I-1, j = 0, j = J-1.
    backend : {"numba", "numpy"}
        The kernel, or the readable reference.
    """
    if backend == "numba":
        from stereocal.board import growth_kernels

        return float(growth_kernels.outer_reach(G, points, side))
    gray = G.astype(np.float64)
    lines = points if side < 2 else points.transpose(1, 0, 2)
    lines = (lines if side % 2 == 0 else lines[::-1])[:3]
    middle = (lines[:, 1:] + lines[:, :-1]) / 2  # of the squares' sides, on the border line and on the two behind it
    outward = middle[0] - middle[1]
    if len(lines) > 2:
        outward = outward + 0.5 * (middle[0] - 2 * middle[1] + middle[2])

    def contrast(t: float) -> Float:
        """How much lighter the neighbours are than each square, t steps outside the line."""
        g = bilinear(gray, *(middle[0] + t * outward).T)
        beside = [np.delete(g[max(m - 1, 0) : m + 2], min(m, 1)).mean() for m in range(len(g))]
        return np.array(beside) - g

    inside = contrast(-0.35)
    reach = np.full(len(inside), 1.5)
    for m, own in enumerate(inside):
        for step in range(2, 16):
            towards = contrast(0.1 * step)[m] * (-1 if step <= 10 else 1)
            if step not in _EDGE and towards * own <= 0.3 * own * own:
                reach[m] = 0.1 * (step - 1)
                break
    return float(reach.mean())
