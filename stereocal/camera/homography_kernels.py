# mypy: allow-untyped-defs
"""Homographies of many views at once, compiled: the twin of ``homography.fit_homography``.

Where that takes the singular value decomposition of A (2N × 9), this accumulates AᵀA (9 × 9), which has the same
vector for the smallest singular value, and finds it by inverse iteration, h ← (AᵀA + εI)⁻¹ h, normalised, until h
stands still. Each pass shrinks the other directions by the ratio of the two smallest eigenvalues: a few passes for a
mild lens, dozens where distortion or noise blur the difference.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def homographies_kernel(X, y, offsets, H, degenerate):
    """Fill H (V, 3, 3), scaled to unit norm with H[2, 2] ≥ 0, and flags of views whose points lie on a line.

    X and y are (3, M) and (2, M); view v is columns offsets[v] : offsets[v + 1].
    """
    B = np.empty((9, 9))
    h = np.empty(9)
    before = np.empty(9)
    P = np.empty((3, 3))
    for view in range(len(offsets) - 1):
        first, last = offsets[view], offsets[view + 1]
        n = last - first
        xm, ym, um, vm = 0.0, 0.0, 0.0, 0.0
        for j in range(first, last):
            xm += X[0, j]
            ym += X[1, j]
            um += y[0, j]
            vm += y[1, j]
        xm, ym, um, vm = xm / n, ym / n, um / n, vm / n
        xx, xy, yy, uu, uv, vv, dx, du = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(first, last):
            a, b, c, d = X[0, j] - xm, X[1, j] - ym, y[0, j] - um, y[1, j] - vm
            xx, xy, yy = xx + a * a, xy + a * b, yy + b * b
            uu, uv, vv = uu + c * c, uv + c * d, vv + d * d
            dx += math.sqrt(a * a + b * b)
            du += math.sqrt(c * c + d * d)
        # determinant over trace² of the second moments is about (short side / long side)²
        degenerate[view] = not (
            xx * yy - xy * xy > 1e-12 * (xx + yy) ** 2 and uu * vv - uv * uv > 1e-12 * (uu + vv) ** 2
        )
        if degenerate[view]:
            continue
        a_scale, b_scale = math.sqrt(2.0) * n / dx, math.sqrt(2.0) * n / du
        for i in range(9):
            for k in range(9):
                B[i, k] = 0.0
        for j in range(first, last):
            a, b = (X[0, j] - xm) * a_scale, (X[1, j] - ym) * a_scale
            u, v = (y[0, j] - um) * b_scale, (y[1, j] - vm) * b_scale
            # rows (X̂, 0, −u X̂) and (0, X̂, −v X̂): only six products of X̂ X̂ᵀ, times 1, −u, −v and u² + v²
            r = u * u + v * v
            for i in range(6):
                p = a * a if i == 0 else a * b if i == 1 else a if i == 2 else b * b if i == 3 else b if i == 4 else 1.0
                row = 0 if i < 3 else 1 if i < 5 else 2
                column = i if i < 3 else i - 2 if i < 5 else 2
                B[column, row] += p
                B[6 + column, row] -= u * p
                B[6 + column, 3 + row] -= v * p
                B[6 + column, 6 + row] += r * p
        for i in range(3):  # the other triangle of each 3×3 block, and the second diagonal block
            for k in range(i + 1):
                B[3 + i, 3 + k] = B[i, k]
                B[6 + k, i] = B[6 + i, k]
                B[6 + k, 3 + i] = B[6 + i, 3 + k]
        trace = 0.0
        for i in range(9):
            trace += B[i, i]
        for i in range(9):
            B[i, i] += 1e-14 * trace
        for k in range(9):  # Cholesky
            s = B[k, k]
            for i in range(k):
                s -= B[k, i] * B[k, i]
            s = math.sqrt(max(s, 1e-300))
            B[k, k] = s
            for i in range(k + 1, 9):
                t = B[i, k]
                for e in range(k):
                    t -= B[i, e] * B[k, e]
                B[i, k] = t / s
        for i in range(9):
            h[i] = 1.0 if i == 0 or i == 4 or i == 8 else 0.1
        for _ in range(300):
            for i in range(9):
                before[i] = h[i]
            for i in range(9):
                t = h[i]
                for k in range(i):
                    t -= B[i, k] * h[k]
                h[i] = t / B[i, i]
            for i in range(8, -1, -1):
                t = h[i]
                for k in range(i + 1, 9):
                    t -= B[k, i] * h[k]
                h[i] = t / B[i, i]
            norm = 0.0
            for i in range(9):
                norm += h[i] * h[i]
            norm = math.sqrt(norm)
            moved = 0.0
            for i in range(9):
                h[i] /= norm
                moved += (h[i] - before[i]) ** 2
            if moved < 1e-22:
                break
        # undo the two similarities: H = Tb⁻¹ h Ta
        for i in range(3):
            P[i, 0] = h[3 * i] * a_scale
            P[i, 1] = h[3 * i + 1] * a_scale
            P[i, 2] = h[3 * i + 2] - P[i, 0] * xm - P[i, 1] * ym
        norm = 0.0
        for k in range(3):
            H[view, 0, k] = P[0, k] / b_scale + um * P[2, k]
            H[view, 1, k] = P[1, k] / b_scale + vm * P[2, k]
            H[view, 2, k] = P[2, k]
            norm += H[view, 0, k] ** 2 + H[view, 1, k] ** 2 + H[view, 2, k] ** 2
        norm = math.sqrt(norm) if H[view, 2, 2] >= 0 else -math.sqrt(norm)
        for i in range(3):
            for k in range(3):
                H[view, i, k] /= norm
