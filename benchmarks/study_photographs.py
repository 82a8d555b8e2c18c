"""The README's table: real photographs, each library's corners, one and the same calibration engine of its own.

Usage: python benchmarks/study_photographs.py [FOLDER]   (default: STEREOCAL_DATA, or ../shared/data beside the project)

For each set it prints, for stereocal and for OpenCV as most people use it (findChessboardCorners, cornerSubPix with a
half window of 11, calibrateCamera, stereoCalibrate with CALIB_USE_INTRINSIC_GUESS): boards found, RMS of each camera
alone, RMS of both together, and for stereocal the RMS with the board's shape as unknown. RMS is √(Σ‖d‖²/N points).
Corner lists of OpenCV that come from opposite ends of the board are turned first, for its benefit.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import cv2
import numpy as np

import stereocal as sc
from stereocal.pair.corner_order import repair_corner_order
from stereocal.store.images import read_image
from stereocal.verify import opencv_calls

SETS = {"uvc_paper": ((7, 6), 1.0), "opencv_sample": ((9, 6), 30.0), "bumblebee2_chess": ((6, 4), 30.0)}


def main() -> None:
    """Print the table as Markdown."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else os.environ.get("STEREOCAL_DATA", default))
    print("| photographs | | boards found | left alone | right alone | both | both, board's shape free |")
    print("|---|---|---|---|---|---|---|")
    for name, (inner_corners, square) in SETS.items():
        board = sc.Chessboard(inner_corners, square)
        images = [[read_image(p) for p in sorted((folder / name / side).glob("*.jpg"))] for side in ("left", "right")]
        ours = [[sc.detect_chessboard(image, board) for image in side] for side in images]
        theirs = [[opencv_calls.find_corners(image, inner_corners, 11) for image in side] for side in images]
        sb = sum(opencv_calls.find_corners(i, inner_corners, None) is not None for side in images for i in side)
        print(_row(name, "stereocal", ours, _ours(board, *_pairs(board, ours)), len(images[0])))
        print(_row("", f"OpenCV {cv2.__version__}", theirs, _opencv(board, *_pairs(board, theirs)), len(images[0])))
        print(f"| | findChessboardCornersSB | {sb} of {2 * len(images[0])} | | | | |")


def _row(name: str, who: str, found: list[list], rms: list[float | None], pairs: int) -> str:
    count = sum(corners is not None for side in found for corners in side)
    cells = ["" if value is None else f"{value:.3f} px" for value in rms]
    return f"| {name} | {who} | {count} of {2 * pairs} | " + " | ".join(cells) + " |"


def _pairs(board: sc.Chessboard, found: list[list]) -> tuple[list, list]:
    both = [(a, b) for a, b in zip(*found, strict=True) if a is not None and b is not None]
    left, right, _ = repair_corner_order(board, [a for a, _ in both], [b for _, b in both], (640, 480))
    return left, right


def _ours(board: sc.Chessboard, left: list, right: list) -> list[float | None]:
    X, size = board.object_points, (640, 480)
    alone = [sc.calibrate_camera(X, views, size).rms for views in (left, right)]
    free = sc.calibrate_stereo(X, left, right, size, board_warp="released").rms
    return [*alone, sc.calibrate_stereo(X, left, right, size).rms, free]


def _opencv(board: sc.Chessboard, left: list, right: list) -> list[float | None]:
    X, size = board.object_points, (640, 480)
    alone = [opencv_calls.calibrate_camera(X, views, size, "brown") for views in (left, right)]
    cameras = tuple((K, dist) for _, K, dist in alone)
    joint = opencv_calls.calibrate_stereo(X, (left, right), size, cameras, "brown")[0]
    return [alone[0][0], alone[1][0], float(np.asarray(joint)), None]


if __name__ == "__main__":
    main()
