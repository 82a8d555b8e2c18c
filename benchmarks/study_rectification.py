"""Held-out error of rectification: calibrate on all pairs but one, and look at the rows of the one left out.

For every choice of the pair left out: calibrate both cameras jointly on the others, rectify, take the corners of the
pair left out to the rectified pictures, and average |y_left − y_right| over its corners. The figure is the mean over
all choices: what a user gets on pictures that the calibration has not seen. Beside it, what OpenCV's calibration gives
on the same corners (calibrateCamera and joint stereoCalibrate, 300 iterations).

Corners: our own detector's on the photographs, or with --opencv the stored ones (findChessboardCorners and
cornerSubPix, half window 5).

Run: python benchmarks/study_rectification.py DATA [set …] [--opencv] [--no-cv]
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np

from stereocal.board.chessboard import Chessboard
from stereocal.board.detection import detect_chessboard
from stereocal.camera.model import Camera
from stereocal.pair.corner_order import repair_corner_order
from stereocal.pair.rectification import rectify
from stereocal.pair.rig import StereoRig
from stereocal.pair.stereo_calibration import calibrate_stereo

SETS = {
    "uvc_paper": ((7, 6), 1.0, 0.25),
    "opencv_sample": ((9, 6), 30.0, 0.16),
    "bumblebee2_chess": ((6, 4), 30.0, 0.05),
}
SIZE = (640, 480)


def corners(data: Path, name: str, board: Chessboard, stored: bool) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return the corners of the pairs in which both cameras see the board."""
    folder = data / name
    if stored:
        loaded = [np.load(folder / f"opencv_corners_{side}.npz")["classic_subpix5"] for side in ("left", "right")]
        views = [list(one.reshape(len(one), -1, 2).astype(float)) for one in loaded]
        views = [[v if np.isfinite(v).all() else None for v in side] for side in views]
    else:
        views = []
        for side in ("left", "right"):
            images = sorted(path for path in (folder / side).iterdir() if path.suffix in (".jpg", ".png"))
            views.append([detect_chessboard(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), board) for path in images])
    both = [(a, b) for a, b in zip(*views, strict=True) if a is not None and b is not None]
    left, right, _ = repair_corner_order(board, [a for a, _ in both], [b for _, b in both], SIZE)
    return left, right


def row_error(rig: StereoRig, left: np.ndarray, right: np.ndarray) -> float:
    """Mean |y_left − y_right| of matching corners after rectification."""
    result = rectify(rig)
    return float(np.abs(result.rectify_points(left, "left")[:, 1] - result.rectify_points(right, "right")[:, 1]).mean())


def calibrate_opencv(X: np.ndarray, left: list[np.ndarray], right: list[np.ndarray]) -> StereoRig:
    """The same by OpenCV, iterated to the end."""
    points = [X.astype(np.float32)] * len(left)
    a, b = ([v.astype(np.float32).reshape(-1, 1, 2) for v in side] for side in (left, right))
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 300, 1e-12)
    K1, d1 = cv2.calibrateCamera(points, a, SIZE, None, None, criteria=stop)[1:3]
    K2, d2 = cv2.calibrateCamera(points, b, SIZE, None, None, criteria=stop)[1:3]
    found = cv2.stereoCalibrate(points, a, b, K1, d1, K2, d2, SIZE, flags=cv2.CALIB_USE_INTRINSIC_GUESS, criteria=stop)
    K1, d1, K2, d2, R, T = found[1:7]
    return StereoRig(Camera(K1, d1.ravel()[:5], SIZE), Camera(K2, d2.ravel()[:5], SIZE), R, T.ravel())


def main() -> None:
    names = [a for a in sys.argv[2:] if not a.startswith("--")] or list(SETS)
    data, stored, compare = Path(sys.argv[1]), "--opencv" in sys.argv, "--no-cv" not in sys.argv
    print(f"{'set':18} {'pairs':>5} {'ours px':>9} {'target':>7} {'OpenCV ' + cv2.__version__:>13}")
    for name in names:
        shape, square, target = SETS[name]
        board = Chessboard(shape, square)
        left, right = corners(data, name, board, stored)
        ours, theirs = [], []
        for out in range(len(left)):
            rest = [n for n in range(len(left)) if n != out]
            kept = [left[n] for n in rest], [right[n] for n in rest]
            fit = calibrate_stereo([board.object_points] * len(rest), *kept, SIZE)
            ours.append(row_error(fit.rig, left[out], right[out]))
            if compare:
                theirs.append(row_error(calibrate_opencv(board.object_points, *kept), left[out], right[out]))
        other = f"{np.mean(theirs):13.4f}" if compare else ""
        print(f"{name:18} {len(left):5d} {np.mean(ours):9.4f} {target:7.2f} {other}", flush=True)


if __name__ == "__main__":
    main()
