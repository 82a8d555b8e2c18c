# mypy: allow-untyped-defs
"""Kernels of :mod:`stereocal.board.links`: neighbours, links between them, closed cells, components."""

from __future__ import annotations

import numpy as np
from numba import njit

# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _bilinear(G, x, y):
    height, width = G.shape
    x = min(max(x, 0.0), width - 1.001)
    y = min(max(y, 0.0), height - 1.001)
    ix, iy = int(x), int(y)
    fx, fy = x - ix, y - iy
    return (G[iy, ix] * (1 - fx) + G[iy, ix + 1] * fx) * (1 - fy) + (
        G[iy + 1, ix] * (1 - fx) + G[iy + 1, ix + 1] * fx
    ) * fy


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def edge_holds(G, ax, ay, bx, by, least):
    """Whether left is lighter than right of the way from a to b by more than `least`, at samples of its inner part.

    Left and right are seen on the image with y down: right is the side of growing angle.
    """
    dx, dy = bx - ax, by - ay
    length = np.sqrt(dx * dx + dy * dy)
    offset = max(1.0, 0.15 * length)
    nx, ny = -dy / length * offset, dx / length * offset
    steps = 5 if length < 24 else 9
    for i in range(steps):
        t = 0.2 + 0.6 * i / (steps - 1)
        x, y = ax + t * dx, ay + t * dy
        if not _bilinear(G, x - nx, y - ny) - _bilinear(G, x + nx, y + ny) > least:
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _sort_into_bins(points, x0, y0, side, columns, rows, first, members):
    """Counting sort: members[first[b] : first[b + 1]] are the points of bin b, in the order of their numbers."""
    n = points.shape[0]
    first[:] = 0
    for i in range(n):
        b = int((points[i, 1] - y0) / side) * columns + int((points[i, 0] - x0) / side)
        first[b + 1] += 1
    for b in range(columns * rows):
        first[b + 1] += first[b]
    place = first[:-1].copy()
    for i in range(n):
        b = int((points[i, 1] - y0) / side) * columns + int((points[i, 0] - x0) / side)
        members[place[b]] = i
        place[b] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_others(points, near):
    """Indices of the nearest other points, nearest first (of equally near ones the lower), -1 where there are fewer.

    The points lie in square bins, four in each on average; the bins are visited ring by ring around the point's own,
    until no bin outside can hold a nearer point than the last one kept.
    """
    n, k = near.shape
    x0, y0, x1, y1 = np.inf, np.inf, -np.inf, -np.inf
    for i in range(n):
        x0, x1 = min(x0, points[i, 0]), max(x1, points[i, 0])
        y0, y1 = min(y0, points[i, 1]), max(y1, points[i, 1])
    wide, high = x1 - x0 + 1.0, y1 - y0 + 1.0
    side = max(np.sqrt(4.0 * wide * high / n), max(wide, high) / n)
    columns, rows = int(wide / side) + 1, int(high / side) + 1
    first, members = np.empty(columns * rows + 1, np.int64), np.empty(n, np.int64)
    _sort_into_bins(points, x0, y0, side, columns, rows, first, members)
    distance = np.empty(k)
    for i in range(n):
        x, y = points[i, 0], points[i, 1]
        column, row = int((x - x0) / side), int((y - y0) / side)
        filled, ring = 0, 0
        while ring < max(columns, rows):
            for r in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
                whole = abs(r - row) == ring  # the ring's upper and lower side; between them only its two ends
                c = column - ring
                while c <= column + ring:
                    if 0 <= c < columns:
                        for m in range(first[r * columns + c], first[r * columns + c + 1]):
                            j = members[m]
                            dx, dy = points[j, 0] - x, points[j, 1] - y
                            d = dx * dx + dy * dy
                            if j == i or (
                                filled == k and (d > distance[k - 1] or (d == distance[k - 1] and j > near[i, k - 1]))
                            ):
                                continue
                            place = filled if filled < k else k - 1
                            while place > 0 and (
                                distance[place - 1] > d or (distance[place - 1] == d and near[i, place - 1] > j)
                            ):
                                distance[place], near[i, place] = distance[place - 1], near[i, place - 1]
                                place -= 1
                            distance[place], near[i, place] = d, j
                            filled = min(filled + 1, k)
                    c += 1 if whole or ring == 0 else 2 * ring
            # every point not yet seen lies beyond the square of the bins visited
            margin = min(
                min(x - x0 - (column - ring) * side, (column + ring + 1) * side - (x - x0)),
                min(y - y0 - (row - ring) * side, (row + ring + 1) * side - (y - y0)),
            )
            if filled == k and distance[k - 1] < margin * margin:
                break
            ring += 1
        near[i, filled:] = -1


@njit(cache=True, nogil=True, error_model="numpy")
def link_corners(G, candidates, near, tolerance, least_share, link, back):
    """For each corner and edge, the nearest corner that the edge leads to.

    A link needs: both edges point at each other within the tolerance (radians), their polarities agree (an edge with
    the dark on its right is, seen from the other end, one with the dark on its left), and light is lighter than dark by
    a share of the amplitudes all the way. `link` (n, 4) gets the neighbour or -1, `back` the number of its edge; only
    mutual links stay.
    """
    n = candidates.shape[0]
    link[:] = -1
    direction = np.empty((n, 4, 2))
    for i in range(n):
        for e in range(4):
            direction[i, e, 0], direction[i, e, 1] = np.cos(candidates[i, 2 + e]), np.sin(candidates[i, 2 + e])
    least_cosine = np.cos(tolerance)
    for i in range(n):
        x, y, amplitude = candidates[i, 0], candidates[i, 1], candidates[i, 6]
        for place in range(near.shape[1]):
            j = near[i, place]
            if j < 0:
                break
            dx, dy = candidates[j, 0] - x, candidates[j, 1] - y
            square = dx * dx + dy * dy
            ratio = amplitude / candidates[j, 6]
            if square < 9.0 or ratio > 4.0 or ratio < 0.25:
                continue
            along = least_cosine * np.sqrt(square)
            for e in range(4):
                if link[i, e] >= 0 or direction[i, e, 0] * dx + direction[i, e, 1] * dy < along:
                    continue
                for f in range(1 - (e % 2), 4, 2):
                    if -(direction[j, f, 0] * dx + direction[j, f, 1] * dy) < along:
                        continue
                    least = least_share * (amplitude + candidates[j, 6])
                    holds = (
                        edge_holds(G, x, y, candidates[j, 0], candidates[j, 1], least)
                        if e % 2 == 0
                        else edge_holds(G, candidates[j, 0], candidates[j, 1], x, y, least)
                    )
                    if holds:
                        link[i, e], back[i, e] = j, f
    for i in range(n):
        for e in range(4):
            j = link[i, e]
            if j >= 0 and (link[j, back[i, e]] != i or back[j, back[i, e]] != e):
                link[i, e] = -2
    for i in range(n):
        for e in range(4):
            if link[i, e] == -2:
                link[i, e] = -1


@njit(cache=True, nogil=True, error_model="numpy")
def mark_cells(link, back, trusted):
    """Trust the links that are sides of a closed cell: four corners, each linked to the next, turning the same way."""
    trusted[:] = False
    for i in range(link.shape[0]):
        for e in range(4):
            corner, edge = i, e
            closed = True
            for _ in range(4):
                following = link[corner, edge]
                if following < 0:
                    closed = False
                    break
                # arrived on edge b of the next corner; the next side of the cell, keeping it on the right, is b - 1
                edge, corner = (back[corner, edge] + 3) % 4, following
            if closed and corner == i and edge == e:
                for _ in range(4):
                    b = back[corner, edge]
                    trusted[corner, edge] = True
                    trusted[link[corner, edge], b] = True
                    edge, corner = (b + 3) % 4, link[corner, edge]


@njit(cache=True, nogil=True, error_model="numpy")
def walk_components(link, back, trusted, component, place, turned):
    """Grid coordinates by walking the trusted links, one component after the other.

    Edge `turned` of a corner is its +i direction; the other edges follow as +j, -i, -j. `place` (n, 2) gets (i, j),
    counted from the component's first corner; `component` (n,) its number, -1 where a corner has no trusted link.
    A corner that a second way reaches at other coordinates breaks the component: it is marked -2 and left out.
    Returns the number of components.
    """
    n = link.shape[0]
    component[:] = -1
    queue = np.empty(n, np.int64)
    components = 0
    for first in range(n):
        if component[first] != -1:
            continue
        any_link = False
        for e in range(4):
            any_link = any_link or trusted[first, e]
        if not any_link:
            continue
        component[first], turned[first] = components, 0
        place[first, 0] = place[first, 1] = 0
        head, tail = 0, 1
        queue[0] = first
        while head < tail:
            corner = queue[head]
            head += 1
            if component[corner] == -2:
                continue
            for direction in range(4):
                edge = (turned[corner] + direction) % 4
                if not trusted[corner, edge]:
                    continue
                other = link[corner, edge]
                i = place[corner, 0] + (1 if direction == 0 else (-1 if direction == 2 else 0))
                j = place[corner, 1] + (1 if direction == 1 else (-1 if direction == 3 else 0))
                turn = (back[corner, edge] - direction - 2 + 8) % 4
                if component[other] == -1:
                    component[other], turned[other] = components, turn
                    place[other, 0], place[other, 1] = i, j
                    queue[tail] = other
                    tail += 1
                elif component[other] == components and (
                    place[other, 0] != i or place[other, 1] != j or turned[other] != turn
                ):
                    component[other] = -2
        components += 1
    return components
