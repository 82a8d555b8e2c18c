# mypy: allow-untyped-defs
"""Homographies of many views at once, compiled: the twin of ``homography.fit_homography``.

Where that takes the singular value decomposition of A (2N × 9), this accumulates AᵀA (9 × 9), which has the same
vector for the smallest singular value. With X̂ = (X, Y, 1) the rows of A are (X̂, 0, −u X̂) and (0, X̂, −v X̂), so that of
AᵀA only X̂X̂ᵀ is needed, weighted by 1, −u, −v and u² + v². The vector is the one that N = (AᵀA + εI)⁻¹ enlarges most:
h ← N h, normalised, until h stands still. Each pass shrinks the other directions by the ratio of the two smallest
eigenvalues: a few passes for a mild lens, dozens where distortion or noise blur the difference.
"""

from __future__ import annotations

import math

from numba import njit

# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
SUMS = {"reassoc", "contract", "nsz"}  # sums of products may be regrouped: that is what makes them vectors


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def normalize(x, y, to, similarity):
    """Write (x, y) moved to its centroid and scaled to a mean distance of √2; return whether it is no line."""
    n = len(x)
    a = b = 0.0
    for j in range(n):
        a += x[j]
        b += y[j]
    a /= n
    b /= n
    spread = xx = xy = yy = 0.0
    for j in range(n):
        d = x[j] - a
        e = y[j] - b
        xx += d * d
        xy += d * e
        yy += e * e
        spread += math.sqrt(d * d + e * e)
    spread = math.sqrt(2.0) * n / spread
    for j in range(n):
        to[0, j] = (x[j] - a) * spread
        to[1, j] = (y[j] - b) * spread
    similarity[0], similarity[1], similarity[2] = a, b, spread
    # determinant over trace² of the second moments is about (short side / long side)²
    return xx * yy - xy * xy > 1e-12 * (xx + yy) * (xx + yy)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def accumulate(C, n, B):
    """Fill the lower triangle of AᵀA from normalised points, rows X, Y, 1, u, v of C; return its trace."""
    trace = 0.0
    for i in range(3):
        for k in range(i + 1):
            p, q = C[i], C[k]
            s0 = s1 = s2 = s3 = 0.0
            for j in range(n):
                u, v = C[3, j], C[4, j]
                product = p[j] * q[j]
                s0 += product
                s1 -= product * u
                s2 -= product * v
                s3 += product * (u * u + v * v)
            B[i, k] = B[3 + i, 3 + k] = s0
            B[3 + i, k] = B[3 + k, i] = 0.0
            B[6 + i, k] = B[6 + k, i] = s1
            B[6 + i, 3 + k] = B[6 + k, 3 + i] = s2
            B[6 + i, 6 + k] = s3
        trace += 2 * s0 + s3
    return trace


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, **INNER)
def smallest(B, h, half, after):
    """Fill h with the eigenvector of B for its smallest eigenvalue; B, below which there is an identity, is lost."""
    n = len(h)  # loops of known length would be written out one by one, which takes long to compile
    for j in range(n):  # Cholesky, B = L Lᵀ; the identity becomes L⁻ᵀ
        for i in range(j, n + j + 1):
            total = B[i, j]
            for k in range(j):
                total -= B[i, k] * B[j, k]
            B[i, j] = total / math.sqrt(max(total, 1e-300)) if i == j else total / B[j, j]
    for _ in range(300):
        norm = moved = 0.0
        for j in range(n):
            half[j] = 0.0
            for i in range(j + 1):
                half[j] += B[n + i, j] * h[i]
        for i in range(n):
            after[i] = 0.0
            for j in range(i, n):
                after[i] += B[n + i, j] * half[j]
            norm += after[i] * after[i]
        norm = 1 / math.sqrt(norm)
        for i in range(n):
            moved += (after[i] * norm - h[i]) ** 2
            h[i] = after[i] * norm
        if moved < 1e-22:
            break


@njit(cache=True, nogil=True, error_model="numpy")
def homographies_kernel(data, offsets, H, middle, degenerate, C, B, h, work, similarities):
    """Fill H (V, 9), `middle` (V, 2), and flags of views whose points lie on a line.

    The middle (X_m, Y_m) is the mean of a view's board points, and H is about it: from (X − X_m, Y − Y_m, 1) to (u, v,
    1), scaled to unit norm with a last entry ≥ 0. `data` has rows X, Y, Z, u, v; view i is its columns offsets[i] :
    offsets[i + 1]. Scratch: C (5, points of the
    largest view), whose third row holds ones, B (18, 9), h (9), work (2, 9) and similarities (2, 3).
    """
    a, b = similarities[0], similarities[1]
    for v in range(len(H)):
        first = offsets[v]
        n = offsets[v + 1] - first
        degenerate[v] = False
        for side in range(len(similarities)):
            x, y = data[3 * side, first : first + n], data[3 * side + 1, first : first + n]
            if not normalize(x, y, C[3 * side :], similarities[side]):
                degenerate[v] = True
        if degenerate[v]:
            continue
        trace = accumulate(C, n, B)
        for i in range(len(h)):
            for j in range(len(h)):
                B[9 + i, j] = 0.0
            B[9 + i, i] = 1.0
            B[i, i] += 1e-14 * trace
            h[i] = 1.0 if i % 4 == 0 else 0.1
        smallest(B, h, work[0], work[1])
        norm = 0.0
        middle[v, 0], middle[v, 1] = a[0], a[1]
        for i in range(len(h)):  # undo the two similarities, but for the shift to the middle
            if i % 3 < 2:
                h[i] *= a[2]
        for i in range(len(h)):
            if i < 6:
                h[i] = h[i] / b[2] + b[i // 3] * h[6 + i % 3]
            norm += h[i] * h[i]
        norm = math.copysign(math.sqrt(norm), h[8])
        for i in range(len(h)):
            H[v, i] = h[i] / norm
