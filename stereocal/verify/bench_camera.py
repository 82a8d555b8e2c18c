"""Calibration beside OpenCV: the same corners, from points to result; ours with covariance, OpenCV's without.

Views are synthetic, 9x6 corners, 0.1 px of noise. OpenCV runs with its default criteria. Joint stereo starts from
cameras calibrated one by one in both libraries, and that is timed too.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.rotations import rotation_matrix
from stereocal.camera.calibration import calibrate_camera
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig
from stereocal.pair.stereo_calibration import calibrate_stereo
from stereocal.verify.bench import BenchCase

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


def mono_case(count: int) -> BenchCase:
    """Return the case of one camera and `count` views."""
    import cv2

    X, left, _ = synthetic_pairs(count)
    objects, images = _for_opencv(X, left)
    return BenchCase(
        "calibrate_camera",
        f"{count} views of 9x6",
        lambda: calibrate_camera(X, left, SIZE).rms,
        lambda: cv2.calibrateCamera(objects, images, SIZE, None, None)[0],
        _agreement,
        lambda: ((X, left, SIZE), {}),
    )


def stereo_case(count: int) -> BenchCase:
    """Return the case of joint stereo calibration of `count` pairs."""
    import cv2

    X, left, right = synthetic_pairs(count)
    objects, left_images = _for_opencv(X, left)
    _, right_images = _for_opencv(X, right)

    def opencv() -> float:
        cameras: list[Any] = []
        for images in (left_images, right_images):
            cameras += cv2.calibrateCamera(objects, images, SIZE, None, None)[1:3]
        return float(
            cv2.stereoCalibrate(
                objects, left_images, right_images, *cameras, SIZE, flags=cv2.CALIB_USE_INTRINSIC_GUESS
            )[0]
        )

    return BenchCase(
        "calibrate_stereo",
        f"joint, {count} pairs of 9x6, with both mono calibrations",
        lambda: calibrate_stereo(X, left, right, SIZE).rms,
        opencv,
        _agreement,
        lambda: ((X, left, right, SIZE), {}),
    )


def _for_opencv(X: Float, corners: list[Float]) -> tuple[list[Any], list[Any]]:
    return [X.astype(np.float32)] * len(corners), [y.astype(np.float32)[:, None] for y in corners]


def _agreement(ours: float, theirs: float) -> str:
    return f"RMS ours {ours:.7f}, OpenCV's {theirs - ours:+.1e}"
