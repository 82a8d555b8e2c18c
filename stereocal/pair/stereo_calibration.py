"""Calibrating two cameras together: intrinsics, lens, R and T from the same boards seen by both.

    F = Σ_i Σ_j ‖ y^L_ij − p̃(K_L, k_L, R_i, T_i, P_j) ‖² + ‖ y^R_ij − p̃(K_R, k_R, R R_i, R T_i + T, P_j) ‖²

A pair of views has ONE pose of the board, in the left camera's frame; R and T take it to the right. So the right
camera's corners help to place the board for the left, and the other way round: the intrinsics gain, and R, T are the
best for all pairs at once.

How the optimum is reached, ``rig_solution`` tells; here the two cameras of a rig get their names.

Pairs that disagree with the median by a large turn are the sign of corners counted from opposite ends in the two
images (see ``pair.corner_order``).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_image_size
from stereocal.base.errors import InputError
from stereocal.base.rotations import rotation_vector
from stereocal.camera.board_shape import BoardShape, board_line
from stereocal.camera.bundle_problem import intrinsics_of
from stereocal.camera.calibration import CameraCalibration
from stereocal.camera.covariance import BundleCovariance
from stereocal.camera.distortion import distortion_model
from stereocal.camera.model import Camera
from stereocal.camera.outliers import RejectedCorner
from stereocal.camera.parameters import intrinsic_names
from stereocal.pair.rig import StereoRig
from stereocal.pair.rig_inputs import MOTION_NAMES, SIDES, paired_views
from stereocal.pair.rig_solution import RigOptions, RigSolution, RigViews, solve_rig


@dataclass(frozen=True, eq=False)
class StereoCalibration:
    """What :func:`calibrate_stereo` found.

    Attributes
    ----------
    rig : StereoRig
        Both cameras, R and T with X_right = R X_left + T.
    rms, left_rms, right_rms : float
        √(Σ‖d‖² / N points), pixels, over both images, and over each.
    view_rms : ndarray of shape (V, 2)
        The same, a pair and image (left, right).
    rvecs, tvecs : ndarray of shape (V, 3)
        Pose of the board in the left camera's frame.
    residuals : tuple of two lists of ndarray of shape (N, 2)
        Measured minus projected, pixels, left and right, a pair.
    parameter_names : tuple of str
        ``"left.fx"`` … ``"right.fx"`` … ``"rvec_x"`` … ``"T_x"`` …, the order of `covariance`.
    covariance : ndarray of shape (n, n)
        Of the parameters named; rows of 0 for what was held.
    std : ndarray of shape (n,)
        Its square roots of the diagonal.
    baseline_std : float
        Standard deviation of the baseline ‖T‖.
    pose_covariances : ndarray of shape (V, 6, 6)
        Of each pair's (rvec, tvec).
    iterations : int
        Steps of the solver.
    converged : bool
        Whether it reached an optimum.
    reason : str
        The test that ended it.
    left, right : CameraCalibration or None
        The two cameras by themselves, where they were calibrated on the way and could be.
    board : BoardShape
        The board, with its shape where `board_warp` asked for it.
    joint : BundleCovariance
        All covariances, cross terms too.
    rejected : list of RejectedCorner
        Corners that were left out, with the reason; camera 0 is the left one.
    warnings : tuple of str
        What the views leave open (``camera.lens_doubts``), and views that do not fit the others (``rig_agreement``).
    """

    rig: StereoRig
    rms: float
    left_rms: float
    right_rms: float
    view_rms: Float
    rvecs: Float
    tvecs: Float
    residuals: tuple[list[Float], list[Float]]
    parameter_names: tuple[str, ...]
    covariance: Float
    std: Float
    baseline_std: float
    pose_covariances: Float
    iterations: int
    converged: bool
    reason: str
    left: CameraCalibration | None
    right: CameraCalibration | None
    board: BoardShape = field(repr=False)
    joint: BundleCovariance = field(repr=False)
    rejected: list[RejectedCorner] = field(default_factory=list)
    warnings: tuple[str, ...] = ()

    @property
    def object_points(self) -> Float:
        """The board's points (N, 3) that the residuals refer to: flat, or with the shape that was found."""
        return self.board.points

    def summary(self) -> str:
        """Return the result in a few lines of text, each parameter with its standard deviation."""
        om, T = rotation_vector(self.rig.R), self.rig.T
        lines = [
            f"{len(self.rvecs)} pairs, RMS {self.rms:.4f} px (left {self.left_rms:.4f}, right {self.right_rms:.4f}), "
            f"{'converged' if self.converged else 'NOT converged'} ({self.reason}) in {self.iterations} steps"
        ]
        values = [*intrinsics_of(self.rig.left), *intrinsics_of(self.rig.right), *om, *T]
        for name, value, std in zip(self.parameter_names, values, self.std, strict=True):
            lines.append(f"  {name:12s} {value:14.6g}" + (f"  ± {std:.2g}" if std > 0 else "  held"))
        lines.append(f"  {'baseline':12s} {self.rig.baseline:14.6g}  ± {self.baseline_std:.2g}")
        lines.append(board_line(self.board))
        lines += [f"left out: {SIDES[c.camera]} view {c.view}, corner {c.point}: {c.reason}" for c in self.rejected]
        lines += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join(lines)


def calibrate_stereo(
    object_points: ArrayLike | Sequence[ArrayLike],
    left_points: Sequence[ArrayLike],
    right_points: Sequence[ArrayLike],
    image_size: tuple[int, int],
    *,
    model: str = "brown",
    fix_intrinsics: bool = False,
    left: Camera | None = None,
    right: Camera | None = None,
    fix: str | Collection[str] = (),
    loss: str = "linear",
    loss_scale: float = 1.0,
    left_covariances: Sequence[ArrayLike] | None = None,
    right_covariances: Sequence[ArrayLike] | None = None,
    skew: bool = False,
    aspect_ratio: float | None = None,
    share: str | Collection[str] = (),
    priors: Mapping[str, tuple[float, float]] | None = None,
    reject_outliers: bool | float = False,
    right_image_size: tuple[int, int] | None = None,
    board_warp: bool | str = False,
    max_iterations: int = 2000,
    backend: str = "numba",
) -> StereoCalibration:
    """Find both cameras, R, T and the poses that minimise the reprojection error in both images.

    Parameters
    ----------
    object_points : array_like of shape (N, 3), or sequence of them
        Board points; one array for all pairs, or one a pair.
    left_points, right_points : sequence of array_like of shape (N, 2)
        Corners, pixels, one array a pair, in the same order in both.
    image_size : (int, int)
        Width and height, pixels, of the left image (and of the right, unless `right_image_size` is given).
    model : str
        Lens model of both cameras, see ``camera.distortion``; that of `left` and `right` where those are given.
    fix_intrinsics : bool
        Whether the cameras are held and only R, T and the poses are found.
    left, right : Camera, optional
        Cameras to hold, or to start from; otherwise each is calibrated by itself first.
    fix : str or collection of str
        Parameters held, by name: ``"k3"`` for both cameras, ``"left.k3"`` for one.
    loss, loss_scale, skew, aspect_ratio, reject_outliers, board_warp, max_iterations, backend
        As in :func:`~stereocal.camera.calibration.calibrate_camera`.
    share : str or collection of str
        Parameters that both cameras have in common, by name or group, such as ``"focal_length"`` or ``"distortion"``:
        one unknown of two. Without `left` and `right` they start from the mean of the two cameras.
    priors : mapping of str to (mean, sigma), optional
        Parameters known beforehand, with their standard deviation: ``"fx"`` for both cameras, ``"left.fx"`` for one,
        ``"T_x"``, ``"T_y"``, ``"T_z"``.
    left_covariances, right_covariances : sequence of array_like of shape (N, 2, 2), optional
        Covariance of each corner, px².
    right_image_size : (int, int), optional
        Where it differs.

    Returns
    -------
    StereoCalibration

    Raises
    ------
    InputError
        If the lists differ in length, or an argument has the wrong shape or value.
    DegenerateGeometryError
        If the views do not determine the cameras, not even both together.
    ConvergenceError
        If the pairs agree on no common rig: mirrored, mispaired, or counted from opposite ends.

    Notes
    -----
    Paper: section 2. Answers to ``cv2.stereoCalibrate`` with ``CALIB_USE_INTRINSIC_GUESS`` (with
    ``CALIB_FIX_INTRINSIC`` for `fix_intrinsics`): the same optimum as OpenCV 5.0; OpenCV 4's default stops long
    before it.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> board = sc.Chessboard((7, 6), 25.0)
    >>> tilts = [(0.4, 0, 0), (-0.4, 0.1, 0), (0, 0.4, 0.1), (0.1, -0.4, 0), (0.3, 0.3, 0.2), (-0.3, 0.3, 0)]
    >>> camera = sc.Camera(K, None, (640, 480))
    >>> left = [camera.project(board.object_points, tilt, [-75, -60, 400]) for tilt in tilts]
    >>> right = [camera.project(board.object_points, tilt, [-135, -60, 400]) for tilt in tilts]
    >>> found = sc.calibrate_stereo(board.object_points, left, right, (640, 480))
    >>> found.rig.T.round(3) + 0.0
    array([-60.,   0.,   0.])
    >>> found.converged, bool(found.rms < 1e-6)
    (True, True)
    """
    sizes = (as_image_size(image_size), as_image_size(right_image_size or image_size))
    options = RigOptions(
        fix_intrinsics=fix_intrinsics, fix=fix, loss=loss, loss_scale=loss_scale, skew=skew, aspect_ratio=aspect_ratio,
        share=share, priors=priors, reject_outliers=reject_outliers, board_warp=board_warp,
        max_iterations=max_iterations, backend=backend,
    )  # fmt: skip
    if fix_intrinsics and (left is None) != (right is None):
        raise InputError(
            "fix_intrinsics needs both cameras, left= and right=, or neither (each is then calibrated first)"
        )
    objects, images = paired_views(object_points, left_points, right_points)
    views = RigViews(SIDES, sizes, objects, images, (left_covariances, right_covariances))
    return _named(solve_rig(views, (left, right), (model, model), MOTION_NAMES, options))


def _named(found: RigSolution) -> StereoCalibration:
    rig = StereoRig(found.cameras[0], found.cameras[1], found.R[1], found.T[1])
    lenses = [distortion_model(camera.model) for camera in found.cameras]
    names = [f"{side}.{name}" for side, lens in zip(SIDES, lenses, strict=True) for name in intrinsic_names(lens)]
    names += MOTION_NAMES
    direction = rig.T / rig.baseline if rig.baseline > 0 else np.zeros(3)
    of_T = found.joint.shared[found.rig_slices[1], found.rig_slices[1]][3:, 3:]
    state = found.solution.state
    return StereoCalibration(
        rig=rig,
        rms=found.rms,
        left_rms=float(found.camera_rms[0]),
        right_rms=float(found.camera_rms[1]),
        view_rms=found.view_rms,
        rvecs=state.rvecs,
        tvecs=state.t_views.copy(),
        residuals=(found.residuals[0], found.residuals[1]),
        parameter_names=tuple(names),
        covariance=found.joint.shared[: len(names), : len(names)],
        std=np.sqrt(np.diag(found.joint.shared)[: len(names)]),
        baseline_std=float(np.sqrt(direction @ of_T @ direction)),
        pose_covariances=found.joint.views,
        iterations=found.solution.iterations,
        converged=found.solution.converged,
        reason=found.solution.reason,
        left=found.alone[0],
        right=found.alone[1],
        board=found.board,
        joint=found.joint,
        rejected=found.rejected,
        warnings=found.warnings,
    )
