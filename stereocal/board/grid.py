"""From corners to a grid: links, closed cells, and growth by local prediction.

A chessboard seen by a camera is a grid only locally: perspective, a fisheye lens and a bent board change its steps from
place to place. So nothing here fits one homography to the board. Three local rules build the grid:

**Links.** Each corner knows its four edges and which side of them is dark (:mod:`stereocal.board.saddle`). Corners a
and b are neighbours if an edge of a points to b and an edge of b points to a, if the polarities agree, and if along
the whole way the one side is lighter than the other. The last test is what makes it safe: behind every corner of a
board the colours change sides, so a way that skips a corner fails it. Of several neighbours the nearest is taken, and
links must be mutual.

**Cells.** A link is trusted if it is a side of a closed cell: four links, turning right at each corner, lead back to
the start. Chance links between letters and furniture close no cells. Walking the trusted links gives each corner its
coordinates (i, j); a corner reached at two places is left out.

**Growth.** A corner that is missing next to known ones is predicted from them: the last step again, corrected by the
change of the step in the row beside or the step before, which is exact for any smooth map to first order in the
change. If the image has a saddle there, and the four squares around show their colours, it is added. This finds
corners that the ring test lost to glare, at the image's edge, or because their squares are too small for the ring.

**The board's size.** The lines of the grid at its border that are mostly missing are letters or a frame: they are
dropped. Then the rectangle must be the one asked for. If it is larger by a single line, and that line's outer squares
are cut off while those at the other end are whole, the board is partly covered there (the paper's photographs): the
complete lines are taken. In every other case another size is reported, and no corners. And where the rectangle is the
one asked for, but the squares go on beyond it, it is a part of a larger board whose other corners were lost: no
corners either, because they would be numbered from the wrong end.

Sources: the growth by local prediction follows the idea of Geiger et al., ICRA 2012, who minimise an energy for each
proposed line; closed cells of linked corners are used by Ha et al., *Deltille grids for geometric camera calibration*,
ICCV 2017. The edge-polarity test and the rule of the covered line are ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float

LINK_TOLERANCE = 0.35
"""Largest angle between an edge at a corner and the way to the neighbour, radians: 20 degrees hold in a fisheye."""
LINK_LEAST_SHARE = 0.2
"""Least contrast along a link, as a share of the contrast at its ends."""
NEIGHBOURS = 20
GROWTH_SHARE = 0.35
_LINE_SHARE = 0.6


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
    """

    points: Float
    known: NDArray[np.bool_]
    evidence: Float
    parity: int

    @property
    def shape(self) -> tuple[int, int]:
        """(I, J)."""
        return self.known.shape[0], self.known.shape[1]

    def window(self, i: int, j: int, columns: int, rows: int) -> Grid:
        """The part of the grid that starts at (i, j)."""
        part = np.s_[i : i + columns, j : j + rows]
        return Grid(self.points[part], self.known[part], self.evidence[part], (self.parity + i + j) % 2)


def grow_grids(G: NDArray[np.float32], candidates: Float, reach: int, least_corners: int = 6) -> list[Grid]:
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
        Smaller components are left out.
    """
    from stereocal.board import grid_kernels as kernels

    n = len(candidates)
    if n < 4:
        return []
    near = np.empty((n, min(NEIGHBOURS, n - 1)), np.int64)
    kernels.nearest_others(candidates, near)
    link, back = np.empty((n, 4), np.int64), np.zeros((n, 4), np.int64)
    kernels.link_corners(G, candidates, near, LINK_TOLERANCE, LINK_LEAST_SHARE, link, back)
    trusted = np.empty((n, 4), np.bool_)
    kernels.mark_cells(link, back, trusted)
    component, place, turned = np.empty(n, np.int64), np.empty((n, 2), np.int64), np.empty(n, np.int64)
    count = kernels.walk_components(link, back, trusted, component, place, turned)
    if not count:
        return []
    sizes = np.bincount(component[component >= 0], minlength=count)
    grids = []
    for number in np.argsort(-sizes, kind="stable")[:4]:
        if sizes[number] < least_corners:
            break
        members = np.nonzero(component == number)[0]
        grid = _as_grid(candidates[members], place[members], turned[members], reach)
        kernels.grow_grid(G, grid.points, grid.known, grid.evidence, grid.parity, GROWTH_SHARE)
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
        Sides i = 0, i = I-1, j = 0, j = J-1: 1 or more where the outer squares are whole, less where they are cut off;
        up to 1.5, the last 0.4 of which only the squares of a further line can give.
    """
    from stereocal.board.grid_kernels import outer_reach

    points = np.ascontiguousarray(grid.points)
    return np.array([outer_reach(G, points, side) for side in range(4)])
