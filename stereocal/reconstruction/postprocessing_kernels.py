# mypy: allow-untyped-defs
"""Kernel of the weighted median.

The values of a window need not be sorted to find the one at which the votes reach half. Take any of them as a pivot and
count the votes below it, for it and above: that tells on which side the median lies, and the other side can be dropped.
The few that are left are halved again (C. A. R. Hoare's selection, 1961), and the pixel itself is a good first guess.
"""

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
                    values[n], weights[n] = value, weight
                    n += 1
            pivot = disparity[y, x]
            below = 0  # votes for the values that were dropped because they are too small
            while True:
                less, equal = below, 0
                for k in range(n):
                    less += weights[k] * (values[k] < pivot)
                    equal += weights[k] * (values[k] == pivot)
                lower = 2 * less >= total
                if not lower and 2 * (less + equal) >= total:
                    break
                below = below if lower else less + equal
                kept = 0
                for k in range(n):
                    value = values[k]
                    values[kept], weights[kept] = value, weights[k]
                    kept += (value < pivot) if lower else (value > pivot)
                n = kept
                pivot = values[n // 2]
            out[y, x] = pivot
