"""Rectification from points and F alone (Hartley): two homographies that send the epipoles to infinity along x."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_array, as_image_size
from stereocal.base.homogeneous import cross_matrix, to_homogeneous
from stereocal.pair.epipolar import point_pairs


def rectify_uncalibrated(
    left_points: ArrayLike, right_points: ArrayLike, F: ArrayLike, image_size: tuple[int, int]
) -> tuple[Float, Float]:
    """Return homographies H₁, H₂ after which matching points lie on one row.

    Parameters
    ----------
    left_points, right_points : array_like of shape (N, 2)
        Matching pixels.
    F : array_like of shape (3, 3)
        The fundamental matrix.
    image_size : (int, int)
        Width and height.

    Returns
    -------
    H1, H2 : ndarray of shape (3, 3)

    Notes
    -----
    Answers to ``cv2.stereoRectifyUncalibrated``.
    """
    left, right = point_pairs(left_points, right_points, 3)
    matrix = as_array(F, (3, 3), "F")
    width, height = as_image_size(image_size)
    cx, cy = (width - 1) / 2, (height - 1) / 2
    U, s, Vt = np.linalg.svd(matrix)
    matrix = (U * [s[0], s[1], 0]) @ Vt
    e2 = U[:, 2]
    centre = np.array([[1, 0, -cx], [0, 1, -cy], [0, 0, 1.0]])
    e = centre @ e2
    e = e if e[0] >= 0 else -e
    length = np.hypot(e[0], e[1])
    turn = np.array([[e[0], e[1], 0], [-e[1], e[0], 0], [0, 0, length]]) / length
    e = turn @ e
    push = np.array([[1, 0, 0], [0, 1, 0], [-e[2] / e[0], 0, 1]])
    H2 = np.linalg.inv(centre) @ push @ turn @ centre
    M = cross_matrix(e2) @ matrix + np.outer(e2, np.ones(3))
    H0 = H2 @ M
    x1, x2 = to_homogeneous(left) @ H0.T, to_homogeneous(right) @ H2.T
    x1, x2 = x1 / x1[:, 2:], x2 / x2[:, 2:]
    a = np.linalg.lstsq(x1, x2[:, 0], rcond=None)[0]
    H1 = np.array([a, [0, 1, 0], [0, 0, 1.0]]) @ H0
    return H1, H2
