# mypy: allow-untyped-defs
"""Kernels of :mod:`stereocal.board.saddle`: smoothing, the saddle measure, its maxima."""

from __future__ import annotations

import numpy as np
from numba import njit

# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy")
def smooth_binomial(image, out):
    """Binomial smoothing (1 4 6 4 1)/16 along both axes, borders replicated, float32."""
    height, width = image.shape
    column = np.empty(width + 4, np.float32)
    six, four, norm = np.float32(6), np.float32(4), np.float32(1 / 256)
    inner = column[2 : width + 2]
    for y in range(height):
        r0, r1, r2 = image[max(y - 2, 0)], image[max(y - 1, 0)], image[y]
        r3, r4 = image[min(y + 1, height - 1)], image[min(y + 2, height - 1)]
        for x in range(width):
            inner[x] = (
                (np.float32(r0[x]) + np.float32(r4[x]))
                + four * (np.float32(r1[x]) + np.float32(r3[x]))
                + six * np.float32(r2[x])
            )
        column[0] = column[1] = column[2]
        column[width + 2] = column[width + 3] = column[width + 1]
        row = out[y]
        for x in range(width):
            row[x] = ((column[x] + column[x + 4]) + four * (column[x + 1] + column[x + 3]) + six * column[x + 2]) * norm


@njit(cache=True, nogil=True, error_model="numpy")
def saddle_measure(G, out):
    """S = Gxy^2 - Gxx Gyy by differences over two pixels; 0 within two pixels of the border."""
    height, width = G.shape
    zero, two, quarter = np.float32(0), np.float32(2), np.float32(0.25)
    out[:2] = zero
    out[height - 2 :] = zero
    for y in range(2, height - 2):
        up, mid, down, row = G[y - 2], G[y], G[y + 2], out[y]
        row[0] = row[1] = row[width - 2] = row[width - 1] = zero
        inner = row[2:]
        for x in range(width - 4):
            xx = mid[x + 4] - two * mid[x + 2] + mid[x]
            yy = down[x + 2] - two * mid[x + 2] + up[x + 2]
            xy = (down[x + 4] - down[x] - up[x + 4] + up[x]) * quarter
            inner[x] = xy * xy - xx * yy


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _column_maxima(upper, middle, lower, out):
    for x in range(out.size):
        a = upper[x] if upper[x] > middle[x] else middle[x]
        out[x] = a if a > lower[x] else lower[x]


@njit(cache=True, nogil=True, error_model="numpy")
def saddle_maxima(S, threshold, out):
    """Pixels whose S exceeds the threshold and the S of the 5x5 pixels around; returns how many there are.

    A maximum of 5x5 pixels is the largest of the 3x3 block it lies in, so only the largest of each block is compared
    with its surroundings (Neubeck and Van Gool, 2006). Of equal values the first in reading order wins. `out`
    (capacity, 2) gets x, y of the first `capacity` of them.
    """
    height, width = S.shape
    count = 0
    columns = np.empty(width, np.float32)
    for y0 in range(3, height - 5, 3):
        _column_maxima(S[y0], S[y0 + 1], S[y0 + 2], columns)
        for x0 in range(3, width - 5, 3):
            q = max(max(columns[x0], columns[x0 + 1]), columns[x0 + 2])
            if q <= threshold:
                continue
            x = x0 if columns[x0] == q else (x0 + 1 if columns[x0 + 1] == q else x0 + 2)
            y = y0 if S[y0, x] == q else (y0 + 1 if S[y0 + 1, x] == q else y0 + 2)
            largest = True
            for dy in range(-2, 3):
                other = S[y + dy]
                for dx in range(-2, 3):
                    value = other[x + dx]
                    if value > q or (value == q and (dy < 0 or (dy == 0 and dx < 0))):
                        largest = False
                        break
                if not largest:
                    break
            if largest:
                if count < out.shape[0]:
                    out[count, 0] = x
                    out[count, 1] = y
                count += 1
    return count
