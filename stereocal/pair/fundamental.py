"""The fundamental matrix from matching points [eq 20].

Each match gives one equation x'ᵀ F x = 0. How to solve them depends on what the matches are like:

============  =======================================================================================
``8point``    all are good, and an answer at once will do: linear (``two_view_solvers``)
``lmeds``     up to half are wrong, and the noise level is not known (``consensus``)
``ransac``    many are wrong, and good ones are within `threshold` pixels: MSAC (``consensus``)
============  =======================================================================================

The robust methods draw samples of seven, and end with the Gold-Standard refinement on all matches, weighted by the
probability that they are good, so that the threshold only steers the search (``two_view_refinement``). ``8point`` is
refined too with refine=True. Matches of a plane, or of cameras that only turned, do not determine F and are refused by
name (``two_view_degeneracy``).

Sources: R. Hartley, A. Zisserman, *Multiple View Geometry* (2004), chapter 11.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float
from stereocal.base.errors import InputError
from stereocal.base.homogeneous import to_homogeneous
from stereocal.pair.consensus import MinimalProblem, find_consensus
from stereocal.pair.epipolar import point_pairs, sampson_distance
from stereocal.pair.two_view_degeneracy import refuse_homography, require_distinct
from stereocal.pair.two_view_models import fundamental_model
from stereocal.pair.two_view_modes import Answer
from stereocal.pair.two_view_options import TwoViewOptions
from stereocal.pair.two_view_refinement import refine_model
from stereocal.pair.two_view_solvers import eight_point, minimal_models, normalizing_transform

METHODS = ("8point", "lmeds", "ransac")
# Draws at once: with 40 % outliers one sample of seven in 36 is good.
_STACK = 64


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
    backend: str = "numba",
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
    backend : {"numba", "numpy"}
        The compiled kernels, or their readable twins.

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
    1,000 random scenes with 40 % outliers (``benchmarks/study_two_views.py``) the pose from ``ransac`` is off by 0.50°
    in the median and 1.56° in the 95th percentile, where that from USAC_MAGSAC is off by 0.55° and 1.73°; it takes
    three to four times as long.

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
    options = TwoViewOptions(method, threshold, confidence, max_iterations, seed, refine, backend)
    return _fit(left_points, right_points, options).F


def fit_fundamental_detailed(left_points: ArrayLike, right_points: ArrayLike, **options: Any) -> FundamentalFit:
    """Fit F as :func:`fit_fundamental` does, and tell the inliers, the errors and the covariance.

    Parameters
    ----------
    left_points, right_points : array_like of shape (N, 2)
        Matching pixels, N ≥ 8, without lens distortion.
    **options
        `method`, `threshold`, … as in :func:`fit_fundamental`, with the same defaults.

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
    return _fit(left_points, right_points, TwoViewOptions(**options))


def _fit(left_points: ArrayLike, right_points: ArrayLike, options: TwoViewOptions) -> FundamentalFit:
    """Fit F as the options say."""
    options = options.checked(METHODS, 1.0)
    left, right = point_pairs(left_points, right_points, 8)
    require_distinct(left, right, 8, "F")
    points = np.ascontiguousarray(np.hstack([left, right]).T)
    T1, T2 = normalizing_transform(left), normalizing_transform(right)
    inliers, iterations, covariance = np.ones(len(left), dtype=bool), 0, np.full((9, 9), np.nan)
    if options.method == "8point":
        core = eight_point(to_homogeneous(left) @ T1.T, to_homogeneous(right) @ T2.T)
        F, answer = np.asarray(T2.T @ core @ T1), None
        refuse_homography(left, right, F)
        if options.refines:
            refined = refine_model(fundamental_model(core, T2, T1), points, backend=options.backend)
            answer = Answer(refined.model, refined.weights, refined.cost, np.zeros((9, 9)))
    else:
        found = find_consensus(points, _problem(left, right, options.backend), options)
        F, inliers, iterations, answer = found.F, found.inliers, found.iterations, found.answer
    if answer is not None:
        F, inliers = answer.model.F, answer.weights > 0.5
        covariance = _covariance(answer, points, options.backend)
    if options.method != "8point":
        refuse_homography(left[inliers], right[inliers], F, outliers=int((~inliers).sum()))
    rms = float(np.sqrt(np.mean(sampson_distance(left[inliers], right[inliers], F))))
    return FundamentalFit(_unit_corner(F), inliers, rms, covariance, iterations)


def _problem(left: Float, right: Float, backend: str) -> MinimalProblem:
    """Samples of seven, in normalised coordinates."""
    T1, T2 = normalizing_transform(left), normalizing_transform(right)
    x, xp = to_homogeneous(left) @ T1.T, to_homogeneous(right) @ T2.T
    return MinimalProblem(
        sample_size=7,
        solve=lambda samples: minimal_models(x, xp, samples, backend=backend),
        to_pixels=np.asarray(np.kron(T2, T1), dtype=np.float64),
        model=lambda core: fundamental_model(core, T2, T1),
        behind=lambda model, weights: 0,  # without camera matrices it cannot be known
        twofold=False,
        stack=_STACK,
    )


def _covariance(answer: Answer, points: Float, backend: str) -> Float:
    """Of F's entries at ‖F‖ = 1, for the noise that the residuals show: σ² Dᵀ (JᵀWJ)⁻¹ D, and the modes' spread."""
    model = answer.model
    inverse = refine_model(model, points, answer.weights, rounds=0, backend=backend).covariance
    f, D = model.F.ravel(), model.derivatives()
    D = D - np.outer(D @ f, f)  # what changes the scale only is none
    freedom = float(answer.weights.sum()) - model.freedom
    variance = answer.cost / freedom if freedom > 0 else np.nan
    return np.asarray(variance * D.T @ inverse @ D + answer.spread)


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
    problem = _problem(left, right, "numba")
    models = problem.solve(np.arange(7)[None]) @ problem.to_pixels
    return np.array([_unit_corner(F) for F in models.reshape(-1, 3, 3)])


def _unit_corner(F: Float) -> Float:
    F = F / np.linalg.norm(F)
    return np.asarray(F / F[2, 2] if abs(F[2, 2]) > 1e-15 else F)
