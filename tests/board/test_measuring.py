"""What stands in where the blurred saddle does not hold: shadows, strong blur, parted squares."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from board_renders import render

import stereocal as sc
from stereocal.board.measuring import edge_width, is_measured, measure_corners, measure_in_level


@pytest.mark.parametrize("angle", [0.3, 1.2, 2.4])
def test_a_shadow_with_a_hard_edge_across_the_board(angle):
    image, truth = render(sc.Chessboard((7, 6)), noise=0.5)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    middle = truth.mean(axis=0) + 3
    side = np.cos(angle) * (x - middle[0]) + np.sin(angle) * (y - middle[1])
    shadow = np.rint(image * (0.3 + 0.7 / (1 + np.exp(-side / 0.8)))).astype(np.uint8)
    corners = sc.detect_chessboard(shadow, (7, 6))
    assert corners is not None
    assert np.abs(corners - truth).max() < 2.0  # a tenth of a step
    assert np.median(np.abs(corners - truth)) < 0.1


def test_blur_that_mixes_cut_border_squares_with_what_lies_beyond():
    image, truth = render(sc.Chessboard((7, 6)), fill=0.9, noise=0.5)
    step = np.linalg.norm(truth[1] - truth[0])
    blurred = cv2.GaussianBlur(image, (0, 0), 0.2 * step)
    found = sc.detect_chessboard_detailed(blurred, (7, 6))
    assert found.found
    error = np.linalg.norm(found.corners - truth, axis=1)
    assert error.max() < 0.1 * step
    # what is worse than half a pixel says so
    spread = np.sqrt(np.trace(found.covariances, axis1=1, axis2=2))
    assert np.all(spread[error > 0.5] > 0.1)


def test_a_lost_corner_keeps_the_grids_place_and_many_lost_ones_refuse():
    image, truth = render(sc.Chessboard((7, 6)), noise=1)
    x, y = truth[10].astype(int)
    image[y - 12 : y + 13, x - 12 : x + 13] = 120
    grid = truth.reshape(6, 7, 2)
    fit = measure_corners(image, grid)
    assert is_measured(fit)
    assert np.abs(fit.corners - truth).max() < 2.0
    assert not is_measured(
        measure_corners(np.random.default_rng(0).integers(0, 256, image.shape).astype(np.uint8), grid)
    )


def test_a_fit_in_a_level_is_in_the_images_pixels():
    image, truth = render(sc.Chessboard((7, 6)), noise=1)
    half = cv2.resize(image, None, None, 0.5, 0.5, cv2.INTER_AREA)
    grid = (truth.reshape(6, 7, 2) + 0.5) / 2 - 0.5
    fit, fine = measure_in_level(half, grid, 2.0), measure_corners(image, truth.reshape(6, 7, 2))
    assert np.abs(fit.corners - truth).max() < 0.2
    assert edge_width(fit) == pytest.approx(edge_width(fine), rel=0.4)
