"""The essential matrix: epipolar geometry of rays [eq 21].

With known camera matrices a pixel x is a ray x̂ = K⁻¹ (x, 1)ᵀ, and the epipolar constraint of two rays is

    x̂'ᵀ E x̂ = 0,      E = [t]ₓ R,      F = K_right⁻ᵀ E K_left⁻¹,

which is what the paper's [eq 21] means: E relates rays, not poses. What is in it, and how the motion is told from it,
is in ``relative_pose``.

============  =======================================================================================
``8point``    linear; all matches are good, and the scene is not a plane
``5point``    all are good, five or more of them, a plane too: a chessboard will do. Samples of five,
              the one that all matches like best, then the refinement of R and t
``lmeds``     up to half are wrong, and the noise level is not known
``ransac``    many are wrong, and good ones are within `threshold` pixels
============  =======================================================================================

Distances are those in the pictures, in pixels, though the unknowns are R and t. Cameras that only turned have no E and
are refused by name (``two_view_degeneracy``).

Sources: H. C. Longuet-Higgins, Nature 293 (1981); R. Hartley, A. Zisserman, *Multiple View Geometry* (2004), chapter
11; D. Nistér, PAMI 26 (2004).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float
from stereocal.base.homogeneous import cross_matrix
from stereocal.pair.consensus import MinimalProblem, find_consensus
from stereocal.pair.epipolar import point_pairs, sampson_distance
from stereocal.pair.relative_pose import ahead_of_motions, camera_matrices, project_to_essential, rays_of, recover_pose
from stereocal.pair.two_view_degeneracy import FEW_MATCHES, refuse_homography, refuse_turn, require_distinct
from stereocal.pair.two_view_models import TwoViewModel, essential_model, motion_model
from stereocal.pair.two_view_modes import Answer
from stereocal.pair.two_view_options import TwoViewOptions
from stereocal.pair.two_view_refinement import refine_model
from stereocal.pair.two_view_solvers import eight_point, minimal_models, normalizing_transform

METHODS = ("8point", "5point", "lmeds", "ransac")
# Without outliers to fear (5point) so few draws will do, and the threshold is so far off that all matches vote.
_DRAWS_OF_GOOD, _WIDE = 128, 1e3
# Draws at once: with 40 % outliers one sample of five in 13 is good.
_STACK = 32


@dataclass(frozen=True, eq=False)
class EssentialFit:
    """An essential matrix, its motion and how sure they are.

    Attributes
    ----------
    E : ndarray of shape (3, 3)
        Singular values (1, 1, 0).
    R : ndarray of shape (3, 3)
        Rotation from the left to the right camera.
    t : ndarray of shape (3,)
        Direction of T, unit length: X_right ∝ R X_left + t.
    inliers : ndarray of shape (N,), bool
        Which matches it was fitted to.
    rms : float
        Root mean square of the inliers' reprojection distances, pixels.
    covariance : ndarray of shape (5, 5)
        Of a small rotation ω (rad) that precedes R and of t's direction (rad); NaN if it was not refined.
    iterations : int
        Samples drawn.
    """

    E: Float
    R: Float
    t: Float
    inliers: NDArray[np.bool_]
    rms: float
    covariance: Float
    iterations: int


def fit_essential(
    left_points: ArrayLike,
    right_points: ArrayLike,
    K_left: ArrayLike | None = None,
    K_right: ArrayLike | None = None,
    *,
    method: str = "8point",
    threshold: float | None = None,
    confidence: float = 0.999,
    max_iterations: int = 10_000,
    seed: int = 0,
    refine: bool | None = None,
    backend: str = "numba",
) -> Float:
    """Fit E to matching rays, x̂_rightᵀ E x̂_left = 0 [eq 21].

    Parameters
    ----------
    left_points, right_points : array_like of shape (N, 2)
        Matching points: undistorted pixels with `K_left` and `K_right`, or normalised coordinates without.
    K_left, K_right : array_like of shape (3, 3), optional
        Camera matrices; the right one defaults to the left one.
    method : {"8point", "5point", "lmeds", "ransac"}
        See the module. N ≥ 8 for ``8point``, N ≥ 5 otherwise (N = 5 leaves up to ten answers, of which one is taken).
    threshold : float, optional
        Largest distance of an inlier for ``ransac``, in the points' units: 1 pixel by default, or 0.002 without camera
        matrices.
    confidence, max_iterations, seed
        See :func:`stereocal.fit_fundamental`.
    refine : bool, optional
        Whether to end with the refinement of R and t; by default all but ``8point`` do.
    backend : {"numba", "numpy"}
        The compiled kernels, or their readable twins.

    Returns
    -------
    ndarray of shape (3, 3)
        Singular values (1, 1, 0).

    Raises
    ------
    InputError
        If there are too few pairs.
    DegenerateGeometryError
        If the pairs do not determine E: too few distinct ones, cameras that only turned, and, for ``8point``, a planar
        scene.

    Notes
    -----
    Paper: [eq 21]. Answers to ``cv2.findEssentialMat``. On 1,000 random scenes with 40 % outliers
    (``benchmarks/study_two_views.py``) the pose from ``ransac`` is off by 0.28° in the median and 0.71° in the 95th
    percentile, where that from USAC_MAGSAC is off by 0.29° and 0.82°; it takes two and a half times as long.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> E = sc.fit_essential(left, right, K, K)
    >>> np.linalg.svd(E / np.linalg.norm(E), compute_uv=False).round(6)
    array([0.707107, 0.707107, 0.      ])
    """
    options = TwoViewOptions(method, threshold, confidence, max_iterations, seed, refine, backend)
    return _fit(left_points, right_points, K_left, K_right, options).E


def fit_essential_detailed(
    left_points: ArrayLike,
    right_points: ArrayLike,
    K_left: ArrayLike | None = None,
    K_right: ArrayLike | None = None,
    **options: Any,
) -> EssentialFit:
    """Fit E as :func:`fit_essential` does, and tell the motion, the inliers, the errors and the covariance.

    Parameters
    ----------
    left_points, right_points, K_left, K_right
        See :func:`fit_essential`.
    **options
        `method`, `threshold`, … as in :func:`fit_essential`, with the same defaults.

    Returns
    -------
    EssentialFit

    Raises
    ------
    InputError, DegenerateGeometryError
        See :func:`fit_essential`.

    Notes
    -----
    Paper: [eq 21].

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> fit = sc.fit_essential_detailed(left, right, K, K)
    >>> fit.t.round(6) + 0.0
    array([-1.,  0.,  0.])
    >>> int(fit.inliers.sum()), bool(fit.rms < 1e-6)
    (20, True)
    """
    return _fit(left_points, right_points, K_left, K_right, TwoViewOptions(**options))


def _fit(
    left_points: ArrayLike,
    right_points: ArrayLike,
    K_left: ArrayLike | None,
    K_right: ArrayLike | None,
    options: TwoViewOptions,
) -> EssentialFit:
    """Fit E as the options say."""
    options = options.checked(METHODS, 0.002 if K_left is None else 1.0)
    minimum = 8 if options.method == "8point" else 5
    left, right = point_pairs(left_points, right_points, minimum)
    K, K_other = camera_matrices(K_left, K_right)
    inverse, inverse_other = np.asarray(np.linalg.inv(K)), np.asarray(np.linalg.inv(K_other))
    require_distinct(left, right, minimum, "E")
    rays, other = rays_of(left, K), rays_of(right, K_other)
    refuse_turn(rays, other, np.zeros(len(left)), K)
    points = np.ascontiguousarray(np.hstack([left, right]).T)
    inliers, iterations, answer = np.ones(len(left), dtype=bool), 0, None
    if options.method == "8point":
        T1, T2 = normalizing_transform(rays[:, :2]), normalizing_transform(other[:, :2])
        E = T2.T @ eight_point(rays @ T1.T, other @ T2.T) @ T1
        refuse_homography(left, right, inverse_other.T @ E @ inverse)
        E = project_to_essential(E)
        if options.refines:
            refined = refine_model(essential_model(E, inverse_other, inverse), points, backend=options.backend)
            answer = Answer(refined.model, refined.weights, refined.cost, np.zeros((9, 9)))
    else:
        good = options.method == "5point"
        search = options
        if good:
            search = replace(options, threshold=_WIDE * options.reach, max_iterations=_DRAWS_OF_GOOD)
        problem = _problem(rays, other, inverse, inverse_other, options.backend)
        found = find_consensus(points, problem, search, outliers=not good)
        E, iterations, answer = project_to_essential(K_other.T @ found.F @ K), found.iterations, found.answer
        inliers = inliers if good else found.inliers
    if answer is not None:
        E, inliers = project_to_essential(K_other.T @ answer.model.F @ K), answer.weights > 0.5
    R, t, _ = recover_pose(E, left[inliers], right[inliers], K, K_other)
    E = cross_matrix(t) @ R
    distances = sampson_distance(left[inliers], right[inliers], inverse_other.T @ E @ inverse)
    noise = distances
    if options.method == "8point" and len(left) < FEW_MATCHES:
        best = refine_model(motion_model(R, t, inverse_other, inverse), points, backend=options.backend)
        noise = sampson_distance(left, right, best.F)
    refuse_turn(rays[inliers], other[inliers], noise, K, outliers=int((~inliers).sum()))
    covariance = np.full((5, 5), np.nan)
    if answer is not None:
        covariance = _covariance(answer, motion_model(R, t, inverse_other, inverse), points, options.backend)
    return EssentialFit(E, R, t, inliers, float(np.sqrt(np.mean(distances))), covariance, iterations)


def _problem(rays: Float, other: Float, inverse: Float, inverse_other: Float, backend: str) -> MinimalProblem:
    """Samples of five rays, judged in pixels."""

    def behind(model: TwoViewModel, weights: Float) -> int:
        good = weights > 0.5
        in_front = ahead_of_motions(model.R, model.t, rays[good], other[good])
        return int(good.sum() - in_front.sum(axis=1).max(initial=0))

    return MinimalProblem(
        sample_size=5,
        solve=lambda samples: minimal_models(rays, other, samples, backend=backend),
        to_pixels=np.asarray(np.kron(inverse_other, inverse), dtype=np.float64),
        model=lambda core: essential_model(core, inverse_other, inverse),
        behind=behind,
        twofold=True,
        stack=_STACK,
    )


def _covariance(answer: Answer, model: TwoViewModel, points: Float, backend: str) -> Float:
    """Of ω and τ, for the noise that the residuals show, with the modes' spread in these coordinates."""
    inverse = refine_model(model, points, answer.weights, rounds=0, backend=backend).covariance
    freedom = float(answer.weights.sum()) - model.freedom
    variance = answer.cost / freedom if freedom > 0 else np.nan
    back = np.linalg.pinv(model.derivatives())
    return np.asarray(variance * inverse + back.T @ answer.spread @ back)
