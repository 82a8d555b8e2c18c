# mypy: allow-untyped-defs
"""Kernels of :mod:`stereocal.board.ring`: the ring test."""

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
def _looks_alike(G, x, y, least_amplitude):
    """A cheap look before the ring test: eight pixels around, opposite ones more alike than not."""
    height, width = G.shape
    if x < 4 or y < 4 or x >= width - 4 or y >= height - 4:
        return True
    a0, a1 = np.float64(G[y, x - 4]), np.float64(G[y, x + 4])
    b0, b1 = np.float64(G[y - 4, x]), np.float64(G[y + 4, x])
    c0, c1 = np.float64(G[y - 3, x - 3]), np.float64(G[y + 3, x + 3])
    d0, d1 = np.float64(G[y - 3, x + 3]), np.float64(G[y + 3, x - 3])
    low = min(min(min(a0, a1), min(b0, b1)), min(min(c0, c1), min(d0, d1)))
    high = max(max(max(a0, a1), max(b0, b1)), max(max(c0, c1), max(d0, d1)))
    if high - low < 1.4 * least_amplitude:
        return False
    middle = low + high
    odd = (a0 - a1) ** 2 + (b0 - b1) ** 2 + (c0 - c1) ** 2 + (d0 - d1) ** 2
    even = (a0 + a1 - middle) ** 2 + (b0 + b1 - middle) ** 2 + (c0 + c1 - middle) ** 2 + (d0 + d1 - middle) ** 2
    return odd < even


@njit(cache=True, nogil=True, error_model="numpy")
def ring_test(G, pixels, cosine, sine, radius, least_amplitude, out):
    """Keep the saddles around which a ring shows dark, light, dark, light, alike on opposite sides.

    For each pixel (x, y): Newton's step to the saddle point of the local quadratic, samples of G on a ring, crossings
    of the middle grey. `out` (n, 7) gets x, y, the four directions of the edges (the first one leads, with growing
    angle, from light into dark) and the amplitude; returns how many pass.
    """
    steps = cosine.size
    v, crossing = np.empty(steps), np.empty(4)
    kept = 0
    for n in range(pixels.shape[0]):
        px, py = pixels[n, 0], pixels[n, 1]
        if not _looks_alike(G, px, py, least_amplitude):
            continue
        here = np.float64(G[py, px])
        left, right = np.float64(G[py, px - 2]), np.float64(G[py, px + 2])
        above, below = np.float64(G[py - 2, px]), np.float64(G[py + 2, px])
        gx, gy = (right - left) * 0.25, (below - above) * 0.25
        xx, yy = (right - 2 * here + left) * 0.25, (below - 2 * here + above) * 0.25
        along = np.float64(G[py + 2, px + 2]) + np.float64(G[py - 2, px - 2])
        xy = (along - np.float64(G[py + 2, px - 2]) - np.float64(G[py - 2, px + 2])) * 0.0625
        det = xx * yy - xy * xy
        dx, dy = (xy * gy - yy * gx) / det, (xy * gx - xx * gy) / det
        if not (dx * dx + dy * dy < 4.0):
            continue
        cx, cy = px + dx, py + dy
        low, high = 1e30, -1e30
        for i in range(steps):
            v[i] = _bilinear(G, cx + radius * cosine[i], cy + radius * sine[i])
            low, high = min(low, v[i]), max(high, v[i])
        amplitude = (high - low) / 2
        if amplitude < least_amplitude:
            continue
        middle = (high + low) / 2
        crossings, first_falls = 0, False
        for i in range(steps):
            now, following = v[i] - middle, v[(i + 1) % steps] - middle
            if (now > 0) != (following > 0):
                if crossings < 4:
                    if crossings == 0:
                        first_falls = now > 0
                    crossing[crossings] = (i + now / (now - following)) * (2 * np.pi / steps)
                crossings += 1
        if crossings != 4:
            continue
        straight = True
        for i in range(2):
            if abs(crossing[i + 2] - crossing[i] - np.pi) > 0.45:
                straight = False
        opening = crossing[1] - crossing[0]
        second = crossing[2] - crossing[1]
        if not straight or min(opening, second) < 0.3:
            continue
        odd, even = 0.0, 0.0
        for i in range(steps // 2):
            a, b = v[i] - middle, v[i + steps // 2] - middle
            odd += (a - b) * (a - b)
            even += (a + b) * (a + b)
        if odd > 0.35 * even:
            continue
        shift = 0 if first_falls else 1
        out[kept, 0], out[kept, 1], out[kept, 6] = cx, cy, amplitude
        for i in range(4):
            out[kept, 2 + i] = crossing[(i + shift) % 4]
        kept += 1
    return kept
