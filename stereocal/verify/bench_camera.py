"""Calibration beside OpenCV: the same corners, from points to result; ours with covariance, OpenCV's without.

Views are synthetic, 9x6 corners, 0.1 px of noise. OpenCV runs with its default criteria. Joint stereo starts from
cameras calibrated one by one in both libraries, and that is timed too.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.rotations import rotation_matrix
from stereocal.camera.calibration import calibrate_camera
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig
from stereocal.pair.stereo_calibration import calibrate_stereo
from stereocal.verify.bench import Arguments, BenchCase

SIZE = (640, 480)


def cases(mono_views: tuple[int, ...] = (20, 100, 1000), stereo_views: tuple[int, ...] = (20, 100)) -> list[BenchCase]:
    """Return the cases: one camera and joint stereo, for several numbers of views.

    Parameters
    ----------
    mono_views, stereo_views : tuple of int
        Numbers of views.

    Returns
    -------
    list of BenchCase
    """
    return [mono_case(count) for count in mono_views] + [stereo_case(count) for count in stereo_views]


def synthetic_pairs(count: int, seed: int = 0) -> tuple[Float, list[Float], list[Float]]:
    """Return board points and `count` pairs of corners that both cameras of a webcam rig see whole.

    Parameters
    ----------
    count : int
        How many.
    seed : int
        Of the random generator.

    Returns
    -------
    X : ndarray of shape (54, 3)
    left, right : list of ndarray of shape (54, 2)
        As float32 holds them, which is all that OpenCV accepts.
    """
    rng = np.random.default_rng(seed)
    X = np.array([[x, y, 0.0] for y in range(6) for x in range(9)])
    rig = StereoRig(
        Camera([[530, 0, 325], [0, 532, 236], [0, 0, 1]], [-0.28, 0.09, 0.001, -0.0005, 0], SIZE),
        Camera([[535, 0, 320], [0, 534, 242], [0, 0, 1]], [-0.29, 0.1, 0.0005, -0.001, 0], SIZE),
        rotation_matrix([0.005, 0.01, -0.003]),
        [-3.3, 0.02, 0.01],
    )
    left: list[Float] = []
    right: list[Float] = []
    while len(left) < count:
        R = rotation_matrix(rng.uniform(-0.5, 0.5, 3))
        X_0 = X @ R.T + [rng.uniform(-6, -2), rng.uniform(-5, -1), rng.uniform(10, 18)]
        pair = [rig.left.project(X_0), rig.right.project(X_0 @ rig.R.T + rig.T)]
        if all(np.isfinite(y).all() and (y >= 0).all() and (y < SIZE).all() for y in pair):
            noisy = [(y + rng.normal(0, 0.1, y.shape)).astype(np.float32).astype(np.float64) for y in pair]
            left.append(noisy[0])
            right.append(noisy[1])
    return X, left, right


@cache
def _inputs(count: int) -> tuple[Float, list[list[Float]], list[Any], list[list[Any]]]:
    """Board points and corners of both sides, ours and OpenCV's; made when a case runs, not when it is listed."""
    X, *sides = synthetic_pairs(count)
    for_opencv = [[y.astype(np.float32)[:, None] for y in side] for side in sides]
    return X, sides, [X.astype(np.float32)] * count, for_opencv


def mono_case(count: int) -> BenchCase:
    """Return the case of one camera and `count` views."""
    import cv2

    def ours() -> float:
        X, (left, _), _, _ = _inputs(count)
        return calibrate_camera(X, left, SIZE).rms

    def opencv() -> float:
        _, _, objects, (images, _) = _inputs(count)
        return float(cv2.calibrateCamera(objects, images, SIZE, None, None)[0])

    def arguments() -> Arguments:
        X, (left, _), _, _ = _inputs(count)
        return (X, left, SIZE), {}

    return BenchCase("calibrate_camera", f"{count} views of 9x6", ours, opencv, _agreement, arguments)


def stereo_case(count: int) -> BenchCase:
    """Return the case of joint stereo calibration of `count` pairs."""
    import cv2

    def ours() -> float:
        X, (left, right), _, _ = _inputs(count)
        return calibrate_stereo(X, left, right, SIZE).rms

    def opencv() -> float:
        _, _, objects, sides = _inputs(count)
        cameras: list[Any] = []
        for images in sides:
            cameras += cv2.calibrateCamera(objects, images, SIZE, None, None)[1:3]
        flags = cv2.CALIB_USE_INTRINSIC_GUESS
        return float(cv2.stereoCalibrate(objects, *sides, *cameras, SIZE, flags=flags)[0])

    def arguments() -> Arguments:
        X, (left, right), _, _ = _inputs(count)
        return (X, left, right, SIZE), {}

    name = f"joint, {count} pairs of 9x6, with both mono calibrations"
    return BenchCase("calibrate_stereo", name, ours, opencv, _agreement, arguments)


def _agreement(ours: float, theirs: float) -> str:
    return f"RMS ours {ours:.7f}, OpenCV's {theirs - ours:+.1e}"
