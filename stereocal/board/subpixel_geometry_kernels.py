# mypy: allow-untyped-defs
"""Kernels of :mod:`stereocal.board.subpixel_geometry`: differences between the corners of a grid, and their means."""

from __future__ import annotations

import numpy as np
from numba import njit

# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _difference(grid, j, i, k, along_i):
    """Central difference of component k at (j, i), one-sided at the ends."""
    rows, columns = grid.shape[0], grid.shape[1]
    if along_i:
        low, high = max(i - 1, 0), min(i + 1, columns - 1)
        return (grid[j, high, k] - grid[j, low, k]) / (high - low)
    low, high = max(j - 1, 0), min(j + 1, rows - 1)
    return (grid[high, i, k] - grid[low, i, k]) / (high - low)


@njit(cache=True, nogil=True, error_model="numpy")
def steps_and_bends(grid, steps, bends):
    """Steps (J, I, 4) and bends (J, I, 2) of a grid (J, I, 2)."""
    rows, columns = grid.shape[0], grid.shape[1]
    raw = np.zeros((rows, columns, 2))
    for j in range(rows):
        for i in range(columns):
            for k in range(2):
                steps[j, i, k] = _difference(grid, j, i, k, True)
                steps[j, i, 2 + k] = _difference(grid, j, i, k, False)
            if columns >= 3:
                m = min(max(i, 1), columns - 2)
                x = grid[j, m + 1, 0] - 2 * grid[j, m, 0] + grid[j, m - 1, 0]
                y = grid[j, m + 1, 1] - 2 * grid[j, m, 1] + grid[j, m - 1, 1]
                dx, dy = steps[j, i, 0], steps[j, i, 1]
                raw[j, i, 0] = (dx * y - dy * x) / np.sqrt(dx * dx + dy * dy)
            if rows >= 3:
                m = min(max(j, 1), rows - 2)
                x = grid[m + 1, i, 0] - 2 * grid[m, i, 0] + grid[m - 1, i, 0]
                y = grid[m + 1, i, 1] - 2 * grid[m, i, 1] + grid[m - 1, i, 1]
                dx, dy = steps[j, i, 2], steps[j, i, 3]
                raw[j, i, 1] = (dx * y - dy * x) / np.sqrt(dx * dx + dy * dy)
    for j in range(rows):
        for i in range(columns):
            for k in range(2):
                total = 0.0
                for q in range(j - 1, j + 2):
                    for p in range(i - 1, i + 2):
                        total += raw[min(max(q, 0), rows - 1), min(max(p, 0), columns - 1), k]
                bends[j, i, k] = total / 9


@njit(cache=True, nogil=True, error_model="numpy")
def median_slopes(levels, steepest, light):
    """Light (J, I, 5) from the levels (J, I, 2): a, slopes of a along i and j, slopes of b over b, medians of 5 x 5."""
    rows, columns = levels.shape[0], levels.shape[1]
    raw = np.empty((rows, columns, 4))
    for j in range(rows):
        for i in range(columns):
            for k in range(2):
                raw[j, i, 2 * k] = _difference(levels, j, i, k, True)
                raw[j, i, 2 * k + 1] = _difference(levels, j, i, k, False)
    values = np.empty(25)
    for j in range(rows):
        for i in range(columns):
            b = max(levels[j, i, 1], 1e-6)
            light[j, i, 0] = levels[j, i, 0]
            for k in range(4):
                count = 0
                for q in range(j - 2, j + 3):
                    for p in range(i - 2, i + 3):
                        value = raw[min(max(q, 0), rows - 1), min(max(p, 0), columns - 1), k]
                        place = count
                        while place > 0 and values[place - 1] > value:  # sorted by insertion
                            values[place] = values[place - 1]
                            place -= 1
                        values[place] = value
                        count += 1
                middle = values[12]
                if k >= 2:
                    middle = min(max(middle / b, -steepest), steepest)
                light[j, i, 1 + k] = middle
