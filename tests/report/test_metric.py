from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from report_cases import SIZE, Case, make_case

from stereocal.pair.stereo_calibration import calibrate_stereo
from stereocal.report import metric
from stereocal.report.board_bend import free_the_board
from stereocal.report.figures_board import heights_over_plane
from stereocal.report.metric import board_scales, examine_metric, plane_distances, square_sides, triangulate_corners
from stereocal.report.rectified import rectify_corners
from stereocal.synthetic.board_view import bent_points


def test_triangulated_boards_are_boards() -> None:
    case = make_case(noise=0.0, views=6)
    points = triangulate_corners(case.evidence)
    np.testing.assert_allclose(square_sides(points, 8, 6), 25.0, rtol=1e-6)
    np.testing.assert_allclose(plane_distances(points), 0, atol=1e-5)
    np.testing.assert_allclose(board_scales(points, np.asarray(case.board.object_points)), 1, rtol=1e-7)


def test_noise_lengthens_sides_but_not_the_scale(healthy: Case) -> None:
    X = np.asarray(healthy.board.object_points)
    noise = np.random.default_rng(0).normal(0, 3, (400, len(X), 3)) * [0.2, 0.2, 1]
    noisy = X + noise
    # (3² + 3²) / (2 · 25²) = 1.4 % by the depths alone
    assert square_sides(noisy, 8, 6).mean() / 25 > 1.013
    assert board_scales(noisy, X).mean() == pytest.approx(1, abs=1e-3)
    assert board_scales(1.04 * noisy, X).mean() == pytest.approx(1.04, abs=1e-3)


def test_rows_agree_without_noise() -> None:
    case = make_case(noise=0.0, views=6)
    rectified = rectify_corners(case.calibration.rig, case.evidence.left, case.evidence.right)
    np.testing.assert_allclose(rectified.across, 0, atol=1e-5)


def test_delta_y_is_that_of_the_rectified_images(healthy: Case) -> None:
    from stereocal.pair.rectification import rectify

    rig, r = healthy.calibration.rig, rectify(healthy.calibration.rig)
    left = rig.left.undistort_points(healthy.left[0], R=r.R1, P=r.P1)
    right = rig.right.undistort_points(healthy.right[0], R=r.R2, P=r.P2)
    ours = rectify_corners(rig, healthy.left[0], healthy.right[0]).across
    np.testing.assert_allclose(ours, left[:, 1] - right[:, 1], atol=1e-6)


@pytest.mark.parametrize("kind", ["flat", "released"])
def test_the_board_s_shape_is_drawn_whether_the_fit_freed_it_or_not(
    kind: str, bent: Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A fit that released the points leaves the report's step nothing to find: their own shape is to be seen."""
    free = calibrate_stereo(bent.board.object_points, bent.left, bent.right, SIZE, board_warp=kind)
    evidence = replace(bent, calibration=free).evidence
    block = examine_metric(evidence, free_the_board(evidence, np.asarray(free.std) > 0))
    drawn: list[np.ndarray] = []
    monkeypatch.setattr(metric, "draw_board_shape", lambda heights, **_: drawn.append(heights))
    next(picture for picture in block.pictures if picture.name == "board_shape").draw()
    true = heights_over_plane(bent_points(bent.board, 0.15 * 25.0))
    np.testing.assert_allclose(drawn[0].ravel(), true, atol=0.15 * np.abs(true).max())
