"""Triangulation: the point in space that two cameras see at two pixels.

**Linear** (DLT). A camera P with rows p₁ᵀ, p₂ᵀ, p₃ᵀ sees X at x = p₁ᵀX / p₃ᵀX, so (x p₃ − p₁)ᵀ X = 0, and likewise for
y. Two views give four equations A X = 0 in four homogeneous unknowns; X is the right singular vector of A's smallest
singular value.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_array, as_points
from stereocal.base.errors import InputError
from stereocal.base.homogeneous import from_homogeneous


def triangulate_points(P1: ArrayLike, P2: ArrayLike, left_points: ArrayLike, right_points: ArrayLike) -> Float:
    """Triangulate by the linear method: min ‖A X‖, ‖X‖ = 1.

    Parameters
    ----------
    P1, P2 : array_like of shape (3, 4)
        Projection matrices of the two cameras.
    left_points, right_points : array_like of shape (N, 2)
        Undistorted pixels (or normalised coordinates, if P1 and P2 are poses).

    Returns
    -------
    ndarray of shape (N, 3), float64

    Notes
    -----
    Answers to ``cv2.triangulatePoints``, dehomogenised.
    """
    first, second = as_array(P1, (3, 4), "P1"), as_array(P2, (3, 4), "P2")
    left, right = as_points(left_points, 2, "left_points"), as_points(right_points, 2, "right_points")
    if len(left) != len(right):
        raise InputError(f"left_points holds {len(left)} points and right_points {len(right)}; they must be pairs")
    A = np.concatenate(
        [points[:, :, None] * P[2] - P[None, :2] for points, P in ((left, first), (right, second))], axis=1
    )
    return from_homogeneous(np.linalg.svd(A)[2][:, 3])
