"""One order for the corners of both pictures, on boards that look the same after half a turn.

A detector lists a board's corners row by row from *a* corner of the board. When columns + rows is even, the board
turned by 180° is the same board, colours and all, and which of its two ends comes first is chance: a detector may start
at opposite ends in the left and in the right picture of one pair. (A square board of even side looks the same after
every quarter turn.) Each camera by itself never notices: turned corners fit a turned board as well. The pair does: it
is told that the left camera's first corner is the right camera's last one, and one such pair of eleven takes a stereo
calibration from 0.09 px to 29 px.

**Finding the turned pairs.** Calibrate each camera alone, which is insensitive to the turn, and take from the poses of
view i the rotation from left to right camera, R_i = R_right,i R_left,iᵀ. In a rigid rig all R_i are the same. If the
right corners come turned by D (180° about the board's normal), what is measured instead is R_right,i Dᵀ R_left,iᵀ: half
a turn off, about an axis that moves with the board. So every pair offers one candidate rotation for each turn of the
board; the rotation R* that leaves the least total angle from the nearest candidate of every pair is the rig's, and the
turn that each pair needs to get there is the repair.

If all views hold the board the same way, the turned candidates agree with one another too, and nothing in the rotations
tells which is true. The tie is broken by the milder rig: two cameras side by side are turned against one another by
less than a right angle.

**A sensible order.** What is left is one common choice for both pictures of a pair. It is made so that the board's x
axis runs to the right in the left picture (or down, if the axis stands upright), as a reader would count.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_image_size, as_points
from stereocal.base.errors import InputError, StereocalError
from stereocal.base.rotations import rotation_matrix

if TYPE_CHECKING:
    from stereocal.board.chessboard import Chessboard

# A camera can be calibrated from this many views; below it, the pictures alone decide.
_VIEWS_FOR_CALIBRATION = 3
# Weight of the milder rig against consensus: enough to break a tie, too little to outvote a view.
_PRIOR = 0.02


def turned_orders(columns: int, rows: int) -> list[Any]:
    """Return the index arrays that list a board's corners as seen after each turn that leaves it looking the same.

    Parameters
    ----------
    columns, rows : int
        Inner corners of the board.

    Returns
    -------
    list of ndarray of int
        The first is the identity; then half a turn; then, for square boards, the two quarter turns.
    """
    grid = np.arange(columns * rows).reshape(rows, columns)
    turns = [grid, np.rot90(grid, 2)]
    if columns == rows:
        turns += [np.rot90(grid, 1), np.rot90(grid, 3)]
    return [turn.ravel().copy() for turn in turns]


def repair_corner_order(
    board: Chessboard,
    left_corners: Sequence[ArrayLike],
    right_corners: Sequence[ArrayLike],
    image_size: tuple[int, int],
) -> tuple[list[Float], list[Float], list[bool]]:
    """Give both pictures of every pair the same corner order.

    Parameters
    ----------
    board : Chessboard
        The target. One that is not symmetric has one order only, and comes back as it is.
    left_corners, right_corners : sequence of array_like of shape (N, 2)
        Detected corners, one array a pair.
    image_size : (int, int)
        Width and height of the pictures.

    Returns
    -------
    left, right : list of ndarray of shape (N, 2)
        The corners in a common order.
    flipped : list of bool
        Which pairs had left and right in different orders.

    Raises
    ------
    InputError
        If the numbers of pairs or of corners do not match.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> board = sc.Chessboard((7, 7), 25.0)
    >>> tilts = [(0.4, 0, 0), (-0.4, 0.1, 0), (0, 0.4, 0.1), (0.1, -0.4, 0), (0.3, 0.3, 0.2), (-0.3, 0.3, 0)]
    >>> camera = sc.Camera(K, None, (640, 480))
    >>> left = [camera.project(board.object_points, tilt, [-75, -75, 400]) for tilt in tilts]
    >>> right = [camera.project(board.object_points, tilt, [-135, -75, 400]) for tilt in tilts]
    >>> right[2] = right[2][::-1]  # begun at the other end: a square board looks the same turned round
    >>> _, mended, flipped = sc.repair_corner_order(board, left, right, (640, 480))
    >>> flipped
    [False, False, True, False, False, False]
    """
    size = as_image_size(image_size)
    if len(left_corners) != len(right_corners):
        raise InputError(f"{len(left_corners)} left and {len(right_corners)} right boards: they must come in pairs")
    columns, rows = board.columns, board.rows
    left = [as_points(c, 2, "left_corners", minimum=columns * rows) for c in left_corners]
    right = [as_points(c, 2, "right_corners", minimum=columns * rows) for c in right_corners]
    if any(len(c) != columns * rows for c in (*left, *right)):
        raise InputError(f"every view must list the board's {columns * rows} corners ({columns}x{rows})")
    if not board.is_symmetric or not left:
        return left, right, [False] * len(left)
    orders = turned_orders(columns, rows)
    choice = _turns_of_right(board, left, right, size, orders)
    right = [corners[orders[turn]] for corners, turn in zip(right, choice, strict=True)]
    for i, corners in enumerate(left):
        order = orders[_sensible_turn(corners, columns, rows)]
        left[i], right[i] = corners[order], right[i][order]
    return left, right, [turn != 0 for turn in choice]


def _turns_of_right(
    board: Chessboard, left: list[Float], right: list[Float], size: tuple[int, int], orders: list[Any]
) -> list[int]:
    """Return, for each pair, the turn that brings the right corners into the left ones' order."""
    rotations = _relative_rotations(board, left, right, size, orders)
    if rotations is None:
        return [_turn_by_picture(a, b, orders) for a, b in zip(left, right, strict=True)]
    candidates = rotations.reshape(-1, 3, 3)
    cost = np.array([np.minimum(_angles(rotations, R), 0.5).min(axis=1).mean() for R in candidates])
    cost += _PRIOR * np.array([_angles(np.eye(3), R) for R in candidates])
    return [int(turn) for turn in _angles(rotations, candidates[int(np.argmin(cost))]).argmin(axis=1)]


def _relative_rotations(
    board: Chessboard, left: list[Float], right: list[Float], size: tuple[int, int], orders: list[Any]
) -> Float | None:
    """Return (pairs, turns, 3, 3): the rotation from left to right camera by each turn of the right board."""
    if len(left) < _VIEWS_FOR_CALIBRATION:
        return None
    from stereocal.camera.calibration import calibrate_camera

    try:
        first, second = (
            calibrate_camera([board.object_points] * len(v), v, size, model="polynomial") for v in (left, right)
        )
    except StereocalError:
        # too few or too similar views to calibrate from: the pictures alone decide
        return None
    X = board.object_points
    turns = np.array([_turn_of_board(X, order) for order in orders])
    R_left = np.array([rotation_matrix(r) for r in first.rvecs])
    R_right = np.array([rotation_matrix(r) for r in second.rvecs])
    return np.einsum("iab,tbc,idc->itad", R_right, turns, R_left)


def _turn_of_board(X: Float, order: Any) -> Float:
    """Return the rotation D about z with X[order] − centre = Dᵀ... that the reordered corners make of the board."""
    centred = X - X.mean(axis=0)
    moved = centred[order]
    angle = np.arctan2(
        np.sum(moved[:, 0] * centred[:, 1] - moved[:, 1] * centred[:, 0]),
        np.sum(moved[:, 0] * centred[:, 0] + moved[:, 1] * centred[:, 1]),
    )
    # corners[order][j] = R_right X[order[j]] must read R_new X[j]: R_new = R_right D with X[order] = D X
    return rotation_matrix([0, 0, -angle])


def _turn_by_picture(left: Float, right: Float, orders: list[Any]) -> int:
    """Return the turn whose corner directions agree best between the pictures of two upright cameras."""
    a = left - left.mean(axis=0)
    b = right - right.mean(axis=0)
    return int(np.argmax([np.sum(a * b[order]) for order in orders]))


def _sensible_turn(corners: Float, columns: int, rows: int) -> int:
    """Return 0 if the board's x axis runs right (or down) in the picture, else 1: half a turn."""
    grid = corners.reshape(rows, columns, 2)
    x_axis = (grid[:, -1] - grid[:, 0]).mean(axis=0)
    larger = int(np.argmax(np.abs(x_axis)))
    return int(x_axis[larger] < 0)


def _angles(rotations: Float, R: Float) -> Float:
    """Return the angles between rotations (..., 3, 3) and R, in radians."""
    trace = np.einsum("...ab,ab->...", rotations, R)
    return np.asarray(np.arccos(np.clip((trace - 1) / 2, -1, 1)))
