# mypy: allow-untyped-defs
"""Kernels of :mod:`stereocal.board.growth`: prediction of a corner, its saddle, its squares, growth, outer squares."""

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


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
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


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
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


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
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
    """Mean reach of the squares beyond border line `side` (i = 0, i = I-1, j = 0, j = J-1), in steps, 0.1 to 1.5."""
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
            if step == 10:  # here the colours change, if the board goes on
                step = 12
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
