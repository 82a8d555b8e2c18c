"""Corners without pictures: projected points and noise, thousands of times faster than rendering.

For studies of the calibration itself (bias, covariance, consistency) what matters of a photograph is where its corners
are and how far the detector is off. Here the corners are the exact projections and the detector's error is Gaussian,
the same in both directions and independent from corner to corner: the noise model under which least squares is the
maximum likelihood estimate, so that any deviation found is the estimator's own.

A detector's real errors are measured by rendering (``rig``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import InputError
from stereocal.base.rotations import rotation_vector
from stereocal.board.chessboard import Chessboard
from stereocal.pair.rig import StereoRig
from stereocal.synthetic.board_view import bent_points
from stereocal.synthetic.poses import Pose


def simulate_corners(
    rig: StereoRig,
    board: Chessboard,
    poses: Sequence[Pose],
    *,
    noise: float = 0.1,
    bow: float = 0.0,
    outliers: float = 0.0,
    seed: int = 0,
) -> tuple[list[Float], list[Float]]:
    """Project a board's corners into both cameras and add a detector's error.

    Parameters
    ----------
    rig : StereoRig
        The cameras.
    board : Chessboard
        In the rig's unit of length.
    poses : sequence of (R, t)
        Board to left camera, as :func:`~stereocal.synthetic.poses.hold_board` gives them.
    noise : float
        σ of each coordinate, pixels.
    bow : float
        The board's bend, in units of square_size; see ``board_view``.
    outliers : float
        Part of the corners that are off by 2 to 10 pixels instead.
    seed : int
        Of the noise.

    Returns
    -------
    left, right : list of ndarray of shape (N, 2)
        One array a pose.
    """
    if not 0 <= outliers < 1:
        raise InputError(f"outliers must be a part from 0 up to 1, but is {outliers:g}")
    random = np.random.default_rng(seed)
    points = bent_points(board, bow)
    left, right = [], []
    for R, t in poses:
        left.append(rig.left.project(points, rotation_vector(R), t))
        right.append(rig.right.project(points, rotation_vector(rig.R @ R), rig.R @ t + rig.T))
    for corners in (*left, *right):
        corners += noise * random.standard_normal(corners.shape)
        wrong = random.random(len(corners)) < outliers
        angle = random.uniform(0, 2 * np.pi, wrong.sum())
        length = random.uniform(2, 10, wrong.sum())
        corners[wrong] += length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return left, right
