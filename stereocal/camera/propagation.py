"""What the uncertainty of a calibration means for a pixel and for a point in space.

A quantity y = f(p) of parameters p with covariance C has, to first order, the covariance J C Jᵀ, J = ∂f/∂p.

**A pixel** that a calibrated camera draws of a point given in its own frame depends on fx, fy, cx, cy, s and k: J is
the derivative that the bundle engine uses.

**A point in space** is where the rays of two corners meet. Written out, X minimises the distance of its two
projections from the corners,

    ‖p̃_L(X) − y_L‖² + ‖p̃_R(R X + T) − y_R‖²,

and at the minimum gᵀr = 0 holds, with r the four residuals and g = ∂r/∂X (4×3). Differentiating it, δX = −(gᵀg)⁻¹gᵀ
(∂r/∂p δp − δy), which gives both what the calibration contributes and what the corners' own noise does. Far away both
grow with the square of the distance: for a rectified pair σ_Z = Z² σ_d / (f B), and the calibration adds a part that
no averaging over corners removes.

The calibration's errors of the two cameras and of R and T are correlated, strongly so; the whole covariance is used.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_points
from stereocal.base.rotations import left_jacobian_inverse, rotation_vectors
from stereocal.camera.distortion import distortion_model
from stereocal.camera.model import Camera
from stereocal.camera.projection import perspective_jacobian


def pixel_covariance(X: ArrayLike, camera: Camera, covariance: Float) -> Float:
    """Return the covariance of the pixels at which a calibrated camera draws points of its own frame.

    Parameters
    ----------
    X : array_like of shape (N, 3)
        Points in the camera's frame.
    camera : Camera
        The camera.
    covariance : ndarray of shape (n, n)
        Of fx, fy, cx, cy, skew and k, as ``CameraCalibration.covariance``.

    Returns
    -------
    ndarray of shape (N, 2, 2)
        px².
    """
    _, _, J = _pixels(as_points(X, 3, "X"), camera)
    return np.asarray(J @ covariance @ J.transpose(0, 2, 1))


def triangulation_covariance(
    X: ArrayLike, left: Camera, right: Camera, R: Float, T: Float, covariance: Float, *, corner_std: float = 0.0
) -> Float:
    """Return the covariance of points triangulated by a calibrated rig.

    Parameters
    ----------
    X : array_like of shape (N, 3)
        Points in the left camera's frame.
    left, right : Camera
        The cameras.
    R, T : ndarray of shape (3, 3), (3,)
        X_right = R X_left + T.
    covariance : ndarray of shape (n, n)
        Of left camera, right camera, rvec and T, as ``StereoCalibration.covariance``.
    corner_std : float
        Standard deviation of each coordinate of the two corners, pixels; 0 leaves the calibration's part alone.

    Returns
    -------
    ndarray of shape (N, 3, 3)
        Units of the board squared; σ_Z is the root of entry [2, 2].
    """
    points = as_points(X, 3, "X")
    _, g_left, J_left = _pixels(points, left)
    turned = points @ R.T
    _, g_right, J_right = _pixels(turned + T, right)
    count, a, b = len(points), J_left.shape[2], J_right.shape[2]
    by_parameters = np.zeros((count, 4, a + b + 6))
    by_parameters[:, :2, :a] = J_left
    by_parameters[:, 2:, a : a + b] = J_right
    # a change of rvec is a turn J_l δr on the left of R: ∂p̃/∂ω = (R X) × g
    J_l = np.linalg.inv(left_jacobian_inverse(rotation_vectors(R[None]))[0])
    by_parameters[:, 2:, a + b : a + b + 3] = np.cross(turned[:, None, :], g_right) @ J_l
    by_parameters[:, 2:, a + b + 3 :] = g_right
    g = np.concatenate([g_left, g_right @ R], axis=1)
    solve = np.linalg.pinv(g)
    of_residuals = by_parameters @ covariance @ by_parameters.transpose(0, 2, 1) + corner_std**2 * np.eye(4)
    return np.asarray(solve @ of_residuals @ solve.transpose(0, 2, 1))


def _pixels(X: Float, camera: Camera) -> tuple[Float, Float, Float]:
    """x_d, ∂p̃/∂X (N, 2, 3) and ∂p̃/∂θ (N, 2, 5 + n)."""
    with np.errstate(all="ignore"):
        x = np.where(X[:, 2:] > 0, X[:, :2] / X[:, 2:], np.nan)
    x_d, D, D_k = distortion_model(camera.model).jacobians(x, camera.dist)
    A = camera.K[:2, :2]
    J = np.zeros((len(X), 2, 5 + len(camera.dist)))
    J[:, 0, 0], J[:, 1, 1] = x_d[:, 0], x_d[:, 1]
    J[:, 0, 2] = J[:, 1, 3] = 1
    J[:, 0, 4] = x_d[:, 1]
    J[:, :, 5:] = A @ D_k
    return x_d, A @ D @ perspective_jacobian(x, X[:, 2]), J
