"""From corners to a grid: links, closed cells, and growth by local prediction.

A chessboard seen by a camera is a grid only locally: perspective, a fisheye lens and a bent board change its steps from
place to place. So nothing here fits one homography to the board. Three local rules build the grid:

**Links** join corners whose edges point at each other with the same polarity, and closed **cells** of four links say
which to trust (:mod:`stereocal.board.links`). Walking them gives each corner its coordinates (i, j).

**Growth** predicts the corners missing next to known ones, and adds those that the image shows
(:mod:`stereocal.board.growth`). This finds corners that the ring test lost to glare, at the image's edge, or because
their squares are too small for the ring.

Which part of the grid is the board asked for is decided later (:mod:`stereocal.board.selection`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.board.growth import grow_corners, outer_reach
from stereocal.board.links import link_corners

GROWTH_SHARE = 0.35
"""Least contrast of a grown corner's squares, as a share of that of its neighbours."""
FADED_SHARE = 0.1
"""The same where nearly all corners of the board stand."""
_LINE_SHARE = 0.6
_MOST_GRIDS = 4  # of all pieces, so many of the largest are grown


@dataclass
class Grid:
    """Corners in a grid.

    Attributes
    ----------
    points : ndarray of shape (I, J, 2)
        x, y of corner (i, j).
    known : ndarray of shape (I, J), bool
        Whether the corner was seen.
    evidence : ndarray of shape (I, J)
        Half the least difference between the light and the dark squares around it, grey levels.
    parity : int
        The square between +i and +j of corner (i, j) is dark if (i + j) % 2 == parity.
    place : tuple of int
        Where the grid starts in the one it was cut from.
    """

    points: Float
    known: NDArray[np.bool_]
    evidence: Float
    parity: int
    place: tuple[int, int] = (0, 0)

    @property
    def shape(self) -> tuple[int, int]:
        """(I, J)."""
        return self.known.shape[0], self.known.shape[1]

    def window(self, i: int, j: int, columns: int, rows: int) -> Grid:
        """The part of the grid that starts at (i, j)."""
        part = np.s_[i : i + columns, j : j + rows]
        place = (self.place[0] + i, self.place[1] + j)
        return Grid(self.points[part], self.known[part], self.evidence[part], (self.parity + i + j) % 2, place)

    def offset_of(self, part: Grid) -> tuple[int, int]:
        """Where a window of this grid starts in it."""
        return part.place[0] - self.place[0], part.place[1] - self.place[1]


def grow_grids(
    G: NDArray[np.float32], candidates: Float, reach: int, least_corners: int = 6, *, backend: str = "numba"
) -> list[Grid]:
    """Grids of linked corners, each grown as far as the image shows it; the largest first.

    Parameters
    ----------
    G : ndarray of shape (H, W), float32
        The smoothed image.
    candidates : ndarray of shape (n, 7)
        From :func:`stereocal.board.saddle.saddle_candidates`.
    reach : int
        How many lines a grid may grow on each side beyond the linked corners.
    least_corners : int
        Smaller pieces are left out.
    backend : {"numba", "numpy"}
        The kernels, or the readable references (they agree to rounding).
    """
    if len(candidates) < 4:
        return []
    links = link_corners(G, candidates, backend=backend)
    if not links.count:
        return []
    sizes = np.bincount(links.component[links.component >= 0], minlength=links.count)
    grids = []
    for number in np.argsort(-sizes, kind="stable")[:_MOST_GRIDS]:
        if sizes[number] < least_corners:
            break
        members = np.nonzero(links.component == number)[0]
        grid = _as_grid(candidates[members], links.place[members], links.turned[members], reach)
        grow_corners(G, grid.points, grid.known, grid.evidence, grid.parity, GROWTH_SHARE, backend=backend)
        grids.append(_cropped(grid))
    return sorted(grids, key=lambda grid: -int(grid.known.sum()))


def _as_grid(corners: Float, place: NDArray[Any], turned: NDArray[Any], reach: int) -> Grid:
    start = place.min(axis=0) - reach
    shape = tuple(place.max(axis=0) + reach + 1 - start)
    i, j = (place - start).T
    grid = Grid(np.zeros((*shape, 2)), np.zeros(shape, np.bool_), np.zeros(shape), 0)
    order = np.argsort(corners[:, 6])  # where two claim one place, the stronger stays
    grid.points[i[order], j[order]] = corners[order, :2]
    grid.known[i, j] = True
    grid.evidence[i[order], j[order]] = corners[order, 6]
    # even edges lead from light into dark with growing angle: where +i is one, the square between +i and +j is dark
    grid.parity = int((i[0] + j[0] + turned[0]) % 2)
    return grid


def _cropped(grid: Grid) -> Grid:
    i, j = np.nonzero(grid.known)
    return grid.window(i.min(), j.min(), int(np.ptp(i)) + 1, int(np.ptp(j)) + 1)


def drop_ragged_lines(grid: Grid, least_share: float = _LINE_SHARE) -> Grid:
    """The grid without border lines of which less than `least_share` of the corners were seen."""
    while min(grid.shape) > 1:
        known, (columns, rows) = grid.known, grid.shape
        shares = [known[0].mean(), known[-1].mean(), known[:, 0].mean(), known[:, -1].mean()]
        side = int(np.argmin(shares))
        if shares[side] >= least_share:
            break
        i, j = int(side == 0), int(side == 2)
        grid = grid.window(i, j, columns - (side < 2), rows - (side >= 2))
    return grid


def fill_grid(G: NDArray[np.float32], grid: Grid) -> Grid:
    """The grid with its missing corners grown on little evidence: where nearly all stand, few places are in question.

    Parameters
    ----------
    G : ndarray of shape (H, W), float32
        The smoothed image.
    grid : Grid
        Nearly full.
    """
    filled = Grid(grid.points.copy(), grid.known.copy(), grid.evidence.copy(), grid.parity, grid.place)
    grow_corners(G, filled.points, filled.known, filled.evidence, filled.parity, FADED_SHARE)
    return filled


def outer_extents(G: NDArray[np.float32], grid: Grid) -> Float:
    """How far the squares beyond each border line of the grid reach outwards, in steps.

    Parameters
    ----------
    G : ndarray of shape (H, W), float32
        The smoothed image.
    grid : Grid
        A full grid.

    Returns
    -------
    ndarray of shape (4,), float64
        Sides i = 0, i = I-1, j = 0, j = J-1: about 1 where the outer squares are whole, less where they are cut off,
        1.5 where a further line of squares follows.
    """
    points = np.ascontiguousarray(grid.points)
    return np.array([outer_reach(G, points, side) for side in range(4)])
