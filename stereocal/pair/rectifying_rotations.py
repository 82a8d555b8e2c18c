"""Bouguet's rectifying rotations: turn both cameras, as little as possible, until their rows are the same rows.

Two pinhole images are *rectified* when the cameras have the same orientation and the baseline lies along the image rows
(or columns). Then both epipoles are at infinity, epipolar lines are image rows, and a point of the left image is looked
for on one row of the right image. Any pair can be brought there by rotations alone, because a rotation about the
camera's centre moves pixels by a homography and needs to know nothing of the scene.

With X_right = R X_left + T, three steps:

1. **Meet half way.** Let ω be the rotation vector of R. Turning the right camera by −ω/2 and the left one by +ω/2
   gives both the same orientation, and shares the warping fairly. With h = R(−ω/2):  R₂ ← h,  R₁ ← hᵀ.
2. **Lay the baseline on an axis.** In that common frame the baseline is t = h T. Its larger image component, x or y,
   decides between a horizontal and a vertical rig; e is the signed unit vector of that axis, e = ±e_x or ±e_y, the
   sign that of the component. The smallest rotation that takes t onto e turns about t × e by the angle between them,
   whose sine is ‖t × e‖ / ‖t‖ and whose cosine is t·e / ‖t‖ = |t_x| / ‖t‖ (or |t_y| / ‖t‖): call it w. The angle is
   taken from both, by the two-argument arctangent: near 0 an arccosine alone loses half of the digits.
3. R₁ = w hᵀ, R₂ = w h, and the new baseline R₂ T = (±‖T‖, 0, 0) (or along y).

The sign in step 2 matters: it keeps the pictures upright whichever camera stands on the left. When the cameras were
swapped (T_x > 0), the rectified baseline stays positive, and it is the disparity that changes its sign.

Sources: J.-Y. Bouguet, *Camera Calibration Toolbox for Matlab*, function ``rectify_stereo_pair``; the decision between
x and y and the sign of e as in ``cv2.stereoRectify``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import DegenerateGeometryError
from stereocal.base.rotations import rotation_matrix, rotation_vector


@dataclass(frozen=True)
class RectifyingRotations:
    """What Bouguet's three steps give.

    Attributes
    ----------
    R1, R2 : ndarray of shape (3, 3)
        From the left and the right camera's frame into the rectified frame.
    axis : int
        0 where the rectified baseline lies along x (rows match), 1 where it lies along y (columns match).
    baseline : float
        The rectified baseline's component along that axis, R₂T [axis], with its sign: negative for a rig whose first
        camera is on the left (or on top).
    """

    R1: Float
    R2: Float
    axis: int
    baseline: float


def rectifying_rotations(R: Float, T: Float) -> RectifyingRotations:
    """Rotate both cameras by half, then the baseline onto an axis: R₁ = w hᵀ, R₂ = w h, h = R(−ω/2).

    Parameters
    ----------
    R : ndarray of shape (3, 3)
        Rotation from the left to the right camera's frame.
    T : ndarray of shape (3,)
        The left camera's centre in the right camera's frame, any unit of length.

    Returns
    -------
    RectifyingRotations

    Raises
    ------
    DegenerateGeometryError
        If T is zero: two cameras at one place have no epipolar geometry.

    Notes
    -----
    Answers to the first half of ``cv2.stereoRectify``.
    """
    length = float(np.linalg.norm(T))
    if length == 0:
        raise DegenerateGeometryError(
            "the two cameras stand at the same point (T = 0): there is no baseline to rectify"
        )
    half = rotation_matrix(-0.5 * rotation_vector(R))
    t = half @ T
    axis = 0 if abs(t[0]) > abs(t[1]) else 1
    e = np.zeros(3)
    e[axis] = 1.0 if t[axis] > 0 else -1.0
    turn = np.cross(t, e)
    sine = float(np.linalg.norm(turn))
    if sine > 0:
        turn *= np.arctan2(sine, abs(t[axis])) / sine
    w = rotation_matrix(turn)
    R1, R2 = w @ half.T, w @ half
    return RectifyingRotations(R1, R2, axis, float((R2 @ T)[axis]))
