# mypy: allow-untyped-defs
"""Undoing a lens, compiled: the twin of ``distortion_inverse``.

It knows OpenCV's family before the tilt, the fisheye, and the rational function, whose distorting it is that iterates.

Domain, iteration, tolerances and letters are those of ``distortion_inverse``. There the points go through each step
together, here every point runs to its end alone, so that an easy point does not wait for a hard one. Both radial
families are one function of the radius, or of the angle for a fisheye,

    g(r) = r (1 + a₁ s + a₂ s² + a₃ s³ + a₄ s⁴) / (1 + b₁ s + b₂ s² + b₃ s³),   s = r²,

and a general map is told by its number of coefficients: twelve, k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, are Brown's
(``distortion_brown``), three more are the row M₃ of a tilt, beyond whose line at infinity, M₃ (x_d, 1) = 0, the map has
no value, and eighteen are W of the rational function (``distortion_rational_function``).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

TOLERANCE = 1e-12
MAX_NEWTON = 60
NEWTON_PER_STEP = 12
LONGEST_STEP, SHORTEST_STEP = 1 / 16, 1 / 64
FIRST_LEVEL = 4
LAST_LEVEL = 40
MOST_INTERVALS = 1000
DIRECTIONS = 64
SURVEYS = 12

# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def radial(r, a, b):
    """Return g(r) and g′(r) = f + 2 s f′."""
    s = r * r
    q = 1 + s * (b[0] + s * (b[1] + s * b[2]))
    f = (1 + s * (a[0] + s * (a[1] + s * (a[2] + s * a[3])))) / q
    c_s = a[0] + s * (2 * a[1] + s * (3 * a[2] + s * (4 * a[3])))
    f_s = (c_s - f * (b[0] + s * (2 * b[1] + 3 * b[2] * s))) / q
    return r * f, f + 2 * s * f_s


@njit(cache=True, nogil=True, error_model="numpy")
def invert_radial_kernel(y, a, b, limit, of_angle, x):
    """Write x = y · r / |y| with g(r) = |y|, or y · tan(r) / |y| where r is an angle; NaN beyond the turning point."""
    end = abs(radial(limit, a, b)[0]) if np.isfinite(limit) else np.inf
    for i in range(len(y)):
        length = math.hypot(y[i, 0], y[i, 1])
        if end <= length or not np.isfinite(length):
            x[i, 0] = x[i, 1] = np.nan
            continue
        low, high = 0.0, limit
        if not np.isfinite(limit):
            high = max(2 * length, 1e-300)
            for _ in range(1100):
                if not radial(high, a, b)[0] < length:
                    break
                high *= 2
        r = min(length, 0.5 * high)
        for _ in range(200):
            value, slope = radial(r, a, b)
            if value == length:
                break
            if value <= length:
                low = r
            else:
                high = r
            new = r - (value - length) / slope
            if not (new > low and new < high):
                new = 0.5 * (low + high)
            moved = abs(new - r) > 1e-16 * max(new, 1e-300)
            r = new
            if not moved:
                break
        if of_angle:
            r = math.tan(r)
        ratio = r / length if length > 0 else 1.0
        x[i, 0] = y[i, 0] * ratio
        x[i, 1] = y[i, 1] * ratio


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def brown(u, v, k):
    """Return x_d and the four entries of ∂x_d/∂x, by rows."""
    s = u * u + v * v
    q = 1 + s * (k[5] + s * (k[6] + s * k[7]))
    f = (1 + s * (k[0] + s * (k[1] + s * k[4]))) / q
    f_s = (k[0] + s * (2 * k[1] + 3 * k[4] * s) - f * (k[5] + s * (2 * k[6] + 3 * k[7] * s))) / q
    cross = 2 * u * v * f_s + 2 * k[2] * u + 2 * k[3] * v
    prism_u, prism_v = k[8] + 2 * k[9] * s, k[10] + 2 * k[11] * s
    return (
        u * f + 2 * k[2] * u * v + k[3] * (s + 2 * u * u) + s * (k[8] + k[9] * s),
        v * f + k[2] * (s + 2 * v * v) + 2 * k[3] * u * v + s * (k[10] + k[11] * s),
        f + 2 * u * u * f_s + 2 * k[2] * v + 6 * k[3] * u + 2 * u * prism_u,
        cross + 2 * v * prism_u,
        cross + 2 * u * prism_v,
        f + 2 * v * v * f_s + 6 * k[2] * v + 2 * k[3] * u + 2 * v * prism_v,
    )


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def rational_function(u, v, W):
    """Return x_u and the four entries of ∂x_u/∂x_d, by rows: dx_u = (dh₁₂ − x_u dh₃) / h₃, h = W χ."""
    uu, uv, vv = u * u, u * v, v * v
    h3 = W[12] * uu + W[13] * uv + W[14] * vv + W[15] * u + W[16] * v + W[17]
    x = (W[0] * uu + W[1] * uv + W[2] * vv + W[3] * u + W[4] * v + W[5]) / h3
    y = (W[6] * uu + W[7] * uv + W[8] * vv + W[9] * u + W[10] * v + W[11]) / h3
    by_u, by_v = 2 * W[12] * u + W[13] * v + W[15], W[13] * u + 2 * W[14] * v + W[16]
    return (
        x,
        y,
        (2 * W[0] * u + W[1] * v + W[3] - x * by_u) / h3,
        (W[1] * u + 2 * W[2] * v + W[4] - x * by_v) / h3,
        (2 * W[6] * u + W[7] * v + W[9] - y * by_u) / h3,
        (W[7] * u + 2 * W[8] * v + W[10] - y * by_v) / h3,
    )


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def lens(u, v, k):
    """Return the map and its derivatives at (u, v), of the model that has as many coefficients."""
    if len(k) == 18:
        return rational_function(u, v, k)
    x_d, y_d, a, b, c, d = brown(u, v, k)
    if len(k) == 15 and not k[12] * x_d + k[13] * y_d + k[14] > 0:
        return np.nan, np.nan, np.nan, np.nan, np.nan, np.nan
    return x_d, y_d, a, b, c, d


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def newton(y0, y1, u, v, k, most):
    """Some steps of damped Newton from (u, v), at `most`; return where it ended and whether f = y, with det > 0."""
    f0, f1, a, b, c, d = lens(u, v, k)
    for _ in range(8):  # a start outside of the domain is drawn to the centre, where every lens is nearly ideal
        if a * d - b * c > 0:
            break
        u, v = 0.5 * u, 0.5 * v
        f0, f1, a, b, c, d = lens(u, v, k)
    size = max(1.0, math.hypot(y0, y1))
    error = math.hypot(f0 - y0, f1 - y1)
    for _ in range(most):
        if not error > 1e-15 * size:
            break
        determinant = a * d - b * c
        r0, r1 = f0 - y0, f1 - y1
        h0, h1 = -(d * r0 - b * r1) / determinant, -(a * r1 - c * r0) / determinant
        accepted = False
        for _ in range(24):
            g0, g1, a_there, b_there, c_there, d_there = lens(u + h0, v + h1, k)
            there = math.hypot(g0 - y0, g1 - y1)
            if there < error and a_there * d_there - b_there * c_there > 0:
                accepted = True
                break
            if not error > TOLERANCE * size:  # nothing left to win but rounding
                break
            h0, h1 = 0.5 * h0, 0.5 * h1
        if not accepted:
            break
        u, v, error = u + h0, v + h1, there
        f0, f1, a, b, c, d = g0, g1, a_there, b_there, c_there, d_there
    return u, v, error <= TOLERANCE * size and a * d - b * c > 0


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def determinant(u, v, k):
    """Return det ∂f/∂x at (u, v)."""
    _, _, a, b, c, d = lens(u, v, k)
    return a * d - b * c


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def open_way(u, v, k):
    """Return how far one can go from the centre to (u, v) with det ∂f/∂x > 0, as a part of the way; 1 is all of it."""
    i, level, D_0 = 0, FIRST_LEVEL, determinant(0.0, 0.0, k)
    for _ in range(MOST_INTERVALS):
        h = 0.5**level
        middle, end = (i + 0.5) * h, (i + 1) * h
        D_m, D_1 = determinant(middle * u, middle * v, k), determinant(end * u, end * v, k)
        if not (D_0 > 0 and D_m > 0 and D_1 > 0 and np.isfinite(D_m + D_1)):
            break
        if abs(D_m - 0.5 * (D_0 + D_1)) <= 0.5 * min(D_0, D_m, D_1):
            i, D_0 = i + 1, D_1
            if i % 2 == 0 and level > FIRST_LEVEL:
                i, level = i // 2, level - 1
            if i == 2**level:
                return 1.0
        else:
            i, level = 2 * i, level + 1
            if level > LAST_LEVEL:
                break
    return i * 0.5**level


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def safe_radius(reach, k):
    """Radius of a disc about the centre, at most `reach`, without a fold: a survey that settles most points."""
    angles = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    directions_u, directions_v = np.cos(angles), np.sin(angles)
    for _ in range(SURVEYS):
        free = 1.0
        for i in range(DIRECTIONS):
            free = min(free, open_way(reach * directions_u[i], reach * directions_v[i], k))
        if free == 1:
            return reach
        if free >= 0.5:  # the nearest fold may lie between two directions, a little nearer than in either
            return 0.95 * free * reach
        reach *= free + 0.5**FIRST_LEVEL  # the fold is not much further: look closer
    return 0.0


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def follow(y0, y1, k):
    """Continuation f(x) = s·y from the centre; return where it came to and whether it arrived, s = 1."""
    u, v, s, step = 0.0, 0.0, 0.0, LONGEST_STEP
    while s < 1 and step >= SHORTEST_STEP:
        u_there, v_there, solved = newton((s + step) * y0, (s + step) * y1, u, v, k, NEWTON_PER_STEP)
        if solved:
            u, v, s = u_there, v_there, s + step
        else:
            step *= 0.5
    return u, v, s == 1


@njit(cache=True, nogil=True, error_model="numpy")
def invert_map_kernel(y, k, limit, x):
    """Write the x with f(x) = y inside the star-shaped domain of f about the centre; NaN where there is none."""
    good = np.zeros(len(y), dtype=np.bool_)
    reach = 0.0
    for i in range(len(y)):
        x[i, 0], x[i, 1], good[i] = newton(y[i, 0], y[i, 1], y[i, 0], y[i, 1], k, MAX_NEWTON)
        radius = math.hypot(x[i, 0], x[i, 1])
        good[i] = good[i] and radius < limit
        if good[i]:
            reach = max(reach, radius)
    safe = safe_radius(reach, k)
    for i in range(len(y)):
        if good[i] and (math.hypot(x[i, 0], x[i, 1]) <= safe or open_way(x[i, 0], x[i, 1], k) == 1):
            continue
        u, v, arrived = np.nan, np.nan, False
        if np.isfinite(y[i, 0]) and np.isfinite(y[i, 1]):
            u, v, arrived = follow(y[i, 0], y[i, 1], k)
        if not (arrived and math.hypot(u, v) < limit and open_way(u, v, k) == 1):
            u, v = np.nan, np.nan
        x[i, 0], x[i, 1] = u, v


@njit(cache=True, nogil=True, error_model="numpy")
def map_inside_kernel(x, k, y):
    """Write y = f(x) where x is inside the star-shaped domain of f about the centre; NaN outside."""
    farthest = 0.0
    for i in range(len(x)):
        square = x[i, 0] * x[i, 0] + x[i, 1] * x[i, 1]
        if square < np.inf:
            farthest = max(farthest, square)
    safe = safe_radius(math.sqrt(farthest), k)
    for i in range(len(x)):
        u, v = x[i, 0], x[i, 1]
        square = u * u + v * v
        if square < np.inf and (square <= safe * safe or open_way(u, v, k) == 1):
            y[i, 0], y[i, 1], _, _, _, _ = lens(u, v, k)
        else:
            y[i, 0] = y[i, 1] = np.nan


@njit(cache=True, nogil=True, error_model="numpy")
def rational_function_jacobians_kernel(x_d, k, D, D_k):
    """Write ∂x_d/∂x = G⁻¹ (N, 2, 2) and ∂x_d/∂W = −G⁻¹ ∂x_u/∂W (N, 2, 18) at distorted points (N, 2)."""
    chi, by_x, by_y, h = np.empty(6), np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(x_d)):
        x, y = x_d[i]
        chi[0], chi[1], chi[2], chi[3], chi[4], chi[5] = x * x, x * y, y * y, x, y, 1.0
        for row in range(3):
            w = k[6 * row : 6 * row + 6]
            by_x[row] = 2 * x * w[0] + y * w[1] + w[3]
            by_y[row] = x * w[1] + 2 * y * w[2] + w[4]
            h[row] = w[0] * chi[0] + w[1] * chi[1] + w[2] * chi[2] + w[3] * x + w[4] * y + w[5]
        u, v = h[0] / h[2], h[1] / h[2]
        # G = [a b; c d] / h₃, so that G⁻¹ = [d −b; −c a] h₃ / det, and ∂x_u/∂W has 1/h₃ too
        a, b = by_x[0] - u * by_x[2], by_y[0] - u * by_y[2]
        c, d = by_x[1] - v * by_x[2], by_y[1] - v * by_y[2]
        scale = 1.0 / (a * d - b * c)
        D[i, 0, 0], D[i, 0, 1] = h[2] * d * scale, -h[2] * b * scale
        D[i, 1, 0], D[i, 1, 1] = -h[2] * c * scale, h[2] * a * scale
        for j in range(6):
            f = chi[j] * scale
            D_k[i, 0, j], D_k[i, 0, 6 + j], D_k[i, 0, 12 + j] = -d * f, b * f, (d * u - b * v) * f
            D_k[i, 1, j], D_k[i, 1, 6 + j], D_k[i, 1, 12 + j] = c * f, -a * f, (a * v - c * u) * f
