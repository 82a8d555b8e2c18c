# mypy: allow-untyped-defs
"""Kernels of the medians.

The median of nine is taken by a network of exchanges (A. Paeth, 1990), which is the same for all pixels, so that the
compiler does many at once.

For the weighted one, the values of a window need not be sorted to find the one at which the votes reach half. Take any
of them as a pivot and count the votes below it, for it and above: that tells on which side the median lies, and the
other side can be dropped. The few that are left are halved again (C. A. R. Hoare's selection, 1961), and the pixel
itself is a good first guess.
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


@njit(cache=True, nogil=True, error_model="numpy")
def median_of_nine(padded, out):
    """Write the median of 3x3 pixels: a neighbour that is NaN counts as the pixel itself, and that, if NaN, as −∞.

    Parameters
    ----------
    padded : (H + 2, W + 2) float32
        The map with a margin of NaN.
    out : (H, W) float32
    """
    height, width = out.shape
    infinity, none = np.float32(np.inf), np.float32(np.nan)
    for y in range(height):
        above, here, below, row = padded[y], padded[y + 1], padded[y + 2], out[y]
        for x in range(width):
            e = here[x + 1] if here[x + 1] == here[x + 1] else -infinity
            a, b, c = above[x], above[x + 1], above[x + 2]
            d, f = here[x], here[x + 2]
            g, h, i = below[x], below[x + 1], below[x + 2]
            a, b, c = a if a == a else e, b if b == b else e, c if c == c else e
            d, f = d if d == d else e, f if f == f else e
            g, h, i = g if g == g else e, h if h == h else e, i if i == i else e
            b, c = (b, c) if b < c else (c, b)
            e, f = (e, f) if e < f else (f, e)
            h, i = (h, i) if h < i else (i, h)
            a, b = (a, b) if a < b else (b, a)
            d, e = (d, e) if d < e else (e, d)
            g, h = (g, h) if g < h else (h, g)
            b, c = (b, c) if b < c else (c, b)
            e, f = (e, f) if e < f else (f, e)
            h, i = (h, i) if h < i else (i, h)
            # Of three sorted triples: the greatest of the least, the middle of the middle, the least of the greatest.
            g = max(max(a, d), g)
            b, e = (b, e) if b < e else (e, b)
            e = max(min(e, h), b)
            c = min(min(c, f), i)
            # … and the middle of those three.
            c, e = (c, e) if c < e else (e, c)
            middle = max(c, min(e, g))
            row[x] = middle if middle > -infinity else none
