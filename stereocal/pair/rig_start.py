"""Where the joint calibration of several cameras starts: from each by itself.

Each camera alone gives the pose of the board in every view it saw. A view that two cameras saw gives R = R_b R_aᵀ and
T = t_b − R t_a; the start is the median of all such views near the one nearest to the rest, so that a view whose
corners are counted from opposite ends has no say. From the first camera on, each further one is joined to the camera
that it shares the most views with (the widest tree over the cameras), R_c = R R_parent and T_c = R T_parent + T.

The poses are the first camera's, or, of views that it missed, those of the camera that joined earliest, taken over by
its R_c and T_c.

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
    """Return the state of the rig that cameras by themselves suggest.

    Parameters
    ----------
    cameras : list of Camera
    poses : list of Poses
        One a camera; views must join them all.
    count : int
        Number of views.

    Returns
    -------
    BundleState
    """
    R_rig, t_rig = np.tile(np.eye(3), (len(cameras), 1, 1)), np.zeros((len(cameras), 3))
    order = widest_tree([p.views for p in poses], count)
    for parent, child in order:
        R, T = median_rig(poses[parent], poses[child])
        R_rig[child], t_rig[child] = R @ R_rig[parent], R @ t_rig[parent] + T
    R_views, t_views = np.empty((count, 3, 3)), np.empty((count, 3))
    for c in [*(child for _, child in reversed(order)), 0]:  # who joined earlier writes over who joined later
        views = poses[c].views
        R_views[views], t_views[views] = R_rig[c].T @ poses[c].R, (poses[c].t - t_rig[c]) @ R_rig[c]
    return BundleState([intrinsics_of(c) for c in cameras], R_rig, t_rig, R_views, t_views)


def widest_tree(views: list[np.ndarray], count: int) -> list[tuple[int, int]]:
    """Return (camera joined to, camera) in the order of joining, from camera 0 on, by the most views in common.

    Parameters
    ----------
    views : list of ndarray of int
        Which views each camera saw.
    count : int
        Number of views.

    Returns
    -------
    list of (int, int)

    Notes
    -----
    Prim's algorithm for a maximum spanning tree.
    """
    seen = np.zeros((len(views), count))
    for row, of_camera in zip(seen, views, strict=True):
        row[of_camera] = 1
    common = seen @ seen.T
    order: list[tuple[int, int]] = []
    inside = [0]
    while len(inside) < len(views):
        outside = [c for c in range(len(views)) if c not in inside]
        best = np.argmax(common[np.ix_(inside, outside)])
        parent, child = inside[best // len(outside)], outside[best % len(outside)]
        order.append((parent, child))
        inside.append(child)
    return order


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
