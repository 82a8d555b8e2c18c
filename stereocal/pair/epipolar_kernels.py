# mypy: allow-untyped-defs
"""The nearest pair that satisfies F, compiled: Lindstrom's iteration of ``epipolar``, one pair after another.

The letters are those of the module. A pair at which the constraint has no solution nearby keeps its last estimate.
"""

from __future__ import annotations

import math

from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_pairs(F, left, right, rounds, new_left, new_right):
    """Write the nearest pair with x'ᵀ F x = 0 to each of left, right (N, 2) into new_left, new_right."""
    a, b, c, d, e, f, g, h, i = F.ravel()
    for k in range(len(left)):
        x, y, u, v = left[k, 0], left[k, 1], right[k, 0], right[k, 1]
        n0, n1 = a * x + b * y + c, d * x + e * y + f
        m0, m1 = a * u + d * v + g, b * u + e * v + h
        value = n0 * u + n1 * v + g * x + h * y + i
        s0, s1, t0, t1 = n0, n1, m0, m1
        p, q, o, w = x, y, u, v
        for _ in range(rounds):
            curve = s0 * (a * t0 + b * t1) + s1 * (d * t0 + e * t1)
            half = 0.5 * (s0 * n0 + s1 * n1 + t0 * m0 + t1 * m1)
            below = half + math.sqrt(max(half * half - curve * value, 0.0))
            if below > 0:
                step = value / below
                p, q, o, w = x - step * t0, y - step * t1, u - step * s0, v - step * s1
                s0, s1 = a * p + b * q + c, d * p + e * q + f
                t0, t1 = a * o + d * w + g, b * o + e * w + h
        new_left[k, 0], new_left[k, 1], new_right[k, 0], new_right[k, 1] = p, q, o, w
