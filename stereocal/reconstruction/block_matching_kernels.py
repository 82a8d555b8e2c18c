# mypy: allow-untyped-defs
"""Kernels of StereoBM's recipe around the sliding window: the two prefilters, the texture test, the cross-check."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def prefilter_xsobel(image, cap, out):
    """Write clip(∂I/∂x by Sobel, ±cap) + cap."""
    height, width = image.shape
    for y in range(height):
        if (y == height - 1 and height % 2 == 1) or width < 2:
            out[y] = cap
            continue
        above = y - 1 if y > 0 else 1
        below = y + 1 if y < height - 1 else height - 2
        out[y, 0] = cap
        out[y, width - 1] = cap
        for x in range(1, width - 1):
            slope = (
                np.int64(image[above, x + 1]) - np.int64(image[above, x - 1])
                + 2 * (np.int64(image[y, x + 1]) - np.int64(image[y, x - 1]))
                + np.int64(image[below, x + 1]) - np.int64(image[below, x - 1])
            )  # fmt: skip
            out[y, x] = min(max(slope, -cap), cap) + cap


@njit(cache=True, nogil=True)
def prefilter_normalized_response(image, size, cap, gain, mean_gain, column_sum, out):
    """Write clip((gain (4 I + neighbours) − mean_gain Σ_window I) >> 10, ±cap) + cap; borders are replicated.

    `column_sum`, (W,) int32, is scratch.
    """
    height, width = image.shape
    radius = size // 2
    for x in range(width):
        column_sum[x] = 0
        for j in range(-radius, radius + 1):
            column_sum[x] += image[min(max(j, 0), height - 1), x]
    for y in range(height):
        if y > 0:
            enter = min(y + radius, height - 1)
            leave = max(y - radius - 1, 0)
            for x in range(width):
                column_sum[x] += np.int64(image[enter, x]) - np.int64(image[leave, x])
        above = max(y - 1, 0)
        below = min(y + 1, height - 1)
        total = 0
        for i in range(-radius, radius + 1):
            total += column_sum[min(max(i, 0), width - 1)]
        for x in range(width):
            if x > 0:
                total += column_sum[min(x + radius, width - 1)] - column_sum[max(x - radius - 1, 0)]
            centre = (
                4 * np.int64(image[y, x])
                + np.int64(image[y, max(x - 1, 0)]) + np.int64(image[y, min(x + 1, width - 1)])
                + np.int64(image[above, x]) + np.int64(image[below, x])
            )  # fmt: skip
            value = (centre * gain - total * mean_gain) >> 10
            out[y, x] = min(max(value, -cap), cap) + cap


@njit(cache=True, nogil=True)
def reject_untextured(image, cap, radius, first_row, last_row, first_column, threshold, column_sum, running, out):
    """Set `out` to NaN where Σ |I − cap| over the window is below the threshold, to 0 elsewhere.

    Parameters
    ----------
    image : (H, n + 2r) uint8
        The columns that the windows of the n pixels cover.
    first_column : int
        Where the first of the n pixels stands in `out`.
    column_sum, running : (n + 2r,) and (n + 2r + 1,) int32
        Scratch: the sum down each column of the window, and the sum of those before each column.
    """
    count = image.shape[1]
    block = 2 * radius + 1
    column_sum[:] = 0
    running[0] = 0
    for y in range(first_row - radius, first_row + radius):
        for x in range(count):
            column_sum[x] += abs(np.int32(image[y, x]) - cap)
    for y in range(first_row, last_row):
        for x in range(count):
            column_sum[x] += abs(np.int32(image[y + radius, x]) - cap)
        total = np.int32(0)
        for x in range(count):
            total += column_sum[x]
            running[x + 1] = total
        row = out[y, first_column : first_column + count - 2 * radius]
        for x in range(count - 2 * radius):
            row[x] = np.float32(0.0) if running[x + block] - running[x] >= threshold else np.float32(np.nan)
        for x in range(count):
            column_sum[x] -= abs(np.int32(image[y - radius, x]) - cap)


@njit(cache=True, nogil=True)
def cross_check(cost, max_difference, first_x, last_x, first_row, last_row, best_cost, best, disparity):
    """Set NaN where the right image's disparity, on both sides of the match, differs by more than max_difference.

    `best_cost` (W,) int32 and `best` (W,) float32 are scratch.
    """
    width = disparity.shape[1]
    for y in range(first_row, last_row):
        best_cost[:] = 2147483647
        best[:] = float("nan")
        for x in range(first_x, last_x):
            d = disparity[y, x]
            if d == d:
                matched = x - int((d * 16 + 8) // 16)
                if best_cost[matched] > cost[y, x]:
                    best_cost[matched] = cost[y, x]
                    best[matched] = d
        for x in range(first_x, last_x):
            d = disparity[y, x]
            if d == d:
                near = x - int(d // 1)
                far = x - int(-((-d) // 1))
                if (
                    0 <= near < width and 0 <= far < width
                    and abs(best[near] - d) > max_difference and abs(best[far] - d) > max_difference
                ):  # fmt: skip
                    disparity[y, x] = float("nan")
