"""Find a chessboard: pyramid, saddles, grid, size, order, subpixel.

The image is halved until it is small, and the search starts there: a board of large squares is found in a thousandth
of the pixels, blur shrinks to nothing, and noise averages out. If the board is not seen whole, the next finer level
is tried, up to the image itself and its double (:mod:`stereocal.board.pyramid`). At each level:

1. saddles of the brightness (:mod:`stereocal.board.saddle`) that pass the ring test (:mod:`stereocal.board.ring`);
2. grids grown from them (:mod:`stereocal.board.grid`);
3. the grid that is the board asked for, and the number of each corner (:mod:`stereocal.board.selection`);
4. the corners measured at full resolution (:mod:`stereocal.board.measuring`), which is also the last test.

**Shadows.** Across the edge of a shadow a light square may be darker than a dark one in the sun, and no ring there
shows four colours in turn. The levels are tried again on the logarithm of the picture, in which the shadow is a step
that is added, and smaller than the one between the colours.

**Parted squares.** Where glare, ink or a thin print has parted the squares that should touch, no level shows the board.
Then the dark parts, or the light ones, are grown by a pixel or two, which closes the gap from both sides alike and
leaves its middle where the corner was, and the levels are tried once more.

These two searches would triple the time that a scene without a board takes. But such a scene shows no part of a grid
either: without one the logarithm is left alone, and gaps are closed at the coarse levels only, where it costs little.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float
from stereocal.base.gray import to_gray
from stereocal.board.chessboard import Chessboard
from stereocal.board.grid import grow_grids
from stereocal.board.measuring import (
    confidence,
    edge_width,
    is_measured,
    measure_corners,
    measure_in_level,
)
from stereocal.board.pyramid import closed_levels, levels, logarithmic_levels
from stereocal.board.saddle import saddle_candidates, saddle_response
from stereocal.board.selection import choose_board, ordered_corners
from stereocal.board.subpixel import compile_fits_ahead


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
        "lattice" (the same as (I, J, 2), NaN where missing), "fit" (that of a board refused),
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
    compile_fits_ahead(gray.dtype)
    best = Detection(False, message="no corner of a chessboard was seen; is the board in the picture, and sharp?")
    others: list[Detection] = []
    longest = max(board.inner_corners)

    def part_of_a_grid_was_seen() -> bool:
        return best.stages.get("grid") is not None

    searches = (
        (False, levels(gray, longest)),
        (False, logarithmic_levels(gray, longest, part_of_a_grid_was_seen)),
        (True, closed_levels(gray, longest, part_of_a_grid_was_seen)),
    )
    for closed, search in searches:
        for level, scale in search:
            attempt = _search_level(level, scale, gray, board, closed)
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


def _search_level(level: NDArray[Any], scale: float, gray: NDArray[Any], board: Chessboard, closed: bool) -> Detection:
    G, S = saddle_response(level)
    candidates, maxima = saddle_candidates(G, S)
    stages: dict[str, Any] = {"response": S, "candidates": candidates, "maxima": maxima, "grid": None, "scale": scale}
    grids = grow_grids(G, candidates, max(board.inner_corners))
    if not grids:
        return Detection(
            False, message=f"{len(candidates)} corners were seen, but no four of them form a square", stages=stages
        )
    stages["grid"] = scale * (grids[0].points[grids[0].known] + 0.5) - 0.5
    stages["lattice"] = scale * (np.where(grids[0].known[..., None], grids[0].points, np.nan) + 0.5) - 0.5
    reasons = []
    for grid in grids:
        choice = choose_board(G, grid, board)
        if choice.grid is None:
            reasons.append((choice.reason, choice.other_size))
            continue
        in_level = ordered_corners(choice.grid, board)
        corners = scale * (in_level + 0.5) - 0.5
        fit = measure_corners(gray, corners)
        if closed and not is_measured(fit):
            fit = measure_in_level(level, in_level, scale)
        if is_measured(fit):
            width, sure = edge_width(fit), confidence(fit)
            return Detection(True, fit.corners, fit.covariances, width, sure, None, "", stages)
        lost = int(np.count_nonzero(~fit.converged))
        reason = f"{lost} of the {len(fit.converged)} corners could not be measured; the picture may be blurred there"
        reasons.append((reason, None))
        stages["fit"] = fit
    return Detection(False, other_size=reasons[0][1], message=reasons[0][0], stages=stages)
