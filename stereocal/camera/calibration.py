"""Calibrating one camera from views of a board: the maximum likelihood estimate [eq 19].

Given are corners y_ij of board points P_j in views i. If their errors are independent and normal with equal spread,
the most likely camera minimises

    F = Σ_i Σ_j ‖ y_ij − p̃(K, k, R_i, T_i, P_j) ‖²

over the matrix K, the lens k and the poses (R_i, T_i) together. The way there:

1. a homography a view (``homography``), checked for degenerate views;
2. a start: Zhang's closed form, or what stands in for it (``zhang``, ``initialisation``);
3. Levenberg–Marquardt on all unknowns at once (``bundle``, ``bundle_solver``). If it ends at an implausible place,
   other starts are tried and the lowest F wins;
4. the covariance of all unknowns (``covariance``).

Reported RMS is OpenCV's, √(F / number of points): both coordinates count in one distance. A standard deviation σ of
each coordinate shows up as an RMS of about 1.41 σ.

Source: Zhang (2000), section 3.2 and 3.3; the paper prints the case of k1, k2.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_image_size, require_choice, require_integer, require_positive
from stereocal.base.errors import DegenerateGeometryError, InputError
from stereocal.camera.board_shape import BoardShape, board_line
from stereocal.camera.board_shape_fit import board_shape_of
from stereocal.camera.bundle import Bundle, BundleState
from stereocal.camera.bundle_problem import camera_of, intrinsics_of, make_bundle, whitening_of
from stereocal.camera.bundle_solver import BundleSolution, solve_bundle
from stereocal.camera.covariance import BundleCovariance, bundle_covariance
from stereocal.camera.degeneracy import ADVICE, refuse_degenerate
from stereocal.camera.distortion import distortion_model
from stereocal.camera.distortion_base import DistortionModel
from stereocal.camera.initialisation import solve_from_starts
from stereocal.camera.lens_doubts import lens_doubts
from stereocal.camera.lens_starts import first_lens
from stereocal.camera.losses import LOSSES
from stereocal.camera.model import Camera
from stereocal.camera.odd_views import OddView, blame_odd_views, odd_view_warnings, odd_views
from stereocal.camera.outliers import RejectedCorner
from stereocal.camera.parameters import fixed_names, free_columns, intrinsic_names, prior_arrays
from stereocal.camera.pose import initial_poses
from stereocal.camera.refinements import refine_optimum
from stereocal.camera.views import as_views


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """What :func:`calibrate_camera` found.

    Attributes
    ----------
    camera : Camera
        K, dist, image_size, model.
    rvecs, tvecs : ndarray of shape (V, 3)
        Pose of the board in each view: X_camera = R(rvec) X_board + tvec.
    rms : float
        √(Σ‖d‖² / N points), pixels (OpenCV's definition).
    view_rms : ndarray of shape (V,)
        The same, a view.
    residuals : list of ndarray of shape (N, 2)
        Measured minus projected, pixels, a view.
    parameter_names : tuple of str
        fx, fy, cx, cy, skew and the lens, the order of `covariance`.
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
    board : BoardShape
        The board, with its shape where `board_warp` asked for it.
    joint : BundleCovariance
        All covariances, cross terms too.
    rejected : list of RejectedCorner
        Corners that were left out, with the reason.
    warnings : tuple of str
        What the views leave open, see ``lens_doubts``, and which of them do not belong.
    odd : tuple of OddView
        Views that do not belong to the others, see ``odd_views``.
    """

    camera: Camera
    rvecs: Float
    tvecs: Float
    rms: float
    view_rms: Float
    residuals: list[Float]
    parameter_names: tuple[str, ...]
    covariance: Float
    std: Float
    pose_covariances: Float
    iterations: int
    converged: bool
    reason: str
    board: BoardShape = field(repr=False)
    joint: BundleCovariance = field(repr=False)
    rejected: list[RejectedCorner] = field(default_factory=list)
    warnings: tuple[str, ...] = ()
    odd: tuple[OddView, ...] = ()

    def summary(self) -> str:
        """Return the result in a few lines of text, each parameter with its standard deviation."""
        values = intrinsics_of(self.camera)
        lines = [
            f"{len(self.rvecs)} views, {sum(map(len, self.residuals))} corners, RMS {self.rms:.4f} px, "
            f"{'converged' if self.converged else 'NOT converged'} ({self.reason}) in {self.iterations} steps",
            f"{self.camera.image_size[0]}x{self.camera.image_size[1]}, model {self.camera.model}",
        ]
        for name, value, std in zip(self.parameter_names, values, self.std, strict=True):
            lines.append(f"  {name:6s} {value:14.6g}" + (f"  ± {std:.2g}" if std > 0 else "  held"))
        lines.append(board_line(self.board))
        lines += [f"left out: view {c.view}, corner {c.point}: {c.reason}" for c in self.rejected]
        lines += [f"warning: {warning}" for warning in self.warnings]
        return "\n".join(lines)


def calibrate_camera(
    object_points: ArrayLike | Sequence[ArrayLike],
    image_points: Sequence[ArrayLike],
    image_size: tuple[int, int],
    *,
    model: str = "brown",
    fix: str | Collection[str] = (),
    loss: str = "linear",
    loss_scale: float = 1.0,
    covariances: Sequence[ArrayLike] | None = None,
    skew: bool = False,
    aspect_ratio: float | None = None,
    initial: Camera | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    reject_outliers: bool | float = False,
    board_warp: bool | str = False,
    max_iterations: int = 2000,
    backend: str = "numba",
) -> CameraCalibration:
    """Find camera, lens and poses that minimise Σᵢ Σⱼ ‖y_ij − p̃(K, k, Rᵢ, Tᵢ, P_j)‖².

    Parameters
    ----------
    object_points : array_like of shape (N, 3), or sequence of them
        Board points; one array for all views, or one a view.
    image_points : sequence of array_like of shape (N, 2)
        Corners, pixels, one array a view.
    image_size : (int, int)
        Width and height, pixels.
    model : str
        Lens model, see ``distortion``.
    fix : str or collection of str
        Parameters held at their value in `initial` (principal point: the middle of the image; lens: none, unless
        given).
    loss : {"linear", "huber", "cauchy"}
        How much large residuals count, see ``losses``.
    loss_scale : float
        Where the loss begins to forgive, pixels.
    covariances : sequence of array_like of shape (N, 2, 2), optional
        Covariance of each corner, px²; corners are weighted by their inverse.
    skew : bool
        Whether K[0, 1] is free.
    aspect_ratio : float, optional
        Ties fx = aspect_ratio · fy.
    initial : Camera, optional
        Start, and the values of what is held; otherwise found by closed form.
    priors : mapping of str to (mean, sigma), optional
        Parameters known beforehand, with their standard deviation.
    reject_outliers : bool or float
        Whether corners far from where the calibration draws them are left out, and beyond how many standard deviations
        (5 for True); see ``outliers``. What was left out, and why, is in ``.rejected``.
    board_warp : bool or str
        Whether the board's shape is unknown too: ``"bow"``, ``"released"``, or True or ``"auto"`` to let held-out views
        choose; see ``board_shape``.
    max_iterations : int
        Limit on steps.
    backend : {"numba", "numpy"}
        The compiled twin (for OpenCV's models), or the equations in NumPy.

    Returns
    -------
    CameraCalibration

    Raises
    ------
    InputError
        If an argument has the wrong shape or value.
    DegenerateGeometryError
        If the views do not determine the camera: fewer than two (one, where the principal point is held; three with
        skew and no lens), all parallel (see ``degeneracy``), or a view whose points lie on one line. The message names
        the views and says what to photograph.
    ConvergenceError
        If no start leads to an optimum.

    Notes
    -----
    Paper: [eq 19]. Answers to ``cv2.calibrateCamera``: the same optimum, to 1e-7 px of RMS.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> board = sc.Chessboard((7, 6), 25.0)
    >>> tilts = [(0.4, 0, 0), (-0.4, 0.1, 0), (0, 0.4, 0.1), (0.1, -0.4, 0), (0.3, 0.3, 0.2), (-0.3, 0.3, 0)]
    >>> camera = sc.Camera(K, [-0.2, 0.05, 0, 0, 0], (640, 480))
    >>> corners = [camera.project(board.object_points, tilt, [-75, -60, 400]) for tilt in tilts]
    >>> found = sc.calibrate_camera(board.object_points, corners, (640, 480))
    >>> found.camera.K.round(3)
    array([[500.,   0., 320.],
           [  0., 500., 240.],
           [  0.,   0.,   1.]])
    >>> found.converged, bool(found.rms < 1e-6)
    (True, True)
    """
    size = as_image_size(image_size)
    lens = distortion_model(model)
    require_choice(loss, LOSSES, "loss")
    objects, images = as_views(object_points, image_points)
    if aspect_ratio is not None:
        require_positive(aspect_ratio, "aspect_ratio")
    held = fixed_names(lens, fix, skew=skew)
    require_integer(max_iterations, "max_iterations", minimum=1)
    names, G = intrinsic_names(lens), free_columns(intrinsic_names(lens), held, aspect_ratio)
    known = prior_arrays(names, priors) if priors else None
    _require_views(images, G, known)
    if "fx" in held and initial is None:
        raise InputError("fix names the focal length, but no value is given: pass initial=Camera(...)")
    bundle = make_bundle([lens], [objects], [images], G)
    bundle.loss, bundle.loss_scale = loss, require_positive(loss_scale, "loss_scale")
    bundle.whitening = whitening_of([covariances], [images])

    solve = partial(
        solve_from_starts, lens=lens, held=held, image_size=size, aspect_ratio=aspect_ratio,
        max_iterations=max_iterations, backend=backend,
    )  # fmt: skip
    if initial is None:
        solution = solve(bundle)
    else:
        state = _given_state(objects, images, initial, lens, held, size)
        solution = solve_bundle(bundle, state, max_iterations=max_iterations, backend=backend)
    odd = () if reject_outliers else odd_views(bundle, solution, solve if initial is None else None)
    refined = refine_optimum(
        bundle, solution, board_warp=board_warp, reject_outliers=reject_outliers,
        priors=known, max_iterations=max_iterations, backend=backend,
    )  # fmt: skip
    try:
        result = _result(refined.bundle, refined.solution, size, lens, names, refined.kind, refined.held_out_rms)
    except DegenerateGeometryError as error:
        blame_odd_views(odd, error)
        raise
    if odd:
        result = replace(result, odd=odd, warnings=(*odd_view_warnings(odd), *result.warnings))
    if not refined.kept.all():  # residuals of all corners, as they were passed in; the RMS is of the corners kept
        d, offsets = -refined.residuals, refined.everything.offsets
        result = replace(result, residuals=[d[a:b] for a, b in pairwise(offsets)], rejected=refined.rejected())
    return result


def _require_views(images: list[Float], G: Float, known: tuple[Float, Float] | None) -> None:
    """Refuse fewer views than there are pairs of unknowns in K: each gives two equations (``zhang``).

    With skew and a lens two will do: the lens shows where its centre is.
    """
    if not images:
        raise InputError("image_points is empty; at least two views are needed")
    missed = [i for i, y in enumerate(images) if len(y) == 0]
    if missed:
        raise InputError(f"image_points has no corners in view {', '.join(map(str, missed))}; leave these views out")
    open_ones = G[:5] if known is None else G[:5][np.isinf(known[1][:5])]
    needed = -(-int(np.count_nonzero(open_ones.any(axis=0))) // 2)
    needed = min(needed, 2) if G[5:].any() else needed
    if len(images) < needed:
        raise DegenerateGeometryError(
            f"{len(images)} view{'s are' if len(images) > 1 else ' is'} too few: {needed} are needed, or "
            f"fix='principal_point'; {ADVICE}"
        )


def _given_state(
    objects: list[Float], images: list[Float], initial: Camera, lens: DistortionModel, held: set[str],
    size: tuple[int, int],
) -> BundleState:  # fmt: skip
    """The start from a camera that the user gave; its lens counts where it is of the same model."""
    if not isinstance(initial, Camera):
        raise InputError(f"initial must be a Camera(K, dist, image_size), not {type(initial).__name__}")
    if initial.image_size != size:
        raise InputError(f"initial is a camera of {initial.image_size} pixels, but image_size is {size}; scale it")
    R, t = initial_poses(objects, images, initial)
    theta = np.concatenate([intrinsics_of(initial)[:5], first_lens(lens, held)])
    if initial.model == lens.name:
        theta = intrinsics_of(initial)
    return BundleState([theta], np.eye(3)[None], np.zeros((1, 3)), R, t)


def _result(
    bundle: Bundle, solution: BundleSolution, size: tuple[int, int], lens: DistortionModel, names: tuple[str, ...],
    kind: str, held_out: dict[str, float],
) -> CameraCalibration:  # fmt: skip
    state = solution.state
    camera = camera_of(state.intrinsics[0], size, lens)
    joint = bundle_covariance(bundle, state, solution.equations)
    std = np.sqrt(np.diag(joint.shared)[: len(names)])
    refuse_degenerate(bundle, state, solution.equations, joint, size[0])
    d = -solution.equations.residuals
    squares = d[:, 0] ** 2 + d[:, 1] ** 2
    counts = np.diff(bundle.offsets)
    return CameraCalibration(
        camera=camera,
        rvecs=state.rvecs,
        tvecs=state.t_views.copy(),
        rms=float(np.sqrt(squares.mean())),
        view_rms=np.sqrt(np.add.reduceat(squares, bundle.offsets[:-1]) / counts),
        residuals=[d[a:b] for a, b in pairwise(bundle.offsets.tolist())],
        parameter_names=names,
        covariance=joint.shared[: len(names), : len(names)],
        std=std,
        pose_covariances=joint.views,
        iterations=solution.iterations,
        converged=solution.converged,
        reason=solution.reason,
        board=board_shape_of(bundle, state, kind, held_out, joint),
        joint=joint,
        warnings=lens_doubts(bundle, state, joint.shared, 0, size),
    )
