# mypy: allow-untyped-defs
"""Kernels of ``undistortion``: the maps of OpenCV's family of lenses, a row at a time.

The ray of pixel (u, v) is B (u, v, 1)ᵀ, B = (P R)⁻¹, so along a row each of its three coordinates is a *ramp*, start +
j · step. Each row first lays the three ramps into buffers, then computes the map from them in one loop that vectorises.

**To the last bit.** OpenCV lays its ramps in blocks of eight, adding 8 · step to the block's start and j · step within
the block. The sum so made differs from start + j · step by rounding, some 1e-13 px, and once in six million pixels that
shows in the float32 map. So the ramps here are laid in the same blocks.

With x = X/W, y = Y/W, the five-parameter lens is regrouped to share factors between the two coordinates,

    x_d = x g + p₂ r²,   y_d = y g + p₁ r²,   g = 1 + k₁r² + k₂r⁴ + k₃r⁶ + 2 (p₂ x + p₁ y),

which is Brown's formula: p₂ (r² + 2x²) + 2 p₁ x y = p₂ r² + 2x (p₂ x + p₁ y). That is 15 multiplications and one
division a pixel where the textbook's grouping takes 23 and two.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic


@intrinsic
def _fma(typingctx, a, b, c):
    """a * b + c, rounded once."""

    def codegen(context, builder, signature, args):
        return builder.fma(*args)

    return a(a, a, a), codegen


@intrinsic
def _store_ramp(typingctx, out, at, start, step):
    """out[at + q] = start + q * step for q = 0 … 7, as one vector."""

    def codegen(context, builder, signature, args):
        lanes = ir.VectorType(ir.DoubleType(), 8)
        undefined = ir.Constant(lanes, ir.Undefined)
        first = ir.Constant(ir.VectorType(ir.IntType(32), 8), [0] * 8)

        def splat(value):
            return builder.shuffle_vector(builder.insert_element(undefined, value, ir.IntType(32)(0)), undefined, first)

        ramp = builder.fmul(splat(args[3]), ir.Constant(lanes, [float(q) for q in range(8)]))
        array = context.make_array(signature.args[0])(context, builder, args[0])
        pointer = builder.bitcast(builder.gep(array.data, [args[1]]), lanes.as_pointer())
        builder.store(builder.fadd(splat(args[2]), ramp), pointer).align = 8
        return context.get_dummy_value()

    return types.void(out, at, start, step), codegen


@njit(cache=True, nogil=True, error_model="numpy")
def _lay_ramps(B, v, count, X, Y, W):
    """The rays of row v in blocks of eight; the buffers have room for whole blocks."""
    x, y, w = v * B[1] + B[2], v * B[4] + B[5], v * B[7] + B[8]
    for at in range(0, count, 8):
        _store_ramp(X, at, x, B[0])
        _store_ramp(Y, at, y, B[3])
        _store_ramp(W, at, w, B[6])
        x += 8 * B[0]
        y += 8 * B[3]
        w += 8 * B[6]


@njit(cache=True, nogil=True, error_model="numpy")
def brown_maps(B, k, fx, fy, cx, cy, map_x, map_y):
    """Maps of k1 k2 p1 p2 k3. B is (P R)⁻¹, row by row."""
    height, width = map_x.shape
    room = (width + 7) // 8 * 8
    X, Y, W = np.empty(room), np.empty(room), np.empty(room)
    k1, k2, p1, p2, k3 = k[0], k[1], k[2], k[3], k[4]
    twice_p1, twice_p2, shift_x, shift_y = 2 * p1, 2 * p2, fx * p2, fy * p1
    for v in range(height):
        _lay_ramps(B, v, width, X, Y, W)
        row_x, row_y = map_x[v], map_y[v]
        for j in range(width):
            s = 1.0 / W[j]
            x, y = X[j] * s, Y[j] * s
            r2 = x * x + y * y
            g = _fma(twice_p2, x, _fma(twice_p1, y, 1.0))
            g = _fma(_fma(_fma(k3, r2, k2), r2, k1), r2, g)
            row_x[j] = np.float32(_fma(fx * x, g, _fma(shift_x, r2, cx)))
            row_y[j] = np.float32(_fma(fy * y, g, _fma(shift_y, r2, cy)))


@njit(cache=True, nogil=True, error_model="numpy")
def rational_maps(B, k, fx, fy, cx, cy, map_x, map_y):
    """Maps of the first twelve coefficients: rational radial factor, thin prism."""
    height, width = map_x.shape
    room = (width + 7) // 8 * 8
    X, Y, W = np.empty(room), np.empty(room), np.empty(room)
    k1, k2, k3, k4, k5, k6 = k[0], k[1], k[4], k[5], k[6], k[7]
    # x_d = x g + r² (p₂ + s₁ + s₂ r²), y_d = y g + r² (p₁ + s₃ + s₄ r²)
    twice_p1, twice_p2, near_x, near_y, far_x, far_y = 2 * k[2], 2 * k[3], k[3] + k[8], k[2] + k[10], k[9], k[11]
    for v in range(height):
        _lay_ramps(B, v, width, X, Y, W)
        row_x, row_y = map_x[v], map_y[v]
        for j in range(width):
            s = 1.0 / W[j]
            x, y = X[j] * s, Y[j] * s
            r2 = x * x + y * y
            radial = _fma(_fma(_fma(k3, r2, k2), r2, k1), r2, 1.0) / _fma(_fma(_fma(k6, r2, k5), r2, k4), r2, 1.0)
            g = _fma(twice_p2, x, _fma(twice_p1, y, radial))
            row_x[j] = np.float32(_fma(fx, _fma(x, g, r2 * _fma(far_x, r2, near_x)), cx))
            row_y[j] = np.float32(_fma(fy, _fma(y, g, r2 * _fma(far_y, r2, near_y)), cy))


@njit(cache=True, nogil=True, error_model="numpy")
def tilted_maps(B, k, tilt, fx, fy, cx, cy, map_x, map_y):
    """Maps of all fourteen coefficients; `tilt` is the sensor's homography."""
    height, width = map_x.shape
    room = (width + 7) // 8 * 8
    X, Y, W = np.empty(room), np.empty(room), np.empty(room)
    k1, k2, k3, k4, k5, k6 = k[0], k[1], k[4], k[5], k[6], k[7]
    twice_p1, twice_p2, near_x, near_y, far_x, far_y = 2 * k[2], 2 * k[3], k[3] + k[8], k[2] + k[10], k[9], k[11]
    for v in range(height):
        _lay_ramps(B, v, width, X, Y, W)
        row_x, row_y = map_x[v], map_y[v]
        for j in range(width):
            s = 1.0 / W[j]
            x, y = X[j] * s, Y[j] * s
            r2 = x * x + y * y
            radial = _fma(_fma(_fma(k3, r2, k2), r2, k1), r2, 1.0) / _fma(_fma(_fma(k6, r2, k5), r2, k4), r2, 1.0)
            g = _fma(twice_p2, x, _fma(twice_p1, y, radial))
            xd = _fma(x, g, r2 * _fma(far_x, r2, near_x))
            yd = _fma(y, g, r2 * _fma(far_y, r2, near_y))
            w = 1.0 / _fma(tilt[6], xd, _fma(tilt[7], yd, tilt[8]))
            row_x[j] = np.float32(_fma(fx * w, _fma(tilt[0], xd, _fma(tilt[1], yd, tilt[2])), cx))
            row_y[j] = np.float32(_fma(fy * w, _fma(tilt[3], xd, _fma(tilt[4], yd, tilt[5])), cy))
