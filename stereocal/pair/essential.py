"""The essential matrix: epipolar geometry of rays, and the motion within it.

x̂'ᵀ E x̂ = 0 for rays x̂ = K⁻¹ x, E = [T]ₓ R [eq 21].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float, as_array, as_camera_matrix
from stereocal.pair.epipolar import point_pairs
from stereocal.pair.fundamental import fit_fundamental


def project_to_essential(E: Float) -> Float:
    """Return the nearest essential matrix with singular values (1, 1, 0)."""
    U, _, Vt = np.linalg.svd(E)
    return np.asarray(U @ np.diag([1.0, 1.0, 0.0]) @ Vt)


def fit_essential(
    left_points: ArrayLike,
    right_points: ArrayLike,
    K_left: ArrayLike | None = None,
    K_right: ArrayLike | None = None,
    *,
    method: str = "8point",
) -> Float:
    """Fit E from rays, x̂_rightᵀ E x̂_left = 0.

    Parameters
    ----------
    left_points, right_points : array_like of shape (N, 2)
        Matching points: undistorted pixels with `K_left` and `K_right`, or normalised coordinates without.
    K_left, K_right : array_like of shape (3, 3), optional
        Camera matrices; the right one defaults to the left one.
    method : {"8point"}
        How.

    Returns
    -------
    ndarray of shape (3, 3)
        Singular values (1, 1, 0).

    Notes
    -----
    Paper: [eq 21].
    """
    left, right = point_pairs(left_points, right_points)
    if K_left is not None:
        left = (
            left @ np.linalg.inv(as_camera_matrix(K_left, "K_left"))[:2, :2].T
            + np.linalg.inv(as_camera_matrix(K_left))[:2, 2]
        )
        K2 = as_camera_matrix(K_left if K_right is None else K_right, "K_right")
        right = right @ np.linalg.inv(K2)[:2, :2].T + np.linalg.inv(K2)[:2, 2]
    return project_to_essential(fit_fundamental(left, right))


def decompose_essential(E: ArrayLike) -> tuple[Float, Float, Float]:
    """Return R₁, R₂ and t: the four motions of E are (R₁, ±t), (R₂, ±t).

    Parameters
    ----------
    E : array_like of shape (3, 3)
        An essential matrix.

    Returns
    -------
    R1, R2 : ndarray of shape (3, 3)
        The two rotations.
    t : ndarray of shape (3,)
        The direction of translation, unit length.

    Notes
    -----
    Answers to ``cv2.decomposeEssentialMat``.
    """
    U, _, Vt = np.linalg.svd(as_array(E, (3, 3), "E"))
    U = U if np.linalg.det(U) > 0 else -U
    Vt = Vt if np.linalg.det(Vt) > 0 else -Vt
    W = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    return U @ W @ Vt, U @ W.T @ Vt, U[:, 2]


class RelativePose(NamedTuple):
    """R and the unit vector t, X_right = R X_left + t, and which points lie before both cameras."""

    R: Float
    t: Float
    inliers: NDArray[np.bool_]


def recover_pose(
    E: ArrayLike,
    left_points: ArrayLike,
    right_points: ArrayLike,
    K_left: ArrayLike | None = None,
    K_right: ArrayLike | None = None,
) -> RelativePose:
    """Choose the motion of E for which the points lie before both cameras (cheirality).

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
    Answers to ``cv2.recoverPose``.
    """
    left, right = point_pairs(left_points, right_points, 1)
    if K_left is not None:
        left = (
            left @ np.linalg.inv(as_camera_matrix(K_left, "K_left"))[:2, :2].T
            + np.linalg.inv(as_camera_matrix(K_left))[:2, 2]
        )
        K2 = as_camera_matrix(K_left if K_right is None else K_right, "K_right")
        right = right @ np.linalg.inv(K2)[:2, :2].T + np.linalg.inv(K2)[:2, 2]
    R1, R2, t = decompose_essential(E)
    best = None
    for R, sign in ((R1, 1), (R2, 1), (R1, -1), (R2, -1)):
        P2 = np.column_stack([R, sign * t])
        A = np.concatenate(
            [points[:, :, None] * P[2] - P[None, :2] for points, P in ((left, np.eye(3, 4)), (right, P2))], axis=1
        )
        X = np.linalg.svd(A)[2][:, 3]
        depth1, depth2 = X[:, 2] / X[:, 3], X @ P2[2] / X[:, 3]
        good = (depth1 > 0) & (depth2 > 0)
        if best is None or good.sum() > best.inliers.sum():
            best = RelativePose(R, sign * t, good)
    assert best is not None
    return best
