"""Corners counted from different ends of a symmetric board."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

from stereocal.base.errors import InputError
from stereocal.base.rotations import rotation_matrix
from stereocal.board.chessboard import Chessboard
from stereocal.camera.model import Camera
from stereocal.pair.corner_order import repair_corner_order, turned_orders

SIZE = (640, 480)


def views(seed: int, board: Chessboard, count: int, *, noise: float = 0.1):
    """Return corners of a board in random attitudes seen by a side-by-side rig, x axis to the right."""
    random = np.random.default_rng(seed)
    camera = Camera([[500, 0, 320], [0, 502, 240], [0, 0, 1]], [-0.2, 0.05], SIZE)
    R, T = rotation_matrix(random.normal(size=3) * 0.03), np.array([-3.0, 0.05, 0.02])
    X = board.object_points - board.object_points.mean(axis=0)
    left, right = [], []
    for _ in range(count):
        Y = X @ rotation_matrix(random.uniform(-0.35, 0.35, 3)).T + random.uniform((-1.5, -1, 11), (3, 1, 16))
        left.append(camera.project(Y) + noise * random.normal(size=(len(X), 2)))
        right.append(camera.project(Y @ R.T + T) + noise * random.normal(size=(len(X), 2)))
    return left, right


@given(seed=seeds, count=st.integers(1, 9), shape=st.sampled_from([(6, 4), (7, 5), (6, 6), (5, 5)]))
@settings(max_examples=25)
def test_any_turn_of_either_side_is_undone_and_reported(seed, count, shape) -> None:
    board = Chessboard(shape, 1.0)
    left, right = views(seed, board, count)
    random = np.random.default_rng(seed)
    # a detector that knows the colours can only be off by half a turn, unless both sides are even
    orders = turned_orders(*shape) if shape == (6, 6) else turned_orders(*shape)[:2]
    turn_left, turn_right = random.integers(0, len(orders), (2, count))
    found_left, found_right, flipped = repair_corner_order(
        board,
        [v[orders[t]] for v, t in zip(left, turn_left, strict=True)],
        [v[orders[t]] for v, t in zip(right, turn_right, strict=True)],
        SIZE,
    )
    assert flipped == [bool(a != b) for a, b in zip(turn_left, turn_right, strict=True)]
    for i in range(count):
        # one order for both, and the same points
        match = [np.array_equal(found_left[i], left[i][order]) for order in turned_orders(*shape)]
        assert any(match)
        np.testing.assert_array_equal(found_right[i], right[i][turned_orders(*shape)[match.index(True)]])
        # the x axis runs right or down
        grid = found_left[i].reshape(shape[1], shape[0], 2)
        x_axis = (grid[:, -1] - grid[:, 0]).mean(axis=0)
        assert x_axis[np.argmax(np.abs(x_axis))] > 0


def test_a_board_with_one_order_only_comes_back_as_it_is() -> None:
    board = Chessboard((7, 6), 1.0)
    left, right = views(0, board, 3)
    right[1] = right[1][::-1]
    found = repair_corner_order(board, left, right, SIZE)
    assert found[2] == [False, False, False]
    np.testing.assert_array_equal(found[1][1], right[1])


def test_bumblebee_finds_exactly_pair_eleven(data) -> None:
    corners = [np.load(data / "bumblebee2_chess" / f"opencv_corners_{side}.npz") for side in ("left", "right")]
    views = [list(c["classic_subpix5"].reshape(11, 24, 2)) for c in corners]
    _, _, flipped = repair_corner_order(Chessboard((6, 4), 30.0), *views, SIZE)
    assert [str(name) for name, f in zip(corners[0]["names"], flipped, strict=True) if f] == ["left11.jpg"]


def test_bad_input_is_refused() -> None:
    board = Chessboard((6, 4), 1.0)
    with pytest.raises(InputError, match="1 left and 2 right"):
        repair_corner_order(board, [np.zeros((24, 2))], [np.zeros((24, 2))] * 2, SIZE)
    with pytest.raises(InputError, match="24 corners"):
        repair_corner_order(board, [np.zeros((25, 2))], [np.zeros((25, 2))], SIZE)
