# mypy: allow-untyped-defs
"""Sums of the normal equations from a lens's derivatives that are at hand: the kernel of ``bundle_sums``.

What ``bundle.normal_equations`` does with the columns of one camera, a point at a time: with a = A ∂x_d/∂x, the chain
of the perspective division and of the pose gives q = ∂p̃/∂t_v and Y × q = ∂p̃/∂ω_v, and U, V, W, b add up.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def sums_kernel(
    points, measured, offsets, view_of_block, R, t, theta, x_d, D, D_k, row_of, free_of, factor, U, b, V, b_v, W,
    residuals,
):  # fmt: skip
    """Add up U (F, F), b (F,), V (V, 6, 6), b_v (V, 6), W (V, F, 6), all 0 before; write residuals (M, 2); return F.

    `row_of`, `free_of`, `factor` are the entries of G that are not 0.
    """
    F, lens = len(b), D_k.shape[2]
    by_theta, by_free, by_pose = np.zeros((2, 5 + lens)), np.empty((2, F)), np.empty((2, 6))
    fx, fy, cx, cy, skew = theta[0], theta[1], theta[2], theta[3], theta[4]
    cost = 0.0
    for block in range(len(view_of_block)):
        v = view_of_block[block]
        for i in range(offsets[block], offsets[block + 1]):
            X, Y, Z = points[i]
            y0 = R[v, 0, 0] * X + R[v, 0, 1] * Y + R[v, 0, 2] * Z
            y1 = R[v, 1, 0] * X + R[v, 1, 1] * Y + R[v, 1, 2] * Z
            y2 = R[v, 2, 0] * X + R[v, 2, 1] * Y + R[v, 2, 2] * Z
            z = 1.0 / (y2 + t[v, 2])
            x, y = (y0 + t[v, 0]) * z, (y1 + t[v, 1]) * z
            u, w = x_d[i]
            e0 = fx * u + skew * w + cx - measured[i, 0]
            e1 = fy * w + cy - measured[i, 1]
            residuals[i, 0], residuals[i, 1] = e0, e1
            cost += e0 * e0 + e1 * e1
            for row in range(2):
                if row == 0:
                    a0, a1 = fx * D[i, 0, 0] + skew * D[i, 1, 0], fx * D[i, 0, 1] + skew * D[i, 1, 1]
                else:
                    a0, a1 = fy * D[i, 1, 0], fy * D[i, 1, 1]
                q0, q1 = a0 * z, a1 * z
                q2 = -(x * q0 + y * q1)
                by_pose[row, 0], by_pose[row, 1] = y1 * q2 - y2 * q1, y2 * q0 - y0 * q2
                by_pose[row, 2] = y0 * q1 - y1 * q0
                by_pose[row, 3], by_pose[row, 4], by_pose[row, 5] = q0, q1, q2
            by_theta[0, 0], by_theta[1, 1], by_theta[0, 2], by_theta[1, 3], by_theta[0, 4] = u, w, 1.0, 1.0, w
            for j in range(lens):
                by_theta[0, 5 + j] = fx * D_k[i, 0, j] + skew * D_k[i, 1, j]
                by_theta[1, 5 + j] = fy * D_k[i, 1, j]
            by_free[:] = 0.0
            for j in range(len(row_of)):
                by_free[0, free_of[j]] += by_theta[0, row_of[j]] * factor[j]
                by_free[1, free_of[j]] += by_theta[1, row_of[j]] * factor[j]
            for m in range(6):
                p0, p1 = by_pose[0, m], by_pose[1, m]
                b_v[v, m] += p0 * e0 + p1 * e1
                for n in range(m + 1):
                    V[v, m, n] += p0 * by_pose[0, n] + p1 * by_pose[1, n]
            for m in range(F):
                p0, p1 = by_free[0, m], by_free[1, m]
                b[m] += p0 * e0 + p1 * e1
                for n in range(m + 1):
                    U[m, n] += p0 * by_free[0, n] + p1 * by_free[1, n]
                for n in range(6):
                    W[v, m, n] += p0 * by_pose[0, n] + p1 * by_pose[1, n]
    for m in range(F):
        for n in range(m):
            U[n, m] = U[m, n]
    for v in range(len(V)):
        for m in range(6):
            for n in range(m):
                V[v, n, m] = V[v, m, n]
    return cost
