"""From a point in space to a pixel, and the derivatives of each step [eq 11, 13, 14].

    X_c = R X + T                        board (or world) to camera
    x   = (X_c / Z_c, Y_c / Z_c)         perspective division
    x_d = x_d(x; k)                      the lens
    u   = fx x_d + s y_d + cx,  v = fy y_d + cy

[eq 11]'s ŝ p̂ = W [R∣T] P̂ is the same without the third line: W is K, ŝ is Z_c. The paper's (s_x, s_y) is the
principal point (cx, cy) here.

The chain rule, with A = [[fx, s], [0, fy]], D = ∂x_d/∂x and Π = ∂x/∂X_c = 1/Z [[1, 0, −x], [0, 1, −y]]:

    ∂p/∂X_c = A D Π,    ∂p/∂T = A D Π,    ∂p/∂rᵢ = A D Π (∂R/∂rᵢ) X,    ∂p/∂k = A ∂x_d/∂k,
    ∂u/∂fx = x_d,       ∂v/∂fy = y_d,     ∂p/∂c = I.
"""

from __future__ import annotations

from typing import Literal, overload

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_array, as_camera_matrix, as_points
from stereocal.base.rotations import rotation_matrix, rotation_matrix_jacobian
from stereocal.camera.distortion import as_distortion, distortion_model, model_meant, to_pixels


@overload
def project_points(
    object_points: ArrayLike, rvec: ArrayLike, tvec: ArrayLike, K: ArrayLike, dist: ArrayLike | None = None,
    *, model: str = "brown", jacobian: Literal[False] = False,
) -> Float: ...  # fmt: skip
@overload
def project_points(
    object_points: ArrayLike, rvec: ArrayLike, tvec: ArrayLike, K: ArrayLike, dist: ArrayLike | None = None,
    *, model: str = "brown", jacobian: Literal[True],
) -> tuple[Float, Float]: ...  # fmt: skip
def project_points(
    object_points: ArrayLike,
    rvec: ArrayLike,
    tvec: ArrayLike,
    K: ArrayLike,
    dist: ArrayLike | None = None,
    *,
    model: str = "brown",
    jacobian: bool = False,
) -> Float | tuple[Float, Float]:
    """Project points: ŝ p̂ = K [R∣T] X̂ through the lens; u = fx x + cx, v = fy y + cy.

    Parameters
    ----------
    object_points : array_like of shape (N, 3), (N, 1, 3) or (1, N, 3)
        Points X in the board's (or world's) frame.
    rvec, tvec : array_like of 3 numbers
        Pose: X_camera = R(rvec) X + tvec.
    K : array_like of shape (3, 3)
        Camera matrix; K[0, 1] is the skew.
    dist : array_like or None
        Coefficients of the model.
    model : str
        Distortion model, see ``distortion``; 8, 12 or 14 coefficients need no name, as in OpenCV.
    jacobian : bool
        Whether to return the derivatives too.

    Returns
    -------
    points : ndarray of shape (N, 2)
        Pixels; NaN for points that are not in front of the camera (Z ≤ 0).
    jacobian : ndarray of shape (2N, 10 + n)
        Only if asked for. Rows u₀ v₀ u₁ v₁ …; columns rvec (3), tvec (3), fx, fy, cx, cy, k (n).

    Raises
    ------
    InputError
        If an argument has the wrong shape or is not finite.

    Notes
    -----
    Paper: [eq 11, 13, 14]. Answers to ``cv2.projectPoints``, derivatives included (agreement 1e-10
    relative), but for points behind the camera, which OpenCV projects as if they stood in front of it.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> sc.project_points([[0.1, 0.2, 0.0]], [0, 0, 0], [0, 0, 2.0], K, [-0.3, 0.1]).round(4)
    array([[344.9066, 289.8133]])
    """
    X = as_points(object_points, 3, "object_points")
    r, t = as_array(_flat(rvec), (3,), "rvec"), as_array(_flat(tvec), (3,), "tvec")
    model = model_meant(dist, model)
    matrix, k = as_camera_matrix(K), as_distortion(dist, model)
    lens = distortion_model(model)
    X_c = X @ rotation_matrix(r).T + t
    with np.errstate(all="ignore"):
        x = np.where(X_c[:, 2:] > 0, X_c[:, :2] / X_c[:, 2:], np.nan)
    if not jacobian:
        return to_pixels(lens.distort(x, k), matrix)

    x_d, D, D_k = lens.jacobians(x, k)
    A = matrix[:2, :2]
    g = A @ D @ perspective_jacobian(x, X_c[:, 2])  # ∂p/∂X_c
    J = np.zeros((len(X), 2, 10 + len(k)))
    for i, R_i in enumerate(rotation_matrix_jacobian(r)):
        J[:, :, i] = np.einsum("nij,nj->ni", g, X @ R_i.T)
    J[:, :, 3:6] = g
    J[:, 0, 6], J[:, 1, 7] = x_d[:, 0], x_d[:, 1]
    J[:, 0, 8] = J[:, 1, 9] = 1
    J[:, :, 10:] = A @ D_k
    return to_pixels(x_d, matrix), J.reshape(2 * len(X), J.shape[2])


def _flat(vector: ArrayLike) -> ArrayLike:
    """A vector in any of OpenCV's shapes, (3,), (3, 1), (1, 3) or (1, 1, 3), in a row; anything else as it is."""
    shape = np.shape(vector)
    return np.ravel(np.asarray(vector)) if sum(n > 1 for n in shape) <= 1 else vector


def perspective_jacobian(x: Float, Z: Float) -> Float:
    """Return Π = ∂x/∂X_c = 1/Z [[1, 0, −x], [0, 1, −y]] of points x (N, 2) at depth Z (N,): (N, 2, 3)."""
    out = np.zeros((len(x), 2, 3))
    with np.errstate(all="ignore"):
        out[:, 0, 0] = out[:, 1, 1] = 1 / Z
        out[:, :, 2] = -x / Z[:, None]
    return out
