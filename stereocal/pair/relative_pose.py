"""The motion within an essential matrix: the manifold of them all, four motions, and which one is seen.

E = [t]ₓ R has five degrees of freedom, three of the rotation and two of the direction t; how far the cameras are apart
cannot be seen. Its singular values are (1, 1, 0) up to scale, and the nearest such matrix to a given one, U diag(1, 1,
0) Vᵀ, is its *projection onto the essential manifold*.

**Four motions.** With E = U diag(1, 1, 0) Vᵀ, W a quarter turn about z,

    R₁ = U W Vᵀ,    R₂ = U Wᵀ Vᵀ,    t = ± u₃,

all give E up to sign. They differ by turning one camera half about the baseline and by exchanging the sides. Only one
of them has the points in front of both cameras (*cheirality*), and :func:`recover_pose` takes the one that has most.

**Depths.** λ' x̂' = λ R x̂ + t are three equations for the depths λ, λ' of a match, solved in the least-squares sense.

Sources: H. C. Longuet-Higgins, Nature 293 (1981); R. Hartley, A. Zisserman, *Multiple View Geometry* (2004), section
9.6.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float, as_array, as_camera_matrix
from stereocal.base.errors import InputError
from stereocal.base.homogeneous import to_homogeneous
from stereocal.pair.epipolar import point_pairs


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
    first, second = camera_matrices(K_left, K_right)
    x, xp = rays_of(left, first), rays_of(right, second)
    R1, R2, t = decompose_essential(E)
    in_front = ahead_of_motions(R1, t, x, xp)
    best = int(np.argmax(in_front.sum(axis=1)))
    return RelativePose((R1, R2)[best // 2], -t if best % 2 else t, in_front[best])


def ahead_of_motions(R: Float, t: Float, x: Float, xp: Float) -> NDArray[np.bool_]:
    """Return which points lie in front of both cameras, for the four motions of one essential matrix.

    Parameters
    ----------
    R : ndarray of shape (3, 3)
        One of the two rotations.
    t : ndarray of shape (3,)
        Unit vector.
    x, xp : ndarray of shape (N, 3)
        Rays of the left and of the right camera, z = 1.

    Returns
    -------
    ndarray of shape (4, N), bool
        Of (R, t), (R, −t), and then of (R', t), (R', −t), R' = (2 t tᵀ − 1) R the other rotation.
    """
    a, b = x @ R.T, xp  # λ' b = λ a + t in the least-squares sense; −t changes the signs of both depths
    at, bt = a @ t, b @ t
    aa, bb, ab = np.einsum("ni,ni->n", a, a), np.einsum("ni,ni->n", b, b), np.einsum("ni,ni->n", a, b)
    ahead = []
    # the other rotation takes a to 2 t (a·t) − a: a·t stays, and a·b becomes
    for product in (ab, 2 * at * bt - ab):
        left, right = product * bt - bb * at, aa * bt - product * at
        ahead += [(left > 0) & (right > 0), (left < 0) & (right < 0)]
    return np.array(ahead)


def camera_matrices(K_left: ArrayLike | None, K_right: ArrayLike | None) -> tuple[Float, Float]:
    """Return both camera matrices: the right one is the left one if not given, and both are 1 if none is."""
    if K_left is None:
        if K_right is not None:
            raise InputError("K_right is given without K_left; give both, or normalised coordinates and neither")
        return np.eye(3), np.eye(3)
    first = as_camera_matrix(K_left, "K_left")
    return first, first if K_right is None else as_camera_matrix(K_right, "K_right")


def rays_of(points: Float, K: Float) -> Float:
    """Return K⁻¹ (x, 1)ᵀ, z = 1."""
    return np.asarray(to_homogeneous(points) @ np.linalg.inv(K).T)
