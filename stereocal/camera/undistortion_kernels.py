# mypy: allow-untyped-defs
"""Kernels of ``undistortion``: the maps of OpenCV's family of lenses, eight pixels at a time, and of the fisheye.

The ray of pixel (u, v) is B (u, v, 1)ᵀ, B = (P R)⁻¹, so along a row each of its coordinates X, Y, W is a *ramp*,
start + u · step. With s = f_x / W the kernel works in x = s X and y = s Y, which are f_x times the normalised
coordinates: the multiplication by f_x at the end is saved, for coefficients that are divided by powers of f_x once. The
lens is regrouped, so that the two coordinates share factors,

    x_d = x g + r² (p₂ + s₁ + s₂ r²),   y_d = y g + r² (p₁ + s₃ + s₄ r²),   g = 1 + r² rise(r²) + 2 (p₂ x + p₁ y),

which is Brown's formula: p₂ (r² + 2x²) + 2 p₁ x y = p₂ r² + 2x (p₂ x + p₁ y). Here 1 + r² rise is the radial factor:
with a = k₁ + k₂ r² + k₃ r⁴ and b = k₄ + k₅ r² + k₆ r⁴ it is (1 + a r²) / (1 + b r²), so rise = (a − b) / (1 + b r²).
And 2 (p₂ x + p₁ y) is s times a ramp of its own, G.

**What bounds it.** The five-parameter lens takes 13 multiplications (or multiplications with an addition) and one
division a pixel; the textbook's grouping takes 23 and two. A core of AMD's Zen 4 multiplies eight numbers a cycle, and
a division of eight keeps one of its two multipliers for nine cycles: (13 · 2 + 9) / 2 = 17.5 cycles for eight pixels.
The kernel takes 18.5. Additions, conversions and stores run beside that.

**To the last bit.** OpenCV lays its ramps in blocks of eight, adding 8 · step to the block's start and u · step within
the block. The sum so made differs from start + u · step by rounding, some 1e-13 px, and once in six million pixels that
shows in the float32 map. So the ramps here are laid in the same blocks. Regrouping the formula rounds differently too,
but by less: of 361 million values of random maps 2 differ from OpenCV's, by the last bit of a float32.

The fisheye's arctangent has no vector instruction: its map is made pixel by pixel, and a ray from behind the camera
(W ≤ 0), which the lens may well see but the plane z = 1 cannot hold, is NaN.
"""

from __future__ import annotations

from math import atan, sqrt

import numpy as np
from numba import njit

from stereocal.camera.vector_doubles import fill, lanes, multiply_add, store

# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _inverse(P, R):
    """(P R)⁻¹ by cofactors, row by row, and the determinant: in OpenCV's order of operations, bit for bit."""
    M = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            M[i, j] = P[i, 0] * R[0, j] + P[i, 1] * R[1, j] + P[i, 2] * R[2, j]
    a, b, c = M[0]
    d, e, f = M[1]
    g, h, i = M[2]
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    s = 1 / determinant
    first = s * (e * i - f * h), s * (c * h - b * i), s * (b * f - c * e)
    second = s * (f * g - d * i), s * (a * i - c * g), s * (c * d - a * f)
    third = s * (d * h - e * g), s * (b * g - a * h), s * (a * e - b * d)
    return first + second + third, determinant


@njit(cache=True, nogil=True, error_model="numpy")
def lens_maps(P, R, k, tilt, fx, fy, cx, cy, lens, map_x, map_y):
    """Maps of a lens of OpenCV's family.

    k holds k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4; `tilt` is the homography of the sensor on coordinates that are f_x and
    f_y times the normalised ones. `lens` is a tuple whose LENGTH, known when this is compiled, tells which coefficients
    count: 0 the first five, 1 the first eight, 2 all of k, 3 the tilt too. Returns the determinant of P R.
    """
    B, determinant = _inverse(P, R)
    height, width = map_x.shape
    flat_x, flat_y = map_x.reshape(-1), map_y.reshape(-1)
    f2, ratio = 1 / (fx * fx), fy / fx
    k1, k2, k3, k4, k5, k6 = k[0] * f2, k[1] * f2**2, k[4] * f2**3, k[5] * f2, k[6] * f2**2, k[7] * f2**3
    near_x, near_y = (k[3] + k[8]) / fx, (k[2] + k[10]) / fx * ratio
    far_x, far_y = k[9] * f2 / fx, k[11] * f2 / fx * ratio
    twice_p2, twice_p1 = 2 * k[3] / fx, 2 * k[2] / fx
    g_u, g_v = twice_p2 * B[0] + twice_p1 * B[3], twice_p2 * B[1] + twice_p1 * B[4]
    g_0 = twice_p2 * B[2] + twice_p1 * B[5]
    lanes_x, lanes_y, lanes_w, lanes_g = lanes(B[0]), lanes(B[3]), lanes(B[6]), lanes(g_u)
    block_x, block_y, block_w, block_g = fill(8 * B[0]), fill(8 * B[3]), fill(8 * B[6]), fill(8 * g_u)
    for v in range(height):
        start_x, start_y = fill(v * B[1] + B[2]), fill(v * B[4] + B[5])
        start_w, start_g = fill(v * B[7] + B[8]), fill(v * g_v + g_0)
        for u in range(0, width, 8):
            s = fx / (start_w + lanes_w)
            x, y = (start_x + lanes_x) * s, (start_y + lanes_y) * s
            r2 = multiply_add(x, x, y * y)
            y = ratio * y  # from here on f_y times the normalised coordinate
            g = multiply_add(start_g + lanes_g, s, 1.0)
            rise = multiply_add(multiply_add(k3, r2, k2), r2, k1)
            if len(lens) >= 1:
                below = multiply_add(multiply_add(k6, r2, k5), r2, k4)
                rise = (rise - below) / multiply_add(below, r2, 1.0)
            g = multiply_add(rise, r2, g)
            aside_x, aside_y = fill(near_x), fill(near_y)
            if len(lens) >= 2:
                aside_x, aside_y = multiply_add(far_x, r2, near_x), multiply_add(far_y, r2, near_y)
            if len(lens) == 3:
                xd, yd = multiply_add(x, g, aside_x * r2), multiply_add(y, g, aside_y * r2)
                w = 1.0 / multiply_add(tilt[2, 0], xd, multiply_add(tilt[2, 1], yd, tilt[2, 2]))
                out_x = multiply_add(w, multiply_add(tilt[0, 0], xd, multiply_add(tilt[0, 1], yd, tilt[0, 2])), cx)
                out_y = multiply_add(w, multiply_add(tilt[1, 0], xd, multiply_add(tilt[1, 1], yd, tilt[1, 2])), cy)
            else:
                out_x = multiply_add(x, g, multiply_add(aside_x, r2, cx))
                out_y = multiply_add(y, g, multiply_add(aside_y, r2, cy))
            store(out_x, flat_x, v * width + u, width - u)
            store(out_y, flat_y, v * width + u, width - u)
            start_x, start_y = start_x + block_x, start_y + block_y
            start_w, start_g = start_w + block_w, start_g + block_g
    return determinant


@njit(cache=True, nogil=True, error_model="numpy")
def fisheye_maps(P, R, k, fx, fy, cx, cy, map_x, map_y):
    """Maps of Kannala and Brandt's fisheye, k1 k2 k3 k4. Returns the determinant of P R."""
    B, determinant = _inverse(P, R)
    height, width = map_x.shape
    for v in range(height):
        for u in range(width):
            W = B[6] * u + B[7] * v + B[8]
            x, y = (B[0] * u + B[1] * v + B[2]) / W, (B[3] * u + B[4] * v + B[5]) / W
            r = sqrt(x * x + y * y)
            angle = atan(r)
            t = angle * angle
            bent = angle * (1 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3]))))
            scale = bent / r if r > 1e-8 else 1.0
            map_x[v, u] = np.float32(fx * x * scale + cx) if W > 0 else np.float32(np.nan)
            map_y[v, u] = np.float32(fy * y * scale + cy) if W > 0 else np.float32(np.nan)
    return determinant
