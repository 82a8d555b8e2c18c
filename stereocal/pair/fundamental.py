"""The fundamental matrix from matching points.

Each match gives one linear equation in the nine entries of F: x'ᵀ F x = 0 [eq 20].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float
from stereocal.base.homogeneous import to_homogeneous
from stereocal.pair.epipolar import point_pairs


def normalizing_transform(points: Float) -> Float:
    """Return the similarity that moves the points' centroid to 0 and their mean distance from it to √2."""
    centre = points.mean(axis=0)
    distance = float(np.mean(np.linalg.norm(points - centre, axis=1)))
    s = np.sqrt(2) / distance
    return np.array([[s, 0, -s * centre[0]], [0, s, -s * centre[1]], [0, 0, 1]])


def fit_fundamental(left_points: ArrayLike, right_points: ArrayLike, *, method: str = "8point") -> Float:
    """Fit F by the normalised eight-point algorithm: min ‖A f‖, ‖f‖ = 1, then rank 2.

    Parameters
    ----------
    left_points, right_points : array_like of shape (N, 2)
        Matching pixels, N ≥ 8.
    method : {"8point"}
        How.

    Returns
    -------
    ndarray of shape (3, 3)
        F with x_rightᵀ F x_left = 0.

    Notes
    -----
    Paper: [eq 20]. Answers to ``cv2.findFundamentalMat(..., cv2.FM_8POINT)``.
    """
    left, right = point_pairs(left_points, right_points, 8)
    T1, T2 = normalizing_transform(left), normalizing_transform(right)
    x, xp = to_homogeneous(left) @ T1.T, to_homogeneous(right) @ T2.T
    A = np.einsum("ni,nj->nij", xp, x).reshape(-1, 9)
    F = np.linalg.svd(A)[2][8].reshape(3, 3)
    U, s, Vt = np.linalg.svd(F)
    s[2] = 0
    F = T2.T @ (U * s) @ Vt @ T1
    return np.asarray(F / F[2, 2] if abs(F[2, 2]) > 1e-12 else F / np.linalg.norm(F))
