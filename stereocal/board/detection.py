"""Find a chessboard: pyramid, saddles, grid, size, order, subpixel.

The image is halved until it is small, and the search starts there: a board of large squares is found in a thousandth
of the pixels, blur shrinks to nothing, and noise averages out. If the board is not seen whole, the next finer level
is tried, up to the image itself (and an image of few pixels is also doubled). Where glare or ink has parted the squares
that should touch, no level shows the board: then the dark parts, or the light ones, are grown by a pixel or two, which
closes the gap from both sides alike and leaves its middle where the corner was, and the levels are tried again. At each
level:

1. saddles of the brightness that pass the ring test (:mod:`stereocal.board.saddle`);
2. grids grown from them (:mod:`stereocal.board.grid`);
3. the grid whose complete lines are the board asked for; a grid of another size is reported, not bent to fit;
4. the corners numbered by the board's own colours (:mod:`stereocal.board.chessboard`);
5. the blurred saddle fitted at full resolution (:mod:`stereocal.board.subpixel`), which is also the last test: every
   corner's
   fit has to converge near its place, with the contrast of its neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float
from stereocal.base.gray import to_gray
from stereocal.board.chessboard import Chessboard
from stereocal.board.grid import Grid, drop_ragged_lines, grow_grids, outer_extents
from stereocal.board.saddle import saddle_candidates, saddle_response
from stereocal.board.subpixel import SaddleFit, fit_corner_grid

_SMALLEST_LEVEL = 200  # longest side of the coarsest level is at least this
_LARGEST_CLOSED = 1.3e6  # pixels: gaps are closed in images up to this size
_GOES_ON = 1.2  # outer squares that reach further are those of a further line
_COVERED, _WHOLE = 0.65, 0.15  # a covered line's outer squares reach less than this; and less than others by this


@dataclass(frozen=True)
class Detection:
    """What was seen of a board in one image.

    Attributes
    ----------
    found : bool
    corners : ndarray of shape (N, 2) or None
        x, y, row by row in the board's own order.
    covariances : ndarray of shape (N, 2, 2) or None
        Of the corners, px^2.
    edge_width : float
        Standard deviation of the blur of the board's edges, px (NaN if not found).
    confidence : float
        0 to 1: how sure it is that this is the board.
    other_size : tuple of int or None
        (columns, rows) of the grid that was seen instead.
    message : str
        One sentence: why the board was not found, or what to know about it.
    stages : dict
        For drawing: "response" (S), "candidates" (n, 7), "maxima" (m, 2), "grid" (the largest grid's corners),
        "scale" (from that level's pixels to the image's).
    """

    found: bool
    corners: Float | None = None
    covariances: Float | None = None
    edge_width: float = float("nan")
    confidence: float = 0.0
    other_size: tuple[int, int] | None = None
    message: str = ""
    stages: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)


def detect_chessboard(image: ArrayLike, board: Chessboard | tuple[int, int]) -> Float | None:
    """Find a chessboard's inner corners.

    Parameters
    ----------
    image : array_like of shape (H, W) or (H, W, 3), uint8, uint16 or float
        Grey or RGB.
    board : Chessboard or (columns, rows)
        The board to look for.

    Returns
    -------
    ndarray of shape (N, 2), float64, or None
        The refined corners, row by row in the board's own order, or None if the board is not there.

    Raises
    ------
    InputError
        If the image or the board is not valid.

    Notes
    -----
    Answers to ``cv2.findChessboardCornersSB`` and ``cv2.findChessboardCorners`` with ``cv2.cornerSubPix``.
    :func:`detect_chessboard_detailed` says how sure it is, and why a board was not found.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> dark = np.add.outer(np.arange(7), np.arange(8)) % 2
    >>> image = np.pad(np.kron(230 - 200 * dark, np.ones((30, 30))), 60, constant_values=230).astype(np.uint8)
    >>> corners = sc.detect_chessboard(image, sc.Chessboard((7, 6)))
    >>> corners.shape
    (42, 2)
    >>> corners[:2].round(1)
    array([[269.5, 239.5],
           [239.5, 239.5]])
    """
    return detect_chessboard_detailed(image, board).corners


def detect_chessboard_detailed(image: ArrayLike, board: Chessboard | tuple[int, int]) -> Detection:
    """Find a chessboard, and say how well or why not.

    Parameters
    ----------
    image : array_like of shape (H, W) or (H, W, 3), uint8, uint16 or float
        Grey or RGB.
    board : Chessboard or (columns, rows)
        The board to look for.

    Returns
    -------
    Detection

    Raises
    ------
    InputError
        If the image or the board is not valid.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> dark = np.add.outer(np.arange(7), np.arange(8)) % 2
    >>> image = np.pad(np.kron(230 - 200 * dark, np.ones((30, 30))), 60, constant_values=230).astype(np.uint8)
    >>> detection = sc.detect_chessboard_detailed(image, sc.Chessboard((7, 6)))
    >>> detection.found, detection.corners.shape
    (True, (42, 2))
    >>> sc.detect_chessboard_detailed(image, sc.Chessboard((9, 6))).found
    False
    """
    if not isinstance(board, Chessboard):
        board = Chessboard(board)
    gray = _as_bytes_or_float(to_gray(image))
    best = Detection(False, message="no corner of a chessboard was seen; is the board in the picture, and sharp?")
    others: list[Detection] = []
    for levels in (_pyramid(gray, board), _closed_pyramid(gray, board)):
        for level, scale in levels:
            attempt = _search_level(level, scale, gray, board)
            if not attempt.found:
                others.append(attempt)
                best = attempt if _progress(attempt) >= _progress(best) else best
            elif not any(_dwarfed(attempt, other) for other in others):
                return attempt
        if best.other_size and np.prod(best.other_size) > board.corner_count:
            break  # a larger board was seen whole: no part of it is the one asked for
    return best


def _dwarfed(found: Detection, other: Detection) -> bool:
    """Whether a coarser level saw a larger grid: around the small one, which is then a part of it, or much larger."""
    larger = other.stages.get("grid")
    if larger is None or found.corners is None or len(larger) <= len(found.corners):
        return False
    low, high, middle = larger.min(axis=0), larger.max(axis=0), found.corners.mean(axis=0)
    around = bool(np.all((low < middle) & (middle < high))) and len(larger) > 1.3 * len(found.corners)
    much_larger = np.prod(high - low) > 8 * np.prod(np.ptp(found.corners, axis=0))
    return around or (other.other_size is not None and bool(much_larger))


def _progress(detection: Detection) -> float:
    grid = detection.stages.get("grid")
    return (1e6 if detection.other_size else 0) + (0 if grid is None else len(grid))


def _as_bytes_or_float(gray: NDArray[Any]) -> NDArray[Any]:
    """Bytes as they are; all else as float32 stretched to 0..255, because thresholds are in grey levels of bytes."""
    if gray.dtype == np.uint8:
        return gray
    low, high = float(gray.min()), float(gray.max())
    stretch = 255.0 / (high - low) if high > low else 1.0
    return ((gray.astype(np.float64) - low) * stretch).astype(np.float32)


def _halved(gray: NDArray[Any], smallest: int, least_side: int) -> list[tuple[NDArray[Any], float]]:
    """The image and its halves while the longest side stays above `smallest` and the shortest above `least_side`."""
    from stereocal.board.saddle_kernels import halve

    levels = [(gray, 1.0)]
    while max(levels[-1][0].shape) >= 2 * smallest and min(levels[-1][0].shape) >= 2 * least_side:
        fine, scale = levels[-1]
        coarse = np.empty((fine.shape[0] // 2, fine.shape[1] // 2), np.float32)
        halve(fine, coarse)
        levels.append((coarse, 2 * scale))
    return levels


def _closed_pyramid(gray: NDArray[Any], board: Chessboard) -> Any:
    """Levels whose dark, then whose light parts have grown by one and by two pixels, coarse to fine."""
    from stereocal.board.saddle_kernels import spread_darkest

    for level, scale in reversed(_halved(gray, _SMALLEST_LEVEL // 2, 6 * max(board.inner_corners))):
        if level.size > _LARGEST_CLOSED:
            break
        for tone in (1, -1):
            grown = level
            for _ in range(2):
                former, grown = grown, np.empty(level.shape, np.float32)
                spread_darkest(former, tone, grown)
                yield grown, scale


def _pyramid(gray: NDArray[Any], board: Chessboard) -> Any:
    """Levels from coarse to fine, each with its scale: image pixel = scale * (level pixel + 0.5) - 0.5."""
    from stereocal.board.saddle_kernels import double

    yield from reversed(_halved(gray, _SMALLEST_LEVEL, 6 * max(board.inner_corners)))
    if max(gray.shape) <= 800:
        fine = np.empty((2 * gray.shape[0], 2 * gray.shape[1]), np.float32)
        double(gray, fine)
        yield fine, 0.5


def _search_level(level: NDArray[Any], scale: float, gray: NDArray[Any], board: Chessboard) -> Detection:
    G, S = saddle_response(level)
    candidates, maxima = saddle_candidates(G, S)
    stages: dict[str, Any] = {"response": S, "candidates": candidates, "maxima": maxima, "grid": None, "scale": scale}
    grids = grow_grids(G, candidates, max(board.inner_corners))
    if not grids:
        return Detection(
            False, message=f"{len(candidates)} corners were seen, but no four of them form a square", stages=stages
        )
    stages["grid"] = scale * (grids[0].points[grids[0].known] + 0.5) - 0.5
    reasons = []
    for grid in grids:
        part, reason, other = _choose_board(G, grid, board)
        if part is None:
            reasons.append((reason, other))
            continue
        corners = _ordered(part, board)
        corners = scale * (corners + 0.5) - 0.5
        fit = fit_corner_grid(gray, corners)
        problem = _judge(fit, corners)
        if problem is None:
            return Detection(
                True,
                fit.corners,
                fit.covariances,
                float(np.median(fit.edge_widths)),
                _confidence(fit),
                None,
                "",
                stages,
            )
        reasons.append((problem, None))
        stages["fit"] = fit
    return Detection(False, other_size=reasons[0][1], message=reasons[0][0], stages=stages)


def _choose_board(
    G: NDArray[np.float32], grid: Grid, board: Chessboard
) -> tuple[Grid | None, str, tuple[int, int] | None]:
    """The part of a grid that is the board asked for, or the reason why not and the size that was seen."""
    seen = drop_ragged_lines(grid)
    columns, rows = seen.shape
    wanted = {board.inner_corners, board.inner_corners[::-1]}
    size = (max(columns, rows), min(columns, rows))
    if (columns, rows) in wanted:
        if seen.known.all():
            if outer_extents(G, seen).max() > _GOES_ON:
                return None, f"the board goes on beyond the {board} corners seen: it is larger, or partly lost", None
            return seen, "", None
        count = int(seen.known.sum())
        return (
            None,
            f"{count} of the {board.corner_count} corners were seen; the others are covered or too blurred",
            None,
        )
    spare = [(columns - c, rows - r) for c, r in wanted]
    if (1, 0) in spare or (0, 1) in spare:
        part = _without_covered_line(G, seen, (1, 0) in spare)
        if part is not None and part.known.all() and part.shape in wanted:
            return part, "", None
    if min(columns, rows) < 3 or not seen.known.all():
        return None, f"only a part of {columns}x{rows} corners was seen, not {board}", None
    return None, f"a board of {size[0]}x{size[1]} inner corners was seen, not {board}", size


def _without_covered_line(G: NDArray[np.float32], seen: Grid, along_i: bool) -> Grid | None:
    """The grid without the border line whose outer squares are cut off, if those of the other end are whole."""
    extents = outer_extents(G, seen)
    first, last = (extents[0], extents[1]) if along_i else (extents[2], extents[3])
    if min(first, last) >= _COVERED or abs(first - last) < _WHOLE:
        return None
    columns, rows = seen.shape
    if along_i:
        return seen.window(int(first < last), 0, columns - 1, rows)
    return seen.window(0, int(first < last), columns, rows - 1)


def _ordered(grid: Grid, board: Chessboard) -> Float:
    """Corners as (rows, columns, 2) in the board's order: clockwise frame, dark square first; see chessboard."""
    points, parity = grid.points.transpose(1, 0, 2), grid.parity  # (J, I, 2)
    options = []
    for transpose in (False, True):
        for flip_i in (False, True):
            for flip_j in (False, True):
                p = points.transpose(1, 0, 2) if transpose else points
                p = p[:, ::-1] if flip_i else p
                p = p[::-1] if flip_j else p
                if p.shape[:2] != (board.rows, board.columns):
                    continue
                x, y = p[0, -1] - p[0, 0] + p[-1, -1] - p[-1, 0], p[-1, 0] - p[0, 0] + p[-1, -1] - p[0, -1]
                if x[0] * y[1] - x[1] * y[0] <= 0:
                    continue
                # the square between +i and +j of the first corner has the colour of the one diagonally outside
                i, j = (
                    (grid.shape[0] - 1 if _reversed_axes(transpose, flip_i, flip_j)[0] else 0),
                    (grid.shape[1] - 1 if _reversed_axes(transpose, flip_i, flip_j)[1] else 0),
                )
                turns = int(flip_i) + int(flip_j)
                dark = ((i + j) % 2 == parity) != (turns % 2 == 1)
                options.append((not dark, float(p[0, 0].sum()), p))
    return np.ascontiguousarray(min(options, key=lambda option: option[:2])[2])


def _reversed_axes(transpose: bool, flip_i: bool, flip_j: bool) -> tuple[bool, bool]:
    """Which of the grid's own axes are reversed."""
    return (flip_j, flip_i) if transpose else (flip_i, flip_j)


def _judge(fit: SaddleFit, corners: Float) -> str | None:
    """Why the fitted corners are not a board's, or None."""
    lost = int(np.count_nonzero(~fit.converged))
    if lost:
        return f"{lost} of the {len(fit.converged)} corners could not be measured; the picture may be blurred there"
    return None


def _confidence(fit: SaddleFit) -> float:
    """Share of the contrast that the model explains, in the median corner: 1 - (noise / half contrast)^2."""
    unexplained = (2 * fit.noise / fit.contrasts) ** 2
    return float(np.clip(1 - np.median(unexplained), 0, 1))
