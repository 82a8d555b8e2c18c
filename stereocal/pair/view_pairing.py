"""Which right view belongs to each left one, and how its corners are counted: shifted lists and turned boards.

A left view i and a right view j of the same moment see the rig that all others see. So each pair (i, j) of views not
far apart in the lists, with each of the turns by which a board's corners can be counted, is a *candidate* for the rig;
the candidate with which most left views fit some right view is taken. Then

- a left view that fits its own right view in another turn has its corners counted from another end (``corner_order``);
- left views that fit only the right views one, two, … places on are the sign of a shifted list (``pairing``): a picture
  is missing in one list, and from there on nothing belongs together.

A view "fits" if the rig predicts its corners to a few pixels, or to several times what the cameras leave over. Ties are
broken in favour of own partners, of the tighter rig, and of the milder one: a rig whose cameras are turned by 180° to
each other is the same as one whose boards are all counted from the other end, and rarer.
"""

from __future__ import annotations

import numpy as np

from stereocal.pair.findings import Finding, listed_pairs
from stereocal.pair.view_rigs import Rig, Turns, ViewPoses, board_turn, rough_errors

# A right view belongs to a left one if the rig predicts it to about this (pixels, and times the cameras' own RMS).
_FIT_PIXELS, _FIT_FACTOR = 3.0, 5.0
# Partners are looked for this many places away in the list; fewer wrong pairs than this are not a shifted list.
_SHIFTS, _WRONG_PAIRS = 5, 3


def common_rig(first: ViewPoses, second: ViewPoses, orders: list[Turns], noise: float) -> tuple[Rig, Turns, Turns]:
    """Find the rig that most left views see with some right view, and which turn of the board each needs.

    Parameters
    ----------
    first, second : ViewPoses
        Of the left and of the right camera.
    orders : list of ndarray of int
        The orders in which the corners may be counted, the usual one first.
    noise : float
        RMS of both cameras' calibrations, pixels.

    Returns
    -------
    rig : (R, T)
    partner : ndarray of shape (V,), int
        For each left view its right view: its own where that fits, or where none does.
    turns : ndarray of shape (V,), int
        For each RIGHT view the number of the order.
    """
    limit = max(_FIT_PIXELS, _FIT_FACTOR * noise)
    count = len(first.R)
    here = np.arange(count)
    reach = min(_SHIFTS, count - 2)
    allowed = np.abs(here[:, None] - here[None]) <= reach
    turns = [board_turn(first.object_points, order) for order in orders]
    i, j = np.nonzero(allowed)
    candidates: list[Rig] = []
    for D in turns:
        R = second.R[j] @ D @ np.swapaxes(first.R[i], 1, 2)
        candidates += zip(R, second.centres[j] - np.einsum("nab,nb->na", R, first.centres[i]), strict=True)
    R, T = np.array([c[0] for c in candidates]), np.array([c[1] for c in candidates])
    errors = np.stack([rough_errors(first, second, R, T, D) for D in turns])
    errors = np.where(allowed, errors, np.inf)
    by_turn = errors.argmin(axis=0)
    nearest = errors.min(axis=0)
    own = nearest[:, here, here]
    fits_own = (own <= limit).sum(axis=1)
    fits_any = (nearest.min(axis=2) <= limit).sum(axis=1)
    mildness = np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1))
    # most views that fit at all, then most that fit with their own partner, then the tightest, milder rigs first
    tightness = np.minimum(np.sort(own, axis=1)[:, : max(count // 2, 1)].mean(axis=1), 1e3) / limit
    merit = fits_any + 1.5 * fits_own - 0.2 * np.minimum(tightness, 5) - 0.3 * mildness
    best = int(np.argmax(merit))
    partner = np.where(own[best] <= limit, here, nearest[best].argmin(axis=1))
    strays = nearest[best][here, partner] > limit
    partner = np.where(strays, here, partner)
    turn = np.zeros(count, dtype=np.int64)
    turn[partner] = by_turn[best][here, partner]
    return (R[best], T[best]), partner, turn


def pairing_findings(partner: Turns) -> list[Finding]:
    """Name a shifted list if several left views belong to other right views.

    Parameters
    ----------
    partner : ndarray of shape (V,), int

    Returns
    -------
    list of Finding
    """
    here = np.arange(len(partner))
    wrong = np.flatnonzero(partner != here)
    if len(wrong) < _WRONG_PAIRS:
        return []
    shifts, counts = np.unique(partner[wrong] - wrong, return_counts=True)
    shift = int(shifts[np.argmax(counts)])
    if counts.max() < 0.6 * len(wrong):
        return []
    first_wrong = int(wrong[partner[wrong] - wrong == shift][0])
    return [
        Finding(
            "pairing",
            tuple(int(i) for i in wrong),
            f"Left and right images are not paired as they were taken: from pair {first_wrong + 1} on, left image n "
            f"belongs to right image n{shift:+d} ({len(wrong)} of {len(here)} pairs). A picture is missing in one of "
            f"the "
            "lists, or one too many; pair the files by name.",
            float(shift),
        )
    ]


def corner_order_findings(turns: Turns, partner: Turns) -> list[Finding]:
    """Name the views whose right corners are counted from another end.

    Parameters
    ----------
    turns, partner : ndarray of shape (V,), int

    Returns
    -------
    list of Finding
    """
    turned = np.flatnonzero(turns)
    if len(turned) == 0:
        return []
    return [
        Finding(
            "corner_order",
            tuple(int(i) for i in turned),
            f"The corners are counted from different ends of the board in left and right of {len(turned)} pairs "
            f"({listed_pairs(turned)}): they fit only if the board is turned in one of the two. Turn the order of one "
            "(repair_corner_order does), and use one detector for both cameras.",
            180.0,
        )
    ]
