"""The essential matrix: epipolar geometry of rays, and the motion within it [eq 21].

With known camera matrices a pixel x is a ray x̂ = K⁻¹ (x, 1)ᵀ, and the epipolar constraint of two rays is

    x̂'ᵀ E x̂ = 0,      E = [t]ₓ R,      F = K_right⁻ᵀ E K_left⁻¹,

which is what the paper's [eq 21] means: E relates rays, not poses. E has five degrees of freedom, three of the rotation
and two of the direction t; how far the cameras are apart cannot be seen. Its singular values are (1, 1, 0) up to scale,
and the nearest such matrix to a given one, U diag(1, 1, 0) Vᵀ, is its *projection onto the essential manifold*.

**Four motions.** With E = U diag(1, 1, 0) Vᵀ, W a quarter turn about z,

    R₁ = U W Vᵀ,    R₂ = U Wᵀ Vᵀ,    t = ± u₃,

all give E up to sign. They differ by turning one camera half about the baseline and by exchanging the sides. Only one
of them has the points in front of both cameras (*cheirality*), and :func:`recover_pose` takes the one that has most.

**From how many points?** ``8point`` is linear, and fails on a plane like F does. ``5point`` takes five or more: samples
of five, the consensus of all, then the refinement of R and t. It works on a plane, a chessboard too. ``ransac`` is the
same with outliers allowed for; ``lmeds`` needs no threshold.

Sources: H. C. Longuet-Higgins, Nature 293 (1981); R. Hartley, A. Zisserman, *Multiple View Geometry* (2004), section
9.6; D. Nistér, PAMI 26 (2004).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import (
    Float,
    as_array,
    as_camera_matrix,
    require_choice,
    require_integer,
    require_positive,
)
from stereocal.base.errors import DegenerateGeometryError, InputError
from stereocal.base.homogeneous import cross_matrix, to_homogeneous
from stereocal.pair.consensus import Consensus, find_consensus
from stereocal.pair.epipolar import point_pairs, sampson_distance
from stereocal.pair.fundamental import refuse_homography, require_distinct
from stereocal.pair.two_view_refinement import RefinedMotion, refine_among_outliers, refine_motion
from stereocal.pair.two_view_solvers import eight_point, five_point, normalizing_transform

METHODS = ("8point", "5point", "lmeds", "ransac")
_TURN_FACTOR = 3.0
_EXACT = 1e-9


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


class RelativePose(NamedTuple):
    """R and the unit vector t, X_right ∝ R X_left + t, and which points lie in front of both cameras."""

    R: Float
    t: Float
    inliers: NDArray[np.bool_]


def project_to_essential(E: ArrayLike) -> Float:
    """Return U diag(1, 1, 0) Vᵀ, the essential matrix nearest to E up to scale.

    Parameters
    ----------
    E : array_like of shape (3, 3)

    Returns
    -------
    ndarray of shape (3, 3)

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> sc.project_to_essential(np.diag([3.0, 1.0, 0.5])).round(6) + 0.0
    array([[1., 0., 0.],
           [0., 1., 0.],
           [0., 0., 0.]])
    """
    U, _, Vt = np.linalg.svd(as_array(E, (3, 3), "E"))
    return np.asarray(U[:, :2] @ Vt[:2])


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
    Paper: [eq 21]. Answers to ``cv2.findEssentialMat``.

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
    return fit_essential_detailed(
        left_points,
        right_points,
        K_left,
        K_right,
        method=method,
        threshold=threshold,
        confidence=confidence,
        max_iterations=max_iterations,
        seed=seed,
        refine=refine,
    ).E


def fit_essential_detailed(
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
) -> EssentialFit:
    """Fit E as :func:`fit_essential` does, and tell the motion, the inliers, the errors and the covariance.

    Parameters
    ----------
    left_points, right_points, K_left, K_right, method, threshold, confidence, max_iterations, seed, refine
        See :func:`fit_essential`.

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
    require_choice(method, METHODS, "method")
    minimum = 8 if method == "8point" else 5
    left, right = point_pairs(left_points, right_points, minimum)
    first, second = _matrices(K_left, K_right)
    reach = require_positive(threshold or (0.002 if K_left is None else 1.0), "threshold")
    require_integer(max_iterations, "max_iterations", minimum=1)
    if not 0 < confidence < 1:
        raise InputError(f"confidence must be between 0 and 1, but is {confidence:g}")
    require_distinct(left, right, minimum, "E")
    rays, other = _rays(left, first), _rays(right, second)
    refuse_turn(rays, other, np.zeros(len(left)), first)
    to_F = (np.asarray(np.linalg.inv(second).T), np.asarray(np.linalg.inv(first)))
    inliers, iterations = np.ones(len(left), dtype=bool), 0
    if method == "8point":
        T1, T2 = normalizing_transform(rays[:, :2]), normalizing_transform(other[:, :2])
        E = T2.T @ eight_point(rays @ T1.T, other @ T2.T) @ T1
        refuse_homography(left, right, to_F[0] @ E @ to_F[1])
        E = project_to_essential(E)
    else:
        # without outliers to fear (5point) the threshold is wide open: all matches vote with their distance
        wide = 1e3 * reach if method == "5point" else reach
        found = _sample(left, right, rays, other, to_F, method, wide, confidence, max_iterations, seed)
        E = project_to_essential(first_to_rays(found.F, first, second))
        reach, iterations = found.threshold, found.iterations
        inliers = inliers if method == "5point" else found.inliers
    refuse_turn(
        rays[inliers], other[inliers], sampson_distance(left[inliers], right[inliers], to_F[0] @ E @ to_F[1]), first
    )
    pose = recover_pose(E, left[inliers], right[inliers], first, second)
    R, t, covariance = pose.R, pose.t, np.full((5, 5), np.nan)
    if refine or (refine is None and method != "8point"):
        if method in ("8point", "5point"):
            refined = refine_motion(R, t, left, right, first, second)
        else:

            def among_outliers(R: Float, t: Float) -> tuple[RefinedMotion, Float, float]:
                return refine_among_outliers(
                    RefinedMotion(R, t, covariance, 0.0),
                    lambda model, w: refine_motion(model.R, model.t, left, right, first, second, w, max_iterations=8),
                    lambda model: to_F[0] @ cross_matrix(model.t) @ model.R @ to_F[1],
                    left,
                    right,
                    reach,
                )

            refined, weights, likeliest = among_outliers(R, t)
            # the likelihood has several maxima: another search may end in a higher one
            again = _sample(left, right, rays, other, to_F, method, reach, confidence, max_iterations, seed + 1)
            iterations += again.iterations
            E = project_to_essential(first_to_rays(again.F, first, second))
            pose = recover_pose(E, left[again.inliers], right[again.inliers], first, second)
            second_try = among_outliers(pose.R, pose.t)
            if second_try[2] > likeliest:
                refined, weights, _ = second_try
            inliers = weights > 0.5
        R, t, covariance = refined.R, refined.t, refined.covariance
        E = cross_matrix(t) @ R
    rms = float(np.sqrt(np.mean(sampson_distance(left[inliers], right[inliers], to_F[0] @ E @ to_F[1]))))
    return EssentialFit(E, R, t, inliers, rms, covariance, iterations)


def first_to_rays(F: Float, K_left: Float, K_right: Float) -> Float:
    """Return E = K_rightᵀ F K_left.

    Parameters
    ----------
    F, K_left, K_right : ndarray of shape (3, 3)

    Returns
    -------
    ndarray of shape (3, 3)
    """
    return np.asarray(K_right.T @ F @ K_left)


def _sample(
    left: Float,
    right: Float,
    rays: Float,
    other: Float,
    to_F: tuple[Float, Float],
    method: str,
    threshold: float,
    confidence: float,
    max_iterations: int,
    seed: int,
) -> Consensus:
    """Consensus over samples of five rays, judged in pixels."""
    K = np.asarray(np.linalg.inv(to_F[1])), np.asarray(np.linalg.inv(to_F[0].T))

    def refit(mask: NDArray[np.bool_], F: Float) -> Float | None:
        if mask.sum() < 6:
            return None
        pose = recover_pose(project_to_essential(first_to_rays(F, *K)), left[mask], right[mask], *K)
        refined = refine_motion(pose.R, pose.t, left[mask], right[mask], *K, max_iterations=4)
        return np.asarray(to_F[0] @ cross_matrix(refined.t) @ refined.R @ to_F[1])

    return find_consensus(
        left,
        right,
        solve=lambda samples: to_F[0] @ five_point(rays[samples], other[samples])[0] @ to_F[1],
        sample_size=5,
        refit=refit,
        score="lmeds" if method == "lmeds" else "msac",
        threshold=threshold,
        confidence=confidence,
        max_iterations=100 if method == "5point" else max_iterations,
        seed=seed,
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
    if by_turn <= _TURN_FACTOR * by_E + _EXACT * np.sqrt(K[0, 0] * K[1, 1]):
        raise DegenerateGeometryError(
            f"a rotation explains the matches as well as E does ({by_turn:.2g} px against {by_E:.2g} px): the camera "
            "only turned (pure rotation), or all points are too far for this baseline; t is not determined"
        )


def decompose_essential(E: ArrayLike) -> tuple[Float, Float, Float]:
    """Return R₁, R₂ and t: the four motions of E are (R₁, ±t) and (R₂, ±t).

    Parameters
    ----------
    E : array_like of shape (3, 3)
        An essential matrix, of any scale and sign.

    Returns
    -------
    R1, R2 : ndarray of shape (3, 3)
        U W Vᵀ and U Wᵀ Vᵀ.
    t : ndarray of shape (3,)
        u₃, unit length.

    Notes
    -----
    Paper: [eq 21]. Answers to ``cv2.decomposeEssentialMat`` (agreement 1e-12 up to exchange and sign).

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> R1, R2, t = sc.decompose_essential(rig.E)
    >>> bool(min(abs(R1 - rig.R).max(), abs(R2 - rig.R).max()) < 1e-9)
    True
    >>> abs(t).round(6)
    array([1., 0., 0.])
    """
    U, _, Vt = np.linalg.svd(as_array(E, (3, 3), "E"))
    U = U if np.linalg.det(U) > 0 else -U
    Vt = Vt if np.linalg.det(Vt) > 0 else -Vt
    W = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    return U @ W @ Vt, U @ W.T @ Vt, U[:, 2]


def recover_pose(
    E: ArrayLike,
    left_points: ArrayLike,
    right_points: ArrayLike,
    K_left: ArrayLike | None = None,
    K_right: ArrayLike | None = None,
) -> RelativePose:
    """Choose the motion of E for which most points lie in front of both cameras (cheirality).

    Parameters
    ----------
    E : array_like of shape (3, 3)
        An essential matrix.
    left_points, right_points : array_like of shape (N, 2)
        Matching points: undistorted pixels with `K_left` and `K_right`, or normalised coordinates without.
    K_left, K_right : array_like of shape (3, 3), optional
        Camera matrices; the right one defaults to the left one.

    Returns
    -------
    RelativePose
        R, t, inliers.

    Notes
    -----
    Paper: [eq 21]. Answers to ``cv2.recoverPose`` (agreement 1e-9), which besides calls points further than 50
    baselines outliers.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> pose = sc.recover_pose(rig.E, left, right, K, K)
    >>> pose.t.round(6) + 0.0
    array([-1.,  0.,  0.])
    >>> int(pose.inliers.sum())
    20
    """
    left, right = point_pairs(left_points, right_points, 1)
    first, second = _matrices(K_left, K_right)
    x, xp = _rays(left, first), _rays(right, second)
    R1, R2, t = decompose_essential(E)
    best: RelativePose | None = None
    for R, translation in ((R1, t), (R2, t), (R1, -t), (R2, -t)):
        depth_left, depth_right = _depths(x, xp, R, translation)
        good = (depth_left > 0) & (depth_right > 0)
        if best is None or good.sum() > best.inliers.sum():
            best = RelativePose(R, translation, good)
    assert best is not None
    return best


def _depths(x: Float, xp: Float, R: Float, t: Float) -> tuple[Float, Float]:
    """Return λ and λ' of λ' x' = λ R x + t, in the least-squares sense: the points' depths in both cameras."""
    turned = x @ R.T
    aa, bb, ab = np.sum(turned**2, axis=1), np.sum(xp**2, axis=1), np.sum(turned * xp, axis=1)
    at, bt = turned @ t, xp @ t
    determinant = np.maximum(aa * bb - ab * ab, 1e-300)
    return (ab * bt - bb * at) / determinant, (aa * bt - ab * at) / determinant


def _matrices(K_left: ArrayLike | None, K_right: ArrayLike | None) -> tuple[Float, Float]:
    if K_left is None:
        if K_right is not None:
            raise InputError("K_right is given without K_left; give both, or normalised coordinates and neither")
        return np.eye(3), np.eye(3)
    first = as_camera_matrix(K_left, "K_left")
    return first, first if K_right is None else as_camera_matrix(K_right, "K_right")


def _rays(points: Float, K: Float) -> Float:
    """Return K⁻¹ (x, 1)ᵀ, z = 1."""
    return np.asarray(to_homogeneous(points) @ np.linalg.inv(K).T)
