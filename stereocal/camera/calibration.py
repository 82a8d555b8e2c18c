"""Calibrating one camera from views of a board: the maximum likelihood estimate [eq 19].

Given are corners y_ij of board points P_j in views i. If their errors are independent and normal with equal spread,
the most likely camera minimises

    F = Σ_i Σ_j ‖ y_ij − p̃(K, k, R_i, T_i, P_j) ‖²

over the matrix K, the lens k and the poses (R_i, T_i) together. The way there:

1. a homography a view (``homography``), checked for degenerate views;
2. a start: Zhang's closed form, or what stands in for it (``zhang``, ``initialisation``);
3. Levenberg–Marquardt on all unknowns at once (``bundle``, ``bundle_solver``). If it ends at an implausible place,
other starts
   are tried and the lowest F wins;
4. the covariance of all unknowns (``covariance``).

Reported RMS is OpenCV's, √(F / number of points): both coordinates count in one distance. A standard deviation σ of
each coordinate shows up as an RMS of about 1.41 σ.

Source: Zhang (2000), section 3.2 and 3.3; the paper prints the case of k1, k2.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_image_size, require_choice, require_positive
from stereocal.base.errors import ConvergenceError, DegenerateGeometryError, InputError
from stereocal.base.rotations import rotation_vector
from stereocal.camera.bundle import Bundle, BundleState, residuals
from stereocal.camera.bundle_problem import camera_of, intrinsics_of, make_bundle, whitening_of
from stereocal.camera.bundle_solver import BundleSolution, solve_bundle
from stereocal.camera.covariance import BundleCovariance, bundle_covariance
from stereocal.camera.distortion import distortion_model
from stereocal.camera.distortion_base import DistortionModel
from stereocal.camera.distortion_polynomial import Polynomial
from stereocal.camera.initialisation import Start, candidate_starts, convert_lens, homographies_of_views
from stereocal.camera.losses import LOSSES
from stereocal.camera.model import Camera
from stereocal.camera.parameters import fixed_names, free_columns, intrinsic_names
from stereocal.camera.pose import initial_poses
from stereocal.camera.views import as_views, require_not_collinear

# Models that OpenCV has, whose lens may start from zero; the others start from a fit with k1, k2.
_DIRECT_START = ("pinhole", "polynomial", "brown", "rational", "thin_prism", "tilted")
# Relative standard deviation of the focal length beyond which the views do not determine it.
_UNDETERMINED = 0.5


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
    joint : BundleCovariance
        All covariances, cross terms too.
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
    joint: BundleCovariance = field(repr=False)

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
    board_warp: bool | str = False,
    max_iterations: int = 200,
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
    board_warp : bool or str
        Whether the board's shape is unknown too, see ``board_shape``.
    max_iterations : int
        Limit on steps.

    Returns
    -------
    CameraCalibration

    Raises
    ------
    InputError
        If an argument has the wrong shape or value.
    DegenerateGeometryError
        If the views do not determine the camera: fewer than three (two, where enough is held), all parallel, or a view
        whose points lie on one line. The message names the views and says what to photograph.
    ConvergenceError
        If no start leads to an optimum.

    Notes
    -----
    Paper: [eq 19]. Answers to ``cv2.calibrateCamera``: the same optimum, to 1e-7 px of RMS.
    """
    size = as_image_size(image_size)
    lens = distortion_model(model)
    require_choice(loss, LOSSES, "loss")
    objects, images = as_views(object_points, image_points)
    if aspect_ratio is not None:
        require_positive(aspect_ratio, "aspect_ratio")
    held = fixed_names(lens, fix, skew=skew)
    names = intrinsic_names(lens)
    _require_views(objects, images, held, size)
    G = free_columns(names, held, aspect_ratio)
    bundle = make_bundle([lens], [objects], [images], G)
    bundle.loss, bundle.loss_scale = loss, require_positive(loss_scale, "loss_scale")
    bundle.whitening = whitening_of([covariances], [images])

    if "fx" in held and initial is None:
        raise InputError("fix names the focal length, but no value is given: pass initial=Camera(...)")
    solution = _best_solution(bundle, objects, images, size, lens, held, aspect_ratio, initial, max_iterations)
    return _result(bundle, solution, size, lens, names)


def _require_views(objects: list[Float], images: list[Float], held: set[str], size: tuple[int, int]) -> None:
    if not images:
        raise InputError("image_points is empty; at least three views are needed")
    missed = [i for i, y in enumerate(images) if len(y) == 0]
    if missed:
        raise InputError(f"image_points has no corners in view {', '.join(map(str, missed))}; leave these views out")
    known = {"cx", "cy"} <= held
    needed = 1 if {"fx", "fy"} <= held or known else 2 if "skew" in held else 3
    needed = max(needed, 1 if known else 3)
    if len(images) < needed:
        raise DegenerateGeometryError(
            f"{len(images)} views are too few: {needed} are needed; photograph the board tilted by 30 to 45 degrees, "
            "to a different side each time"
        )
    require_not_collinear(objects, images, "image_points")


def _initial_state(start: Start, lens: DistortionModel, k: Float) -> BundleState:
    theta = np.concatenate([[start.K[0, 0], start.K[1, 1], start.K[0, 2], start.K[1, 2], start.K[0, 1]], k])
    return BundleState([theta], np.eye(3)[None], np.zeros((1, 3)), start.R, start.t)


def _best_solution(
    bundle: Bundle, objects: list[Float], images: list[Float], size: tuple[int, int], lens: DistortionModel,
    held: set[str], aspect_ratio: float | None, initial: Camera | None, max_iterations: int,
) -> BundleSolution:  # fmt: skip
    """Solve from one start after another until an optimum looks like a camera; return the lowest."""
    if initial is not None:
        R, t = initial_poses(objects, images, initial)
        theta = np.zeros(5 + lens.parameter_count)
        given = intrinsics_of(initial) if initial.model == lens.name else intrinsics_of(initial)[:5]
        theta[5:] = lens.start()
        theta[: len(given)] = given
        return solve_bundle(bundle, BundleState([theta], np.eye(3)[None], np.zeros((1, 3)), R, t),
                            max_iterations=max_iterations)  # fmt: skip
    flat = [np.column_stack([X[:, :2], np.zeros(len(X))]) for X in objects]
    H = homographies_of_views(flat, images)
    starts = candidate_starts(H, flat, images, size, aspect_ratio=aspect_ratio)
    best: BundleSolution | None = None
    for start in starts:
        if {"cx", "cy"} <= held:
            start.K[0, 2], start.K[1, 2] = (size[0] - 1) / 2, (size[1] - 1) / 2
        state = _staged_start(bundle, start, lens, held)
        solution = solve_bundle(bundle, state, max_iterations=max_iterations)
        if best is None or solution.cost < best.cost:
            best = solution
        if solution.converged and _looks_like_a_camera(solution, size):
            break
    if best is None or not np.isfinite(best.cost):
        raise ConvergenceError(
            "no start leads to a camera: check that corners and board points are in the same order, "
            "and the number of inner corners"
        )
    return best


def _staged_start(bundle: Bundle, start: Start, lens: DistortionModel, held: set[str]) -> BundleState:
    if lens.name in _DIRECT_START or set(lens.parameter_names) <= held:
        return _initial_state(start, lens, lens.neutral())
    simple = Polynomial()
    G = free_columns(intrinsic_names(simple), {"skew"} | (held & {"cx", "cy", "fx", "fy"}), None)
    first = solve_bundle(
        replace(bundle, models=[simple], G=G, prior_weights=None), _initial_state(start, simple, np.zeros(2))
    )
    theta, state = first.state.intrinsics[0], first.state
    view = _views_of_rows(bundle)
    X_c = np.einsum("nij,nj->ni", state.R_views[view], bundle.points) + state.t_views[view]
    k, scale = convert_lens(lens, theta[5:], X_c[:, :2] / X_c[:, 2:])
    K = np.array([[theta[0] * scale, 0, theta[2]], [0, theta[1] * scale, theta[3]], [0, 0, 1.0]])
    return _initial_state(Start(K, state.R_views, state.t_views, 0.0), lens, k)


def _views_of_rows(bundle: Bundle) -> np.ndarray:
    return np.repeat(bundle.view_of_block, np.diff(bundle.offsets))


def _looks_like_a_camera(solution: BundleSolution, size: tuple[int, int]) -> bool:
    fx, fy, cx, cy = solution.state.intrinsics[0][:4]
    width, height = size
    return bool(
        0.05 * width < fx < 30 * width
        and 0.3 < fx / fy < 3.3
        and -0.5 * width < cx < 1.5 * width
        and -0.5 * height < cy < 1.5 * height
    )


def _result(
    bundle: Bundle, solution: BundleSolution, size: tuple[int, int], lens: DistortionModel, names: tuple[str, ...]
) -> CameraCalibration:
    state = solution.state
    camera = camera_of(state.intrinsics[0], size, lens)
    joint = bundle_covariance(bundle, state, solution.equations)
    std = np.sqrt(np.diag(joint.shared)[: len(names)])
    free_focal = bool(np.any(bundle.G[:2]))
    if free_focal and not std[1] < _UNDETERMINED * camera.fy:
        raise DegenerateGeometryError(
            "the views do not determine the focal length: the boards stand nearly parallel to each other; photograph "
            "the board tilted by 30 to 45 degrees, to a different side each time"
        )
    d = -residuals(bundle, state)
    squares = np.sum(d * d, axis=1)
    counts = np.diff(bundle.offsets)
    return CameraCalibration(
        camera=camera,
        rvecs=np.stack([rotation_vector(R) for R in state.R_views]),
        tvecs=state.t_views.copy(),
        rms=float(np.sqrt(squares.mean())),
        view_rms=np.sqrt(np.add.reduceat(squares, bundle.offsets[:-1]) / counts),
        residuals=[d[a:b] for a, b in zip(bundle.offsets[:-1], bundle.offsets[1:], strict=True)],
        parameter_names=names,
        covariance=joint.shared[: len(names), : len(names)],
        std=std,
        pose_covariances=joint.views,
        iterations=solution.iterations,
        converged=solution.converged,
        reason=solution.reason,
        joint=joint,
    )
