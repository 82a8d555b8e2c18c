"""The steps of a crosscheck that need corners: detection, homographies, calibrations, the given one's optimum."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.base.least_squares import central_differences, minimize_least_squares
from stereocal.base.rotations import rotation_matrix, rotation_vector
from stereocal.board.chessboard import Chessboard
from stereocal.camera.calibration import calibrate_camera
from stereocal.camera.homography import fit_homography
from stereocal.camera.model import Camera
from stereocal.camera.pose import estimate_poses
from stereocal.pair.rig import StereoRig
from stereocal.pair.stereo_calibration import calibrate_stereo
from stereocal.verify import opencv_calls
from stereocal.verify.comparison import StepComparison, not_compared

Corners = list[Float]


def rms(residuals: Float) -> float:
    """Return √(Σ‖d‖² / N points) of residuals (N, 2)."""
    return float(np.sqrt(np.mean(np.sum(np.reshape(residuals, (-1, 2)) ** 2, axis=1))))


def as_float32(points: Float) -> Float:
    """Round to float32, which is what OpenCV's solvers read: both libraries get the same numbers."""
    return points.astype(np.float32).astype(np.float64)


def compare_corners(
    side: str, images: list[NDArray[Any]], ours: list[Float | None], board: Chessboard, size: tuple[int, int]
) -> tuple[StepComparison, ...]:
    """Compare both OpenCV detectors with ours: found, difference, and whose corners fit held-out views."""
    detectors = {"classic": 11, "SB": None}  # findChessboardCorners with cornerSubPix 11, and findChessboardCornersSB
    steps = []
    for name, half_window in detectors.items():
        found = [opencv_calls.find_corners(image, board.inner_corners, half_window) for image in images]
        label = f"corners {side}, {name}"
        both = [(a, _in_order_of(b, a)) for a, b in zip(ours, found, strict=True) if a is not None and b is not None]
        full = "findChessboardCornersSB" if half_window is None else "findChessboardCorners and cornerSubPix 11"
        counts = f"of {len(ours)} boards stereocal finds {_count(ours)}, {full} {_count(found)}"
        if len(both) < 4:
            steps.append(not_compared(label, f"{counts}: too few in common to compare."))
            continue
        turned = sum(
            not np.array_equal(_in_order_of(b, a), b)
            for a, b in zip(ours, found, strict=True)
            if a is not None and b is not None
        )
        difference = rms(np.concatenate([a - b for a, b in both]))
        held = [_held_out_rms(board.object_points, [pair[k] for pair in both], size) for k in (0, 1)]
        nearer = "stereocal" if held[0] < held[1] else "opencv"
        finding = (
            f"{counts}; held-out RMS over the {len(both)} in common {held[0]:.3f} px with ours, "
            f"{held[1]:.3f} with OpenCV's."
        )
        if turned:
            finding += f" OpenCV numbers {turned} of them from the other end: never mix two detectors."
        figures = {"ours_held_out_px": held[0], "opencv_held_out_px": held[1], "in_common": len(both)}
        source = "ours: a tenth of a pixel changes the focal length by its standard deviation"
        steps.append(StepComparison(label, difference, "px RMS", 0.1, source, nearer, finding, figures))
    return tuple(steps)


def _count(found: list[Float | None]) -> int:
    return sum(corners is not None for corners in found)


def _in_order_of(corners: Float, reference: Float) -> Float:
    """Turn the list round if that brings it nearer to the reference (the two detectors count from either end)."""
    as_is, turned = (np.median(np.linalg.norm(c - reference, axis=1)) for c in (corners, corners[::-1]))
    return corners if as_is <= turned else corners[::-1]


def _held_out_rms(object_points: Float, views: Corners, size: tuple[int, int], folds: int = 4) -> float:
    """RMS on views that took no part in the fit: only their pose is fitted."""
    errors = []
    for fold in range(min(folds, len(views) - 3)):
        held = views[fold :: min(folds, len(views) - 3)]
        kept = [v for i, v in enumerate(views) if i % min(folds, len(views) - 3) != fold]
        camera = calibrate_camera(object_points, kept, size).camera
        rvecs, tvecs = estimate_poses(object_points, held, camera)
        errors += [camera.project(object_points, r, t) - v for r, t, v in zip(rvecs, tvecs, held, strict=True)]
    return rms(np.concatenate(errors))


def compare_homographies(object_points: Float, views: Corners) -> StepComparison:
    """Compare the homography of each view, by where it takes the board's corners."""
    plane = object_points[:, :2]
    differences, costs = [], []
    for view in views:
        H, H_cv = fit_homography(plane, view), cv2.findHomography(plane, view)[0]
        a, b = _transfer(H, plane), _transfer(H_cv, plane)
        differences.append(float(np.max(np.linalg.norm(a - b, axis=1))))
        costs.append((rms(a - view), rms(b - view)))
    ours, theirs = np.mean(costs, axis=0)
    worst = max(differences)
    nearer = "equal" if worst <= 1e-3 else ("stereocal" if ours <= theirs else "opencv")
    return StepComparison(
        "homography", worst, "px", 1e-3, "OpenCV converts points to float32", nearer,
        f"mean transfer RMS {ours:.4f} px, OpenCV's {theirs:.4f}.",
        {"ours_rms_px": float(ours), "opencv_rms_px": float(theirs)},
    )  # fmt: skip


def _transfer(H: Float, points: Float) -> Float:
    p = np.column_stack([points, np.ones(len(points))]) @ H.T
    return np.asarray(p[:, :2] / p[:, 2:])


def compare_camera(
    side: str, object_points: Float, views: Corners, size: tuple[int, int], model: str
) -> tuple[StepComparison, Camera | None, tuple[Float, Float] | None]:
    """Compare calibrateCamera with ours on the same corners, as the distance between their pixels over the image."""
    views = [as_float32(view) for view in views]
    ours = calibrate_camera(object_points, views, size, model=model)
    label = f"intrinsics, {side}"
    if model not in opencv_calls.FLAGS_OF_MODEL:
        return not_compared(label, f"calibrateCamera has no {model} model."), ours.camera, None
    theirs_rms, K, dist = opencv_calls.calibrate_camera(object_points, views, size, model)
    theirs = Camera(K, dist[: len(ours.camera.dist)], size, model=model)
    apart = projection_difference(ours.camera, theirs)
    nearer = "equal" if abs(ours.rms - theirs_rms) < 1e-6 else ("stereocal" if ours.rms < theirs_rms else "opencv")
    finding = f"RMS {ours.rms:.6f} px, OpenCV's {theirs_rms:.6f}; f {ours.camera.K[0, 0]:.3f} and {K[0, 0]:.3f} px."
    figures = {"ours_rms_px": ours.rms, "opencv_rms_px": theirs_rms}
    source = "the same sum is minimised: what remains is where the solvers stop"
    step = StepComparison(label, apart, "px", 0.01, source, nearer, finding, figures)
    return step, ours.camera, (K, dist)


def projection_difference(a: Camera, b: Camera) -> float:
    """Largest distance over the image between where two cameras see the same ray, after the best common rotation.

    A rotation is taken out because a calibration's poses absorb it: shifting the principal point and turning the
    camera are nearly the same (mrcal calls it the implied rotation).
    """
    width, height = a.image_size
    grid = np.stack(np.meshgrid(np.linspace(0, width - 1, 16), np.linspace(0, height - 1, 12)), -1).reshape(-1, 2)
    x, y = ((a.undistort_points(grid) - a.K[:2, 2]) / np.diag(a.K)[:2]).T
    rays = np.column_stack([x, y, np.ones_like(x)])
    seen = np.isfinite(rays).all(axis=1)
    rays, grid = rays[seen], grid[seen]

    def residuals(rotation: Float) -> Float:
        return (b.project(rays, rotation, np.zeros(3)) - grid).ravel()

    found = minimize_least_squares(residuals, np.zeros(3))
    return float(np.max(np.linalg.norm(found.residuals.reshape(-1, 2), axis=1)))


def compare_stereo(
    object_points: Float, views: tuple[Corners, Corners], size: tuple[int, int], model: str,
    mono: tuple[tuple[Float, Float] | None, tuple[Float, Float] | None],
) -> StepComparison:  # fmt: skip
    """Compare stereoCalibrate, joint and with its default criteria, with our joint optimum of the same sum."""
    views = ([as_float32(view) for view in views[0]], [as_float32(view) for view in views[1]])
    ours = calibrate_stereo(object_points, *views, size, model=model)
    if mono[0] is None or mono[1] is None:
        return not_compared("joint optimum", f"stereoCalibrate has no {model} model.")
    theirs_rms, R, T, _ = opencv_calls.calibrate_stereo(object_points, views, size, (mono[0], mono[1]), model)
    excess = theirs_rms - ours.rms
    length = float(np.linalg.norm(T))
    turn = float(np.degrees(np.linalg.norm(rotation_vector(R @ ours.rig.R.T))))
    finding = (
        f"RMS {ours.rms:.5f} px, OpenCV's {theirs_rms:.5f}; baseline {ours.rig.baseline:.4f} and {length:.4f}, "
        f"R {turn:.3f}° apart."
    )
    if excess > 1e-4:
        finding += f" OpenCV {cv2.__version__} stopped short of the optimum, and did not say so."
    nearer = "equal" if abs(excess) <= 1e-5 else ("stereocal" if excess > 0 else "opencv")
    figures = {"ours_rms_px": ours.rms, "opencv_rms_px": theirs_rms, "rotation_apart_deg": turn}
    figures |= {"ours_baseline": ours.rig.baseline, "opencv_baseline": length}
    source = "the same sum is minimised: a stop within 1e-4 px of the optimum moves nothing that can be measured"
    return StepComparison("joint optimum", abs(excess), "px RMS", 1e-4, source, nearer, finding, figures)


def judge_given(object_points: Float, views: tuple[Corners, Corners], rig: StereoRig, unit: str) -> StepComparison:
    """Ask whether the given calibration is at an optimum of these corners, and how far from it if not.

    The poses of the boards are fitted to the given rig first; the gradient over its own parameters is then the
    derivative of the best cost there is for that rig (the envelope theorem).
    """
    poses = [_pose_in_rig(object_points, left, right, rig) for left, right in zip(*views, strict=True)]
    given = _rig_residuals(object_points, poses, rig, views)
    best = calibrate_stereo(object_points, *views, rig.left.image_size, model=rig.left.model)
    cosine = _gradient_cosine(object_points, poses, rig, views)
    given_points, best_points = (_triangulated(r, views) for r in (rig, best.rig))
    shift = np.linalg.norm(given_points - best_points, axis=1)
    error = rms(given)
    finding = (
        f"given RMS {error:.5f} px, optimum {best.rms:.5f}; corners in space differ by {np.median(shift):.3g} {unit} "
        f"(median), {shift.max():.3g} at most; largest |cos| of gradient and residual {cosine:.1e}."
    )
    if error - best.rms > 1e-4:
        finding += " It is not at an optimum of these corners: other corners, other settings, or an early stop."
    figures = {"given_rms_px": error, "optimum_rms_px": best.rms, "gradient_cosine": cosine}
    figures |= {"median_shift": float(np.median(shift)), "largest_shift": float(shift.max())}
    nearer = "equal" if error - best.rms <= 1e-4 else "stereocal"
    source = "1e-4 px: beyond it the solver, the corners or the model were others"
    return StepComparison("the given calibration", error - best.rms, "px RMS", 1e-4, source, nearer, finding, figures)


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
    return minimize_least_squares(lambda p: _pair_residuals(X, p, rig, left, right).ravel(), start).x


def _gradient_cosine(X: Float, poses: list[Float], rig: StereoRig, views: tuple[Corners, Corners]) -> float:
    """Largest |cos| between the residual and a column of the derivative by one of the rig's own parameters."""
    n = len(rig.left.dist)

    def unpacked(p: Float) -> StereoRig:
        cameras = []
        for q, size in ((p[: 4 + n], rig.left.image_size), (p[4 + n : 8 + 2 * n], rig.right.image_size)):
            K = np.array([[q[0], 0, q[2]], [0, q[1], q[3]], [0, 0, 1]])
            cameras.append(Camera(K, q[4:], size, model=rig.left.model))
        return StereoRig(cameras[0], cameras[1], rotation_matrix(p[-6:-3]), p[-3:])

    def residuals(p: Float) -> Float:
        return _rig_residuals(X, poses, unpacked(p), views).ravel()

    def packed(camera: Camera) -> Float:
        return np.concatenate([camera.K[[0, 1, 0, 1], [0, 1, 2, 2]], camera.dist])

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
