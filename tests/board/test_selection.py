"""Which part of a grid is the board: covered lines at any side, faded corners, letters beside it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from board_renders import render

import stereocal as sc


def cut(image, truth, columns, side, share):
    """The paper is covered beyond `share` of the outer squares at one side of the board."""
    grid = truth.reshape(-1, columns, 2)
    grid = [grid, grid[:, ::-1], grid.transpose(1, 0, 2), grid.transpose(1, 0, 2)[:, ::-1]][side]
    outward = grid[:, 0] - grid[:, 1]
    edge = np.concatenate([grid[:, 0] + share * outward, (grid[:, 0] + 3 * outward)[::-1]])
    widened = edge + 1.5 * (edge - edge.mean(axis=0)) * (np.abs(outward.mean(axis=0))[::-1] > 1)
    covered = image.copy()
    cv2.fillConvexPoly(covered, cv2.convexHull(widened.astype(np.int32)), 200)
    return covered


@pytest.mark.parametrize("turn", [0, 90, 180, 270])
@pytest.mark.parametrize("side", [0, 1, 2, 3])
def test_a_square_board_with_a_covered_line_at_any_side_is_the_one_without_it(turn, side):
    image, truth = render(sc.Chessboard((7, 7)), turn=turn, fill=0.6)
    covered = cut(image, truth, 7, side, 0.3)
    found = sc.detect_chessboard_detailed(covered, (7, 6))
    assert found.found, found.message
    lost = [
        truth.reshape(7, 7, 2)[:, 0],
        truth.reshape(7, 7, 2)[:, -1],
        truth.reshape(7, 7, 2)[0],
        truth.reshape(7, 7, 2)[-1],
    ]
    distance = np.linalg.norm(found.corners[:, None] - lost[side], axis=-1)
    assert distance.min() > 10  # none of the covered line's corners
    assert np.linalg.norm(found.corners[:, None] - truth, axis=-1).min(axis=1).max() < 0.5
    assert sc.detect_chessboard_detailed(image, (7, 6)).other_size == (7, 7)


@pytest.mark.parametrize("at", [0, 20, 41])
def test_a_corner_that_fades_is_found_and_a_covered_one_is_not(at):
    image, truth = render(sc.Chessboard((7, 6)), turn=20, noise=1)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    spot = np.exp(-((x - truth[at, 0]) ** 2 + (y - truth[at, 1]) ** 2) / (2 * 14**2))
    faded = np.clip(image * (1 - 0.8 * spot) + 180 * spot, 0, 255).astype(np.uint8)
    corners = sc.detect_chessboard(faded, (7, 6))
    assert corners is not None
    assert np.abs(corners - truth).max() < 2.0  # a tenth of a step: the spot's own slope moves the corner
    cv2.circle(faded, tuple(int(v) for v in truth[at]), 20, 180, -1)
    assert sc.detect_chessboard(faded, (7, 6)) is None


def test_a_board_of_one_line_less_is_not_completed():
    for size, asked in (((7, 5), (7, 6)), ((6, 6), (7, 6)), ((8, 6), (9, 6))):
        found = sc.detect_chessboard_detailed(render(sc.Chessboard(size), turn=15)[0], asked)
        assert not found.found
        assert found.other_size == size
