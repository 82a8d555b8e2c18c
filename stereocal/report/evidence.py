"""A calibration and its corners, laid out for measuring.

With V views of a board of N corners X_j and the rig (left camera, right camera, R, T), the fit puts corner j of view
i at

    X_left = R_i X_j + t_i,    X_right = R X_left + T,

and each camera projects it to a pixel. Every measure of the report starts from these points, their pixels, and the
residuals observed − projected, which :class:`Evidence` holds as arrays of shape (V, N, ·).

The derivative of a projection by the point in the camera's frame, ∂x/∂X (2×3), is taken by central differences: it is
needed for any camera model, at a few thousand points, once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import InputError
from stereocal.base.rotations import rotation_matrix

Refit = Callable[[list[Float], list[Float]], Any]
"""A function that calibrates the rig from some left and right views, and returns what ``calibrate_stereo`` returns."""


@dataclass(frozen=True)
class Evidence:
    """What a calibration claims and what the photographs say.

    Attributes
    ----------
    rig : StereoRig
    object_points : ndarray of shape (N, 3)
        The board, in its own units.
    columns, rows : int
        Inner corners.
    square_size : float
    image_size : tuple of (width, height)
    left, right : ndarray of shape (V, N, 2)
        Observed corners, pixels.
    rotations : ndarray of shape (V, 3, 3)
        R_left_board of each view.
    translations : ndarray of shape (V, 3)
    names : tuple of str
        Of the views.
    unit : str
        Of length, for the page.
    """

    rig: Any
    object_points: Float
    columns: int
    rows: int
    square_size: float
    image_size: tuple[int, int]
    left: Float
    right: Float
    rotations: Float
    translations: Float
    names: tuple[str, ...]
    unit: str

    @cached_property
    def points_left(self) -> Float:
        """Corners in the left camera's frame, (V, N, 3)."""
        return place(self.object_points, self.rotations, self.translations)

    @cached_property
    def points_right(self) -> Float:
        """Corners in the right camera's frame, (V, N, 3)."""
        return np.asarray(self.points_left @ np.asarray(self.rig.R).T + np.ravel(self.rig.T))

    @cached_property
    def left_residuals(self) -> Float:
        """Observed minus projected in the left image, (V, N, 2), pixels."""
        return self.left - project(self.rig.left, self.points_left)

    @cached_property
    def right_residuals(self) -> Float:
        """Observed minus projected in the right image, (V, N, 2), pixels."""
        return self.right - project(self.rig.right, self.points_right)

    @cached_property
    def residuals(self) -> Float:
        """Both, (2, V, N, 2)."""
        return np.stack([self.left_residuals, self.right_residuals])

    @cached_property
    def noise(self) -> float:
        """σ of the corner noise, an axis, pixels: √(Σ d² / (components − parameters of poses, cameras and rig))."""
        parameters = 6 * len(self.left) + 6 + 2 * 9
        free = max(self.residuals.size - parameters, self.residuals.size // 4)
        return float(np.sqrt(np.sum(self.residuals**2) / free))

    @property
    def view_count(self) -> int:
        """V."""
        return len(self.left)


def gather_evidence(
    calibration: Any,
    board: Any,
    left_corners: Sequence[Any],
    right_corners: Sequence[Any],
    image_size: tuple[int, int],
    names: Sequence[str],
    unit: str,
) -> Evidence:
    """Lay out a calibration and its corners.

    Raises
    ------
    InputError
        If the views of the calibration and of the corners are not the same number, or a view lacks corners.
    """
    count = len(calibration.rvecs)
    if len(left_corners) != count or len(right_corners) != count:
        raise InputError(
            f"the calibration has {count} views, but there are {len(left_corners)} sets of left and "
            f"{len(right_corners)} of right corners; pass the corners that the calibration was made from"
        )
    points = getattr(calibration, "object_points", None)
    points = np.asarray(board.object_points if points is None else points, dtype=np.float64)
    stacks = []
    for side, corners in (("left", left_corners), ("right", right_corners)):
        arrays = [np.asarray(c, dtype=np.float64).reshape(-1, 2) for c in corners]
        wrong = next((i for i, a in enumerate(arrays) if a.shape != (len(points), 2)), None)
        if wrong is not None:
            raise InputError(
                f"{side}_corners[{wrong}] holds {len(arrays[wrong])} corners, but the board has {len(points)}; "
                "a view counts only with all of them"
            )
        stacks.append(np.stack(arrays))
    return Evidence(
        calibration.rig, points, int(board.columns), int(board.rows), float(board.square_size), image_size,
        stacks[0], stacks[1],
        np.stack([rotation_matrix(np.ravel(r)) for r in calibration.rvecs]),
        np.stack([np.ravel(t) for t in calibration.tvecs]).astype(np.float64),
        tuple(names), unit,
    )  # fmt: skip


def place(object_points: Float, rotations: Float, translations: Float) -> Float:
    """R_i X_j + t_i for all views and corners: (V, N, 3)."""
    return np.asarray(np.einsum("vij,nj->vni", rotations, object_points) + translations[:, None, :])


def project(camera: Any, points: Float) -> Float:
    """Project points of the camera's own frame: (…, 3) → (…, 2) pixels."""
    flat = points.reshape(-1, 3)
    return np.asarray(camera.project(flat, np.zeros(3), np.zeros(3)), dtype=np.float64).reshape(*points.shape[:-1], 2)


def projection_jacobian(camera: Any, points: Float) -> Float:
    """∂x/∂X of a projection by central differences: (…, 3) → (…, 2, 3), pixels per unit of length.

    The step is 1e-6 of the depth, which leaves about nine correct digits.
    """
    step = 1e-6 * np.abs(points[..., 2:3])
    columns = []
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = 1.0
        ahead = project(camera, points + step * shift)
        behind = project(camera, points - step * shift)
        columns.append((ahead - behind) / (2 * step))
    return np.stack(columns, axis=-1)


def rms(residuals: Float) -> float:
    """OpenCV's convention: √(Σ‖d‖² / N points) of (…, 2)."""
    return float(np.sqrt(np.mean(np.sum(residuals**2, axis=-1)))) if residuals.size else float("nan")
