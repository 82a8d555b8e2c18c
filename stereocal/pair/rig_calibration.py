"""Calibrating any number of cameras that are fixed to each other, from boards that some of them see.

    F = Σ_c Σ_i Σ_j ‖ y^c_ij − p̃(K_c, k_c, R_c R_i, R_c T_i + T_c, P_j) ‖²,        R_0 = I, T_0 = 0.

A stereo rig of two is the smallest case (``stereo_calibration`` gives the same numbers). More cameras need not all see
the same boards, nor any two of them every board: a camera may miss views, and cameras that never see a board together
are joined by others in between, as long as some chain of common views leads from each to the first. What they share is
one pose of the board a view, and all unknowns are found together (``rig_solution``), with the covariance of all.

Where cameras c and d stand to each other follows from where each stands to the first,

    X_d = R_d R_cᵀ (X_c − T_c) + T_d,

which is what :meth:`RigCalibration.pair` returns: a :class:`~stereocal.pair.rig.StereoRig`, to be rectified and matched
like any other.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_image_size
from stereocal.base.errors import InputError
from stereocal.base.rotations import rotation_vectors
from stereocal.camera.board_shape import BoardShape, board_line
from stereocal.camera.bundle_problem import intrinsics_of
from stereocal.camera.calibration import CameraCalibration
from stereocal.camera.covariance import BundleCovariance
from stereocal.camera.distortion import distortion_model
from stereocal.camera.model import Camera
from stereocal.camera.outliers import RejectedCorner
from stereocal.camera.parameters import intrinsic_names
from stereocal.pair.rig import StereoRig
from stereocal.pair.rig_inputs import MOTION_NAMES, rig_views
from stereocal.pair.rig_solution import RigOptions, RigSolution, RigViews, solve_rig


@dataclass(frozen=True, eq=False)
class RigCalibration:
    """What :func:`calibrate_rig` found, of C cameras and V views.

    Attributes
    ----------
    cameras : tuple of Camera
        In the order they were passed.
    R : ndarray of shape (C, 3, 3)
    T : ndarray of shape (C, 3)
        X_c = R[c] X_0 + T[c]: from the first camera's frame to that of camera c; I and 0 for the first.
    rms : float
        √(Σ‖d‖² / N points), pixels, over all images.
    camera_rms : ndarray of shape (C,)
        The same, a camera.
    view_rms : ndarray of shape (V, C)
        The same, a view and camera; NaN where the camera missed the view.
    rvecs, tvecs : ndarray of shape (V, 3)
        Pose of the board in the first camera's frame.
    residuals : list of C lists of V ndarray of shape (N, 2)
        Measured minus projected, pixels; no rows where the camera missed the view.
    parameter_names : tuple of str
        ``"camera0.fx"`` … ``"camera1.fx"`` … ``"camera1.rvec_x"`` … ``"camera1.T_x"`` …, the order of `covariance`.
    covariance : ndarray of shape (n, n)
        Of the parameters named; rows of 0 for what was held.
    std : ndarray of shape (n,)
        Its square roots of the diagonal.
    pose_covariances : ndarray of shape (V, 6, 6)
        Of each view's (rvec, tvec).
    iterations : int
        Steps of the solver.
    converged : bool
        Whether it reached an optimum.
    reason : str
        The test that ended it.
    alone : tuple of CameraCalibration or None
        Each camera by itself, where it was calibrated on the way.
    board : BoardShape
        The board, with its shape where `board_warp` asked for it.
    joint : BundleCovariance
        All covariances, cross terms too.
    rejected : list of RejectedCorner
        Corners that were left out, with the reason.
    warnings : tuple of str
        What the views leave open (``camera.lens_doubts``), and views that do not fit the others (``rig_agreement``).
    """

    cameras: tuple[Camera, ...]
    R: Float
    T: Float
    rms: float
    camera_rms: Float
    view_rms: Float
    rvecs: Float
    tvecs: Float
    residuals: list[list[Float]]
    parameter_names: tuple[str, ...]
    covariance: Float
    std: Float
    pose_covariances: Float
    iterations: int
    converged: bool
    reason: str
    alone: tuple[CameraCalibration | None, ...]
    board: BoardShape = field(repr=False)
    joint: BundleCovariance = field(repr=False)
    rejected: list[RejectedCorner] = field(default_factory=list)
    warnings: tuple[str, ...] = ()

    def pair(self, left: int, right: int) -> StereoRig:
        """Return two of the cameras as a stereo rig.

        Parameters
        ----------
        left, right : int
            Which cameras.

        Returns
        -------
        StereoRig
            X_right = R X_left + T with R = R_r R_lᵀ, T = T_r − R T_l.

        Raises
        ------
        InputError
            If there is no such camera, or both are the same.
        """
        count = len(self.cameras)
        if left == right or not (0 <= left < count and 0 <= right < count):
            raise InputError(f"pair needs two different cameras of 0 … {count - 1}, not {left} and {right}")
        R = self.R[right] @ self.R[left].T
        return StereoRig(self.cameras[left], self.cameras[right], R, self.T[right] - R @ self.T[left])

    def summary(self) -> str:
        """Return the result in a few lines of text, each parameter with its standard deviation."""
        of_each = ", ".join(f"{rms:.4f}" for rms in self.camera_rms)
        lines = [
            f"{len(self.cameras)} cameras, {len(self.rvecs)} views, RMS {self.rms:.4f} px (cameras {of_each}), "
            f"{'converged' if self.converged else 'NOT converged'} ({self.reason}) in {self.iterations} steps"
        ]
        motions = np.hstack([rotation_vectors(self.R[1:]), self.T[1:]])
        values = np.concatenate([*(intrinsics_of(camera) for camera in self.cameras), motions.ravel()])
        for name, value, std in zip(self.parameter_names, values, self.std, strict=True):
            lines.append(f"  {name:15s} {value:14.6g}" + (f"  ± {std:.2g}" if std > 0 else "  held"))
        lines.append(board_line(self.board))
        lines += [f"left out: camera {c.camera} view {c.view}, corner {c.point}: {c.reason}" for c in self.rejected]
        lines += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join(lines)


def calibrate_rig(
    object_points: ArrayLike | Sequence[ArrayLike],
    image_points: Sequence[Sequence[ArrayLike | None]],
    image_size: tuple[int, int] | Sequence[tuple[int, int]],
    *,
    model: str | Sequence[str] = "brown",
    fix_intrinsics: bool = False,
    cameras: Sequence[Camera | None] | None = None,
    fix: str | Collection[str] = (),
    loss: str = "linear",
    loss_scale: float = 1.0,
    covariances: Sequence[Sequence[ArrayLike | None] | None] | None = None,
    skew: bool = False,
    aspect_ratio: float | None = None,
    share: str | Collection[str] = (),
    priors: Mapping[str, tuple[float, float]] | None = None,
    reject_outliers: bool | float = False,
    board_warp: bool | str = False,
    max_iterations: int = 2000,
    backend: str = "numba",
) -> RigCalibration:
    """Find all cameras, where each stands to the first, and the poses that minimise the reprojection error.

    Parameters
    ----------
    object_points : array_like of shape (N, 3), or sequence of them
        Board points; one array for all views, or one a view.
    image_points : sequence of sequences of array_like of shape (N, 2)
        ``image_points[c][v]`` are the corners of view v in camera c, pixels; None where the camera missed the board.
    image_size : (int, int), or sequence of them
        Width and height, pixels, of all cameras' images, or one a camera.
    model : str, or sequence of str
        Lens model of all cameras, or one a camera; see ``camera.distortion``. That of `cameras` where those are given.
    fix_intrinsics : bool
        Whether the cameras are held and only where they stand and the poses are found.
    cameras : sequence of Camera or None, optional
        Cameras to hold, or to start from; those that are None are calibrated by themselves first.
    fix : str or collection of str
        Parameters held, by name: ``"k3"`` for every camera, ``"camera1.k3"`` for one.
    loss, loss_scale, skew, aspect_ratio, reject_outliers, board_warp, max_iterations, backend
        As in :func:`~stereocal.camera.calibration.calibrate_camera`.
    covariances : sequence, optional
        ``covariances[c][v]``, (N, 2, 2): covariance of each corner, px².
    share : str or collection of str
        Parameters that all cameras have in common, by name or group.
    priors : mapping of str to (mean, sigma), optional
        Parameters known beforehand, with their standard deviation: ``"fx"`` for every camera, ``"camera0.fx"`` for one,
        ``"camera1.T_x"``.

    Returns
    -------
    RigCalibration

    Raises
    ------
    InputError
        If the lists differ in length, or an argument has the wrong shape or value.
    DegenerateGeometryError
        If the views do not determine the cameras, or no chain of common views leads from a camera to the first.
    ConvergenceError
        If the views agree on no common rig: mirrored, mispaired, or counted from opposite ends.

    Notes
    -----
    For two cameras the same as :func:`~stereocal.pair.stereo_calibration.calibrate_stereo`. OpenCV 5.0 answers with
    ``cv2.calibrateMultiview``, 4 with nothing.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> camera = sc.Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], None, (640, 480))
    >>> board = sc.Chessboard((7, 6), 25.0)
    >>> tilts = [(0.4, 0, 0), (-0.4, 0.1, 0), (0, 0.4, 0.1), (0.1, -0.4, 0), (0.3, 0.3, 0.2), (-0.3, 0.3, 0)]
    >>> corners = [
    ...     [camera.project(board.object_points, tilt, [x, -60, 400]) for tilt in tilts] for x in (-75, -135, -195)
    ... ]
    >>> corners[0][4] = corners[2][0] = None  # the first and the third camera each missed a view
    >>> found = sc.calibrate_rig(board.object_points, corners, (640, 480))
    >>> found.T.round(3) + 0.0
    array([[   0.,    0.,    0.],
           [ -60.,    0.,    0.],
           [-120.,    0.,    0.]])
    >>> round(found.pair(1, 2).baseline, 3)
    60.0
    """
    objects, images = rig_views(object_points, image_points)
    count = len(images)
    names = [f"camera{c}" for c in range(count)]
    sizes = [as_image_size(s) for s in _one_each(image_size, np.ndim(image_size) == 1, count, "image_size")]
    models = _one_each(model, isinstance(model, str), count, "model")
    given = _one_each(cameras, cameras is None, count, "cameras")
    if any(camera is not None and not isinstance(camera, Camera) for camera in given):
        raise InputError("cameras must hold a Camera or None for each camera")
    if fix_intrinsics and len({camera is None for camera in given}) > 1:
        raise InputError("fix_intrinsics needs every camera in cameras=, or none (each is then calibrated first)")
    of_corners = _one_each(covariances, covariances is None, count, "covariances")
    options = RigOptions(
        fix_intrinsics=fix_intrinsics, fix=fix, loss=loss, loss_scale=loss_scale, skew=skew, aspect_ratio=aspect_ratio,
        share=share, priors=priors, reject_outliers=reject_outliers, board_warp=board_warp,
        max_iterations=max_iterations, backend=backend,
    )  # fmt: skip
    motion_names = [f"{name}.{motion}" for name in names[1:] for motion in MOTION_NAMES]
    found = solve_rig(RigViews(names, sizes, objects, images, of_corners), given, models, motion_names, options)
    return _named(found, names, motion_names)


def _one_each(value: object, one_for_all: bool, count: int, name: str) -> list:
    """The value for each camera: one for all, or a list of as many as there are."""
    values = [value] * count if one_for_all else list(value)  # type: ignore[call-overload]
    if len(values) != count:
        raise InputError(f"{name} holds {len(values)} entries for {count} cameras; pass one for all, or one a camera")
    return values


def _named(found: RigSolution, names: list[str], motion_names: list[str]) -> RigCalibration:
    own = [
        f"{name}.{parameter}"
        for name, camera in zip(names, found.cameras, strict=True)
        for parameter in intrinsic_names(distortion_model(camera.model))
    ]
    every = (*own, *motion_names)
    state = found.solution.state
    return RigCalibration(
        cameras=tuple(found.cameras),
        R=found.R.copy(),
        T=found.T.copy(),
        rms=found.rms,
        camera_rms=found.camera_rms,
        view_rms=found.view_rms,
        rvecs=state.rvecs,
        tvecs=state.t_views.copy(),
        residuals=found.residuals,
        parameter_names=every,
        covariance=found.joint.shared[: len(every), : len(every)],
        std=np.sqrt(np.diag(found.joint.shared)[: len(every)]),
        pose_covariances=found.joint.views,
        iterations=found.solution.iterations,
        converged=found.solution.converged,
        reason=found.solution.reason,
        alone=tuple(found.alone),
        board=found.board,
        joint=found.joint,
        rejected=found.rejected,
        warnings=found.warnings,
    )
