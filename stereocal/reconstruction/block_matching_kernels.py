# mypy: allow-untyped-defs
"""Kernels of StereoBM's recipe around the sliding window: the two prefilters, the texture test, the cross-check."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def prefilter_xsobel(image, cap, column, out):
    """Write clip(∂I/∂x by Sobel, ±cap) + cap; `column`, (W,) int16, is scratch.

    In two steps, down each column of three and then across. Numba computes whole numbers in 64 bits unless it is told
    each time that 16 are enough, and of those a register holds four times as many.
    """
    height, width = image.shape
    least, most = np.int16(-cap), np.int16(cap)
    for y in range(height):
        row = out[y]
        if (y == height - 1 and height % 2 == 1) or width < 2:
            row[:] = cap
            continue
        above, here, below = image[y - 1 if y > 0 else 1], image[y], image[y + 1 if y < height - 1 else height - 2]
        for x in range(width):
            column[x] = np.int16(above[x]) + 2 * np.int16(here[x]) + np.int16(below[x])
        row[0] = row[width - 1] = cap
        for x in range(1, width - 1):
            slope = np.int16(column[x + 1] - column[x - 1])
            row[x] = min(max(slope, least), most) + most


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

    No window has less texture than the poorest of its columns: where that is enough in all of a row, as it mostly is,
    the windows need no sums.

    Parameters
    ----------
    image : (H, n + 2r) uint8
        The columns that the windows of the n pixels cover.
    cap : int16
    first_column : int
        Where the first of the n pixels stands in `out`.
    column_sum : (n + 2r,) int16
        Scratch: the sum down each column of the window.
    running : (n + 2r + 1,) int32
        Scratch: the sum of the columns before each.
    """
    count = image.shape[1]
    block = 2 * radius + 1
    column_sum[:] = 0
    running[0] = 0
    for y in range(first_row - radius - 1, first_row + radius):
        entering = image[max(y, 0)]
        for x in range(count):
            column_sum[x] += np.int16(abs(np.int16(entering[x] - cap)))
    for y in range(first_row, last_row):
        entering, leaving = image[y + radius], image[max(y - radius - 1, 0)]
        for x in range(count):
            gain = np.int16(abs(np.int16(entering[x] - cap))) - np.int16(abs(np.int16(leaving[x] - cap)))
            column_sum[x] += np.int16(gain)
        poorest = np.int16(32767)
        for x in range(count):
            poorest = min(poorest, column_sum[x])
        row = out[y, first_column : first_column + count - 2 * radius]
        if poorest >= threshold:
            row[:] = 0
            continue
        total = np.int32(0)
        for x in range(count):
            total += column_sum[x]
            running[x + 1] = total
        before_last = running[block:]
        for x in range(count - 2 * radius):
            within = np.int32(before_last[x] - running[x])
            row[x] = np.float32(0.0) if within >= threshold else np.float32(np.nan)


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
