"""Boards seen by a camera, small and quick, for the board room's tests."""

from __future__ import annotations

import numpy as np

import stereocal as sc
from stereocal.synthetic.board_view import render_board

CAMERA = sc.Camera(
    np.array([[420.0, 0, 161.3], [0, 420.0, 118.2], [0, 0, 1]]),
    np.array([-0.25, 0.08, 0.0005, -0.0004, 0.0]),
    (320, 240),
)


def look_at(board, tilt=25.0, turn=20.0, fill=0.8, seed=0):
    """R, t of a board in the middle of the image, tilted and turned by degrees."""
    rng = np.random.default_rng(seed)
    axis = rng.uniform(0, 2 * np.pi)
    R = sc.rotation_matrix(np.deg2rad(tilt) * np.array([np.cos(axis), np.sin(axis), 0])) @ sc.rotation_matrix(
        [0, 0, np.deg2rad(turn)]
    )
    half = board.square_size * np.array([(board.columns - 1) / 2, (board.rows - 1) / 2, 0])
    diagonal = np.hypot(board.columns + 1, board.rows + 1) * board.square_size
    distance = 420.0 * diagonal / (fill * 240 * 1.25)
    return R, np.array([*rng.uniform(-0.03, 0.03, 2) * distance, distance]) - R @ half


def render(board, *, tilt=25.0, turn=20.0, fill=0.8, seed=0, **options):
    """(image, true corners)."""
    R, t = look_at(board, tilt, turn, fill, seed)
    return render_board(CAMERA, R, t, board, seed=seed, **options)
