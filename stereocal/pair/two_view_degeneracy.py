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

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import DegenerateGeometryError
from stereocal.base.homogeneous import from_homogeneous, to_homogeneous
from stereocal.pair.epipolar import sampson_distance

# A homography, or a rotation, that explains the matches this nearly as well as F does leaves F to chance.
_HOMOGRAPHY_FACTOR = _TURN_FACTOR = 3.0
# The linear solution for H is at most this much worse than the best one, but for a broad margin.
_FAR_OFF = 5.0
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


def refuse_homography(left: Float, right: Float, F: Float) -> None:
    """Refuse matches that a homography explains as well as F does.

    Raises
    ------
    DegenerateGeometryError
        A planar scene, or cameras that only turned.
    """
    from stereocal.camera.homography import fit_homography

    by_F = float(np.sqrt(np.mean(sampson_distance(left, right, F))))
    limit = _HOMOGRAPHY_FACTOR * by_F + _EXACT_PIXELS
    for refine in (False, True):  # where the linear solution is far off, the best one is not near either
        try:
            H = fit_homography(left, right, refine=refine)
        except DegenerateGeometryError as error:
            raise DegenerateGeometryError(
                "the points of a picture lie on one line; F needs points all over it"
            ) from error
        moved = from_homogeneous(to_homogeneous(left) @ np.asarray(H).T)
        by_plane = float(np.sqrt(np.mean(np.sum((moved - right) ** 2, axis=1))))
        if by_plane > _FAR_OFF * limit:
            return
    if by_plane <= limit:
        raise DegenerateGeometryError(
            f"a homography explains the matches as well as F does ({by_plane:.2g} px against {by_F:.2g} px): the scene "
            "is planar, or the camera only turned (pure rotation), and F is not determined; add points at other "
            "depths, or use fit_essential with method='5point', which a plane is enough for"
        )


def refuse_turn(rays: Float, other: Float, squared_distances: Float, K: Float) -> None:
    """Refuse matches that a rotation alone explains as well as E does.

    Parameters
    ----------
    rays, other : ndarray of shape (N, 3)
        Rays of the left and the right camera, z = 1.
    squared_distances : ndarray of shape (N,)
        Of the matches from E, pixels².
    K : ndarray of shape (3, 3)
        Of the left camera, which turns angles into pixels.

    Raises
    ------
    DegenerateGeometryError
        Pure rotation: there is no baseline, t is not determined.
    """
    a = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    b = other / np.linalg.norm(other, axis=1, keepdims=True)
    U, _, Vt = np.linalg.svd(b.T @ a)
    R = U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt
    angles = np.linalg.norm(np.cross(a @ R.T, b), axis=1)
    by_turn = float(np.sqrt(np.mean(angles**2)) * np.sqrt(K[0, 0] * K[1, 1]))
    by_E = float(np.sqrt(np.mean(squared_distances)))
    if by_turn <= _TURN_FACTOR * by_E + _EXACT_RADIANS * np.sqrt(K[0, 0] * K[1, 1]):
        raise DegenerateGeometryError(
            f"a rotation explains the matches as well as E does ({by_turn:.2g} px against {by_E:.2g} px): the camera "
            "only turned (pure rotation), or all points are too far for this baseline; t is not determined"
        )
