from __future__ import annotations

import numpy as np
import pytest
from report_cases import SIZE, make_case

from stereocal.report.coverage import examine_data, geometry_score, parameter_ranges, seen_cells, view_parameters


def grid(columns: int = 7, rows: int = 6) -> np.ndarray:
    return np.mgrid[0:columns, 0:rows].T.reshape(-1, 2).astype(float)


def test_a_square_on_view_has_the_size_and_no_skew() -> None:
    corners = 20 * grid() + [100, 50]
    x, y, size, skew = view_parameters(corners[None], 7, SIZE)[0]
    area = 120 * 100
    side = np.sqrt(area)
    assert size == pytest.approx(np.sqrt(area / (640 * 480)))
    assert skew == pytest.approx(0, abs=1e-9)
    assert x == pytest.approx((160 - side / 2) / (640 - side))
    assert y == pytest.approx((100 - side / 2) / (480 - side))


def test_skew_is_the_departure_from_a_right_angle() -> None:
    shear = np.array([[1, 0.0], [np.tan(np.radians(25)), 1]])
    corners = 20 * grid() @ shear + [100, 50]
    assert view_parameters(corners[None], 7, SIZE)[0, 3] == pytest.approx(2 * np.radians(25))


def test_size_and_skew_range_from_zero() -> None:
    parameters = np.array([[0.2, 0.3, 0.5, 0.4], [0.9, 0.6, 0.6, 0.45]])
    np.testing.assert_allclose(parameter_ranges(parameters), [0.7, 0.3, 0.6, 0.45])


def test_cells_of_border_and_inside() -> None:
    border, inside = seen_cells(np.array([[0.0, 0.0], [639.0, 479.0], [320.0, 240.0]]), SIZE)
    assert border.shape == (60,)
    assert inside.sum() == 1
    assert inside[5, 5]
    # clockwise from the top left: the first cell of the top and the last of the left; the corner opposite likewise
    assert set(np.flatnonzero(border)) == {0, 59, 29, 30}


def test_everywhere_is_everywhere() -> None:
    points = np.stack(np.meshgrid(np.arange(0, 640, 3.0), np.arange(0, 480, 3.0)), axis=-1).reshape(-1, 2)
    border, inside = seen_cells(points, SIZE)
    assert border.all()
    assert inside.all()


def score_of(tilt: float) -> float:
    case = make_case(tilt=tilt, noise=0.05)
    camera = case.calibration.rig.left
    corners = np.stack([camera.undistort_points(c) for c in case.left])
    return geometry_score(corners, case.board.object_points, SIZE)


def test_the_geometry_score_grows_with_tilt() -> None:
    scores = [score_of(tilt) for tilt in (4, 12, 40)]
    assert scores == sorted(scores)
    assert scores[0] < 0.25
    assert scores[2] > 0.9


def test_parallel_views_score_nothing() -> None:
    board = np.column_stack([grid(8, 6), np.zeros(48)])
    noise = np.random.default_rng(0).normal(0, 0.1, (4, 48, 2))
    views = np.stack(
        [k * grid(8, 6) + [dx, dy] for k, dx, dy in ((30, 50, 60), (40, 200, 90), (25, 350, 250), (33, 9, 9))]
    )
    assert geometry_score(views, board, SIZE) == 0
    assert geometry_score(views + noise, board, SIZE) == 0


def test_coverage_marks_what_was_seen(healthy) -> None:
    report = examine_data(healthy.evidence, [{"left": "a", "right": "b", "used": True, "reason": None}] * 16, None)
    assert 0 < report.facts["inside_seen"]["left"] <= 1
    assert report.facts["pairs_used"] == 16
