"""Is the given calibration at an optimum of these corners, and how many pixels and millimetres away if it is not?

Whoever calibrated, with whatever tool, minimised the reprojection error of some corners. At an optimum the derivative
of that sum by every parameter is 0. So the boards' poses are fitted to the given rig first, which leaves, for a rig θ,

    F(θ) = min over poses Σ ‖predicted − found‖²,

whose derivative by θ is that of the sum at the fitted poses (the envelope theorem). Its size is told free of units, as
the largest |cos| between the residual r and a column of J = ∂r/∂θ, which is 0 at an optimum and 1 if a parameter alone
could take all of r away. Then the optimum itself is found from the same corners, and the two are compared by what they
do: RMS, where the two cameras draw the same rays (pixels), and where the corners lie in space (the board's unit).

A calibration far from every optimum has a plain cause more often than not, and two are looked for: left and right
exchanged, and lengths in another unit.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import StereocalError
from stereocal.base.least_squares import central_differences, minimize_least_squares
from stereocal.base.rotations import rotation_matrix, rotation_vector
from stereocal.camera.model import Camera
from stereocal.camera.pose import estimate_poses
from stereocal.pair.rig import StereoRig
from stereocal.pair.stereo_calibration import calibrate_stereo
from stereocal.verify.comparison import StepComparison, not_compared
from stereocal.verify.crosscheck_points import Corners, projection_difference, rms

FAR = 5.0
"""A given RMS this many times the optimum's has a cause worth looking for."""


def judge_given(
    object_points: Float, views: tuple[Corners, Corners], rig: StereoRig, unit: str, *, note: str = ""
) -> StepComparison:
    """Ask whether the given calibration is at an optimum of these corners, and how far from it if not.

    Parameters
    ----------
    object_points : ndarray of shape (N, 3)
        The board.
    views : (list of ndarray, list of ndarray)
        Corners of the left and the right photographs.
    rig : StereoRig
        The calibration in question.
    unit : str
        Of the board's lengths, for the sentence.
    note : str
        What the sentence begins with: which pairs, which board.

    Returns
    -------
    StepComparison
    """
    same_model = rig.left.model == rig.right.model
    best = calibrate_stereo(
        object_points,
        *views,
        rig.left.image_size,
        model=rig.left.model,
        left=None if same_model else rig.left,
        right=None if same_model else rig.right,
        right_image_size=rig.right.image_size,
    )
    poses, error = _fitted(object_points, views, rig)
    if poses is None:
        cause = _cause(object_points, views, rig, best.rig, np.inf) or " It is of other cameras, or of another board."
        finding = f"{note}its cameras cannot have seen these corners, whatever the boards' poses.{cause}"
        return not_compared("the given calibration", finding)
    excess = error - best.rms
    cosine = _gradient_cosine(object_points, poses, rig, views)
    both = ((rig.left, best.rig.left, views[0]), (rig.right, best.rig.right, views[1]))
    pixels = max(projection_difference(a, b) for a, b, _ in both)
    at_corners = max(projection_difference(a, b, np.concatenate(corners)) for a, b, corners in both)
    given_points, best_points = (_triangulated(each, views) for each in (rig, best.rig))
    shift = np.linalg.norm(given_points - best_points, axis=1)
    finding = (
        f"{note}RMS {error:.5f} px, the optimum's {best.rms:.5f}; largest |cos| of gradient and residual {cosine:.1e}; "
        f"its cameras draw up to {at_corners:.2g} px apart from the optimum's where the corners are, {pixels:.2g} px "
        f"over the whole image; corners in space differ by {np.median(shift):.2g} {unit} (median), {shift.max():.2g} "
        "at most."
    )
    if excess <= 1e-4:
        finding += " It is at the optimum of these corners."
    else:
        cause = _cause(object_points, views, rig, best.rig, error) if error > FAR * best.rms else ""
        finding += (
            cause or " It is not at an optimum of these corners: other corners, other settings, or an early stop."
        )
    figures = {"given_rms_px": error, "optimum_rms_px": best.rms, "gradient_cosine": cosine}
    figures |= {"cameras_apart_px": pixels, "cameras_apart_at_corners_px": at_corners}
    figures |= {"median_shift": float(np.median(shift)), "largest_shift": float(shift.max())}
    nearer = "equal" if excess <= 1e-4 else "stereocal"
    source = "1e-4 px: beyond it the solver, the corners or the model were others"
    return StepComparison("the given calibration", excess, "px RMS", 1e-4, source, nearer, finding, figures)


def _cause(X: Float, views: tuple[Corners, Corners], rig: StereoRig, best: StereoRig, error: float) -> str:
    """A sentence if exchanged sides or another unit explain the error."""
    views = (views[0][:8], views[1][:8])  # so gross an error shows in a few pairs
    scale = best.baseline / rig.baseline
    in_unit = StereoRig(rig.left, rig.right, rig.R, rig.T * scale)
    exchanged = StereoRig(rig.right, rig.left, rig.R.T, -rig.R.T @ rig.T * scale)
    errors = [_fitted(X, views, other)[1] for other in (in_unit, exchanged)]
    if errors[1] < min(errors[0], error) / 2:
        return f" With left and right exchanged it would be {errors[1]:.3f} px: cameras or photographs are swapped."
    if errors[0] < error / 2 and not 0.5 < scale < 2:
        return f" With T {scale:.4g} times as long it would be {errors[0]:.3f} px: its lengths are in another unit."
    return ""


def _fitted(X: Float, views: tuple[Corners, Corners], rig: StereoRig) -> tuple[list[Float] | None, float]:
    """The boards' poses that fit a rig best, and the RMS; None and infinity if it cannot have seen the corners."""
    try:
        poses = [_pose_in_rig(X, left, right, rig) for left, right in zip(*views, strict=True)]
    except StereocalError:  # a lens that folds, a board behind the camera: no pose to begin from
        return None, np.inf
    return poses, rms(_rig_residuals(X, poses, rig, views))


def _rig_residuals(X: Float, poses: list[Float], rig: StereoRig, views: tuple[Corners, Corners]) -> Float:
    pairs = zip(poses, *views, strict=True)
    return np.concatenate([_pair_residuals(X, pose, rig, left, right) for pose, left, right in pairs])


def _pair_residuals(X: Float, pose: Float, rig: StereoRig, left: Float, right: Float) -> Float:
    R, t = rotation_matrix(pose[:3]), pose[3:]
    in_left = X @ R.T + t
    still = np.zeros(3)
    in_right = in_left @ rig.R.T + rig.T
    return np.concatenate(
        [rig.left.project(in_left, still, still) - left, rig.right.project(in_right, still, still) - right]
    )


def _pose_in_rig(X: Float, left: Float, right: Float, rig: StereoRig) -> Float:
    rvecs, tvecs = estimate_poses(X, [left], rig.left)
    start = np.concatenate([rvecs[0], tvecs[0]])

    def residuals(pose: Float) -> Float:
        return _pair_residuals(X, pose, rig, left, right).ravel()

    return minimize_least_squares(residuals, start, max_iterations=40).x


def _gradient_cosine(X: Float, poses: list[Float], rig: StereoRig, views: tuple[Corners, Corners]) -> float:
    """Largest |cos| between the residual and a column of the derivative by one of the rig's own parameters."""
    n = 4 + len(rig.left.dist)

    def camera(q: Float, like: Camera) -> Camera:
        K = np.array([[q[0], 0, q[2]], [0, q[1], q[3]], [0, 0, 1]])
        return Camera(K, q[4:], like.image_size, model=like.model)

    def residuals(p: Float) -> Float:
        moved = StereoRig(camera(p[:n], rig.left), camera(p[n:-6], rig.right), rotation_matrix(p[-6:-3]), p[-3:])
        return _rig_residuals(X, poses, moved, views).ravel()

    def packed(like: Camera) -> Float:
        return np.concatenate([like.K[[0, 1, 0, 1], [0, 1, 2, 2]], like.dist])

    start = np.concatenate([packed(rig.left), packed(rig.right), rotation_vector(rig.R), rig.T])
    r, J = residuals(start), central_differences(residuals, start)
    lengths = np.linalg.norm(J, axis=0)
    moves = lengths > 0
    return float(np.max(np.abs(J.T @ r)[moves] / lengths[moves]) / np.linalg.norm(r))


def _triangulated(rig: StereoRig, views: tuple[Corners, Corners]) -> Float:
    from stereocal.reconstruction.triangulation import triangulate_points

    P1 = rig.left.K @ np.eye(3, 4)
    P2 = rig.right.K @ np.column_stack([rig.R, rig.T])
    left, right = (
        camera.undistort_points(np.concatenate(side)) for camera, side in zip((rig.left, rig.right), views, strict=True)
    )
    return np.asarray(triangulate_points(P1, P2, left, right))
