# mypy: allow-untyped-defs
"""Kernel of the weighted median."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def weighted_median(disparity, guide, color_weight, space_weight, rows, out):
    """Write the weighted median of the valid pixels in each valid pixel's window.

    Parameters
    ----------
    disparity : (H, W) float32
        NaN where there is none.
    guide : (H, W) uint8
    color_weight : (256,) int64
        Weight by the difference of grey values.
    space_weight : (2r + 1, 2r + 1) int64
        Weight by the place in the window.
    rows : (first, last)
        The rows to write, last not included.
    out : (H, W) float32
    """
    height, width = disparity.shape
    radius = space_weight.shape[0] // 2
    values = np.empty(space_weight.size, np.float32)
    weights = np.empty(space_weight.size, np.int64)
    for y in range(rows[0], rows[1]):
        for x in range(width):
            out[y, x] = disparity[y, x]
            if np.isnan(disparity[y, x]):
                continue
            n, total = 0, 0
            for j in range(max(y - radius, 0), min(y + radius + 1, height)):
                for i in range(max(x - radius, 0), min(x + radius + 1, width)):
                    value = disparity[j, i]
                    if np.isnan(value):
                        continue
                    difference = abs(np.int64(guide[j, i]) - np.int64(guide[y, x]))
                    weight = color_weight[difference] * space_weight[j - y + radius, i - x + radius]
                    total += weight
                    place = n  # insertion keeps the values in order: the window is small
                    while place > 0 and values[place - 1] > value:
                        values[place], weights[place] = values[place - 1], weights[place - 1]
                        place -= 1
                    values[place], weights[place] = value, weight
                    n += 1
            reached = 0
            for place in range(n):
                reached += weights[place]
                if 2 * reached >= total:
                    out[y, x] = values[place]
                    break
