"""Benchmarks of the board room: Harris beside cv2.cornerHarris, detection beside both of OpenCV's detectors."""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from stereocal.board.chessboard import Chessboard
from stereocal.board.detection import detect_chessboard
from stereocal.board.harris import harris_response
from stereocal.camera.model import Camera
from stereocal.synthetic.board_view import render_board
from stereocal.verify.bench import BenchCase

SIZES = ((640, 480), (1920, 1080))
BOARD = Chessboard((9, 6), 1.0)


def cases() -> list[BenchCase]:
    """Return the cases of this room."""
    found = [_harris(size) for size in SIZES]
    for size in SIZES:
        for present in (True, False):
            found += [_detection(size, present, exhaustive) for exhaustive in (False, True)]
    return found


@cache
def picture(size: tuple[int, int], present: bool) -> NDArray[np.uint8]:
    """A board seen at an angle, or a scene of soft texture and boxes without one.

    Parameters
    ----------
    size : (width, height)
    present : bool
        Whether the board is there.
    """
    width, height = size
    if present:
        f = 0.8 * width
        camera = Camera(
            np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1.0]]), np.array([-0.2, 0.05, 0, 0, 0]), size
        )
        c, s = np.cos(0.4), np.sin(0.4)
        R = np.array([[1.0, 0, 0], [0, c, -s], [0, s, c]])
        return render_board(camera, R, R @ [-4.0, -2.5, 0.0] + [0, 0, 0.8 * width / (0.055 * width)], BOARD, noise=2.0)[
            0
        ]
    rng = np.random.default_rng(1)
    image = rng.normal(0, 1, (height, width)).astype(np.float32)
    image = 128 + 400 * cv2.GaussianBlur(image, (0, 0), 3)
    for _ in range(width // 8):
        x, y = rng.integers(0, width), rng.integers(0, height)
        w, h = rng.integers(4, width // 10, 2)
        cv2.rectangle(image, (int(x), int(y)), (int(x + w), int(y + h)), float(rng.uniform(0, 255)), -1)
    return np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8)


def _harris(size: tuple[int, int]) -> BenchCase:
    image = picture(size, True)
    return BenchCase(
        "harris_response",
        f"{size[0]}x{size[1]}, block 3",
        lambda: harris_response(image),
        lambda: cv2.cornerHarris(image, 3, 3, 0.04),
        lambda ours, theirs: f"max |Δ| {np.abs(ours - theirs).max() / np.abs(theirs).max():.1e} of the largest",
        lambda: ((image,), {}),
    )


def _detection(size: tuple[int, int], present: bool, exhaustive: bool) -> BenchCase:
    image = picture(size, present)

    def opencv() -> Any:
        if exhaustive:
            flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
            return cv2.findChessboardCornersSB(image, BOARD.inner_corners, None, flags)
        return cv2.findChessboardCorners(image, BOARD.inner_corners)

    def agreement(ours: Any, theirs: Any) -> str:
        if ours is None or not theirs[0]:
            return f"found: ours {'yes' if ours is not None else 'no'}, OpenCV {'yes' if theirs[0] else 'no'}"
        corners = np.asarray(theirs[1], dtype=np.float64).reshape(-1, 2)
        distance = min(np.abs(ours - other).max() for other in (corners, corners[::-1]))
        return f"both found, within {distance:.2f} px"

    against = "SB exhaustive" if exhaustive else "findChessboardCorners"
    there = "board present" if present else "board absent"
    return BenchCase(
        "detect_chessboard",
        f"{size[0]}x{size[1]}, {there}, against {against}",
        lambda: detect_chessboard(image, BOARD),
        opencv,
        agreement,
        lambda: ((image, BOARD), {}),
    )
