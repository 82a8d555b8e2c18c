"""Where the joint calibration of two cameras starts: from each by itself.

Each camera alone gives the pose of the board in every view it saw. A pair of views then gives R = R_R R_Lᵀ and
T = t_R − R t_L; the start is the median of all pairs near the one that is nearest to the rest, so that a pair whose
corners are counted from opposite ends has no say. The poses are the left camera's, or, of views that only the right one
saw, the right one's taken over by R and T.

A long lens seen at moderate tilts leaves the principal point open (p1 and p2 trade for a turn of every board), and what
is the lowest minimum for each camera need not lie in the valley of the lowest for both. Where a camera by itself is
:func:`unsure <is_unsure>`, two more starts are tried: each camera fitted with its principal point held in the middle of
the image, or without a lens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.bundle import BundleState
from stereocal.camera.bundle_problem import intrinsics_of
from stereocal.camera.calibration import CameraCalibration
from stereocal.camera.model import Camera

_CANDIDATES = 64
# A camera by itself is unsure of a principal point that it knows worse than this part of the image, or found so slowly.
_UNSURE = 0.01
_MANY_STEPS = 20


@dataclass(frozen=True)
class Poses:
    """One camera's views: their numbers (n,), and the poses of the board in them, R (n, 3, 3) and t (n, 3)."""

    views: np.ndarray
    R: Float
    t: Float


def is_unsure(alone: CameraCalibration) -> bool:
    """Return whether a camera calibrated by itself may sit in the wrong valley."""
    std = float(np.max(alone.std[2:4]))
    return alone.iterations > _MANY_STEPS or not std <= _UNSURE * max(alone.camera.image_size)


def starting_state(cameras: list[Camera], poses: list[Poses], count: int) -> BundleState:
    """Return the state of the rig that two cameras by themselves suggest.

    Parameters
    ----------
    cameras : list of two Camera
    poses : list of two Poses
    count : int
        Number of views.

    Returns
    -------
    BundleState
    """
    R, T = median_rig(poses[0], poses[1])
    R_views, t_views = left_poses(poses[0], poses[1], R, T, count)
    theta = [intrinsics_of(c) for c in cameras]
    return BundleState(theta, np.stack([np.eye(3), R]), np.stack([np.zeros(3), T]), R_views, t_views)


def median_rig(left: Poses, right: Poses) -> tuple[Float, Float]:
    """The pair's R = R_R R_Lᵀ, T = t_R − R t_L that is nearest to all others (medoid): a turned pair has no say.

    Of many pairs, 64 spread over the recording are candidates: the time stays linear in the number of pairs.
    """
    _, i, j = np.intersect1d(left.views, right.views, assume_unique=True, return_indices=True)
    Rs = right.R[j] @ left.R[i].transpose(0, 2, 1)
    Ts = right.t[j] - np.einsum("nij,nj->ni", Rs, left.t[i])
    scale = np.median(np.sqrt(np.einsum("ni,ni->n", left.t[i], left.t[i])))
    few = slice(None, None, -(-len(i) // _CANDIDATES))
    turns = Rs.reshape(-1, 9)
    # ‖A − B‖² of two rotations is 6 − 2 A·B
    turn = np.sqrt(np.maximum(6 - 2 * turns[few] @ turns.T, 0))
    shift = np.linalg.norm(Ts[few, None] - Ts[None], axis=2) / scale
    distance = turn + shift
    distance = distance[np.argmin(np.median(distance, axis=1))]
    near = distance <= 2 * np.median(distance) + 1e-6
    U, _, Vt = np.linalg.svd(Rs[near].mean(axis=0))
    return U @ Vt, np.median(Ts[near], axis=0)


def left_poses(left: Poses, right: Poses, R: Float, T: Float, count: int) -> tuple[Float, Float]:
    """Poses in the left camera's frame; of views that only the right one saw, by R and T."""
    R_views, t_views = np.empty((count, 3, 3)), np.empty((count, 3))
    R_views[right.views], t_views[right.views] = R.T @ right.R, (right.t - T) @ R
    R_views[left.views], t_views[left.views] = left.R, left.t
    return R_views, t_views
