# mypy: allow-untyped-defs
"""Kernels of :mod:`stereocal.board.pyramid`: half and double images, grown tones."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def halve(image, out):
    """Means of 2x2 pixels, float32; an odd last row or column is dropped."""
    for y in range(out.shape[0]):
        upper, lower, row = image[2 * y], image[2 * y + 1], out[y]
        for x in range(row.size):
            row[x] = (
                (np.float32(upper[2 * x]) + np.float32(upper[2 * x + 1]))
                + (np.float32(lower[2 * x]) + np.float32(lower[2 * x + 1]))
            ) * np.float32(0.25)


@njit(cache=True, nogil=True, error_model="numpy")
def double(image, out):
    """Twice as many pixels a side, linear: a new pixel's centre lies a quarter of an old pixel beside an old centre."""
    height, width = image.shape
    near, far = np.float32(0.75), np.float32(0.25)
    mixed = np.empty(width, np.float32)
    for y in range(2 * height):
        row = image[y // 2]
        other = image[min(max(y // 2 + (1 if y % 2 else -1), 0), height - 1)]
        for x in range(width):
            mixed[x] = near * np.float32(row[x]) + far * np.float32(other[x])
        target = out[y]
        target[0], target[2 * width - 1] = mixed[0], mixed[width - 1]
        for x in range(width - 1):
            target[2 * x + 1] = near * mixed[x] + far * mixed[x + 1]
            target[2 * x + 2] = far * mixed[x] + near * mixed[x + 1]


@njit(cache=True, nogil=True, error_model="numpy")
def spread_darkest(image, sign, out):
    """Least of sign * image over 3x3 pixels, borders replicated, times sign: dark (+1) or light (-1) grows by one."""
    height, width = image.shape
    column = np.empty(width + 2, np.float32)
    tone = np.float32(sign)
    inner = column[1 : width + 1]
    for y in range(height):
        upper, middle, lower = image[max(y - 1, 0)], image[y], image[min(y + 1, height - 1)]
        for x in range(width):
            a, b, c = tone * np.float32(upper[x]), tone * np.float32(middle[x]), tone * np.float32(lower[x])
            a = a if a < b else b
            inner[x] = a if a < c else c
        column[0], column[width + 1] = column[1], column[width]
        row = out[y]
        for x in range(width):
            a = column[x] if column[x] < column[x + 1] else column[x + 1]
            row[x] = tone * (a if a < column[x + 2] else column[x + 2])
