"""Calibrations with known truth for the tests of this room."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from stereocal.base.rotations import rotation_matrix
from stereocal.board.chessboard import Chessboard
from stereocal.pair.stereo_calibration import calibrate_stereo
from stereocal.report.evidence import Evidence, gather_evidence
from stereocal.synthetic.corners import simulate_corners
from stereocal.synthetic.poses import sees_whole
from stereocal.synthetic.rig import default_rig

SIZE = (640, 480)


@dataclass
class Case:
    """A rig, its corners and its calibration."""

    truth: Any
    board: Chessboard
    left: list[np.ndarray]
    right: list[np.ndarray]
    calibration: Any

    @property
    def evidence(self) -> Evidence:
        names = [f"{i:02d}" for i in range(len(self.left))]
        return gather_evidence(self.calibration, self.board, self.left, self.right, SIZE, names, "mm")


def hold(rig, board, views: int, tilt: float, random: np.random.Generator) -> list[Any]:
    """Boards that both cameras see whole."""
    corners = np.array([[-1, -1], [board.columns, -1], [board.columns, board.rows], [-1, board.rows]])
    outline = np.column_stack([corners * board.square_size, np.zeros(4)])
    extent, poses = float(np.ptp(outline, axis=0).max()), []
    while len(poses) < views:
        direction, angle = random.uniform(0, 2 * np.pi), np.radians(tilt) * random.uniform(0.4, 1.0)
        R = rotation_matrix([angle * np.cos(direction), angle * np.sin(direction), 0.0])
        t = np.array([*random.uniform(-0.7, 0.7, 2), 1.0]) * extent * random.uniform(0.9, 2.0) - R @ outline.mean(
            axis=0
        )
        if sees_whole(rig.left, R, t, outline) and sees_whole(rig.right, rig.R @ R, rig.R @ t + rig.T, outline):
            poses.append((R, t))
    return poses


def make_case(*, seed: int = 0, views: int = 16, tilt: float = 40, noise: float = 0.1, **options: Any) -> Case:
    """Photograph a board and calibrate from it."""
    board, rig = Chessboard((8, 6), 25.0), default_rig()
    poses = hold(rig, board, views, tilt, np.random.default_rng(seed))
    left, right = simulate_corners(rig, board, poses, noise=noise, seed=seed + 1, **options)
    return Case(rig, board, left, right, calibrate_stereo(board.object_points, left, right, SIZE))
