"""Is the board's shape real? Two cameras, views that were not used, and the drawing.

Usage: python benchmarks/study_board_shape.py [FOLDER] [--pictures FOLDER]   (FOLDER: STEREOCAL_DATA by default)

For each set of photographs, with this library's corners: RMS of each camera alone and of both, for a flat, a bowed and
a released board; the RMS of held-out views for the same, and which of them "auto" chooses, in how many seconds; and
how far the shapes that the left and the right camera find apart, by themselves, lie from each other. Two released
shapes differ by where their gauge holds them, so the left one is first moved, turned and scaled onto the right one (the
similarity of least squares, Umeyama 1991); what is left is given a coordinate, RMS and largest, in squares.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import numpy as np

import stereocal as sc
from stereocal.pair.corner_order import repair_corner_order
from stereocal.report.figures_board import draw_board_shape, heights_over_plane
from stereocal.report.style import to_png
from stereocal.store.images import read_image

SETS = {"uvc_paper": ((7, 6), 1.0), "opencv_sample": ((9, 6), 30.0), "bumblebee2_chess": ((6, 4), 30.0)}
SIZE = (640, 480)


def aligned(points: np.ndarray, onto: np.ndarray) -> np.ndarray:
    """Return points (P, 3) after the similarity that brings them nearest to others."""
    a, b = points - points.mean(axis=0), onto - onto.mean(axis=0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    sign = np.array([1, 1, np.sign(np.linalg.det(U @ Vt))])
    return (S @ sign) / np.sum(a * a) * a @ ((U * sign) @ Vt).T + onto.mean(axis=0)


def corners_of(folder: Path, board: sc.Chessboard) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Detect the board in all pairs and return the corners of those in which both cameras see it."""
    found = [[sc.detect_chessboard(read_image(path), board) for path in sorted((folder / side).glob("*.jpg"))]
             for side in ("left", "right")]  # fmt: skip
    both = [(a, b) for a, b in zip(*found, strict=True) if a is not None and b is not None]
    left, right, _ = repair_corner_order(board, [a for a, _ in both], [b for _, b in both], SIZE)
    return left, right


def examine(name: str, folder: Path, pictures: Path | None) -> None:
    """Print what one set of photographs says."""
    inner_corners, square = SETS[name]
    board = sc.Chessboard(inner_corners, square)
    X, (left, right) = board.object_points, corners_of(folder / name, board)
    print(f"\n{name}: {len(left)} pairs")
    fits = {
        "left": lambda kind: sc.calibrate_camera(X, left, SIZE, board_warp=kind),
        "right": lambda kind: sc.calibrate_camera(X, right, SIZE, board_warp=kind),
        "both": lambda kind: sc.calibrate_stereo(X, left, right, SIZE, board_warp=kind),
    }
    for who, fit in fits.items():
        rms = {kind: fit(kind).rms for kind in ("flat", "bow", "released")}
        start = time.perf_counter()
        chosen = fit("auto").board
        seconds = time.perf_counter() - start
        table = "  ".join(f"{kind} {rms[kind]:.4f} / {chosen.held_out_rms[kind]:.4f}" for kind in rms)
        print(f"  {who:6s} RMS / held out, px:  {table}   auto: {chosen.kind} in {seconds:.3f} s")
    shapes = [fits[side]("released").board for side in ("left", "right")]
    apart = (aligned(shapes[0].points, shapes[1].points) - shapes[1].points) / square
    claimed = np.mean([shape.std for shape in shapes], axis=(0, 1)) / square
    rms, largest = np.sqrt(np.mean(apart**2, axis=0)), np.abs(apart).max(axis=0)
    figures = "  ".join(f"{what} {values.round(5).tolist()}" for what, values in (
        ("RMS", rms), ("largest", largest), ("standard deviations given", claimed)))  # fmt: skip
    print(f"  left against right, squares, x y z: {figures}")
    if pictures is not None:
        shape = fits["both"]("released").board
        heights = heights_over_plane(shape.points).reshape(board.rows, board.columns) / square
        sigma = float(np.median(shape.std[:, 2])) / square
        pictures.mkdir(parents=True, exist_ok=True)
        (pictures / f"{name}.png").write_bytes(to_png(draw_board_shape(heights, unit="squares", sigma=sigma)))


def main() -> None:
    """Examine all sets."""
    parser = argparse.ArgumentParser()
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser.add_argument("folder", nargs="?", type=Path, default=Path(os.environ.get("STEREOCAL_DATA", default)))
    parser.add_argument("--pictures", type=Path, help="where to draw the shapes")
    arguments = parser.parse_args()
    for name in SETS:
        examine(name, arguments.folder, arguments.pictures)


if __name__ == "__main__":
    main()
