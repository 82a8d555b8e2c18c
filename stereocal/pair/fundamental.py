"""The fundamental matrix from matching points [eq 20].

Each match gives one equation x'ᵀ F x = 0. How to solve them depends on what the matches are like:

============  =======================================================================================
``8point``    all are good, and an answer at once will do: linear (``two_view_solvers``)
``lmeds``     up to half are wrong, and the noise level is not known (``consensus``)
``ransac``    many are wrong, and good ones are within `threshold` pixels: MSAC (``consensus``)
============  =======================================================================================

The robust methods draw samples of seven, and end with the Gold-Standard refinement on all matches, weighted by the
probability that they are good, so that the threshold only steers the search (``two_view_refinement``). The likelihood
has several maxima; four searches are made, and the likeliest answer is taken. ``8point`` is
refined too with refine=True.

**What does not determine F.** All matches of a *plane*, and all matches of cameras that only *turned* about their
common centre, are related by a homography x' ~ H x; then every F = [v]ₓ H satisfies them, for any v, and the equations'
answer is made of noise. A picture of a flat chessboard is such a case. It shows as H explaining the matches as well as
F does, and is refused by name.

Sources: R. Hartley, A. Zisserman, *Multiple View Geometry* (2004), chapter 11.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float, require_choice, require_integer, require_positive
from stereocal.base.errors import DegenerateGeometryError, InputError
from stereocal.base.homogeneous import from_homogeneous, to_homogeneous
from stereocal.pair.consensus import Consensus, find_consensus
from stereocal.pair.epipolar import point_pairs, sampson_distance
from stereocal.pair.two_view_refinement import RefinedFundamental, refine_among_outliers, refine_fundamental
from stereocal.pair.two_view_solvers import eight_point, normalizing_transform, seven_point

METHODS = ("8point", "lmeds", "ransac")
# A homography that explains the matches this nearly as well as F does leaves F to chance.
_HOMOGRAPHY_FACTOR = 3.0
# Below this, in pixels, errors are those of arithmetic.
_EXACT = 1e-6
# The likelihood of F has several maxima when many matches are wrong: so many searches start apart, the likeliest wins.
_RESTARTS = 4


@dataclass(frozen=True, eq=False)
class FundamentalFit:
    """A fundamental matrix and how sure it is.

    Attributes
    ----------
    F : ndarray of shape (3, 3)
        x_rightᵀ F x_left = 0, scaled to F[2, 2] = 1 where that is not 0.
    inliers : ndarray of shape (N,), bool
        Which matches it was fitted to.
    rms : float
        Root mean square of the inliers' reprojection distances, pixels: √(Σ(‖x − x̂‖² + ‖x' − x̂'‖²)/N).
    covariance : ndarray of shape (9, 9)
        Of F's entries row by row, at the scale ‖F‖ = 1; NaN if it was not refined.
    iterations : int
        Samples drawn; 0 for a linear fit.
    """

    F: Float
    inliers: NDArray[np.bool_]
    rms: float
    covariance: Float
    iterations: int


def fit_fundamental(
    left_points: ArrayLike,
    right_points: ArrayLike,
    *,
    method: str = "8point",
    threshold: float = 1.0,
    confidence: float = 0.999,
    max_iterations: int = 10_000,
    seed: int = 0,
    refine: bool | None = None,
) -> Float:
    """Fit F to matches, x_rightᵀ F x_left = 0 [eq 20].

    Parameters
    ----------
    left_points, right_points : array_like of shape (N, 2)
        Matching pixels, N ≥ 8, without lens distortion.
    method : {"8point", "lmeds", "ransac"}
        See the module.
    threshold : float
        Largest distance of an inlier for ``ransac``, pixels.
    confidence : float
        Of having drawn a sample without outliers.
    max_iterations : int
        Limit on samples.
    seed : int
        Of the random draws: the same seed gives the same F.
    refine : bool, optional
        Whether to end with the Gold-Standard refinement; by default the robust methods do and ``8point`` does not.

    Returns
    -------
    ndarray of shape (3, 3)
        Of rank 2, scaled to F[2, 2] = 1 where that is not 0.

    Raises
    ------
    InputError
        If there are fewer than 8 pairs.
    DegenerateGeometryError
        If the pairs do not determine F: too few distinct ones, a planar scene or cameras that only turned.

    Notes
    -----
    Paper: [eq 20]. Answers to ``cv2.findFundamentalMat``: ``8point`` agrees with FM_8POINT to 1e-9 up to scale. On
    1,000 random scenes with 40 % outliers the pose from ``ransac`` is measured against USAC_MAGSAC in
    ``benchmarks/study_two_views.py``.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> F = sc.fit_fundamental(left, right)
    >>> bool(sc.sampson_distance(left, right, F).max() < 1e-6)
    True
    """
    return fit_fundamental_detailed(
        left_points,
        right_points,
        method=method,
        threshold=threshold,
        confidence=confidence,
        max_iterations=max_iterations,
        seed=seed,
        refine=refine,
    ).F


def fit_fundamental_detailed(
    left_points: ArrayLike,
    right_points: ArrayLike,
    *,
    method: str = "8point",
    threshold: float = 1.0,
    confidence: float = 0.999,
    max_iterations: int = 10_000,
    seed: int = 0,
    refine: bool | None = None,
) -> FundamentalFit:
    """Fit F as :func:`fit_fundamental` does, and tell the inliers, the errors and the covariance.

    Parameters
    ----------
    left_points, right_points, method, threshold, confidence, max_iterations, seed, refine
        See :func:`fit_fundamental`.

    Returns
    -------
    FundamentalFit

    Raises
    ------
    InputError, DegenerateGeometryError
        See :func:`fit_fundamental`.

    Notes
    -----
    Paper: [eq 20].

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> right[0] += [0, 40]  # a false match
    >>> fit = sc.fit_fundamental_detailed(left, right, method="ransac")
    >>> np.flatnonzero(~fit.inliers)
    array([0])
    """
    left, right = point_pairs(left_points, right_points, 8)
    require_choice(method, METHODS, "method")
    require_positive(threshold, "threshold")
    require_integer(max_iterations, "max_iterations", minimum=1)
    if not 0 < confidence < 1:
        raise InputError(f"confidence must be between 0 and 1, but is {confidence:g}")
    require_distinct(left, right, 8, "F")
    inliers, iterations = np.ones(len(left), dtype=bool), 0
    covariance = np.full((9, 9), np.nan)
    if method == "8point":
        F = _eight_point_pixels(left, right)
        refuse_homography(left, right, F)
        if refine:
            F, covariance, _ = refine_fundamental(F, left, right)
    else:
        likeliest = -np.inf
        for restart in range(_RESTARTS if refine is not False else 1):
            found = _search(left, right, method, threshold, confidence, max_iterations, seed + restart)
            iterations += found.iterations
            if refine is False:
                F, inliers = found.F, found.inliers
                break
            refined, weights, likelihood = refine_among_outliers(
                RefinedFundamental(found.F, covariance, 0.0),
                lambda model, w: refine_fundamental(model.F, left, right, w, max_iterations=8),
                lambda model: model.F,
                left,
                right,
                found.threshold,
            )
            if likelihood > likeliest:
                likeliest, best, inliers = likelihood, refined, weights > 0.5
        if refine is not False:
            F, covariance = best.F, best.covariance
        refuse_homography(left[inliers], right[inliers], F)
    rms = float(np.sqrt(np.mean(sampson_distance(left[inliers], right[inliers], F))))
    return FundamentalFit(_unit_corner(F), inliers, rms, covariance, iterations)


def _search(
    left: Float, right: Float, method: str, threshold: float, confidence: float, max_iterations: int, seed: int
) -> Consensus:
    """One consensus over samples of seven."""
    return find_consensus(
        left,
        right,
        solve=lambda samples: _seven_point_pixels(left, right, samples),
        sample_size=7,
        refit=lambda mask, _: _eight_point_pixels(left[mask], right[mask]) if mask.sum() >= 8 else None,
        score="lmeds" if method == "lmeds" else "msac",
        threshold=threshold,
        confidence=confidence,
        max_iterations=max_iterations,
        seed=seed,
    )


def fundamental_from_seven(left_points: ArrayLike, right_points: ArrayLike) -> Float:
    """Return the one or three F of rank 2 through seven pairs.

    Parameters
    ----------
    left_points, right_points : array_like of shape (7, 2)
        Matching pixels.

    Returns
    -------
    ndarray of shape (n, 3, 3)
        n is 1 or 3 (2 where two coincide).

    Notes
    -----
    Paper: [eq 20]. Answers to ``cv2.findFundamentalMat(..., cv2.FM_7POINT)``, which stacks them as (3n, 3).

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> solutions = sc.fundamental_from_seven(left[:7], right[:7])
    >>> bool(min(sc.sampson_distance(left, right, F).max() for F in solutions) < 1e-6)
    True
    """
    left, right = point_pairs(left_points, right_points, 7)
    if len(left) != 7:
        raise InputError(f"seven pairs are needed, no more and no fewer, but {len(left)} are given")
    F = _seven_point_pixels(left, right, np.arange(7)[None])
    return np.array([_unit_corner(one) for one in F])


def _eight_point_pixels(left: Float, right: Float) -> Float:
    """Normalise, solve, and undo the normalisation: F = T₂ᵀ F_n T₁."""
    T1, T2 = normalizing_transform(left), normalizing_transform(right)
    return np.asarray(T2.T @ eight_point(to_homogeneous(left) @ T1.T, to_homogeneous(right) @ T2.T) @ T1)


def _seven_point_pixels(left: Float, right: Float, samples: NDArray[np.int64]) -> Float:
    T1, T2 = normalizing_transform(left), normalizing_transform(right)
    x, xp = to_homogeneous(left) @ T1.T, to_homogeneous(right) @ T2.T
    F, _ = seven_point(x[samples], xp[samples])
    return np.asarray(T2.T @ F @ T1)


def require_distinct(left: Float, right: Float, minimum: int, what: str) -> None:
    """Refuse matches of which too few are distinct.

    Raises
    ------
    DegenerateGeometryError
        Which says how many are.
    """
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

    try:
        H = fit_homography(left, right)
    except DegenerateGeometryError as error:
        raise DegenerateGeometryError("the points of a picture lie on one line; F needs points all over it") from error
    moved = from_homogeneous(to_homogeneous(left) @ np.asarray(H).T)
    by_plane = float(np.sqrt(np.mean(np.sum((moved - right) ** 2, axis=1))))
    by_F = float(np.sqrt(np.mean(sampson_distance(left, right, F))))
    if by_plane <= _HOMOGRAPHY_FACTOR * by_F + _EXACT:
        raise DegenerateGeometryError(
            f"a homography explains the matches as well as F does ({by_plane:.2g} px against {by_F:.2g} px): the scene "
            "is planar, or the camera only turned (pure rotation), and F is not determined; add points at other "
            "depths, or use fit_essential with method='5point', which a plane is enough for"
        )


def _unit_corner(F: Float) -> Float:
    F = F / np.linalg.norm(F)
    return np.asarray(F / F[2, 2] if abs(F[2, 2]) > 1e-15 else F)
