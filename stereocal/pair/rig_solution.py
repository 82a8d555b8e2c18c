"""The joint fit of any number of cameras fixed to each other: what stands behind a pair's and a rig's calibration.

    F = Σ_c Σ_i Σ_j ‖ y^c_ij − p̃(K_c, k_c, R_c R_i, R_c T_i + T_c, P_j) ‖²,        R_0 = I, T_0 = 0.

A view i has ONE pose of the board, in the first camera's frame; R_c and T_c take it to camera c. So every camera's
corners help to place the board for all others: the intrinsics gain, and R_c, T_c are the best for all views at once. A
camera that missed a view has no term there.

The way there: each camera by itself (``camera.calibration``), where the cameras stand from views that two of them saw
(``rig_start``), and then the bundle engine on all unknowns (``camera.bundle``). What one camera's views do not
determine, all together may: a camera that is refused by itself, and one unsure of its focal length beside it, begin
with one focal length after another and no lens, and whether the views determine the rig is asked of the joint optimum
(``camera.degeneracy``). Views that do not fit the rig of the others are named (``rig_agreement``). With
`fix_intrinsics` only the poses and the R_c, T_c are free: the classical second step, worse than the joint optimum.

This module sorts and solves; ``stereo_calibration`` and ``rig_calibration`` check what the user passes, and give the
result its names.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from stereocal.base.checks import Float, require_choice, require_positive
from stereocal.base.errors import ConvergenceError, DegenerateGeometryError, InputError
from stereocal.base.rotations import rotation_matrices
from stereocal.camera.board_shape import BoardShape
from stereocal.camera.board_shape_fit import board_shape_of
from stereocal.camera.bundle import Bundle, BundleState
from stereocal.camera.bundle_problem import camera_of, make_bundle, whitening_of
from stereocal.camera.bundle_solver import BundleSolution, solve_bundle
from stereocal.camera.calibration import CameraCalibration, calibrate_camera
from stereocal.camera.covariance import BundleCovariance, bundle_covariance
from stereocal.camera.degeneracy import refuse_degenerate
from stereocal.camera.distortion import distortion_model
from stereocal.camera.lens_doubts import lens_doubts
from stereocal.camera.losses import LOSSES
from stereocal.camera.model import Camera
from stereocal.camera.odd_views import OddViewsError
from stereocal.camera.outliers import RejectedCorner
from stereocal.camera.parameters import (
    fixed_names,
    free_columns,
    intrinsic_names,
    prior_arrays,
    share_columns,
    with_shared_values,
)
from stereocal.camera.pose import estimate_poses
from stereocal.camera.refinements import refine_optimum
from stereocal.pair.rig_agreement import odd_in_rig
from stereocal.pair.rig_inputs import fix_of_camera, spread_priors
from stereocal.pair.rig_start import Poses, is_unsure, starting_state

# A camera that saw fewer views than this is refused where they do not determine it, whatever the others saw.
_VIEWS_OF_ONE = 3
# Where one is refused: focal lengths, in image widths, to begin with for those that do not know theirs to this part.
_WIDTHS = (0.5, 0.9, 1.6, 2.8, 5.0)
_SURE = 0.05


@dataclass(frozen=True)
class RigOptions:
    """Options of a joint fit; see :func:`~stereocal.pair.stereo_calibration.calibrate_stereo`."""

    fix_intrinsics: bool = False
    fix: str | Collection[str] = ()
    loss: str = "linear"
    loss_scale: float = 1.0
    skew: bool = False
    aspect_ratio: float | None = None
    share: str | Collection[str] = ()
    priors: Mapping[str, tuple[float, float]] | None = None
    reject_outliers: bool | float = False
    board_warp: bool | str = False
    max_iterations: int = 2000
    backend: str = "numba"

    def __post_init__(self) -> None:
        require_choice(self.loss, LOSSES, "loss")
        require_positive(self.loss_scale, "loss_scale")
        if self.fix_intrinsics and self.share:
            raise InputError(
                "share names parameters that the cameras are to have in common, but fix_intrinsics holds them; drop "
                "one of the two"
            )
        if self.aspect_ratio is not None:
            require_positive(self.aspect_ratio, "aspect_ratio")


@dataclass(frozen=True)
class RigViews:
    """What C cameras saw.

    Attributes
    ----------
    names : sequence of str
        What the cameras are called.
    sizes : sequence of (int, int)
        Of their images.
    objects, images : list of lists of ndarray
        Board points and corners, a camera and view; no rows where it missed the board.
    covariances : sequence
        Of the corners, a camera; None where they are not given.
    """

    names: Sequence[str]
    sizes: Sequence[tuple[int, int]]
    objects: list[list[Float]]
    images: list[list[Float]]
    covariances: Sequence[Sequence[ArrayLike] | None]


@dataclass(frozen=True, eq=False)
class RigSolution:
    """The optimum of a rig of C cameras and V views.

    Attributes
    ----------
    cameras : list of Camera
    R, T : ndarray of shape (C, 3, 3), (C, 3)
        X_c = R_c X_0 + T_c.
    solution : BundleSolution
        Where the iteration ended.
    joint : BundleCovariance
        All covariances.
    rig_slices : list of slice
        Where (rvec_c, T_c) stands in `joint.shared`.
    rms : float
        Of all corners.
    camera_rms : ndarray of shape (C,)
    view_rms : ndarray of shape (V, C)
        NaN where a camera missed a view.
    residuals : list of C lists of V ndarray of shape (N, 2)
        Measured minus projected.
    alone : list of CameraCalibration or None
        Each camera by itself, where it was calibrated on the way.
    board : BoardShape
    rejected : list of RejectedCorner
    warnings : tuple of str
        What the views leave open, see ``camera.lens_doubts``.
    """

    cameras: list[Camera]
    R: Float
    T: Float
    solution: BundleSolution
    joint: BundleCovariance
    rig_slices: list[slice]
    rms: float
    camera_rms: Float
    view_rms: Float
    residuals: list[list[Float]]
    alone: list[CameraCalibration | None]
    board: BoardShape
    rejected: list[RejectedCorner]
    warnings: tuple[str, ...]


def solve_rig(
    views: RigViews, given: Sequence[Camera | None], models: Sequence[str], motion_names: Sequence[str],
    options: RigOptions,
) -> RigSolution:  # fmt: skip
    """Find all cameras, their R_c, T_c and the poses that minimise F.

    Parameters
    ----------
    views : RigViews
        What they saw.
    given : sequence of Camera or None
        Cameras to hold, or to start from.
    models : sequence of str
        Lens models, for those that are not given.
    motion_names : sequence of str
        What (rvec, T) of each further camera are called.
    options : RigOptions
        See there.

    Returns
    -------
    RigSolution
    """
    lenses = [distortion_model(m if c is None else c.model) for c, m in zip(given, models, strict=True)]
    parameters = [intrinsic_names(lens) for lens in lenses]
    by_name = dict(zip(views.names, parameters, strict=True))
    fix = [fix_of_camera(options.fix, name, by_name) for name in views.names]
    held = [
        set(own) if options.fix_intrinsics else fixed_names(lens, of_camera, skew=options.skew)
        for own, lens, of_camera in zip(parameters, lenses, fix, strict=True)
    ]
    cameras, alone, poses, again, refused = _each_alone(views, given, models, fix, options)
    parts = [free_columns(own, h, options.aspect_ratio) for own, h in zip(parameters, held, strict=True)]
    G = np.ascontiguousarray(block_diag(*parts, np.eye(6 * len(cameras) - 6)), dtype=np.float64)
    bundle = make_bundle(lenses, views.objects, views.images, G)
    bundle.whitening = whitening_of(views.covariances, views.images)
    bundle.loss, bundle.loss_scale = options.loss, options.loss_scale
    if options.share:
        bundle.G = share_columns(bundle.G, parameters, options.share)

    def begin(cameras: list[Camera], poses: list[Poses]) -> BundleState:
        state = starting_state(cameras, poses, len(views.images[0]))
        return with_shared_values(state, parameters, options.share) if options.share else state

    def solve(state: BundleState, damping: float = 1e-6) -> BundleSolution:
        # the start is an optimum already, of each camera by itself: steps need hardly any damping
        return solve_bundle(
            bundle, state, max_iterations=options.max_iterations, initial_damping=damping, backend=options.backend
        )

    if refused:
        starts = [begin(*_at_focal_length(w, views, models, given, alone, poses, cameras)) for w in _WIDTHS]
        solution, start = min(((solve(state, 1e-3), state) for state in starts), key=lambda found: found[0].cost)
    else:
        start = begin(cameras, poses)
        solution = solve(start)
    if not refused and not options.fix_intrinsics and any(c is not None and is_unsure(c) for c in alone):
        begin_at_none = all(np.array_equal(lens.start(), lens.neutral()) for lens in lenses)
        for held_first in ("principal_point", "distortion") if begin_at_none else ("principal_point",):
            other = _with_held(held_first, again, poses, cameras)
            solution = solution if other is None else min(solution, solve(begin(*other)), key=lambda s: s.cost)
    # both together determine no more: no optimum, or one with a pose that nothing holds
    if refused and not (solution.converged and np.linalg.eigvalsh(solution.equations.V).min() > 0):
        raise refused[0]
    odd = odd_in_rig(views.names, alone, bundle, start, poses, solution)
    every = [f"{camera}.{name}" for camera, own in zip(views.names, parameters, strict=True) for name in own]
    try:
        return _finished(bundle, solution, cameras, alone, [*every, *motion_names], views.names, options, odd)
    except (ConvergenceError, DegenerateGeometryError) as error:
        if not odd:
            raise
        raise type(error)(f"{'; '.join(odd)}; with all views, {error}") from error


def _finished(
    bundle: Bundle, solution: BundleSolution, cameras: list[Camera], alone: list[CameraCalibration | None],
    every: list[str], camera_names: Sequence[str], options: RigOptions, odd: list[str],
) -> RigSolution:  # fmt: skip
    """From the joint optimum to the result: outliers, priors and the board's shape, where they are asked for."""
    known = None
    if options.priors:
        known = prior_arrays(every, spread_priors(options.priors, every, camera_names))
    refined = refine_optimum(
        bundle, solution, board_warp=options.board_warp, reject_outliers=options.reject_outliers, priors=known,
        max_iterations=options.max_iterations, backend=options.backend,
    )  # fmt: skip
    bundle, solution, state = refined.bundle, refined.solution, refined.solution.state
    joint = bundle_covariance(bundle, state, solution.equations)
    final = [camera_of(t, c.image_size, m) for t, c, m in zip(state.intrinsics, cameras, bundle.models, strict=True)]
    if solution.converged or (solution.reason == "stalled" and not odd):
        widths = [camera.image_size[0] for camera in final]
        refuse_degenerate(bundle, state, solution.equations, joint, widths, camera_names)
    rms, camera_rms, view_rms, of_cameras = _by_camera(bundle, -solution.equations.residuals)
    rejected: list[RejectedCorner] = []
    if not refined.kept.all():  # residuals of all corners, as they were passed in; the RMS is of the corners kept
        of_cameras = _by_camera(refined.everything, -refined.residuals)[3]
        rejected = refined.rejected()
    # corners that are left out are named one by one
    warnings = [] if options.reject_outliers else list(odd)
    warnings += [
        f"{name}: {doubt}"
        for c, name in enumerate(camera_names)
        for doubt in lens_doubts(bundle, state, joint.shared, c, final[c].image_size)
    ]
    return RigSolution(
        cameras=final, R=state.R_rig, T=state.t_rig, solution=solution, joint=joint, rig_slices=bundle.rig_slices,
        rms=rms, camera_rms=camera_rms, view_rms=view_rms, residuals=of_cameras, alone=alone,
        board=board_shape_of(bundle, state, refined.kind, refined.held_out_rms, joint), rejected=rejected,
        warnings=tuple(warnings),
    )  # fmt: skip


def _by_camera(bundle: Bundle, d: Float) -> tuple[float, Float, Float, list[list[Float]]]:
    """RMS of all corners, of each camera (C,), of each view (V, C), and the residuals sorted by camera and view."""
    squares, offsets = d[:, 0] ** 2 + d[:, 1] ** 2, bundle.offsets
    block_sums, block_counts = np.add.reduceat(squares, offsets[:-1]), np.diff(offsets)
    camera_of_block, view_of_block = bundle.camera_of_block, bundle.view_of_block
    cameras, views = len(bundle.models), bundle.view_count
    sorted_out = [[np.zeros((0, 2))] * views for _ in range(cameras)]
    rows = pairwise(offsets.tolist())
    for camera, view, (a, b) in zip(camera_of_block.tolist(), view_of_block.tolist(), rows, strict=True):
        sorted_out[camera][view] = d[a:b]
    view_rms = np.full((views, cameras), np.nan)
    view_rms[view_of_block, camera_of_block] = np.sqrt(block_sums / block_counts)
    sums, counts = (np.bincount(camera_of_block, part, minlength=cameras) for part in (block_sums, block_counts))
    with np.errstate(invalid="ignore"):
        return float(np.sqrt(squares.mean())), np.sqrt(sums / counts), view_rms, sorted_out


Again = Callable[..., CameraCalibration] | None


def _each_alone(
    views: RigViews, given: Sequence[Camera | None], models: Sequence[str], fix: list[list[str]], options: RigOptions
) -> tuple[list[Camera], list[CameraCalibration | None], list[Poses], list[Again], list[DegenerateGeometryError]]:
    """Each camera by itself: camera, calibration, poses, and the function that calibrates it again; given ones stay.

    Of a camera that is refused the calibration is None, and the camera one to begin with; the errors come last.
    """
    cameras, alone, poses = [], [], []
    refused: list[DegenerateGeometryError] = []
    again: list[Again] = []
    for side, (images, camera) in enumerate(zip(views.images, given, strict=True)):
        seen = [i for i, y in enumerate(images) if len(y)]
        X, y = [views.objects[side][i] for i in seen], [images[i] for i in seen]
        calibration, calibrate = None, None
        if camera is None:
            here = views.covariances[side]
            calibrate = partial(
                _calibrate_alone, views.names[side], X, y, views.sizes[side], complete=len(seen) == len(images),
                options={
                    "model": models[side], "fix": fix[side], "loss": options.loss, "loss_scale": options.loss_scale,
                    "skew": options.skew,
                    "aspect_ratio": options.aspect_ratio, "reject_outliers": options.reject_outliers,
                    "covariances": None if here is None or len(here) != len(images) else [here[i] for i in seen],
                },
            )  # fmt: skip
            try:
                calibration = calibrate()
                camera, rvecs, tvecs = calibration.camera, calibration.rvecs, calibration.tvecs
            except OddViewsError:
                raise  # other starts would only spread what these views are wrong by
            except DegenerateGeometryError as error:
                if options.fix_intrinsics or len(seen) < _VIEWS_OF_ONE:
                    raise
                refused.append(error)
                camera = _any_camera(1.0, views.sizes[side], models[side])
                rvecs, tvecs = estimate_poses(X, y, camera)
        else:
            rvecs, tvecs = estimate_poses(X, y, camera)
        cameras.append(camera)
        alone.append(calibration)
        again.append(calibrate)
        poses.append(Poses(np.array(seen), rotation_matrices(rvecs), tvecs))
    return cameras, alone, poses, again, refused


def _any_camera(widths: float, size: tuple[int, int], model: str) -> Camera:
    """A camera to begin with where little is known: a focal length of so many image widths, no distortion."""
    f = widths * size[0]
    K = np.array([[f, 0, (size[0] - 1) / 2], [0, f, (size[1] - 1) / 2], [0, 0, 1.0]])
    return Camera(K, distortion_model(model).start(), size, model)


def _at_focal_length(
    widths: float, views: RigViews, models: Sequence[str], given: Sequence[Camera | None],
    alone: Sequence[CameraCalibration | None], poses: list[Poses], cameras: list[Camera],
) -> tuple[list[Camera], list[Poses]]:  # fmt: skip
    """Cameras and their poses, those with a focal length of so many image widths that do not know theirs."""
    cameras, poses = list(cameras), list(poses)
    for c, calibration in enumerate(alone):
        if given[c] is not None or (calibration and calibration.std[1] < _SURE * calibration.camera.fy):
            continue
        cameras[c] = _any_camera(widths, views.sizes[c], models[c])
        seen = poses[c].views
        X, y = [views.objects[c][i] for i in seen], [views.images[c][i] for i in seen]
        rvecs, tvecs = estimate_poses(X, y, cameras[c])
        poses[c] = Poses(seen, rotation_matrices(rvecs), tvecs)
    return cameras, poses


def _calibrate_alone(
    name: str, X: list[Float], y: list[Float], size: tuple[int, int], *, options: dict[str, Any], complete: bool,
    also_fix: Collection[str] = (),
) -> CameraCalibration:  # fmt: skip
    """One camera by itself; what it refuses is said to be its own."""
    try:
        return calibrate_camera(X, y, size, **{**options, "fix": [*options["fix"], *also_fix]})
    except DegenerateGeometryError as error:
        among = "" if complete else " (views counted among those it saw)"
        raise type(error)(f"{name} camera by itself{among}: {error}") from error


def _with_held(
    group: str, calibrations: Sequence[Again], poses: list[Poses], cameras: list[Camera]
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
