# mypy: allow-untyped-defs
"""Kernels of :mod:`stereocal.board.harris`: the response in one pass over the rows.

Each image row is turned into three rows of products I_x^2, I_y^2, I_x I_y, kept in a ring as tall as the window. Column
sums over the ring slide down by adding the row that enters and subtracting the one that leaves; on bytes all of this is
integer arithmetic, hence exact. A sum along the row and the formula of the response finish it. Every inner loop writes
one array, which is what lets LLVM vectorise it.
"""

from __future__ import annotations

import numpy as np
from numba import njit

# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _reflect(i, n):
    if i < 0:
        i = -i
    if i >= n:
        i = 2 * n - 2 - i
    return i


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _products(above, row, below, smooth, slope, xx, yy, xy):
    """Products of the 3x3 Sobel gradient of a row; `smooth` and `slope` are scratch rows with one cell of margin."""
    width = row.size
    for x in range(width):
        middle = smooth.dtype.type(row[x])
        smooth[x + 1] = (smooth.dtype.type(above[x]) + middle) + (middle + smooth.dtype.type(below[x]))
    for x in range(width):
        slope[x + 1] = smooth.dtype.type(below[x]) - smooth.dtype.type(above[x])
    smooth[0], smooth[width + 1] = smooth[2], smooth[width - 1]
    slope[0], slope[width + 1] = slope[2], slope[width - 1]
    for x in range(width):
        gx = smooth[x + 2] - smooth[x]
        xx[x] = gx * gx
    for x in range(width):
        gy = (slope[x] + slope[x + 1]) + (slope[x + 1] + slope[x + 2])
        yy[x] = gy * gy
    for x in range(width):
        gx, gy = smooth[x + 2] - smooth[x], (slope[x] + slope[x + 1]) + (slope[x + 1] + slope[x + 2])
        xy[x] = gx * gy


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _slide(inner, entering, leaving):
    for x in range(inner.size):
        inner[x] += entering[x] - leaving[x]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _reflect_margins(total, r):
    last = total.size - 1 - r
    for i in range(1, r + 1):
        total[r - i] = total[r + i]
        total[last + i] = total[last - i]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _row_sum(total, block, out):
    for x in range(out.size):
        out[x] = total[x]
    for i in range(1, block):
        shifted = total[i:]
        for x in range(out.size):
            out[x] += shifted[x]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _formula(a, b, c, k, scale4, out):
    for x in range(out.size):
        fa, fb, fc = np.float32(a[x]), np.float32(b[x]), np.float32(c[x])
        trace = fa + fb
        out[x] = (fa * fb - fc * fc - k * (trace * trace)) * scale4


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _sum3_and_formula(a, b, c, k, scale4, out):
    """Sums of three neighbours along the row, and the formula, in one pass."""
    for x in range(out.size):
        fa = np.float32(a[x] + a[x + 1] + a[x + 2])
        fb = np.float32(b[x] + b[x + 1] + b[x + 2])
        fc = np.float32(c[x] + c[x + 1] + c[x + 2])
        trace = fa + fb
        out[x] = (fa * fb - fc * fc - k * (trace * trace)) * scale4


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _response_rows(image, block, k, scale, zero, out):
    height, width = image.shape
    r = block // 2
    slots = block + 1
    smooth, slope = np.full(width + 2, zero), np.full(width + 2, zero)
    ring_xx, ring_yy, ring_xy = (
        np.full((slots, width), zero),
        np.full((slots, width), zero),
        np.full((slots, width), zero),
    )
    total_xx, total_yy, total_xy = (
        np.full(width + 2 * r, zero),
        np.full(width + 2 * r, zero),
        np.full(width + 2 * r, zero),
    )
    inner_xx, inner_yy, inner_xy = total_xx[r : r + width], total_yy[r : r + width], total_xy[r : r + width]
    nothing = np.full(width, zero)
    A, B, C = np.full(width, zero), np.full(width, zero), np.full(width, zero)
    s4 = np.float32(scale * scale * scale * scale)
    k32 = np.float32(k)
    for y in range(-1, height):
        # rows that enter: at first the whole window below the edge, then one a step
        for row in range(0 if y < 0 else y + r + 1, min(r + 1, height) if y < 0 else min(y + r + 2, height)):
            i = row % slots
            above, below = image[_reflect(row - 1, height)], image[_reflect(row + 1, height)]
            _products(above, image[row], below, smooth, slope, ring_xx[i], ring_yy[i], ring_xy[i])
        if y < 0:
            for dy in range(-r, r + 1):
                i = _reflect(dy, height) % slots
                _slide(inner_xx, ring_xx[i], nothing)
                _slide(inner_yy, ring_yy[i], nothing)
                _slide(inner_xy, ring_xy[i], nothing)
            continue
        _reflect_margins(total_xx, r)
        _reflect_margins(total_yy, r)
        _reflect_margins(total_xy, r)
        if block == 3:
            _sum3_and_formula(total_xx, total_yy, total_xy, k32, s4, out[y])
        else:
            _row_sum(total_xx, block, A)
            _row_sum(total_yy, block, B)
            _row_sum(total_xy, block, C)
            _formula(A, B, C, k32, s4, out[y])
        if y + 1 < height:
            i, j = _reflect(y + r + 1, height) % slots, _reflect(y - r, height) % slots
            _slide(inner_xx, ring_xx[i], ring_xx[j])
            _slide(inner_yy, ring_yy[i], ring_yy[j])
            _slide(inner_xy, ring_xy[i], ring_xy[j])


@njit(cache=True, nogil=True, error_model="numpy")
def harris_box3_uint8(image, block, k, scale, out):
    """Response of an 8-bit image, box window, 3x3 gradient: exact int32 sums, float32 formula."""
    _response_rows(image, block, k, scale, np.int32(0), out)


@njit(cache=True, nogil=True, error_model="numpy")
def harris_box3_small_uint8(image, block, k, scale, out):
    """The same for windows up to 3x3, whose sums stay below 2^24: float32 holds them exactly, and is faster."""
    _response_rows(image, block, k, scale, np.float32(0), out)


@njit(cache=True, nogil=True, error_model="numpy")
def harris_box3_float(image, block, k, scale, out):
    """The same of a float64 image: sums in float64, so that sliding them loses nothing that float32 would show."""
    _response_rows(image, block, k, scale, 0.0, out)
