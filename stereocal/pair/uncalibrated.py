"""Rectification from matching points and F alone: two homographies that make rows match (Hartley).

Without calibration no angles are known, but which points lie on one line is. A homography H' that sends the right
epipole e' to infinity along x makes all epipolar lines of the right picture rows; then the left picture's H is all but
fixed, because its rows must be the matching ones.

**Right picture.** In coordinates with the picture's middle as origin: turn e' onto the x axis, e' → (f, 0, 1), then
push it to infinity with G = [[1, 0, 0], [0, 1, 0], [−1/f, 0, 1]]. Near the middle G is the identity to first order, so
the picture is distorted least where it counts: H' = C⁻¹ G R C.

**Left picture.** With F = [e']ₓ M, the homographies H with matching rows are H = A H' M, A = [[a, b, c], [0, 1, 0], [0,
0, 1]]: any shear, stretch and shift along the rows. M = [e']ₓ F + e' vᵀ for any v. A is chosen so that disparities are
small: Σ (a x̂ᵢ + b ŷᵢ + c − x̂'ᵢ)² → min over the points x̂ = H' M x, x̂' = H' x', linear least squares.

If e' is within the picture no homography can send it to infinity without tearing the picture apart; that is refused. A
rectification without calibration gives no depth: metric reconstruction is known up to a projective change only.

Sources: R. Hartley, *Theory and practice of projective rectification*, IJCV 35 (1999); R. Hartley, A. Zisserman (2004),
section 11.12.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_array, as_image_size
from stereocal.base.errors import DegenerateGeometryError
from stereocal.base.homogeneous import cross_matrix, from_homogeneous, to_homogeneous
from stereocal.pair.epipolar import point_pairs


def rectify_uncalibrated(
    left_points: ArrayLike, right_points: ArrayLike, F: ArrayLike, image_size: tuple[int, int]
) -> tuple[Float, Float]:
    """Return homographies H₁, H₂ after which matching points lie on one row: y(H₁ x) = y(H₂ x').

    Parameters
    ----------
    left_points, right_points : array_like of shape (N, 2)
        Matching undistorted pixels without outliers, N ≥ 3; only the stretch along rows depends on them.
    F : array_like of shape (3, 3)
        The fundamental matrix, x_rightᵀ F x_left = 0.
    image_size : (int, int)
        Width and height of both pictures.

    Returns
    -------
    H1, H2 : ndarray of shape (3, 3)
        Scaled to H[2, 2] = 1. H2 keeps the right picture's middle in place, and the pictures upright.

    Raises
    ------
    InputError
        If there are fewer than 3 pairs.
    DegenerateGeometryError
        If the right epipole is within the picture, or the points do not determine the stretch.

    Notes
    -----
    Paper: [eq 20]. Answers to ``cv2.stereoRectifyUncalibrated``, which rounds the middle to a whole pixel; rows match
    as well (compared by the y distance of points, because the homographies are free along the rows).

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> H1, H2 = sc.rectify_uncalibrated(left, right, rig.F, (640, 480))
    >>> row = [np.c_[points, np.ones(20)] @ H.T for points, H in ((left, H1), (right, H2))]
    >>> bool(np.allclose(row[0][:, 1] / row[0][:, 2], row[1][:, 1] / row[1][:, 2]))
    True
    """
    left, right = point_pairs(left_points, right_points, 3)
    width, height = as_image_size(image_size)
    middle = np.array([[1, 0, -(width - 1) / 2], [0, 1, -(height - 1) / 2], [0, 0, 1]])
    U, s, Vt = np.linalg.svd(as_array(F, (3, 3), "F"))
    rank2 = (U * [s[0], s[1], 0]) @ Vt
    e = U[:, 2]
    H2 = _send_epipole_to_infinity(middle @ e, width, height) @ middle
    H2 = np.linalg.inv(middle) @ H2
    # v = e' keeps M well conditioned: [e']ₓF is singular in the direction of e' only
    M = cross_matrix(e) @ rank2 + np.outer(e, Vt[2]) * s[0]
    H0 = H2 @ M
    x, xp = from_homogeneous(to_homogeneous(left) @ H0.T), from_homogeneous(to_homogeneous(right) @ H2.T)
    system = to_homogeneous(x)
    shear, _, rank, _ = np.linalg.lstsq(system, xp[:, 0])
    if rank < 3 or not np.all(np.isfinite(shear)) or abs(shear[0]) < 1e-12:
        raise DegenerateGeometryError(
            "the points lie on one line after rectification; give points all over the picture"
        )
    H1 = np.array([shear, [0, 1, 0], [0, 0, 1]]) @ H0
    return H1 / H1[2, 2], H2 / H2[2, 2]


def _send_epipole_to_infinity(e: Float, width: int, height: int) -> Float:
    """Return G R for an epipole e in coordinates about the picture's middle."""
    if abs(e[2]) > 1e-12 * np.linalg.norm(e) and np.all(np.abs(e[:2] / e[2]) <= (width / 2, height / 2)):
        raise DegenerateGeometryError(
            "the epipole is within the picture (the camera moved forward): rows cannot be made to match without "
            "tearing the picture apart; use a rig whose cameras stand side by side"
        )
    # of the two directions of the x axis the nearer one, so that the picture is not turned upside down
    direction = e[:2] * (1.0 if e[0] >= 0 else -1.0)
    c, s = direction / np.hypot(*direction)
    turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    x, _, w = turn @ e
    return np.array([[1, 0, 0], [0, 1, 0], [-w / x, 0, 1]]) @ turn
