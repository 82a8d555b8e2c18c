"""Where a board stands, seen by a camera that is known.

The corners are undistorted, the homography from the board gives the pose in closed form (``zhang``), and the bundle
engine refines all poses with the camera held: a block of six unknowns a view, independent of each other.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float
from stereocal.base.errors import DegenerateGeometryError
from stereocal.camera.bundle import BundleState
from stereocal.camera.bundle_problem import intrinsics_of, make_bundle
from stereocal.camera.bundle_solver import solve_bundle
from stereocal.camera.distortion import distortion_model
from stereocal.camera.model import Camera
from stereocal.camera.seen_boards import seen_boards
from stereocal.camera.views import as_views


def estimate_poses(
    object_points: ArrayLike | Sequence[ArrayLike], image_points: Sequence[ArrayLike], camera: Camera
) -> tuple[Float, Float]:
    """Find the poses of a board: for each view the (R, t) that minimises Σ ‖y − p̃(R X + t)‖².

    Parameters
    ----------
    object_points : array_like of shape (N, 3), or sequence of them
        Board points, z near 0; one array for all views, or one a view.
    image_points : sequence of array_like of shape (N, 2)
        Corners, pixels.
    camera : Camera
        The camera that saw them.

    Returns
    -------
    rvecs, tvecs : ndarray of shape (V, 3)
        X_camera = R(rvec) X_board + tvec.

    Raises
    ------
    DegenerateGeometryError
        If fewer than four corners of a view can be undistorted.

    Notes
    -----
    Answers to ``cv2.solvePnP`` on a planar board (agreement 1e-6).
    """
    objects, images = as_views(object_points, image_points)
    R, t = initial_poses(objects, images, camera)
    lens = distortion_model(camera.model)
    theta = intrinsics_of(camera)
    bundle = make_bundle([lens], [objects], [images], np.zeros((len(theta), 0)))
    solution = solve_bundle(bundle, BundleState([theta], np.eye(3)[None], np.zeros((1, 3)), R, t))
    return solution.state.rvecs, solution.state.t_views


def initial_poses(objects: list[Float], images: list[Float], camera: Camera) -> tuple[Float, Float]:
    """Return the closed-form poses, R (V, 3, 3) and t (V, 3)."""
    undone = [camera.undistort_points(y) for y in images]
    seen = [np.isfinite(x[:, 0]) for x in undone]
    for view, inside in enumerate(seen):
        if np.count_nonzero(inside) < 4:
            raise DegenerateGeometryError(
                f"view {view}: the given camera's lens model cannot be undone at most of its corners, so it is not the "
                "camera that saw them; check dist and model"
            )
    board = [X[inside] for X, inside in zip(objects, seen, strict=True)]
    ideal = [x[inside] for x, inside in zip(undone, seen, strict=True)]
    bundle = make_bundle([distortion_model("pinhole")], [board], [ideal], np.zeros((5, 0)))
    return seen_boards(bundle, backend="numpy").poses(camera.K)
