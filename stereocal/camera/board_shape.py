"""The board's shape as unknowns: no board is flat.

A printed sheet on a panel bows, a folding board has a hinge, and once corners are measured to a few hundredths of a
pixel that is the largest error left. The shape is one for all views, so it can be found with the cameras: X_j = X₀_j
+ Φ_j β, with β among the shared unknowns of ``bundle``.

==============  ==============================================================================  =================
kind            Φ                                                                               unknowns
==============  ==============================================================================  =================
``"flat"``      nothing                                                                         0
``"bow"``       z = β₁ ξ² + β₂ ξη + β₃ η² + cubic terms, ξ, η from −1 to 1 across the board     7
``"released"``  every coordinate of every point, less the gauge                                 3P − 7
==============  ==============================================================================  =================

**The gauge.** Moving, turning or scaling the whole board is no change of its shape: the poses (and, for scale, all
distances) undo it. So seven coordinates of the released points must be held, and ``cv2.calibrateCameraRO``'s choice
is kept: the first point and the last of the first row whole, and the z of the last point. The bow has no constant and
no linear terms, for the same reason.

**Is it real?** More unknowns always fit better. So "auto" asks views that were not used: the views are dealt into
five parts, the cameras and the shape are fitted on four of them, the poses alone on the fifth, and the kind with the
least error there wins; a richer kind must win by more than one per cent. Each of these fits begins at that of all
views, which is near, and goes on to its own optimum.

Source: Strobl and Hirzinger, *More accurate pinhole camera calibration with imperfect planar target*, ICCV Workshops
2011 (released points).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import InputError

KINDS = ("flat", "bow", "released")
"""Shapes, from poor to rich."""

_RICHER_MUST_WIN_BY = 0.01


@dataclass(frozen=True, eq=False)
class BoardShape:
    """The shape that a calibration found.

    Attributes
    ----------
    kind : str
        ``"flat"``, ``"bow"`` or ``"released"``.
    points : ndarray of shape (P, 3)
        The board's points.
    offsets : ndarray of shape (P, 3)
        `points` minus the flat board.
    std : ndarray of shape (P, 3)
        Standard deviation of each coordinate.
    held_out_rms : dict of str to float
        RMS of views that were not used, by kind; empty unless ``"auto"`` asked for it.
    """

    kind: str
    points: Float
    offsets: Float
    std: Float
    held_out_rms: dict[str, float]


def requested_kind(board_warp: bool | str) -> str:
    """Return the kind that the user means: False is flat, True is auto.

    Raises
    ------
    InputError
        If it is no kind.
    """
    if board_warp is True or board_warp is False:
        return "auto" if board_warp else "flat"
    if board_warp not in (*KINDS, "auto"):
        raise InputError(
            f"board_warp must be False, True, {', '.join(map(repr, (*KINDS, 'auto')))}, not {board_warp!r}"
        )
    return board_warp


def shape_basis(kind: str, board: Float) -> Float | None:
    """Return Φ, (P, 3, m), of a kind; None for a flat board.

    Parameters
    ----------
    kind : str
        One of :data:`KINDS`.
    board : ndarray of shape (P, 3)
        The flat board, row by row.

    Returns
    -------
    ndarray of shape (P, 3, m) or None
    """
    if kind == "flat":
        return None
    count = len(board)
    if kind == "bow":
        low, high = board[:, :2].min(axis=0), board[:, :2].max(axis=0)
        x, y = (2 * (board[:, :2] - low) / (high - low) - 1).T
        heights = np.stack([x * x, x * y, y * y, x**3, x * x * y, x * y * y, y**3], axis=1)
        basis = np.zeros((count, 3, heights.shape[1]))
        basis[:, 2] = heights
        return basis
    held = gauge(board)
    free = [i for i in range(3 * count) if i not in held]
    return np.eye(3 * count)[:, free].reshape(count, 3, len(free))


def gauge(board: Float) -> set[int]:
    """Return the seven coordinates (3·point + axis) that released points hold: calibrateCameraRO's.

    Parameters
    ----------
    board : ndarray of shape (P, 3)
        The flat board, row by row.

    Returns
    -------
    set of int
    """
    first_row = np.flatnonzero(np.abs(board[:, 1] - board[0, 1]) < 1e-9 * max(1.0, float(np.ptp(board))))
    end = int(first_row[np.argmax(np.abs(board[first_row, 0] - board[0, 0]))])
    last = len(board) - 1
    if end == 0 or last == end:
        raise InputError(
            "the released shape needs a board of rows and columns, its first row at one y, points row by row"
        )
    return {0, 1, 2, 3 * end, 3 * end + 1, 3 * end + 2, 3 * last + 2}


def folds(count: int, parts: int = 5) -> list[np.ndarray]:
    """Return which views each part holds out: dealt round, so that neighbours in time go to different parts."""
    return [np.arange(count)[i::parts] for i in range(min(parts, count))]


def choose_kind(held_out_rms: dict[str, float]) -> str:
    """Return the kind of least held-out error; a richer one must win by more than one per cent."""
    best = "flat"
    for kind in KINDS[1:]:
        if kind in held_out_rms and held_out_rms[kind] < held_out_rms[best] * (1 - _RICHER_MUST_WIN_BY):
            best = kind
    return best


def board_line(shape: BoardShape) -> str:
    """Return one line of text about a shape."""
    if shape.kind == "flat":
        line = "board: taken to be flat"
    else:
        line = f"board: {shape.kind}, heights from {shape.offsets[:, 2].min():.4g} to {shape.offsets[:, 2].max():.4g}"
    if shape.held_out_rms:
        line += "; held-out RMS " + ", ".join(f"{kind} {rms:.4f}" for kind, rms in shape.held_out_rms.items())
    return line
