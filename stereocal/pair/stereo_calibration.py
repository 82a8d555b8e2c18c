"""Calibrating two cameras together: intrinsics, lens, R and T from the same boards seen by both.

    F = Σ_i Σ_j ‖ y^L_ij − p̃(K_L, k_L, R_i, T_i, P_j) ‖² + ‖ y^R_ij − p̃(K_R, k_R, R R_i, R T_i + T, P_j) ‖²

A pair of views has ONE pose of the board, in the left camera's frame; R and T take it to the right. So the right
camera's corners help to place the board for the left, and the other way round: the intrinsics gain, and R, T are the
best for all pairs at once.

The way there: each camera by itself (``camera.calibration``), R and T of each pair from its two poses, R_i^R (R_i^L)ᵀ
and so on, the medians of those as a start (``pair.stereo_start``), and then the bundle engine on all unknowns
(``camera.bundle``). With
``fix_intrinsics`` only the poses, R and T are free: the classical second step, worse than the joint optimum.

Pairs that disagree with the median by a large turn are the sign of corners counted from opposite ends in the two
images (see ``pair.corner_order``).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_image_size, require_choice, require_positive
from stereocal.base.errors import ConvergenceError, DegenerateGeometryError, InputError
from stereocal.base.rotations import rotation_matrices, rotation_vector
from stereocal.camera.board_shape import BoardShape, board_line
from stereocal.camera.board_shape_fit import board_shape_of, fit_shape
from stereocal.camera.bundle import Bundle, residuals
from stereocal.camera.bundle_problem import camera_of, intrinsics_of, make_bundle, whitening_of
from stereocal.camera.bundle_solver import BundleSolution, solve_bundle
from stereocal.camera.calibration import CameraCalibration, calibrate_camera
from stereocal.camera.covariance import BundleCovariance, bundle_covariance
from stereocal.camera.degeneracy import ADVICE
from stereocal.camera.distortion import distortion_model
from stereocal.camera.losses import LOSSES
from stereocal.camera.model import Camera
from stereocal.camera.outliers import RejectedCorner, report_rejected, solve_without_outliers
from stereocal.camera.parameters import (
    fixed_names,
    free_columns,
    intrinsic_names,
    prior_arrays,
    share_columns,
    with_shared_values,
)
from stereocal.camera.pose import estimate_poses
from stereocal.camera.priors import solve_with_priors
from stereocal.pair.rig import StereoRig
from stereocal.pair.stereo_inputs import RIG_NAMES, SIDES, fix_of_side, paired_views, spread_priors
from stereocal.pair.stereo_start import Poses, is_unsure, starting_state


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
        The two cameras by themselves, where they were calibrated on the way.
    board : BoardShape
        The board, with its shape where `board_warp` asked for it.
    joint : BundleCovariance
        All covariances, cross terms too.
    rejected : list of RejectedCorner
        Corners that were left out, with the reason; camera 0 is the left one.
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
        If the views do not determine the cameras.

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
    require_choice(loss, LOSSES, "loss")
    require_positive(loss_scale, "loss_scale")
    objects, images = paired_views(object_points, left_points, right_points)
    covariances = (left_covariances, right_covariances)
    given = (left, right)
    if fix_intrinsics and (left is None) != (right is None):
        raise InputError(
            "fix_intrinsics needs both cameras, left= and right=, or neither (each is then calibrated first)"
        )

    cameras, alone, poses, calibrations = [], [], [], []
    for side in (0, 1):
        seen = [i for i, y in enumerate(images[side]) if len(y)]
        X, y = [objects[side][i] for i in seen], [images[side][i] for i in seen]
        here = covariances[side]
        options = {
            "model": model, "fix": fix_of_side(fix, side), "loss": loss, "loss_scale": loss_scale, "skew": skew,
            "aspect_ratio": aspect_ratio, "reject_outliers": reject_outliers,
            "covariances": None if here is None else [here[i] for i in seen],
        }  # fmt: skip
        calibrate = partial(_calibrate_alone, side, X, y, sizes[side], options, complete=len(seen) == len(images[side]))
        camera, calibration = given[side], None
        if camera is None:
            calibration = calibrate()
            camera = calibration.camera
            rvecs, tvecs = calibration.rvecs, calibration.tvecs
        else:
            rvecs, tvecs = estimate_poses(X, y, camera)
        cameras.append(camera)
        alone.append(calibration)
        calibrations.append(None if calibration is None else calibrate)
        poses.append(Poses(np.array(seen), rotation_matrices(rvecs), tvecs))

    models = [distortion_model(camera.model) for camera in cameras]
    held = [
        set(intrinsic_names(m)) if fix_intrinsics else fixed_names(m, fix, skew=skew, camera=s, cameras=SIDES)
        for m, s in zip(models, SIDES, strict=True)
    ]
    parts = [free_columns(intrinsic_names(m), h, aspect_ratio) for m, h in zip(models, held, strict=True)]
    bundle = make_bundle(models, objects, images, _block_diagonal([*parts, np.eye(6)]))
    bundle.whitening = whitening_of(covariances, images)
    bundle.loss, bundle.loss_scale = loss, loss_scale
    names = [intrinsic_names(m) for m in models]
    if share:
        bundle.G = share_columns(bundle.G, names, share)

    def solve(cameras: list[Camera], poses: list[Poses]) -> BundleSolution:
        state = starting_state(cameras, poses, len(images[0]))
        state = with_shared_values(state, names, share) if share else state
        # the start is an optimum already, of each camera by itself: steps need hardly any damping
        return solve_bundle(bundle, state, max_iterations=max_iterations, initial_damping=1e-6, backend=backend)

    solution = solve(cameras, poses)
    if not fix_intrinsics and any(c is not None and is_unsure(c) for c in alone):
        begin_at_none = all(np.array_equal(m.start(), m.neutral()) for m in models)
        for held_first in ("principal_point", "distortion") if begin_at_none else ("principal_point",):
            other = _with_held(held_first, calibrations, poses, cameras)
            solution = solution if other is None else min(solution, solve(*other), key=lambda s: s.cost)
    everything, kept, limit = bundle, None, np.inf
    if reject_outliers:
        factor = 5.0 if reject_outliers is True else require_positive(reject_outliers, "reject_outliers")
        bundle, solution, kept, limit = solve_without_outliers(
            bundle, solution, factor, max_iterations=max_iterations, backend=backend
        )
    if priors:
        every = [f"{side}.{name}" for side, part in zip(SIDES, names, strict=True) for name in part] + list(RIG_NAMES)
        bundle, solution = solve_with_priors(
            bundle, solution, *prior_arrays(every, spread_priors(priors, every)), max_iterations=max_iterations
        )
    bundle, solution, kind, held_out = fit_shape(bundle, solution, board_warp, max_iterations=max_iterations)
    result = _result(bundle, solution, cameras, alone, kind, held_out)
    return result if kept is None else _with_rejected(result, everything, solution, kept, limit)


def _calibrate_alone(
    side: int, X: list[Float], y: list[Float], size: tuple[int, int], options: dict[str, Any], *, complete: bool,
    also_fix: Collection[str] = (),
) -> CameraCalibration:  # fmt: skip
    """One camera by itself; what it refuses is said to be its own."""
    try:
        return calibrate_camera(X, y, size, **{**options, "fix": [*options["fix"], *also_fix]})
    except DegenerateGeometryError as error:
        among = "" if complete else " (views counted among those it saw)"
        raise DegenerateGeometryError(f"{SIDES[side]} camera by itself{among}: {error}") from error


def _with_held(
    group: str,
    calibrations: Sequence[Callable[..., CameraCalibration] | None],
    poses: list[Poses],
    cameras: list[Camera],
) -> tuple[list[Camera], list[Poses]] | None:
    """Cameras calibrated by themselves with a group of parameters held, and their poses; given ones stay."""
    cameras, poses = list(cameras), list(poses)
    for side, calibrate in enumerate(calibrations):
        if calibrate is not None:
            try:
                held = calibrate(also_fix=(group,))
            except (ConvergenceError, DegenerateGeometryError):
                return None  # the first start has to do
            cameras[side] = held.camera
            poses[side] = Poses(poses[side].views, rotation_matrices(held.rvecs), held.tvecs)
    return cameras, poses


def _with_rejected(
    result: StereoCalibration, everything: Bundle, solution: BundleSolution, kept: np.ndarray, limit: float
) -> StereoCalibration:
    """The result with the residuals of all corners, as they were passed in; its RMS is that of the corners kept."""
    d = -residuals(everything, replace(solution.state, shape=np.zeros(0)))
    sides: tuple[list[Float], list[Float]] = (list(result.residuals[0]), list(result.residuals[1]))
    for block, (camera, view) in enumerate(zip(everything.camera_of_block, everything.view_of_block, strict=True)):
        sides[camera][view] = d[everything.offsets[block] : everything.offsets[block + 1]]
    return replace(result, residuals=sides, rejected=report_rejected(everything, solution, kept, limit))


def _block_diagonal(parts: list[Float]) -> Float:
    """One matrix with the parts along its diagonal."""
    G = np.zeros((sum(len(part) for part in parts), sum(part.shape[1] for part in parts)))
    row = column = 0
    for part in parts:
        G[row : row + len(part), column : column + part.shape[1]] = part
        row, column = row + len(part), column + part.shape[1]
    return G


def _result(
    bundle: Bundle, solution: BundleSolution, cameras: list[Camera], alone: list[CameraCalibration | None], kind: str,
    held_out: dict[str, float],
) -> StereoCalibration:  # fmt: skip
    state = solution.state
    both = [camera_of(t, c.image_size, m) for t, c, m in zip(state.intrinsics, cameras, bundle.models, strict=True)]
    rig = StereoRig(both[0], both[1], state.R_rig[1], state.t_rig[1])
    joint = bundle_covariance(bundle, state, solution.equations)
    for side, camera, part in zip(SIDES, both, bundle.intrinsic_slices, strict=True):
        if solution.converged and not np.sqrt(joint.shared[part, part][1, 1]) < 0.5 * camera.fy:
            raise DegenerateGeometryError(
                f"the {len(state.R_views)} views do not determine the focal length of the {side} camera; {ADVICE}"
            )
    names = [f"{s}.{n}" for s, m in zip(SIDES, bundle.models, strict=True) for n in intrinsic_names(m)]
    names += RIG_NAMES
    direction = rig.T / rig.baseline if rig.baseline > 0 else np.zeros(3)
    of_T = joint.shared[bundle.rig_slices[1], bundle.rig_slices[1]][3:, 3:]

    d = -solution.equations.residuals
    squares = d[:, 0] ** 2 + d[:, 1] ** 2
    views, offsets = len(state.R_views), bundle.offsets
    block_sums, block_counts = np.add.reduceat(squares, offsets[:-1]), np.diff(offsets)
    per_side: tuple[list[Float], list[Float]] = ([np.zeros((0, 2))] * views, [np.zeros((0, 2))] * views)
    camera_of_block, view_of_block = bundle.camera_of_block, bundle.view_of_block
    rows = pairwise(offsets.tolist())
    for camera, view, (a, b) in zip(camera_of_block.tolist(), view_of_block.tolist(), rows, strict=True):
        per_side[camera][view] = d[a:b]
    view_rms = np.full((views, 2), np.nan)
    view_rms[view_of_block, camera_of_block] = np.sqrt(block_sums / block_counts)
    sums, counts = np.bincount(camera_of_block, block_sums), np.bincount(camera_of_block, block_counts)
    return StereoCalibration(
        rig=rig,
        rms=float(np.sqrt(squares.mean())),
        left_rms=float(np.sqrt(sums[0] / counts[0])),
        right_rms=float(np.sqrt(sums[1] / counts[1])),
        view_rms=view_rms,
        rvecs=state.rvecs,
        tvecs=state.t_views.copy(),
        residuals=per_side,
        parameter_names=tuple(names),
        covariance=joint.shared[: len(names), : len(names)],
        std=np.sqrt(np.diag(joint.shared)[: len(names)]),
        baseline_std=float(np.sqrt(direction @ of_T @ direction)),
        pose_covariances=joint.views,
        iterations=solution.iterations,
        converged=solution.converged,
        reason=solution.reason,
        left=alone[0],
        right=alone[1],
        board=board_shape_of(bundle, state, kind, held_out, joint),
        joint=joint,
    )
