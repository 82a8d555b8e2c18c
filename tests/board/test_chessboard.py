"""The board: its points and its symmetry."""

from __future__ import annotations

import numpy as np
import pytest

import stereocal as sc


def test_points_run_along_the_rows():
    board = sc.Chessboard((3, 2), 25.0)
    expected = [[0, 0, 0], [25, 0, 0], [50, 0, 0], [0, 25, 0], [25, 25, 0], [50, 25, 0]]
    np.testing.assert_array_equal(board.object_points, expected)
    assert (board.columns, board.rows, board.corner_count) == (3, 2, 6)


@pytest.mark.parametrize(("size", "symmetric"), [((7, 6), False), ((9, 6), False), ((6, 4), True), ((7, 7), True)])
def test_symmetry_is_the_parity_of_the_colours(size, symmetric):
    assert sc.Chessboard(size).is_symmetric == symmetric
    p, q = np.meshgrid(np.arange(size[0] + 1), np.arange(size[1] + 1))
    colours = (p + q) % 2
    assert np.array_equal(colours, colours[::-1, ::-1]) == symmetric


@pytest.mark.parametrize("size", [(1, 5), (7,), "7x6", (7.5, 6), None, (7, 6, 5)])
def test_refuses_what_is_not_a_board(size):
    with pytest.raises(sc.InputError):
        sc.Chessboard(size)


@pytest.mark.parametrize("square", [0, -1, float("nan"), "x"])
def test_refuses_a_square_of_no_size(square):
    with pytest.raises(sc.InputError, match="square_size"):
        sc.Chessboard((7, 6), square)
