"""Which part of a grid is the board asked for, and which of its corners is the first.

A grid as it was grown is seldom just the board: a line of letters may continue it, glare may have taken corners away,
a hand may cover a line. The rules, in this order:

1. **Ragged lines go.** Border lines that are mostly missing are letters or a frame.
2. **The size must be the one asked for.** A grid of another size is reported, not bent to fit; a part of a larger board
   would be numbered from the wrong end.
3. **A covered line.** If the grid is larger by a single line, and that line's outer squares are cut off while those at
   the other end are whole, the board is partly covered there (the paper's photographs: 7x7 corners are visible where
   7x6 are asked for): the complete lines are taken.
4. **Faded corners.** If nearly all corners of a board of the right size stand, what is left to decide is small: is
   there a corner, at the one place where it must be? Far less evidence answers that than was needed to find the others,
   so growth is tried again inside the board's rectangle with a lower threshold. It still needs a saddle near its place
   and four squares of the right colours around it, and so invents nothing under a hand.
5. **Nothing outside.** Where the squares go on beyond the rectangle, it is a part of a larger board whose other corners
   were lost: no corners.

The order of the corners is the board's own (:mod:`stereocal.board.chessboard`): of the four or eight ways to number a
rectangle's corners, the ones that run clockwise and start beside a dark square are left; a symmetric board has two or
four of these, of which the first corner nearest to the image's origin decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.board.chessboard import Chessboard
from stereocal.board.grid import Grid, drop_ragged_lines, fill_grid, outer_extents

GOES_ON = 1.35
"""Outer squares that reach further than this, in steps, are those of a further line."""
COVERED, WHOLE = 0.65, 0.15
"""A covered line's outer squares reach less than the first; and less than those of the other end by the second."""
FADED_SHARE = 0.8
"""Of the corners of a board of the right size, at least this share must stand before the others are filled in."""
FADED_LINE = 0.35
"""Of a border line, at least this share."""


@dataclass(frozen=True)
class Choice:
    """The part of a grid that is the board, or why there is none.

    Attributes
    ----------
    grid : Grid or None
    reason : str
        Why not.
    other_size : tuple of int or None
        The size that was seen instead.
    """

    grid: Grid | None
    reason: str = ""
    other_size: tuple[int, int] | None = None


def choose_board(G: NDArray[np.float32], grid: Grid, board: Chessboard) -> Choice:
    """The part of a grid that is the board asked for.

    Parameters
    ----------
    G : ndarray of shape (H, W), float32
        The smoothed image.
    grid : Grid
        As grown.
    board : Chessboard
        The board asked for.

    Returns
    -------
    Choice
    """
    seen = drop_ragged_lines(grid)
    wanted = {board.inner_corners, board.inner_corners[::-1]}
    if seen.shape in wanted and seen.known.all():
        return _alone(G, seen, board)
    filled = [_filled(G, grid, seen, shape) for shape in wanted]
    for whole in filled:
        if whole is not None:
            return _alone(G, whole, board)
    columns, rows = seen.shape
    spare = [(columns - c, rows - r) for c, r in wanted]
    for part in _without_covered_line(G, seen, (1, 0) in spare, (0, 1) in spare):
        whole = part if part.known.all() else _filled(G, part, part, part.shape)
        if whole is not None:
            return Choice(whole)
    if seen.shape in wanted:
        count = int(seen.known.sum())
        return Choice(
            None, f"{count} of the {board.corner_count} corners were seen; the others are covered or too blurred"
        )
    if min(columns, rows) < 3 or not seen.known.all():
        return Choice(None, f"only a part of {columns}x{rows} corners was seen, not {board}")
    size = (max(columns, rows), min(columns, rows))
    return Choice(None, f"a board of {size[0]}x{size[1]} inner corners was seen, not {board}", size)


def _alone(G: NDArray[np.float32], whole: Grid, board: Chessboard) -> Choice:
    """The board, if no squares go on beyond it."""
    if outer_extents(G, whole).max() > GOES_ON:
        return Choice(None, f"the board goes on beyond the {board} corners seen: it is larger, or partly lost")
    return Choice(whole)


def _filled(G: NDArray[np.float32], grid: Grid, seen: Grid, shape: tuple[int, int]) -> Grid | None:
    """The board of this shape around the lines seen, its faded corners filled in; None if too little of it stands."""
    (columns, rows), (most_columns, most_rows) = shape, grid.shape
    if columns > most_columns or rows > most_rows or columns < seen.shape[0] or rows < seen.shape[1]:
        return None
    i0, j0 = grid.offset_of(seen)
    best: Grid | None = None
    for i in range(max(0, i0 + seen.shape[0] - columns), min(i0, most_columns - columns) + 1):
        for j in range(max(0, j0 + seen.shape[1] - rows), min(j0, most_rows - rows) + 1):
            part = grid.window(i, j, columns, rows)
            if best is None or part.known.sum() > best.known.sum():
                best = part
    if best is None or best.known.mean() < FADED_SHARE:
        return None
    known = best.known
    if min(known[0].mean(), known[-1].mean(), known[:, 0].mean(), known[:, -1].mean()) < FADED_LINE:
        return None
    whole = fill_grid(G, best)
    return whole if whole.known.all() else None


def _without_covered_line(G: NDArray[np.float32], seen: Grid, along_i: bool, along_j: bool) -> list[Grid]:
    """The grid without a border line whose outer squares are cut off, where those of the other end are whole.

    `along_i`, `along_j` say which axes may lose a line (both, where a square grid is one line too large for a board of
    either orientation); the line that is cut off more comes first.
    """
    if not (along_i or along_j):
        return []
    extents = outer_extents(G, seen)
    (columns, rows), parts = seen.shape, []
    for axis, allowed in ((0, along_i), (1, along_j)):
        first, last = extents[2 * axis : 2 * axis + 2]
        if not allowed or min(first, last) >= COVERED or abs(first - last) < WHOLE:
            continue
        start = int(first < last)
        part = seen.window(start, 0, columns - 1, rows) if axis == 0 else seen.window(0, start, columns, rows - 1)
        parts.append((min(first, last), part))
    return [part for _, part in sorted(parts, key=lambda item: item[0])]


def ordered_corners(grid: Grid, board: Chessboard) -> Float:
    """Corners as (rows, columns, 2) in the board's order: clockwise frame, dark square first.

    Parameters
    ----------
    grid : Grid
        The board's corners, all known, in either orientation.
    board : Chessboard
        The board asked for.
    """
    points, (columns, rows) = grid.points.transpose(1, 0, 2), grid.shape  # (J, I, 2)
    options = []
    for transpose, flip_x, flip_y in product((False, True), repeat=3):
        p = points.transpose(1, 0, 2) if transpose else points
        p = p[:, ::-1] if flip_x else p
        p = p[::-1] if flip_y else p
        if p.shape[:2] != (board.rows, board.columns):
            continue
        x, y = p[0, -1] - p[0, 0] + p[-1, -1] - p[-1, 0], p[-1, 0] - p[0, 0] + p[-1, -1] - p[0, -1]
        if x[0] * y[1] - x[1] * y[0] <= 0:
            continue
        flip_i, flip_j = (flip_y, flip_x) if transpose else (flip_x, flip_y)
        i, j = (columns - 1 if flip_i else 0), (rows - 1 if flip_j else 0)  # the first corner's place in the grid
        # the square between +x and +y of the first corner has the colour of the one diagonally outside
        dark = ((i + j) % 2 == grid.parity) != (flip_x != flip_y)
        options.append((not dark, float(p[0, 0].sum()), p))
    return np.ascontiguousarray(min(options, key=lambda option: option[:2])[2])
