"""Matches that do not determine F, or the motion: by name, before an answer made of noise is given.

**Planar scene, pure rotation.** All matches of a *plane*, and all matches of cameras that only *turned* about their
common centre, are related by a homography x' ~ H x; then every F = [v]ₓ H satisfies them, for any v. A picture of a
flat chessboard is such a case. It shows as H explaining the matches as well as F does, noise included.

**Pure rotation, for E.** A plane is enough for E, whose calibrated rays leave less freedom, but not a turn: without a
baseline every t satisfies x̂' = R x̂. It shows as a rotation that turns the rays onto one another (the orthogonal
Procrustes problem, R = U diag(1, 1, ±1) Vᵀ of Σ x̂' x̂ᵀ) as well as E does.

**Too few distinct points.** Copies of a match add an equation that is already there.

Sources: R. Hartley, A. Zisserman, *Multiple View Geometry* (2004), section 11.9; P. Torr, A. Fitzgibbon, A. Zisserman,
*The problem of degeneracy in structure and motion recovery*, IJCV 32 (1999).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.base.errors import DegenerateGeometryError, InputError
from stereocal.base.homogeneous import from_homogeneous, to_homogeneous
from stereocal.pair.epipolar import sampson_distance
from stereocal.pair.two_view_models import fundamental_model
from stereocal.pair.two_view_refinement import refine_model
from stereocal.pair.two_view_solvers import normalizing_transform

Mask = NDArray[np.bool_]
# The linear solution of fewer matches leaves several times their noise; only the best F tells what that is. And it is
# known the less surely, the fewer there are.
FEW_MATCHES, _UNSURE = 30, 4.0
# A homography, or a rotation, that explains the matches this nearly as well as F does leaves F to chance.
_HOMOGRAPHY_FACTOR = _TURN_FACTOR = 3.0
# Rounds of fitting the simpler model to the matches that are near it, and to about how many of them.
_TRIMS, _ENOUGH = 4, 60
# Where it is so many limits off, and by this share of the picture, in the median, there is no need to go on.
_FAR_OFF, _FAR_SHARE = 5.0, 0.01
# The two unknowns that it leaves open take in two wrong matches for nothing, and chance up to this share of the others.
_TAKEN_IN, _BY_CHANCE = 2, 0.2
# Below this, in pixels or radians, errors are those of arithmetic.
_EXACT_PIXELS, _EXACT_RADIANS = 1e-6, 1e-9


def require_distinct(left: Float, right: Float, minimum: int, what: str) -> None:
    """Refuse matches of which too few are distinct.

    Raises
    ------
    DegenerateGeometryError
        Which says how many are.
    """
    if len(set(map(tuple, np.round(np.hstack([left[:100], right[:100]]), 9).tolist()))) >= minimum:
        return  # some are enough to know
    distinct = len(np.unique(np.round(np.hstack([left, right]), 9), axis=0))
    if distinct < minimum:
        raise DegenerateGeometryError(
            f"only {distinct} of the {len(left)} pairs are distinct (the others are duplicates); {what} needs at least "
            f"{minimum}"
        )


def refuse_homography(left: Float, right: Float, F: Float, *, outliers: int = 0) -> None:
    """Refuse matches that a homography explains as well as F does.

    Parameters
    ----------
    left, right : ndarray of shape (N, 2)
        Matching pixels that F explains.
    F : ndarray of shape (3, 3)
    outliers : int
        How many others were left out; a few like them may be among these.

    Raises
    ------
    DegenerateGeometryError
        A planar scene, or cameras that only turned.
    """
    from stereocal.camera.homography import fit_homography

    def distances(kept: Mask, refine: bool = False) -> Float:
        chosen = np.flatnonzero(kept)
        if not refine:  # to see whether it is worth while, some are enough
            chosen = chosen[:: max(len(chosen) // _ENOUGH, 1)]
        H = np.asarray(fit_homography(left[chosen], right[chosen], refine=refine))
        return np.asarray(np.linalg.norm(from_homogeneous(to_homogeneous(left) @ H.T) - right, axis=1))

    count = len(left)
    if count < FEW_MATCHES:
        T1, T2 = normalizing_transform(left), normalizing_transform(right)
        core = np.linalg.inv(T2).T @ F @ np.linalg.inv(T1)
        F = refine_model(fundamental_model(core, T2, T1), np.ascontiguousarray(np.hstack([left, right]).T)).F
    # of N squares as many are left as F, with its seven unknowns, has not taken up
    by_F = float(np.sqrt(np.sum(sampson_distance(left, right, F)) / max(count - 7, 1)))
    limit = _HOMOGRAPHY_FACTOR * (1 + _UNSURE / max(count - 6, 1)) * by_F + _EXACT_PIXELS
    try:
        hopeless = max(_FAR_OFF * limit, _FAR_SHARE * float(np.linalg.norm(np.ptp(right, axis=0))))
        kept = _most_explained(distances, len(left), hopeless, limit, outliers)
        if not kept.any():
            return
        by_plane = distances(kept, True)
    except (DegenerateGeometryError, InputError) as error:
        raise DegenerateGeometryError(
            "the matches that agree lie on one line of a picture, or are too few; F needs points all over it"
        ) from error
    if _is_explained(by_plane, kept, limit, outliers):
        raise DegenerateGeometryError(
            f"a homography explains the matches as well as F does ({_rms(by_plane[kept]):.2g} px against {by_F:.2g} "
            "px): the scene is planar, or the camera only turned (pure rotation), and F is not determined; add points "
            "at other depths, or use fit_essential with method='5point' (or 'ransac'), which a plane is enough for"
        )


def refuse_turn(rays: Float, other: Float, squared_distances: Float, K: Float, *, outliers: int = 0) -> None:
    """Refuse matches that a rotation alone explains as well as E does.

    Parameters
    ----------
    rays, other : ndarray of shape (N, 3)
        Rays of the left and the right camera, z = 1.
    squared_distances : ndarray of shape (N,)
        Of the matches from E, pixels².
    K : ndarray of shape (3, 3)
        Of the left camera, which turns angles into pixels.
    outliers : int
        How many others were left out; a few like them may be among these.

    Raises
    ------
    DegenerateGeometryError
        Pure rotation: there is no baseline, t is not determined.
    """
    a = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    b = other / np.linalg.norm(other, axis=1, keepdims=True)
    focal = float(np.sqrt(K[0, 0] * K[1, 1]))

    def distances(kept: Mask) -> Float:
        U, _, Vt = np.linalg.svd(b[kept].T @ a[kept])
        R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
        return np.asarray(focal * np.linalg.norm(a @ R.T - b, axis=1))

    by_E = float(np.sqrt(np.mean(squared_distances))) if len(a) else 0.0
    limit = _TURN_FACTOR * by_E + _EXACT_RADIANS * focal
    hopeless = max(_FAR_OFF * limit, _FAR_SHARE * focal)
    kept = _most_explained(distances, len(a), hopeless, limit, outliers)
    if not kept.any():
        return
    by_turn = distances(kept)
    if _is_explained(by_turn, kept, limit, outliers):
        raise DegenerateGeometryError(
            f"a rotation explains the matches as well as E does ({_rms(by_turn[kept]):.2g} px against {by_E:.2g} px): "
            "the camera only turned (pure rotation), or all points are too far for this baseline; t is not determined"
        )


def _most_explained(
    distances: Callable[[Mask], Float], count: int, hopeless: float, limit: float, outliers: int
) -> Mask:
    """All matches; or, among outliers, those near the simpler model that most suggest, none if it is far off."""
    kept = np.ones(count, dtype=bool)
    for trim in range(_TRIMS if outliers else 1):
        off = distances(kept)
        middle = float(np.median(off))
        if middle > hopeless and (trim > 1 or not outliers):
            return np.zeros(count, dtype=bool)
        if outliers:
            kept = off <= max(2.5 * 1.4826 * middle, 2 * limit)
    return kept


def _is_explained(off: Float, kept: Mask, limit: float, outliers: int) -> bool:
    """Whether the simpler model does as well for all matches, or all but the few that are there for nothing."""
    if not outliers:
        return _rms(off) <= limit
    return bool(np.median(off) <= 2 * limit and (off > 2 * limit).sum() <= _TAKEN_IN + _BY_CHANCE * outliers)


def _rms(off: Float) -> float:
    return float(np.sqrt(np.mean(off**2)))
