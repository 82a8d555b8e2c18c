"""The steps of a crosscheck that need only the rig: undistortion, F and E, rectification, remap, disparity, points."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.base.gray import to_gray
from stereocal.camera.resampling import remap
from stereocal.camera.undistortion import undistortion_maps
from stereocal.pair.rectification import Rectification, rectify
from stereocal.pair.rig import StereoRig
from stereocal.reconstruction.block_matching import match_bm
from stereocal.reconstruction.depth import disparity_to_points
from stereocal.reconstruction.speckles import filter_speckles
from stereocal.verify import opencv_calls
from stereocal.verify.comparison import StepComparison, not_compared

Image = NDArray[Any]
ROUNDING = "rounding of float64"


def compare_undistortion(rig: StereoRig) -> StepComparison:
    """Undistort a grid of pixels; the judge is to distort the answer again, which needs no oracle."""
    errors, apart = {"stereocal": 0.0, "opencv": 0.0}, 0.0
    for camera in (rig.left, rig.right):
        width, height = camera.image_size
        grid = np.stack(np.meshgrid(np.linspace(0, width - 1, 20), np.linspace(0, height - 1, 15)), -1).reshape(-1, 2)
        dist = opencv_calls.opencv_distortion(camera)
        ours = camera.undistort_points(grid)
        theirs = cv2.undistortPoints(grid[:, None], camera.K, dist, P=camera.K)[:, 0]
        inside = np.isfinite(ours).all(axis=1)
        apart = max(apart, float(np.max(np.linalg.norm((ours - theirs)[inside], axis=1))))
        for name, points in (("stereocal", ours), ("opencv", theirs)):
            rays = (points[inside] - camera.K[:2, 2]) / np.diag(camera.K)[:2]
            X = np.column_stack([rays, np.ones(len(rays))])
            again = cv2.projectPoints(X, np.zeros(3), np.zeros(3), camera.K, dist)[0][:, 0]
            errors[name] = max(errors[name], float(np.max(np.linalg.norm(again - grid[inside], axis=1))))
    finding = f"distorted again, ours comes back to {errors['stereocal']:.1e} px, OpenCV's to {errors['opencv']:.1e}."
    if errors["opencv"] > 1e-3:
        finding += " cv2.undistortPoints stops after five iterations."
    nearer = "equal" if apart <= 1e-3 else min(errors, key=lambda name: errors[name])
    return StepComparison(
        "undistorted points", apart, "px", 1e-3, "a tenth of the best corners' noise", nearer, finding,
        {"ours_round_trip_px": errors["stereocal"], "opencv_round_trip_px": errors["opencv"]},
    )  # fmt: skip


def compare_epipolar(rig: StereoRig) -> StepComparison:
    """Compare F and E of the rig with those that stereoCalibrate returns for the same cameras, held fixed."""
    X = np.stack([*np.meshgrid(np.linspace(-3, 3, 6), np.linspace(-2, 2, 5)), np.zeros((5, 6))], -1).reshape(-1, 3)
    X *= rig.baseline / 3
    poses = [
        (np.array([a, b, 0.0]), np.array([0.3 * a, 0.2 * b, 9]) * rig.baseline)
        for a, b in ((0.3, 0), (0, 0.4), (-0.3, 0.2))
    ]
    dist1, dist2 = (opencv_calls.opencv_distortion(camera) for camera in (rig.left, rig.right))
    left, right = [], []
    for rvec, tvec in poses:
        in_left = X @ cv2.Rodrigues(rvec)[0].T + tvec
        left.append(cv2.projectPoints(in_left, np.zeros(3), np.zeros(3), rig.left.K, dist1)[0].astype(np.float32))
        right.append(
            cv2.projectPoints(in_left, cv2.Rodrigues(rig.R)[0], rig.T, rig.right.K, dist2)[0].astype(np.float32)
        )
    objects = [X.astype(np.float32)] * len(poses)
    cameras = [np.array(matrix) for matrix in (rig.left.K, dist1, rig.right.K, dist2)]  # it wants to write to them
    size, flags = rig.left.image_size, cv2.CALIB_FIX_INTRINSIC
    F = cv2.stereoCalibrate(objects, left, right, *cameras, size, flags=flags)[8]
    corners = np.array([[0, 0, 1], [rig.left.image_size[0], 0, 1], [0, rig.left.image_size[1], 1]], np.float64)
    ours, theirs = corners @ rig.F.T, corners @ np.asarray(F).T
    ours, theirs = (lines / np.linalg.norm(lines[:, :2], axis=1, keepdims=True) for lines in (ours, theirs))
    middle = np.array([rig.right.image_size[0] / 2, rig.right.image_size[1] / 2, 1])
    apart = float(np.max(np.minimum(np.abs((ours - theirs) @ middle), np.abs((ours + theirs) @ middle))))
    finding = "epipolar lines of the image's corners, mid right image; OpenCV re-estimates R and T from float32."
    return StepComparison("F and E", apart, "px", 0.05, "float32 corners of a simulated board", "unknown", finding)


def compare_rectification(rig: StereoRig) -> StepComparison:
    """Compare R1, R2, P1, P2 and Q with cv2.stereoRectify's."""
    ours = rectify(rig)
    dist1, dist2 = (opencv_calls.opencv_distortion(camera) for camera in (rig.left, rig.right))
    cameras, motion = (rig.left.K, dist1, rig.right.K, dist2), (rig.R, rig.T[:, None])
    R1, R2, P1, P2, Q, *_ = cv2.stereoRectify(
        *cameras, rig.left.image_size, *motion, flags=cv2.CALIB_ZERO_DISPARITY, alpha=-1
    )
    pairs = ((ours.R1, R1), (ours.R2, R2), (ours.P1, P1), (ours.P2, P2), (ours.Q, Q))
    apart = max(float(np.max(np.abs(a - b)) / max(1.0, float(np.max(np.abs(b))))) for a, b in pairs)
    finding = "R1, R2, P1, P2 and Q side by side." + "".join(f" {warning}" for warning in ours.warnings)
    nearer = "equal" if apart <= 1e-9 else "unknown"
    return StepComparison("rectification", apart, "relative", 1e-9, ROUNDING, nearer, finding)


def compare_maps(rig: StereoRig, rectification: Rectification) -> StepComparison:
    """Compare the rectification maps with cv2.initUndistortRectifyMap."""
    apart = 0.0
    for camera, R, P in (
        (rig.left, rectification.R1, rectification.P1),
        (rig.right, rectification.R2, rectification.P2),
    ):
        size = rectification.image_size
        ours = undistortion_maps(camera.K, camera.dist, camera.image_size, R=R, P=P, model=camera.model, out_size=size)
        dist = opencv_calls.opencv_distortion(camera)
        theirs = cv2.initUndistortRectifyMap(camera.K, dist, R, P[:, :3], size, cv2.CV_32FC1)
        inside = (np.abs(theirs[0]) < 4 * size[0]) & (np.abs(theirs[1]) < 4 * size[1])
        inside &= np.isfinite(ours[0])
        apart = max(apart, *(float(np.max(np.abs(a - b)[inside])) for a, b in zip(ours, theirs, strict=True)))
    nearer = "equal" if apart <= 1e-3 else "unknown"
    return StepComparison("rectification maps", apart, "px", 1e-3, "float32 of coordinates", nearer, "both cameras.")


def compare_remap(image: Image, maps: tuple[NDArray[np.float32], NDArray[np.float32]]) -> StepComparison:
    """Compare bilinear interpolation, judged by exact interpolation in float64."""
    gray = to_gray(image)
    ours, theirs = remap(gray, *maps), cv2.remap(gray, *maps, cv2.INTER_LINEAR)
    exact = remap(gray.astype(np.float64), *maps)
    inside = np.isfinite(maps[0]) & (maps[0] > 1) & (maps[1] > 1)
    inside &= (maps[0] < gray.shape[1] - 2) & (maps[1] < gray.shape[0] - 2)
    apart = float(np.max(np.abs(ours.astype(float) - theirs)[inside]))
    errors = [float(np.max(np.abs(picture.astype(float) - exact)[inside])) for picture in (ours, theirs)]
    finding = (
        f"against exact interpolation ours is off by {errors[0]:.2f} grey levels at most, OpenCV's by {errors[1]:.2f}."
    )
    if errors[1] > 1:
        finding += " OpenCV 4 rounds coordinates to 1/32 of a pixel."
    nearer = "equal" if apart <= 1 else ("stereocal" if errors[0] < errors[1] else "opencv")
    figures = {"ours_error": errors[0], "opencv_error": errors[1]}
    return StepComparison("remap", apart, "grey levels", 1.0, "rounding to 8 bits", nearer, finding, figures)


def compare_disparity(left: Image, right: Image) -> tuple[StepComparison, StepComparison, NDArray[np.float32]]:
    """Compare match_bm with cv2.StereoBM, and the speckle filter with cv2.filterSpeckles, on a rectified pair."""
    a, b = (to_gray(image).astype(np.uint8) for image in (left, right))
    matcher = cv2.StereoBM_create(64, 21)
    fixed = matcher.compute(a, b)
    theirs = np.where(fixed == -16, np.nan, fixed / 16).astype(np.float32)
    ours = match_bm(a, b, num_disparities=64, block_size=21)
    other = int(np.count_nonzero(~((ours == theirs) | (np.isnan(ours) & np.isnan(theirs)))))
    source = "the same integers"
    finding = f"StereoBM(64, 21): a disparity on {np.isfinite(ours).mean():.1%} of the pixels."
    matching = StepComparison("disparity", other, "pixels", 0, source, "equal" if not other else "unknown", finding)
    filtered = filter_speckles(ours, max_size=100, max_difference=1.0)
    cv2.filterSpeckles(fixed, -16, 100, 16)
    speckled = np.where(fixed == -16, np.nan, fixed / 16).astype(np.float32)
    other = int(np.count_nonzero(~((filtered == speckled) | (np.isnan(filtered) & np.isnan(speckled)))))
    finding = f"components up to 100 pixels: {np.count_nonzero(np.isnan(filtered) & np.isfinite(ours))} pixels removed."
    speckles = StepComparison(
        "speckle filter", other, "pixels", 0, source, "equal" if not other else "unknown", finding
    )
    return matching, speckles, filtered


def compare_points(disparity: NDArray[np.float32], Q: Float) -> StepComparison:
    """Compare points in space with cv2.reprojectImageTo3D."""
    ours, theirs = disparity_to_points(disparity, Q), cv2.reprojectImageTo3D(disparity, Q.astype(np.float64))
    valid = np.isfinite(disparity) & (disparity > 0.5)
    if not valid.any():
        return not_compared("points in space", "no pixel has a disparity above half a pixel.")
    ours, theirs = ours[valid], theirs[valid]
    apart = float(np.max(np.abs(ours - theirs) / np.maximum(np.abs(theirs), 1e-6)))
    nearer = "equal" if apart <= 1e-5 else "unknown"
    return StepComparison(
        "points in space", apart, "relative", 1e-5, "float32 of the result", nearer, "all valid pixels."
    )
