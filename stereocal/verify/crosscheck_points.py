"""The steps of a crosscheck that need corners: detection, homographies, calibrations, each library's whole way."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.base.least_squares import minimize_least_squares
from stereocal.base.rotations import rotation_vector
from stereocal.board.chessboard import Chessboard
from stereocal.camera.calibration import calibrate_camera
from stereocal.camera.homography import fit_homography
from stereocal.camera.model import Camera
from stereocal.camera.pose import estimate_poses
from stereocal.pair.corner_order import repair_corner_order
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
    side: str,
    images: list[NDArray[Any]],
    ours: list[Float | None],
    board: Chessboard,
    size: tuple[int, int],
    names: Sequence[str],
) -> tuple[list[StepComparison], list[Float | None]]:
    """Compare both OpenCV detectors with ours: found, difference, and whose corners fit held-out views.

    Returns
    -------
    steps : list of StepComparison
        Against findChessboardCorners with cornerSubPix, and against findChessboardCornersSB.
    classic : list of ndarray or None
        What the former found, in its own order.
    """
    detectors = {"classic": 11, "SB": None}  # findChessboardCorners with cornerSubPix 11, and findChessboardCornersSB
    steps, lists = [], []
    for name, half_window in detectors.items():
        found = [opencv_calls.find_corners(image, board.inner_corners, half_window) for image in images]
        lists.append(found)
        full = "findChessboardCornersSB" if half_window is None else "findChessboardCorners and cornerSubPix 11"
        steps.append(_compare_detector(f"corners {side}, {name}", full, ours, found, board, size, names))
    return steps, lists[0]


def _compare_detector(
    label: str,
    full: str,
    ours: list[Float | None],
    found: list[Float | None],
    board: Chessboard,
    size: tuple[int, int],
    names: Sequence[str],
) -> StepComparison:
    both = {k: (a, b) for k, (a, b) in enumerate(zip(ours, found, strict=True)) if a is not None and b is not None}
    turned = {k for k, (a, b) in both.items() if _counts_from_the_other_end(b, a)}
    both = {k: (a, b[::-1] if k in turned else b) for k, (a, b) in both.items()}
    finding = f"of {len(ours)} boards stereocal finds {_count(ours)}, {full} {_count(found)}"
    missed = [names[k] for k, (a, b) in enumerate(zip(ours, found, strict=True)) if a is not None and b is None]
    if missed:
        finding += f" (not {_listed(missed)})"
    apart = {k: float(np.median(np.linalg.norm(a - b, axis=1))) for k, (a, b) in both.items()}
    # a list half a square off is not of the same corners at all: another part of the board, or transposed
    strange = [k for k, (a, _) in both.items() if apart[k] > 0.5 * _spacing(a, board)]
    for k in strange:
        fits = [rms(_transfer(fit_homography(board.object_points[:, :2], c), board.object_points[:, :2]) - c)
                for c in both[k]]  # fmt: skip
        finding += (
            f"; in {names[k]} the two are of different corners: as a plane board ours fit to {fits[0]:.2f} px, "
            f"OpenCV's to {fits[1]:.2f}"
        )
    same = [pair for k, pair in both.items() if k not in strange]
    if len(same) < 4:
        return not_compared(label, f"{finding}: too few in common to compare.")
    errors = [_held_out_errors(board.object_points, [pair[k] for pair in same], size) for k in (0, 1)]
    held = [float(np.sqrt(np.mean(each))) for each in errors]
    nearer = _smaller_beyond_noise(errors[0], errors[1])
    shape = ", the board's shape free," if len(same) >= 8 else ""
    finding += f"; held-out RMS over the {len(same)} in common{shape} {held[0]:.3f} px with ours, {held[1]:.3f} with "
    finding += "OpenCV's"
    finding += ", a difference within what these views scatter." if nearer == "unknown" else "."
    if turned - set(strange):
        finding += f" OpenCV numbers {len(turned - set(strange))} of them from the other end: never mix two detectors."
    figures = {"ours_held_out_px": held[0], "opencv_held_out_px": held[1], "in_common": len(same)}
    figures |= {"ours_found": _count(ours), "opencv_found": _count(found), "other_corners": len(strange)}
    source = "ours: a tenth of a pixel changes the focal length by its standard deviation"
    difference = max([rms(np.concatenate([a - b for a, b in same])), *(apart[k] for k in strange)])
    return StepComparison(label, difference, "px RMS", 0.1, source, nearer, finding, figures)


def _spacing(corners: Float, board: Chessboard) -> float:
    """The median distance of neighbours along the rows, pixels."""
    columns, rows = board.inner_corners
    return float(np.median(np.linalg.norm(np.diff(corners.reshape(rows, columns, 2), axis=1), axis=2)))


def _listed(names: Sequence[str], most: int = 3) -> str:
    text = ", ".join(names[:most])
    return text if len(names) <= most else f"{text} and {len(names) - most} more"


def _count(found: list[Float | None]) -> int:
    return sum(corners is not None for corners in found)


def _counts_from_the_other_end(corners: Float, reference: Float) -> bool:
    """Whether the list turned round is nearer to the reference (the two detectors count from either end)."""
    as_is, turned = (np.median(np.linalg.norm(c - reference, axis=1)) for c in (corners, corners[::-1]))
    return bool(turned < as_is)


def _held_out_errors(object_points: Float, views: Corners, size: tuple[int, int]) -> Float:
    """Mean squared error of each view by a calibration that it took no part in: only its pose is fitted.

    The board's shape is an unknown where there are views enough to find it: the bend of a board taken for flat is
    larger than the noise of good corners, and would rank them by how they happen to go with it.
    """
    errors = np.empty(len(views))
    warp = len(views) >= 8
    folds = 4 if warp else len(views)  # few views are left out one by one: three at least must stay
    for fold in range(folds):
        held = range(fold, len(views), folds)
        kept = [v for i, v in enumerate(views) if i not in held]
        fit = calibrate_camera(object_points, kept, size, board_warp=warp)
        X = fit.board.points if warp else object_points
        rvecs, tvecs = estimate_poses(X, [views[i] for i in held], fit.camera)
        for i, rvec, tvec in zip(held, rvecs, tvecs, strict=True):
            errors[i] = rms(fit.camera.project(X, rvec, tvec) - views[i]) ** 2
    return errors


def _smaller_beyond_noise(ours: Float, theirs: Float) -> str:
    """Whose errors are smaller, view by view, by more than two standard errors of the mean difference."""
    difference = theirs - ours
    noise = float(np.std(difference, ddof=1) / np.sqrt(len(difference)))
    mean = float(np.mean(difference))
    return "unknown" if abs(mean) <= 2 * noise else "stereocal" if mean > 0 else "opencv"


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


def projection_difference(a: Camera, b: Camera, pixels: Float | None = None) -> float:
    """Largest distance between where two cameras see the same ray, after the best common rotation.

    Over the whole image, or over the `pixels` given.

    A rotation is taken out because a calibration's poses absorb it: shifting the principal point and turning the
    camera are nearly the same (mrcal calls it the implied rotation).
    """
    width, height = a.image_size
    whole = np.stack(np.meshgrid(np.linspace(0, width - 1, 16), np.linspace(0, height - 1, 12)), -1).reshape(-1, 2)
    grid = whole if pixels is None else pixels
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


def compare_chain(
    board: Chessboard,
    ours: tuple[list[Float | None], list[Float | None]],
    theirs: tuple[list[Float | None], list[Float | None]],
    size: tuple[int, int],
    model: str,
    unit: str,
    names: Sequence[str],
    corners_nearer: str,
) -> StepComparison:
    """Compare the whole way of each library from its own corners, and name pairs that OpenCV numbers from two ends.

    That is what most programs do: findChessboardCorners, cornerSubPix, calibrateCamera, stereoCalibrate, and no look at
    whether left and right count from the same end of a board that is the same after half a turn.
    """
    label, X = "each its own corners", board.object_points
    pairs = [[(k, a, b) for k, (a, b) in enumerate(zip(*who, strict=True)) if a is not None and b is not None]
             for who in (ours, theirs)]  # fmt: skip
    if min(map(len, pairs)) < 3 or model not in opencv_calls.FLAGS_OF_MODEL:
        return not_compared(label, "OpenCV finds too few pairs, or has no such lens model.")
    left, right, _ = repair_corner_order(board, [a for _, a, _ in pairs[0]], [b for _, _, b in pairs[0]], size)
    best = calibrate_stereo(X, left, right, size, model=model)
    first, second = [a for _, a, _ in pairs[1]], [b for _, _, b in pairs[1]]
    repaired_left, repaired_right, flipped = repair_corner_order(board, first, second, size)
    try:
        as_found = _opencv_stereo(X, first, second, size, model)
        repaired = _opencv_stereo(X, repaired_left, repaired_right, size, model) if any(flipped) else as_found
    except cv2.error as error:
        return not_compared(label, f"OpenCV gives up on its own corners: {' '.join(str(error).split())[:120]}.")
    finding = (
        f"joint RMS {best.rms:.3f} px and baseline {best.rig.baseline:.4f} {unit} from our corners of {len(left)} "
        f"pairs; OpenCV from its own of {len(first)}: {as_found[0]:.3f} px and {as_found[1]:.4f}."
    )
    if any(flipped):
        turned = [names[k] for (k, _, _), turn in zip(pairs[1], flipped, strict=True) if turn]
        finding += (
            f" It numbers left and right from opposite ends in {_listed(turned)}, and does not check; these turned, it "
            f"gives {repaired[0]:.3f} px and {repaired[1]:.4f}."
        )
    apart, tolerance = abs(as_found[1] - best.rig.baseline), 3 * best.baseline_std
    nearer = "equal" if apart <= tolerance else "stereocal" if any(flipped) else corners_nearer
    figures = {"ours_rms_px": best.rms, "opencv_rms_px": as_found[0], "flipped_pairs": float(sum(flipped))}
    figures |= {"ours_baseline": best.rig.baseline, "opencv_baseline": as_found[1]}
    figures |= {"opencv_rms_unflipped_px": repaired[0], "opencv_baseline_unflipped": repaired[1]}
    source = "three standard deviations of our baseline"
    return StepComparison(label, apart, f"{unit} baseline", tolerance, source, nearer, finding, figures)


def _opencv_stereo(X: Float, left: Corners, right: Corners, size: tuple[int, int], model: str) -> tuple[float, float]:
    """OpenCV's joint RMS and baseline from corners, by way of its calibrations of each camera."""
    views = ([as_float32(view) for view in left], [as_float32(view) for view in right])
    mono = [opencv_calls.calibrate_camera(X, side, size, model)[1:] for side in views]
    error, _, T, _ = opencv_calls.calibrate_stereo(X, views, size, (mono[0], mono[1]), model)
    return error, float(np.linalg.norm(T))
