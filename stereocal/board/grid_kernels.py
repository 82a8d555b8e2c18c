# mypy: allow-untyped-defs
"""Kernels of :mod:`stereocal.board.grid`: links between neighbouring corners, cells, components, growth."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def _bilinear(G, x, y):
    height, width = G.shape
    x = min(max(x, 0.0), width - 1.001)
    y = min(max(y, 0.0), height - 1.001)
    ix, iy = int(x), int(y)
    fx, fy = x - ix, y - iy
    return (G[iy, ix] * (1 - fx) + G[iy, ix + 1] * fx) * (1 - fy) + (
        G[iy + 1, ix] * (1 - fx) + G[iy + 1, ix + 1] * fx
    ) * fy


@njit(cache=True, nogil=True, error_model="numpy")
def edge_contrast(G, ax, ay, bx, by):
    """Least difference, left minus right of the way from a to b, over samples along its inner part.

    Left and right are seen on the image with y down: right is the side of growing angle.
    """
    dx, dy = bx - ax, by - ay
    length = np.sqrt(dx * dx + dy * dy)
    offset = max(1.0, 0.15 * length)
    nx, ny = -dy / length * offset, dx / length * offset
    least = 1e30
    steps = 5 if length < 24 else 9
    for i in range(steps):
        t = 0.2 + 0.6 * i / (steps - 1)
        x, y = ax + t * dx, ay + t * dy
        least = min(least, _bilinear(G, x - nx, y - ny) - _bilinear(G, x + nx, y + ny))
    return least


@njit(cache=True, nogil=True, error_model="numpy")
def _turn(angle):
    """An angle brought to (-pi, pi]."""
    return angle - 2 * np.pi * np.floor((angle + np.pi) / (2 * np.pi))


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_others(points, near):
    """Indices of the nearest other points, nearest first, -1 where there are fewer."""
    n, k = near.shape
    distance = np.empty(k)
    for i in range(n):
        filled = 0
        x, y = points[i, 0], points[i, 1]
        for j in range(n):
            if j == i:
                continue
            dx, dy = points[j, 0] - x, points[j, 1] - y
            d = dx * dx + dy * dy
            if filled == k and d >= distance[k - 1]:
                continue
            place = filled if filled < k else k - 1
            while place > 0 and distance[place - 1] > d:
                distance[place], near[i, place] = distance[place - 1], near[i, place - 1]
                place -= 1
            distance[place], near[i, place] = d, j
            filled = min(filled + 1, k)
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
    for i in range(n):
        x, y = candidates[i, 0], candidates[i, 1]
        for place in range(near.shape[1]):
            j = near[i, place]
            if j < 0:
                break
            dx, dy = candidates[j, 0] - x, candidates[j, 1] - y
            if dx * dx + dy * dy < 9.0:
                continue
            ratio = candidates[i, 6] / candidates[j, 6]
            if ratio > 4.0 or ratio < 0.25:
                continue
            heading = np.arctan2(dy, dx)
            for e in range(4):
                if link[i, e] >= 0 or abs(_turn(heading - candidates[i, 2 + e])) > tolerance:
                    continue
                for f in range(1 - (e % 2), 4, 2):
                    if abs(_turn(heading + np.pi - candidates[j, 2 + f])) > tolerance:
                        continue
                    contrast = (
                        edge_contrast(G, x, y, candidates[j, 0], candidates[j, 1])
                        if e % 2 == 0
                        else edge_contrast(G, candidates[j, 0], candidates[j, 1], x, y)
                    )
                    if contrast > least_share * (candidates[i, 6] + candidates[j, 6]):
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


@njit(cache=True, nogil=True, error_model="numpy")
def predict_corner(grid, known, i, j, out):
    """Where corner (i, j) should be, from its neighbours; returns how many predictions were averaged.

    `out` gets x, y, and the steps along i and along j there (6 numbers). Between two known neighbours: the middle.
    Beyond them: the last step again, changed as the step changed in the row beside (a parallelogram), or not changed.
    """
    columns, rows = known.shape
    out[:] = 0.0
    total = 0.0
    for axis in range(2):
        di, dj = (1, 0) if axis == 0 else (0, 1)
        for sign in (1, -1):
            ai, aj = i - sign * di, j - sign * dj  # the neighbour that is known
            if not (0 <= ai < columns and 0 <= aj < rows and known[ai, aj]):
                continue
            # the step from that neighbour: of the rows beside it
            for side in (1, -1):
                si, sj = side * dj, side * di
                bi, bj, ci, cj = ai + si, aj + sj, i + si, j + sj
                if (
                    0 <= bi < columns
                    and 0 <= bj < rows
                    and known[bi, bj]
                    and 0 <= ci < columns
                    and 0 <= cj < rows
                    and known[ci, cj]
                ):
                    w = 1.0
                    out[0] += w * (grid[ai, aj, 0] + grid[ci, cj, 0] - grid[bi, bj, 0])
                    out[1] += w * (grid[ai, aj, 1] + grid[ci, cj, 1] - grid[bi, bj, 1])
                    total += w
            bi, bj = ai - sign * di, aj - sign * dj
            if 0 <= bi < columns and 0 <= bj < rows and known[bi, bj]:
                w = 1.0
                x, y = 2 * grid[ai, aj, 0] - grid[bi, bj, 0], 2 * grid[ai, aj, 1] - grid[bi, bj, 1]
                ci, cj = bi - sign * di, bj - sign * dj
                if 0 <= ci < columns and 0 <= cj < rows and known[ci, cj]:
                    x += 0.5 * (grid[ai, aj, 0] - 2 * grid[bi, bj, 0] + grid[ci, cj, 0])
                    y += 0.5 * (grid[ai, aj, 1] - 2 * grid[bi, bj, 1] + grid[ci, cj, 1])
                    w = 1.5
                out[0] += w * x
                out[1] += w * y
                total += w
    if total > 0:
        out[0] /= total
        out[1] /= total
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def local_steps(grid, known, i, j, x, y, out):
    """Steps along i and j at (x, y), the place of corner (i, j): means over the known neighbours; False if none."""
    columns, rows = known.shape
    complete = True
    for axis in range(2):
        di, dj = (1, 0) if axis == 0 else (0, 1)
        sx, sy, count = 0.0, 0.0, 0
        for sign in (1, -1):
            ai, aj = i + sign * di, j + sign * dj
            if 0 <= ai < columns and 0 <= aj < rows and known[ai, aj]:
                sx += sign * (grid[ai, aj, 0] - x)
                sy += sign * (grid[ai, aj, 1] - y)
                count += 1
        if count == 0:
            for side in (1, -1):
                ai, aj = i + side * dj, j + side * di
                if not (0 <= ai < columns and 0 <= aj < rows and known[ai, aj]):
                    continue
                for sign in (1, -1):
                    bi, bj = ai + sign * di, aj + sign * dj
                    if 0 <= bi < columns and 0 <= bj < rows and known[bi, bj]:
                        sx += sign * (grid[bi, bj, 0] - grid[ai, aj, 0])
                        sy += sign * (grid[bi, bj, 1] - grid[ai, aj, 1])
                        count += 1
        if count == 0:
            complete = False
        else:
            out[2 * axis], out[2 * axis + 1] = sx / count, sy / count
    return complete


@njit(cache=True, nogil=True, error_model="numpy")
def square_evidence(G, x, y, ix, iy, jx, jy, sign):
    """How well the four squares around (x, y) show their colours: (least light - most dark) / 2, grey levels.

    Square centres lie half a step off in both directions; samples are taken at 0.3 of a step. `sign` is +1 where the
    square between +i and +j is dark.
    """
    lightest_dark, darkest_light = -1e30, 1e30
    for a in range(2):
        for b in range(2):
            u, v = (0.3 if a else -0.3), (0.3 if b else -0.3)
            g = _bilinear(G, x + u * ix + v * jx, y + u * iy + v * jy)
            if (a == b) == (sign > 0):
                lightest_dark = max(lightest_dark, g)
            else:
                darkest_light = min(darkest_light, g)
    return (darkest_light - lightest_dark) / 2


@njit(cache=True, nogil=True, error_model="numpy")
def settle(G, x, y, reach, steps, out):
    """Newton's steps to the saddle point of G near (x, y); False if there is none within the reach."""
    height, width = G.shape
    cx, cy = x, y
    h = steps
    for _ in range(8):
        if not (h <= cx < width - 1 - h and h <= cy < height - 1 - h):
            return False
        m = _bilinear(G, cx, cy)
        right, left = _bilinear(G, cx + h, cy), _bilinear(G, cx - h, cy)
        below, above = _bilinear(G, cx, cy + h), _bilinear(G, cx, cy - h)
        gx, gy = (right - left) / (2 * h), (below - above) / (2 * h)
        xx, yy = (right - 2 * m + left) / (h * h), (below - 2 * m + above) / (h * h)
        xy = (
            _bilinear(G, cx + h, cy + h)
            - _bilinear(G, cx + h, cy - h)
            - _bilinear(G, cx - h, cy + h)
            + _bilinear(G, cx - h, cy - h)
        ) / (4 * h * h)
        det = xx * yy - xy * xy
        if det >= 0:
            return False
        dx, dy = (xy * gy - yy * gx) / det, (xy * gx - xx * gy) / det
        length = np.sqrt(dx * dx + dy * dy)
        if length > h:
            dx, dy = dx * h / length, dy * h / length
        cx, cy = cx + dx, cy + dy
        if (cx - x) * (cx - x) + (cy - y) * (cy - y) > reach * reach:
            return False
        if length < 0.02:
            break
    out[0], out[1] = cx, cy
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def grow_grid(G, grid, known, evidence, parity, share):
    """Add corners next to known ones where the image shows them, until nothing is added; returns how many were.

    A corner is added if a saddle lies near its predicted place and the four squares around it show their colours with
    at least `share` of the contrast of the known corners around.
    """
    columns, rows = known.shape
    place, found, steps = np.empty(2), np.empty(2), np.empty(4)
    added, again = 0, True
    while again:
        again = False
        for j in range(rows):
            for i in range(columns):
                if known[i, j]:
                    continue
                contrast, neighbours = 0.0, 0
                for di in range(-1, 2):
                    for dj in range(-1, 2):
                        a, b = i + di, j + dj
                        if 0 <= a < columns and 0 <= b < rows and known[a, b]:
                            contrast += evidence[a, b]
                            neighbours += 1
                if neighbours < 2 or predict_corner(grid, known, i, j, place) < 2:
                    continue
                if not local_steps(grid, known, i, j, place[0], place[1], steps):
                    continue
                si = np.sqrt(steps[0] ** 2 + steps[1] ** 2)
                sj = np.sqrt(steps[2] ** 2 + steps[3] ** 2)
                area = abs(steps[0] * steps[3] - steps[1] * steps[2])
                narrow = area / max(si, sj)
                if narrow < 3.0:
                    continue
                reach = max(1.5, 0.3 * narrow)
                if not settle(G, place[0], place[1], reach, min(max(0.2 * narrow, 1.0), 3.0), found):
                    continue
                sign = 1 if (i + j) % 2 == parity else -1
                shown = square_evidence(G, found[0], found[1], steps[0], steps[1], steps[2], steps[3], sign)
                if shown > share * contrast / neighbours:
                    grid[i, j, 0], grid[i, j, 1] = found[0], found[1]
                    known[i, j], evidence[i, j] = True, shown
                    added += 1
                    again = True
    return added


@njit(cache=True, nogil=True, error_model="numpy")
def outer_reach(G, grid, side):
    """Mean reach of the squares beyond border line `side` (i = 0, i = I-1, j = 0, j = J-1), in steps, 0.1 to 1.5.

    Half a square inside the line the squares show their colours; half a step and more outside, the square across
    the line shows the other one, up to its end at 1, and beyond 1 the first again if the board goes on. Followed
    square by square, against the mean of its neighbours, until the contrast falls below 0.3 of that inside.
    """
    columns, rows = grid.shape[0], grid.shape[1]
    count = (rows if side < 2 else columns) - 1
    length = columns if side < 2 else rows
    middle, outward, inside = np.empty((count, 2)), np.empty((count, 2)), np.empty(count)
    line = np.empty((3, 2))
    for m in range(count):
        for back in range(min(3, length)):
            k = back if side % 2 == 0 else length - 1 - back
            for c in range(2):
                if side < 2:
                    line[back, c] = 0.5 * (grid[k, m, c] + grid[k, m + 1, c])
                else:
                    line[back, c] = 0.5 * (grid[m, k, c] + grid[m + 1, k, c])
        for c in range(2):
            middle[m, c] = line[0, c]
            outward[m, c] = line[0, c] - line[1, c]
            if length > 2:
                outward[m, c] += 0.5 * (line[0, c] - 2 * line[1, c] + line[2, c])
        inside[m] = _bilinear(G, middle[m, 0] - 0.35 * outward[m, 0], middle[m, 1] - 0.35 * outward[m, 1])
    total = 0.0
    for m in range(count):
        first, last = max(m - 1, 0), min(m + 1, count - 1)
        contrast = 0.0
        for n in range(first, last + 1):
            if n != m:
                contrast += inside[n] / (last - first)
        contrast -= inside[m]
        step = 2
        while step < 16:
            t = 0.1 * step
            here = _bilinear(G, middle[m, 0] + t * outward[m, 0], middle[m, 1] + t * outward[m, 1])
            beside = 0.0
            for n in range(first, last + 1):
                if n != m:
                    beside += _bilinear(G, middle[n, 0] + t * outward[n, 0], middle[n, 1] + t * outward[n, 1])
            difference = beside / (last - first) - here
            towards = -difference if step <= 10 else difference
            if towards * contrast <= 0.3 * contrast * contrast:
                break
            step += 1
        total += 0.1 * (step - 1) if step < 16 else 1.5
    return total / count
