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

from stereocal.base.checks import Float, as_array, as_points, as_rotation
from stereocal.base.errors import InputError
from stereocal.base.rotations import left_jacobian_inverse, rotation_vectors
from stereocal.camera.distortion import distortion_model
from stereocal.camera.model import Camera
from stereocal.camera.projection import perspective_jacobian


def pixel_covariance(X: ArrayLike, camera: Camera, covariance: ArrayLike) -> Float:
    """Return the covariance J C Jᵀ of the pixels at which a calibrated camera draws points of its own frame.

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
        px²; NaN for a point that is not in front of the camera.

    Raises
    ------
    InputError
        If the points or the covariance have the wrong shape.

    Examples
    --------
    A point straight ahead is drawn where the principal point is, and no surer than that; to the side fx counts too:

    >>> import numpy as np
    >>> import stereocal as sc
    >>> camera = sc.Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], None, (640, 480))
    >>> C = np.diag([1.0, 1.0, 0.25, 0.25, 0, 0, 0, 0, 0, 0])  # fx fy cx cy skew k1 k2 p1 p2 k3, as of a calibration
    >>> sc.pixel_covariance([[0, 0, 2.0], [1, 0, 2.0]], camera, C).round(3)
    array([[[0.25, 0.  ],
            [0.  , 0.25]],
    <BLANKLINE>
           [[0.5 , 0.  ],
            [0.  , 0.25]]])
    """
    _, _, J = _pixels(as_points(X, 3, "X"), camera)
    C = _covariance_of(covariance, J.shape[2], "fx, fy, cx, cy, skew and the lens: CameraCalibration.covariance")
    return np.asarray(J @ C @ J.transpose(0, 2, 1))


def triangulation_covariance(
    X: ArrayLike,
    left: Camera,
    right: Camera,
    R: ArrayLike,
    T: ArrayLike,
    covariance: ArrayLike,
    *,
    corner_std: float = 0.0,
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
        Units of the board squared; σ_Z is the root of entry [2, 2]. NaN for a point that is not in front of both
        cameras.

    Raises
    ------
    InputError
        If an argument has the wrong shape, or `corner_std` is negative.

    Examples
    --------
    Without errors of the calibration σ_Z = √2 Z² σ / (f B) is left, σ that of a corner's coordinates:

    >>> import numpy as np
    >>> import stereocal as sc
    >>> camera = sc.Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], None, (640, 480))
    >>> X = [[0.05, 0, 1.0], [0.05, 0, 2.0], [0.05, 0, 4.0]]
    >>> C = sc.triangulation_covariance(X, camera, camera, np.eye(3), [-0.1, 0, 0], np.zeros((26, 26)), corner_std=0.2)
    >>> np.sqrt(C[:, 2, 2]).round(4)
    array([0.0057, 0.0226, 0.0905])
    """
    points = as_points(X, 3, "X")
    R, T = as_rotation(R), as_array(np.ravel(np.asarray(T)), (3,), "T")
    if not corner_std >= 0:
        raise InputError(f"corner_std must not be negative: it is a standard deviation in pixels, not {corner_std!r}")
    _, g_left, J_left = _pixels(points, left)
    turned = points @ R.T
    _, g_right, J_right = _pixels(turned + T, right)
    count, a, b = len(points), J_left.shape[2], J_right.shape[2]
    C = _covariance_of(covariance, a + b + 6, "both cameras, rvec and T: StereoCalibration.covariance")
    by_parameters = np.zeros((count, 4, a + b + 6))
    by_parameters[:, :2, :a] = J_left
    by_parameters[:, 2:, a : a + b] = J_right
    # a change of rvec is a turn J_l δr on the left of R: ∂p̃/∂ω = (R X) × g
    J_l = np.linalg.inv(left_jacobian_inverse(rotation_vectors(R[None]))[0])
    by_parameters[:, 2:, a + b : a + b + 3] = np.cross(turned[:, None, :], g_right) @ J_l
    by_parameters[:, 2:, a + b + 3 :] = g_right
    g = np.concatenate([g_left, g_right @ R], axis=1)
    seen = np.isfinite(g).all(axis=(1, 2))
    solve = np.full((count, 3, 4), np.nan)
    solve[seen] = np.linalg.pinv(g[seen])
    of_residuals = by_parameters @ C @ by_parameters.transpose(0, 2, 1) + corner_std**2 * np.eye(4)
    return np.asarray(solve @ of_residuals @ solve.transpose(0, 2, 1))


def _covariance_of(covariance: ArrayLike, count: int, what: str) -> Float:
    """The covariance as an array; its shape must be that of the parameters."""
    C = np.asarray(covariance, dtype=np.float64)
    if C.shape != (count, count):
        raise InputError(f"covariance must have shape ({count}, {count}), of {what}, but has {C.shape}")
    return C


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
