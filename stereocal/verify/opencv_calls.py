"""OpenCV's functions with this library's shapes, the same for 4.x and 5.x.

The two versions differ in small ways (shapes of corners, where flags are accepted); they are evened out here, so that
the comparisons read alike. Nothing here computes anything of its own.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.base.gray import to_gray
from stereocal.camera.model import Camera

FLAGS_OF_MODEL = {
    "pinhole": cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3,
    "polynomial": cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3,
    "brown": 0,
    "rational": cv2.CALIB_RATIONAL_MODEL,
    "thin_prism": cv2.CALIB_RATIONAL_MODEL | cv2.CALIB_THIN_PRISM_MODEL,
    "tilted": cv2.CALIB_RATIONAL_MODEL | cv2.CALIB_THIN_PRISM_MODEL | cv2.CALIB_TILTED_MODEL,
}
"""The distortion models that cv2.calibrateCamera has, with the flags that ask for them."""


def opencv_distortion(camera: Camera) -> Float:
    """Return the camera's coefficients in OpenCV's order and one of its lengths: k1 k2 p1 p2 [k3 …]."""
    dist = np.asarray(camera.dist, dtype=np.float64)
    if camera.model in ("pinhole", "polynomial"):
        return np.concatenate([dist, np.zeros(4 - len(dist))])
    return dist


def find_corners(image: NDArray[Any], inner_corners: tuple[int, int], half_window: int | None) -> Float | None:
    """Run findChessboardCorners, then cornerSubPix with a half window; for None, findChessboardCornersSB."""
    gray = to_gray(image)
    if gray.dtype == np.uint16:
        gray = (gray >> 8).astype(np.uint8)
    if half_window is None:
        found, corners = cv2.findChessboardCornersSB(
            gray, inner_corners, flags=cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        )
        return np.asarray(corners, np.float64).reshape(-1, 2) if found else None
    found, corners = cv2.findChessboardCorners(gray, inner_corners)
    if not found:
        return None
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 30, 0.001)
    start = np.ascontiguousarray(corners, np.float32).reshape(-1, 1, 2)
    refined = cv2.cornerSubPix(gray, start, (half_window, half_window), (-1, -1), criteria)
    return np.asarray(refined, np.float64).reshape(-1, 2)


def calibrate_camera(
    object_points: Float, views: list[Float], size: tuple[int, int], model: str
) -> tuple[float, Float, Float]:
    """Run calibrateCamera with default criteria: RMS, K, dist."""
    objects, images = _as_float32(object_points, len(views)), [v.astype(np.float32)[:, None] for v in views]
    K0, dist0 = np.eye(3), np.zeros(5)
    rms, K, dist, *_ = cv2.calibrateCamera(objects, images, size, K0, dist0, flags=FLAGS_OF_MODEL[model])
    return float(rms), np.asarray(K), np.ravel(dist)


def calibrate_stereo(
    object_points: Float,
    views: tuple[list[Float], list[Float]],
    size: tuple[int, int],
    cameras: tuple[tuple[Float, Float], tuple[Float, Float]],
    model: str,
) -> tuple[float, Float, Float, tuple[tuple[Float, Float], tuple[Float, Float]]]:
    """Run stereoCalibrate jointly from known intrinsics with default criteria: RMS, R, T, cameras."""
    objects = _as_float32(object_points, len(views[0]))
    left, right = ([v.astype(np.float32)[:, None] for v in side] for side in views)
    (K1, d1), (K2, d2) = cameras
    rms, K1, d1, K2, d2, R, T, *_ = cv2.stereoCalibrate(
        objects, left, right, K1.copy(), d1.copy(), K2.copy(), d2.copy(), size,
        flags=cv2.CALIB_USE_INTRINSIC_GUESS | FLAGS_OF_MODEL[model],
    )  # fmt: skip
    return float(rms), np.asarray(R), np.ravel(T), ((K1, np.ravel(d1)), (K2, np.ravel(d2)))


def _as_float32(object_points: Float, count: int) -> list[NDArray[np.float32]]:
    return [np.ascontiguousarray(object_points, np.float32)] * count
