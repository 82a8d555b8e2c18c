"""Links between neighbouring corners, the closed cells that confirm them, and coordinates by walking them.

**Links.** Each corner knows its four edges and which side of them is dark (:mod:`stereocal.board.ring`). Corners a and
b are neighbours if an edge of a points to b and an edge of b points to a, if the polarities agree, and if along the
whole way the one side is lighter than the other. The last test is what makes it safe: behind every corner of a board
the colours change sides, so a way that skips a corner fails it. Of several neighbours the nearest is taken, and links
must be mutual.

With the edge angle t of a and d = b - a, "points to" is ``d . (cos t, sin t) >= cos(tolerance) |d|``. Edges are
numbered so that even ones have the dark on their right (seen on the picture, y down): seen from the other end the dark
is on the left, so even edges lead to odd ones.

**Cells.** A link is trusted if it is a side of a closed cell: four links, turning the same way at each corner, lead
back to the start. Chance links between letters and furniture close no cells.

**Coordinates.** Walking the trusted links gives each corner its place (i, j); a corner reached at two places is left
out.

Source: closed cells of linked corners are used by Ha et al., *Deltille grids for geometric camera calibration*, ICCV
2017. The edge-polarity test is ours.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.board.ring import bilinear

LINK_TOLERANCE = 0.35
"""Largest angle between an edge at a corner and the way to the neighbour, radians: 20 degrees hold in a fisheye."""
LINK_LEAST_SHARE = 0.2
"""Least contrast along a link, as a share of the contrast at its ends."""
NEIGHBOURS = 20
"""So many nearest other corners are looked at."""
_STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))


@dataclass(frozen=True)
class Links:
    """Corners joined into pieces of grids.

    Attributes
    ----------
    link, back : ndarray of shape (n, 4), int64
        The corner that each edge leads to, -1 if none, and the number of its edge that leads back.
    trusted : ndarray of shape (n, 4), bool
        Whether the link is a side of a closed cell.
    component : ndarray of shape (n,), int64
        Number of the piece a corner belongs to; -1 without a trusted link, -2 where two ways lead to different places.
    place : ndarray of shape (n, 2), int64
        (i, j) in the piece.
    turned : ndarray of shape (n,), int64
        Which edge is the corner's +i direction; the next ones are +j, -i, -j.
    count : int
        Number of pieces.
    """

    link: NDArray[np.int64]
    back: NDArray[np.int64]
    trusted: NDArray[np.bool_]
    component: NDArray[np.int64]
    place: NDArray[np.int64]
    turned: NDArray[np.int64]
    count: int


def link_corners(G: NDArray[np.float32], candidates: Float, *, backend: str = "numba") -> Links:
    """Join corners to their neighbours, and walk the cells that closes.

    Parameters
    ----------
    G : ndarray of shape (H, W), float32
        The smoothed image.
    candidates : ndarray of shape (n, 7)
        From :func:`stereocal.board.saddle.saddle_candidates`, n >= 2.
    backend : {"numba", "numpy"}
        The kernels, or the readable references (they agree exactly).

    Returns
    -------
    Links
    """
    if backend == "numpy":
        link, back = _link_reference(G.astype(np.float64), candidates)
        trusted = _cells_reference(link, back)
        return Links(link, back, trusted, *_walk_reference(link, back, trusted))
    from stereocal.board import link_kernels as kernels

    n = len(candidates)
    near = np.empty((n, min(NEIGHBOURS, n - 1)), np.int64)
    kernels.nearest_others(candidates, near)
    link, back = np.empty((n, 4), np.int64), np.zeros((n, 4), np.int64)
    kernels.link_corners(G, candidates, near, LINK_TOLERANCE, LINK_LEAST_SHARE, link, back)
    trusted = np.empty((n, 4), np.bool_)
    kernels.mark_cells(link, back, trusted)
    component, place, turned = np.empty(n, np.int64), np.zeros((n, 2), np.int64), np.zeros(n, np.int64)
    count = kernels.walk_components(link, back, trusted, component, place, turned)
    return Links(link, back, trusted, component, place, turned, count)


def nearest_reference(points: Float, k: int) -> NDArray[np.int64]:
    """Indices of the k nearest other points, nearest first, of equally near ones the lower: all distances, sorted."""
    d = points[:, None, :2] - points[None, :, :2]
    square = d[..., 0] * d[..., 0] + d[..., 1] * d[..., 1]
    np.fill_diagonal(square, np.inf)
    return np.argsort(square, axis=1, kind="stable")[:, :k]


def _edge_holds(gray: Float, a: Float, b: Float, least: float) -> bool:
    """Whether left is lighter than right of the way from a to b by more than `least` all along its inner part."""
    d = b - a
    length = np.hypot(*d)
    normal = np.array([-d[1], d[0]]) / length * max(1.0, 0.15 * length)
    t = 0.2 + 0.6 * np.linspace(0, 1, 5 if length < 24 else 9)
    way = a + t[:, None] * d
    left, right = way - normal, way + normal
    return bool(np.all(bilinear(gray, *left.T) - bilinear(gray, *right.T) > least))


def _link_reference(gray: Float, candidates: Float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    n = len(candidates)
    points, amplitude = candidates[:, :2], candidates[:, 6]
    direction = np.stack([np.cos(candidates[:, 2:6]), np.sin(candidates[:, 2:6])], axis=-1)
    link, back = np.full((n, 4), -1), np.zeros((n, 4), np.int64)
    for i, near in enumerate(nearest_reference(points, min(NEIGHBOURS, n - 1))):
        for j in near:
            d = points[j] - points[i]
            distance = np.hypot(*d)
            if distance < 3.0 or not 0.25 <= amplitude[i] / amplitude[j] <= 4.0:
                continue
            leads, leads_back = direction[i] @ d, -direction[j] @ d
            least = LINK_LEAST_SHARE * (amplitude[i] + amplitude[j])
            for e in range(4):
                if link[i, e] >= 0 or leads[e] < np.cos(LINK_TOLERANCE) * distance:
                    continue
                ends = (points[i], points[j]) if e % 2 == 0 else (points[j], points[i])
                for f in range(1 - e % 2, 4, 2):
                    if leads_back[f] >= np.cos(LINK_TOLERANCE) * distance and _edge_holds(gray, *ends, least):
                        link[i, e], back[i, e] = j, f
    mutual = (link >= 0) & (link[link, back] == np.arange(n)[:, None]) & (back[link, back] == np.arange(4))
    return np.where(mutual, link, -1), back


def _cells_reference(link: NDArray[np.int64], back: NDArray[np.int64]) -> NDArray[np.bool_]:
    trusted = np.zeros(link.shape, np.bool_)
    for start in np.argwhere(link >= 0):
        corner, edge = start
        sides: list[tuple[int, int]] = []
        while link[corner, edge] >= 0 and len(sides) < 4:
            sides.append((corner, edge))
            # arrived on edge b of the next corner; the next side of the cell, keeping it on the right, is b - 1
            corner, edge = link[corner, edge], (back[corner, edge] + 3) % 4
        if len(sides) == 4 and (corner, edge) == tuple(start):
            for corner, edge in sides:
                trusted[corner, edge] = trusted[link[corner, edge], back[corner, edge]] = True
    return trusted


def _walk_reference(link: NDArray[np.int64], back: NDArray[np.int64], trusted: NDArray[np.bool_]) -> tuple[Any, ...]:
    n = len(link)
    component, place, turned, count = np.full(n, -1), np.zeros((n, 2), np.int64), np.zeros(n, np.int64), 0
    for first in np.nonzero(trusted.any(axis=1))[0]:
        if component[first] != -1:
            continue
        component[first] = count
        queue = deque([first])
        while queue:
            corner = queue.popleft()
            if component[corner] == -2:
                continue
            for direction, step in enumerate(_STEPS):
                edge = (turned[corner] + direction) % 4
                if not trusted[corner, edge]:
                    continue
                other, there = link[corner, edge], place[corner] + step
                turn = (back[corner, edge] - direction - 2) % 4
                if component[other] == -1:
                    component[other], place[other], turned[other] = count, there, turn
                    queue.append(other)
                elif component[other] == count and (tuple(place[other]) != tuple(there) or turned[other] != turn):
                    component[other] = -2
        count += 1
    return component, place, turned, count
