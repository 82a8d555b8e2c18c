"""Which pairs belong to one rig: those that agree with one another.

A rig is rigid, so every pair of photographs tells the same R and T. A pair whose photographs were taken at different
moments, belong to different boards, or were matched wrongly tells another one, and a least-squares fit bends everything
else towards it. So before the joint fit each pair is asked what rig it sees, and the rig that most others agree with
is the judge (least median of squares, Rousseeuw 1984, with every pair as a candidate: no random sampling, the same
answer every time).

With the pose (R_l, t_l) of the board in the left camera and (R_r, t_r) in the right one, pair i sees the rig

    R_i = R_r R_lᵀ,    T_i = t_r − R_i t_l,

and rig i predicts for pair j the right image x̂ = project(R_i (R_lj X + t_lj) + T_i). The error of candidate i on pair j
is the RMS of x̂ − x over the board's corners. The candidate with the smallest median error judges: a pair whose error
under it is more than `FACTOR` times that median, and more than `FLOOR` pixels, does not belong.

After a fit the same rule is applied to the views' residuals: one bad photograph stands out against its fellows.

Before any fit, corners that no flat board could have are left out: where the best homography from board to image misses
them by more than the distance between neighbours, rows were mixed up. A lens bends a board by less.

Views that look at the board from the side are left out too, if enough others remain. Zhang (2000, section 5.1) found
the best angle near 45°, and worse ones beyond, because foreshortening takes the corners' precision. There is a second
reason: a board is taken for flat, and where it bows by h, its corners seem to lie h tan(tilt) away along it; at 63°
that is twice as much as at 45°, and real boards bow.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float
from stereocal.base.homogeneous import to_homogeneous
from stereocal.base.rotations import rotation_matrix
from stereocal.camera.homography import fit_homography
from stereocal.camera.model import Camera

FACTOR = 5.0
"""An error this many times the median is no noise: with Gaussian corners the largest of 100 views is below 1.5."""

FLOOR = 1.0
"""Pixels; below this no pair is left out, however much better the others are."""

MAX_CANDIDATES = 80
"""More pairs than this are asked in even steps, so that the work stays linear in their number."""

MAX_MISFIT = 1.0
"""Neighbour distances by which the best homography may miss a view's corners."""

MAX_TILT = 60.0
"""Degrees between the board's normal and the line of sight, beyond which a view is left out."""

ENOUGH_VIEWS = 10
"""As many views determine a camera well (Zhang 2000, section 5.1: little is gained beyond); fewer are all kept."""


def outlying_views(view_rms: ArrayLike, *, factor: float = FACTOR, floor: float = FLOOR) -> NDArray[np.bool_]:
    """Say which views stand out: RMS > max(factor · median, floor).

    Parameters
    ----------
    view_rms : array_like of shape (V,)
        RMS of each view's residuals, px.
    factor, floor : float
        The rule's two numbers; the floor is in px.

    Returns
    -------
    ndarray of shape (V,), bool
    """
    rms = np.asarray(view_rms, dtype=np.float64)
    return rms > max(factor * float(np.median(rms)), floor)


def rig_disagreement(
    object_points: Float,
    right_points: Sequence[Float],
    right_camera: Camera,
    left_poses: Sequence[tuple[Float, Float]],
    right_poses: Sequence[tuple[Float, Float]],
) -> Float:
    """Return how far each pair is from the rig that most pairs agree on, as an RMS in px of the right image.

    Parameters
    ----------
    object_points : ndarray of shape (N, 3)
        The board's corners.
    right_points : sequence of V ndarrays of shape (N, 2)
        Corners found in the right images, px.
    right_camera : Camera
        The right camera, calibrated alone.
    left_poses, right_poses : sequence of V (rvec, tvec)
        The board in each camera's frame.

    Returns
    -------
    ndarray of shape (V,)
    """
    views = len(right_points)
    in_left = np.stack([object_points @ rotation_matrix(r).T + t for r, t in left_poses])
    found = np.stack(right_points)
    candidates = np.unique(np.linspace(0, views - 1, min(views, MAX_CANDIDATES)).round().astype(int))
    best, least = np.zeros(views), np.inf
    for candidate in candidates:
        R, T = relative_pose(left_poses[candidate], right_poses[candidate])
        predicted = right_camera.project((in_left @ R.T + T).reshape(-1, 3), np.zeros(3), np.zeros(3))
        error = np.sqrt(np.mean(np.sum((predicted.reshape(found.shape) - found) ** 2, axis=2), axis=1))
        error = np.where(np.isfinite(error), error, np.inf)  # behind the camera: as far as can be
        if np.median(error) < least:
            best, least = error, float(np.median(error))
    return best


def homography_misfit(object_points: Float, corners: Float) -> float:
    """Return the RMS by which the best homography misses the corners, in distances between neighbours on the image.

    Parameters
    ----------
    object_points : ndarray of shape (N, 3)
        The board's corners, on z = 0, the first two neighbours.
    corners : ndarray of shape (N, 2)
        Found in one image, px.
    """
    H = fit_homography(object_points[:, :2], corners)
    projected = to_homogeneous(object_points[:, :2]) @ H.T
    misses = projected[:, :2] / projected[:, 2:] - corners
    # the longest side of the smallest box around them, over the board's own longest side in squares
    squares = np.ptp(object_points[:, :2], axis=0).max() / np.linalg.norm(object_points[1] - object_points[0])
    neighbours = np.ptp(corners, axis=0).max() / squares
    return float(np.sqrt(np.mean(np.sum(misses**2, axis=1))) / max(neighbours, 1e-9))


def board_tilts(object_points: Float, poses: Sequence[tuple[Float, Float]]) -> Float:
    """Return the angle between the board's normal and the line of sight to its middle, degrees, of each pose.

    Parameters
    ----------
    object_points : ndarray of shape (N, 3)
        The board's corners, on z = 0.
    poses : sequence of V (rvec, tvec)
        The board in the camera's frame.

    Returns
    -------
    ndarray of shape (V,)
        0: seen face on; 90: seen edge on.
    """
    middle = object_points.mean(axis=0)
    tilts = []
    for rvec, tvec in poses:
        R = rotation_matrix(rvec)
        sight = R @ middle + np.asarray(tvec).reshape(3)
        cosine = abs(R[:, 2] @ sight) / np.linalg.norm(sight)
        tilts.append(np.degrees(np.arccos(min(cosine, 1.0))))
    return np.array(tilts)


def relative_pose(left: tuple[Float, Float], right: tuple[Float, Float]) -> tuple[Float, Float]:
    """Return (R, T) of the rig that sees one board at `left` and `right`: R = R_r R_lᵀ, T = t_r − R t_l."""
    R = rotation_matrix(right[0]) @ rotation_matrix(left[0]).T
    return R, np.asarray(right[1]).reshape(3) - R @ np.asarray(left[1]).reshape(3)
