"""Views whose corners are in another order are named; views that belong are not, whatever the lens and the noise."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from camera_rigs import SIZE, board, camera, mono_views

import stereocal as sc
from stereocal.base.rotations import rotation_matrix
from stereocal.camera.odd_views import OddViewsError

X = board()
GRID = np.arange(54).reshape(6, 9)
SHUFFLED = np.random.default_rng(0).permutation(54)
SWAPPED = np.arange(54)
SWAPPED[[3, 30]] = 30, 3


def views(count: int = 12, seed: int = 4, noise: float = 0.2) -> list[np.ndarray]:
    return mono_views(camera(), X, count, seed=seed, noise=noise)[0]


def named(corners: list[np.ndarray], X: np.ndarray = X) -> list[int]:
    """The views that no pose fits, be it a warning or the reason of a refusal."""
    try:
        return [odd.view for odd in sc.calibrate_camera(X, corners, SIZE).odd if not odd.from_behind]
    except OddViewsError as error:
        sentence = re.match(r"view ([\d, ]+) fits? no pose of the board", str(error))
        return [] if sentence is None else [int(number) for number in sentence[1].split(", ")]


@pytest.mark.parametrize("view", range(0, 12, 2))
def test_a_shuffled_view_is_named(view: int) -> None:
    corners = views()
    corners[view] = corners[view][SHUFFLED]
    assert named(corners) == [view]


@pytest.mark.parametrize("view", [0, 3])
def test_a_view_that_spoils_the_fit_is_named_in_its_refusal(view: int) -> None:
    corners = views()
    corners[view] = corners[view][GRID.T.ravel()]
    assert named(corners) == [view]


@pytest.mark.parametrize(
    ("order", "view"), [(GRID.T.ravel(), 7), (SWAPPED, 0), (SWAPPED, 7)], ids=["columns first", "swapped", "swapped 7"]
)
def test_a_view_in_another_order_is_named(order: np.ndarray, view: int) -> None:
    corners = views()
    clean = sc.calibrate_camera(X, corners[:view] + corners[view + 1 :], SIZE)
    corners[view] = corners[view][order]
    found = sc.calibrate_camera(X, corners, SIZE)
    assert [(odd.view, odd.from_behind) for odd in found.odd] == [(view, False)]
    odd = found.odd[0]
    assert odd.typical_rms == pytest.approx(np.median(clean.view_rms), rel=1e-6)  # the camera of the others judges it
    # by one that the view itself has spoilt the residuals are smaller than by that of the others
    assert odd.rms >= found.view_rms[view]
    assert odd.squares > 0.15
    assert found.warnings[0].startswith(f"view {view} fits no pose of the board (RMS ")
    assert f"warning: view {view} fits no pose" in found.summary()


@pytest.mark.parametrize(
    "mirrored",
    [lambda y: y[GRID[::-1].ravel()], lambda y: y[GRID[:, ::-1].ravel()], lambda y: y * [-1, 1] + [639, 0]],
    ids=["rows reversed", "columns reversed", "image mirrored"],
)
def test_a_view_in_mirrored_order_is_named_though_it_fits(mirrored) -> None:
    corners = views()
    plain = sc.calibrate_camera(X, corners, SIZE)
    corners[5] = mirrored(corners[5])
    found = sc.calibrate_camera(X, corners, SIZE)
    assert found.rms < 1.5 * plain.rms
    assert [(odd.view, odd.from_behind) for odd in found.odd] == [(5, True)]
    assert found.warnings[0].startswith("view 5 shows the board from the other side than the rest")


def test_several_odd_views_are_told_from_each_other() -> None:
    corners = views(15)
    corners[2], corners[9] = corners[2][SWAPPED], corners[9][GRID.T.ravel()]
    corners[12] = corners[12][GRID[::-1].ravel()]
    found = sc.calibrate_camera(X, corners, SIZE)
    assert {odd.view for odd in found.odd if not odd.from_behind} == {2, 9}
    assert {odd.view for odd in found.odd if odd.from_behind} == {12}
    assert found.warnings[0].startswith("view 2, 9 fit no pose of the board")
    assert found.warnings[1].startswith("view 12 shows")


def test_where_a_view_spoils_the_camera_altogether_it_is_blamed_and_not_the_tilt_of_the_others() -> None:
    refused = 0
    for seed in range(12):
        corners = views(5, seed=seed)
        sc.calibrate_camera(X, corners, SIZE)  # the views as they were are good enough
        corners[1] = corners[1][SHUFFLED]
        assert named(corners) == [1]
        try:
            sc.calibrate_camera(X, corners, SIZE)
        except sc.DegenerateGeometryError:
            refused += 1
    assert refused > 0


def test_a_given_camera_does_not_hide_an_odd_view() -> None:
    corners = views()
    corners[3] = corners[3][SHUFFLED]
    assert [odd.view for odd in sc.calibrate_camera(X, corners, SIZE, initial=camera()).odd] == [3]


def test_what_outlier_rejection_leaves_out_is_reported_there() -> None:
    corners = views()
    corners[3] = corners[3][SHUFFLED]
    found = sc.calibrate_camera(X, corners, SIZE, reject_outliers=True)
    assert found.odd == ()
    assert sum(corner.view == 3 for corner in found.rejected) > 40


@pytest.mark.parametrize("model", ["pinhole", "division", "brown", "fisheye"])
@pytest.mark.parametrize("noise", [0.0, 0.2, 2.0])
def test_views_that_belong_are_not_accused(model: str, noise: float) -> None:
    for seed in range(3):
        assert sc.calibrate_camera(X, views(seed=seed, noise=noise), SIZE, model=model).odd == ()


def test_a_false_corner_is_no_order() -> None:
    corners = views(noise=0.5)
    corners[4][17] += (12, -9)
    assert sc.calibrate_camera(X, corners, SIZE).odd == ()


def test_a_wide_lens_and_a_poor_model_are_no_order() -> None:
    """Boards near the edge of a wide fisheye, drawn by a pinhole: bad fits, in a right order."""
    rng = np.random.default_rng(3)
    cam = sc.Camera([[250, 0, 320], [0, 250, 240], [0, 0, 1]], [0.02, -0.01, 0.002, 0], SIZE, "fisheye")
    corners: list[np.ndarray] = []
    while len(corners) < 12:
        r, centre = rng.uniform(-0.7, 0.7, 3), np.array([*rng.uniform([-8, -6], [8, 6]), rng.uniform(3, 8)])
        t = centre - rotation_matrix(r) @ X.mean(axis=0)
        y = cam.project(X, r, t)
        if ((X @ rotation_matrix(r).T + t)[:, 2] > 0.5).all() and ((y >= 0) & (y < SIZE)).all():
            corners.append(y)
    found = sc.calibrate_camera(X, corners, SIZE, model="pinhole")
    assert found.rms > 5
    assert found.odd == ()


@pytest.mark.parametrize("name", ["uvc_paper", "opencv_sample", "bumblebee2_chess"])
@pytest.mark.parametrize("side", ["left", "right"])
def test_photographs_that_belong_are_not_accused(data: Path, name: str, side: str) -> None:
    stored = np.load(data / name / f"opencv_corners_{side}.npz")
    columns, rows = (int(n) for n in stored["board"])
    corners = [y for y in stored["classic_subpix5"].astype(np.float64) if np.isfinite(y).all()]
    for model in ("brown", "pinhole"):
        assert sc.calibrate_camera(board(columns, rows), corners, SIZE, model=model).odd == ()
    corners[2] = corners[2][np.random.default_rng(1).permutation(columns * rows)]
    assert named(corners, board(columns, rows)) == [2]
