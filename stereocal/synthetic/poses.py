"""How a board is held up in front of a rig, so that a calibration can learn from it.

Zhang's method needs views that differ in tilt; the lens shows itself in the corners of the image; both cameras must see
the whole board. So every pose is made to order: the board's middle is aimed at one of nine places of the image in turn
(the corners first, for distortion lives there), it is turned by a tilt about a random axis in its plane and a roll, and
stands as near as both photographs allow. A pose that leaves either image is drawn towards the centre, then moved away.

Poses are pairs (R, t) from the board's frame to the left camera's.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float, require_integer
from stereocal.base.errors import InputError
from stereocal.base.rotations import rotation_matrix, rotation_vector
from stereocal.board.chessboard import Chessboard
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig

Pose = tuple[Float, Float]

_PLACES = ((0, 0), (1, 1), (1, 0), (0, 1), (0.5, 0.5), (0.5, 0), (0.5, 1), (0, 0.5), (1, 0.5))
_EDGE = 6.0
"""Pixels between the outermost square and the image's edge."""


def hold_board(rig: StereoRig, board: Chessboard, count: int, *, tilt: float = 35.0, seed: int = 0) -> list[Pose]:
    """Return poses in which both cameras see the whole board.

    Parameters
    ----------
    rig : StereoRig
        The cameras.
    board : Chessboard
        In the rig's unit of length.
    count : int
        How many poses.
    tilt : float
        Largest angle between board and image plane, degrees; each pose takes 0.4 to 1 of it. 0 holds every board
        parallel to the image plane: then Zhang's method is degenerate.
    seed : int
        Of the choice.

    Returns
    -------
    list of (R, t)
        R (3, 3), t (3,): board to left camera.

    Raises
    ------
    InputError
        If no such pose is found: the cameras look apart, or the board is too large.
    """
    require_integer(count, "count", minimum=1)
    random = np.random.default_rng(seed)
    return [_hold(rig, board, np.array(_PLACES[k % len(_PLACES)]), tilt, random) for k in range(count)]


def _hold(rig: StereoRig, board: Chessboard, place: Float, tilt: float, random: np.random.Generator) -> Pose:
    outline = _outline(board)
    middle = outline.mean(axis=0)
    extent = float(np.ptp(outline, axis=0).max())
    width, height = rig.left.image_size
    centre = np.array([width - 1, height - 1]) / 2
    distance = float(random.uniform(1.0, 1.5)) * extent
    for _ in range(30):
        direction = random.uniform(0, 2 * np.pi)
        angle = np.radians(tilt) * random.uniform(0.4, 1.0)
        R = rotation_matrix([angle * np.cos(direction), angle * np.sin(direction), 0.0])
        if tilt > 0:
            R = R @ rotation_matrix([0, 0, np.radians(random.uniform(-15, 15))])
        for pull in np.linspace(1, 0, 21):
            aim = centre + pull * (place - 0.5) * (width, height)
            ray = rig.left.undistort_points(aim[None], P=np.eye(3))[0]
            if not np.isfinite(ray).all():
                continue
            t = distance * np.array([*ray, 1.0]) - R @ middle
            if sees_whole(rig.left, R, t, outline) and sees_whole(rig.right, rig.R @ R, rig.R @ t + rig.T, outline):
                return R, t
        distance *= 1.1
    raise InputError("no pose was found in which both cameras see the whole board; turn the cameras towards each other")


def sees_whole(camera: Camera, R: Float, t: Float, points: Float) -> bool:
    """Whether all points (N, 3) of a board at pose (R, t) are in front of the camera and inside its image."""
    local = points @ R.T + t
    if local[:, 2].min() <= 0 or np.linalg.norm(local[:, :2] / local[:, 2:], axis=1).max() > 1.6:
        return False
    if (R.T @ t)[2] <= 0:  # the camera stands behind the print
        return False
    pixels = camera.project(points, rotation_vector(R), t)
    width, height = camera.image_size
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    return bool((low >= _EDGE).all() and high[0] <= width - 1 - _EDGE and high[1] <= height - 1 - _EDGE)


def _outline(board: Chessboard) -> Float:
    """Points all around the outermost squares."""
    a = np.linspace(0, 1, 9)
    sides = [(a, 0 * a), (a, 0 * a + 1), (0 * a, a), (0 * a + 1, a)]
    unit = np.concatenate([np.stack(side, axis=1) for side in sides])
    size = np.array([board.columns + 1, board.rows + 1])
    flat = (unit * size - 1) * board.square_size
    return np.column_stack([flat, np.zeros(len(flat))])
