"""One view whose corners are in another order, among good ones: is it named, and is no good view accused?

Random cameras of ``study_random_rigs`` (4 to 40 views, noise up to 1 px), random pairs, and the photographs. In each
set one view's corners are put in another order, and the question is what ``calibrate_camera`` and ``calibrate_stereo``
say: *named* counts the view in a warning or in the reason of a refusal, *silent* says nothing of it, *accused* counts
sets in which a view that belongs is named. Synthetic boards that the random camera really sees from behind are no false
alarm, and such sets are left out. Two interchanged corners of a small board in much noise are about as far off as the
noise: that they are silent is no surprise.

    python benchmarks/study_odd_views.py [--rigs 100]   (photographs: STEREOCAL_DATA)
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

import stereocal as sc
from stereocal.base.rotations import rotation_matrix
from stereocal.camera.pose import estimate_poses

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from camera_rigs import SIZE, board, rig, stereo_views
from study_random_rigs import random_rig

Order = Callable[[np.ndarray, tuple[int, int], np.random.Generator], np.ndarray]


def _grid(shape: tuple[int, int]) -> np.ndarray:
    return np.arange(shape[0] * shape[1]).reshape(shape[1], shape[0])


def _two_swapped(y: np.ndarray, shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    y, pair = y.copy(), rng.choice(len(y), 2, replace=False)
    y[pair] = y[pair[::-1]]
    return y


ORDERS: dict[str, Order] = {
    "as they are": lambda y, shape, rng: y,
    "rows reversed": lambda y, shape, rng: y[_grid(shape)[::-1].ravel()],
    "columns reversed": lambda y, shape, rng: y[_grid(shape)[:, ::-1].ravel()],
    "image mirrored": lambda y, shape, rng: y * [-1, 1] + [SIZE[0] - 1, 0],
    "columns first": lambda y, shape, rng: y[_grid(shape).T.ravel()],
    "shuffled": lambda y, shape, rng: y[rng.permutation(len(y))],
    "two swapped": _two_swapped,
}


def views_named(calibrate: Callable[[], object]) -> set[int]:
    """Numbers of all views that warnings, or the reason of a refusal, name as odd."""
    try:
        said = list(getattr(calibrate(), "warnings", ()))
    except sc.StereocalError as error:
        said = [str(error)]
    found: set[int] = set()
    for text in said:
        for match in re.finditer(r"view ([\d, ]+?) (?:fits? no pose|shows? the board|do(?:es)? not fit the rig)", text):
            found |= {int(number) for number in match[1].split(", ")}
    return found


def count(rows: dict[str, Counter], order: str, named: set[int], view: int) -> None:
    """Add one set to the table."""
    row = rows.setdefault(order, Counter())
    row["sets"] += 1
    if order == "as they are":
        row["accused"] += bool(named)
        return
    row["named" if view in named else "silent"] += 1
    row["accused"] += bool(named - {view})


def show(title: str, rows: dict[str, Counter]) -> None:
    """Print a table."""
    print(f"\n{title}\n{'order':18s} {'sets':>5s} {'named':>6s} {'silent':>7s} {'accused':>8s}")
    for order, row in rows.items():
        print(f"{order:18s} {row['sets']:5d} {row['named']:6d} {row['silent']:7d} {row['accused']:8d}", flush=True)


def seen_from_behind(camera: sc.Camera, X: np.ndarray, clean: list[np.ndarray]) -> bool:
    """Whether a synthetic set has a view of the board's back."""
    rvecs, tvecs = estimate_poses(X, clean, camera)
    return any(rotation_matrix(r)[:, 2] @ t < 0 for r, t in zip(rvecs, tvecs, strict=True))


def single_cameras(rigs: int) -> None:
    """One camera."""
    rows: dict[str, Counter] = {}
    for index in range(rigs):
        rng = np.random.default_rng([0, index])
        camera, X, clean, noise = random_rig(rng)
        if seen_from_behind(camera, X, clean):
            continue
        corners = [y + rng.normal(0, noise, y.shape) for y in clean]
        shape, view = (int(X[:, 0].max()) + 1, int(X[:, 1].max()) + 1), int(rng.integers(len(corners)))
        for order, apply in ORDERS.items():
            changed = [apply(y, shape, rng) if i == view else y for i, y in enumerate(corners)]
            count(rows, order, views_named(lambda: sc.calibrate_camera(X, changed, camera.image_size)), view)  # noqa: B023
    show(f"calibrate_camera, {rigs} random rigs", rows)


def pairs(rigs: int) -> None:
    """Two cameras, the order changed in one of them."""
    rows: dict[str, Counter] = {}
    X = board()
    for index in range(rigs):
        rng = np.random.default_rng([1, index])
        number, noise = int(rng.integers(5, 20)), float(rng.uniform(0, 1))
        sides = stereo_views(rig(), X, number, seed=index, noise=noise)[:2]
        view, side = int(rng.integers(number)), int(rng.integers(2))
        for order, apply in ORDERS.items():
            changed = [[apply(y, (9, 6), rng) if (i, c) == (view, side) else y for i, y in enumerate(corners)]
                       for c, corners in enumerate(sides)]  # fmt: skip
            count(rows, order, views_named(lambda: sc.calibrate_stereo(X, *changed, SIZE)), view)  # noqa: B023
    show(f"calibrate_stereo, {rigs} random sets of pairs, one side's view", rows)


def photographs(folder: Path) -> None:
    """The three sets of photographs, each view in turn, with OpenCV's corners as they are stored there."""
    rows: dict[str, Counter] = {}
    for name in ("uvc_paper", "opencv_sample", "bumblebee2_chess"):
        for side in ("left", "right"):
            stored = np.load(folder / name / f"opencv_corners_{side}.npz")
            shape = (int(stored["board"][0]), int(stored["board"][1]))
            corners = [y for y in stored["classic_subpix5"].astype(np.float64) if np.isfinite(y).all()]
            for order, apply in ORDERS.items():
                for view in range(len(corners)):
                    rng = np.random.default_rng(view)
                    changed = [apply(y, shape, rng) if i == view else y for i, y in enumerate(corners)]
                    named = views_named(lambda: sc.calibrate_camera(board(*shape), changed, SIZE))  # noqa: B023
                    count(rows, order, named, view)
    show("calibrate_camera, photographs, each view in turn", rows)


def main() -> None:
    """Run all three."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rigs", type=int, default=100)
    rigs = parser.parse_args().rigs
    single_cameras(rigs)
    pairs(rigs)
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    folder = Path(os.environ.get("STEREOCAL_DATA", default))
    if folder.is_dir():
        photographs(folder)
    else:
        print(f"\nno photographs at {folder}: set STEREOCAL_DATA")


if __name__ == "__main__":
    main()
