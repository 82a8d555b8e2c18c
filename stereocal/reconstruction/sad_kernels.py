# mypy: allow-untyped-defs
"""Kernels of block matching: a window slides over the image and the sums in it are updated, not summed anew.

The sum of absolute differences over the window of (2r + 1)² pixels around (x, y), at each disparity d,

    S(x, y, d) = Σ_{i,j = −r…r} |L(x + i, y + j) − R(x + i − d, y + j)|,

is a sum of column sums, C(x, y, d) = Σ_j |L(x, y + j) − R(x − d, y + j)|. Going down a row, each column gains one
pixel and loses one; going right by a pixel, the window gains one column and loses one:

    C(x, y, d) = C(x, y − 1, d) + |L(x, y + r) − R(x − d, y + r)| − |L(x, y − r − 1) − R(x − d, y − r − 1)|
    S(x, y, d) = S(x − 1, y, d) + C(x + r, y, d) − C(x − r − 1, y, d),

so that the work does not depend on the block size, and the memory is one row of columns, O(W·D).

Disparities are counted DOWN: k = 0 … D − 1 stands for d = maximum − k, because R(x − d) then lies in memory in the
order of k. The smallest k wins a tie: the largest disparity, as in OpenCV.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def match_rows(
    left, right, left_column, right_start, radius, first_row, last_row, max_disparity, num_disparities,
    first_x, uniqueness_ratio, subpixel, left_right, columns, out, cost,
):  # fmt: skip
    """Match rows first_row … last_row − 1 by the smallest S, and write their disparity.

    Parameters
    ----------
    left, right : (H, W) uint8
    left_column, right_start : (n + 2r,) intp
        For each column of sums: where it stands in `left`, and where its candidate k = 0 stands in `right`.
    radius : int
        r.
    first_x : int
        Where the first of the n matched pixels stands in `out`.
    uniqueness_ratio : int
        u: no disparity where S(k) ≤ S_min + S_min u / 100 for some k more than 1 away from the best; 0 skips the test.
    subpixel : int
        0 none, 1 OpenCV's, 2 parabola.
    left_right : int
        The largest |d − d_right| allowed between the best disparities of the two images; −1 skips the test.
    columns : (n + 2r, D) int32
        Scratch: C.
    out : (H, W) float32
        Enters as NaN where no disparity is wanted.
    cost : (H, W) int32 or (0, 0)
        S_min of the pixels matched, if wanted.
    """
    n = len(left_column) - 2 * radius
    width = right.shape[1]
    window = np.empty(num_disparities, np.int32)
    best = np.empty(n, np.int32)
    right_sum = np.empty(width, np.int32)
    right_disparity = np.empty(width, np.int32)

    columns[:] = 0
    for y in range(first_row - radius, first_row + radius):
        for j in range(n + 2 * radius):
            value = np.int32(left[y, left_column[j]])
            start = right_start[j]
            for k in range(num_disparities):
                columns[j, k] += abs(value - np.int32(right[y, start + k]))

    for y in range(first_row, last_row):
        enter = y + radius
        leave = y - radius - 1
        for j in range(n + 2 * radius):
            start = right_start[j]
            value = np.int32(left[enter, left_column[j]])
            for k in range(num_disparities):
                columns[j, k] += abs(value - np.int32(right[enter, start + k]))
            if y > first_row:
                value = np.int32(left[leave, left_column[j]])
                for k in range(num_disparities):
                    columns[j, k] -= abs(value - np.int32(right[leave, start + k]))

        window[:] = 0
        for j in range(2 * radius):
            for k in range(num_disparities):
                window[k] += columns[j, k]
        if left_right >= 0:
            right_sum[:] = 2147483647

        for x in range(n):
            least = np.int32(2147483647)
            for k in range(num_disparities):
                window[k] += columns[x + 2 * radius, k]
                least = min(least, window[k])
            where = 0
            while window[where] != least:
                where += 1
            best[x] = where
            if left_right >= 0:
                first = first_x + x - max_disparity
                for k in range(num_disparities):
                    if window[k] <= right_sum[first + k]:  # a tie goes to the larger disparity, here the later x
                        right_sum[first + k] = window[k]
                        right_disparity[first + k] = max_disparity - k
            if not np.isnan(out[y, first_x + x]):
                unique = True
                if uniqueness_ratio > 0:
                    limit = least + np.int64(least) * uniqueness_ratio // 100
                    for k in range(num_disparities):
                        if window[k] <= limit and abs(k - where) > 1:
                            unique = False
                if not unique:
                    out[y, first_x + x] = np.nan
                else:
                    disparity = max_disparity - where
                    fraction = 0.0
                    if subpixel != 0 and where > 0 and where < num_disparities - 1:
                        less = window[where + 1]  # S(d − 1)
                        more = window[where - 1]  # S(d + 1)
                        if subpixel == 1:
                            denominator = less + more - 2 * least + abs(less - more)
                            sixteenths = np.int64(256) * disparity + 15
                            if denominator != 0:
                                sixteenths += np.int64(256 * (less - more) / denominator)
                            fraction = (sixteenths >> 4) / 16 - disparity
                        else:
                            denominator = less + more - 2 * least
                            if denominator != 0:
                                fraction = 0.5 * (less - more) / denominator
                    out[y, first_x + x] = disparity + fraction
                    if cost.size > 0:
                        cost[y, first_x + x] = least
            for k in range(num_disparities):
                window[k] -= columns[x, k]

        if left_right >= 0:
            for x in range(n):
                disparity = max_disparity - best[x]
                if abs(disparity - right_disparity[first_x + x - disparity]) > left_right:
                    out[y, first_x + x] = np.nan
