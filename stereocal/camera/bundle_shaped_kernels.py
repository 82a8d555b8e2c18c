# mypy: allow-untyped-defs
"""Kernels of ``bundle_shaped``: where points go, the normal equations, and the step.

The equations and letters are those of ``bundle``; the arrays are those of ``bundle_shaped``. Kernels take arrays and
write into arrays; nothing is checked here.
"""

from __future__ import annotations

import math

from numba import njit

FUSED = {"contract"}
SUMS = {"reassoc", "contract", "nsz"}  # sums of products may be regrouped: that is what makes them vectors
# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED)
def place_kernel(blocks, points, R_rig, t_rig, R_views, t_views, Y, X_c, x):
    """Fill Y = R_v X, X_c and x = X_c / Z_c of the rows of one camera; return how many are behind it."""
    start, behind = blocks[0, 1], 0
    for block in range(len(blocks)):
        v = blocks[block, 0]
        R, t = R_views[v], t_views[v]
        for row in range(blocks[block, 1], blocks[block, 2]):
            n = row - start
            for i in range(3):
                Y[n, i] = R[i, 0] * points[row, 0] + R[i, 1] * points[row, 1] + R[i, 2] * points[row, 2]
            a, b, c = Y[n, 0] + t[0], Y[n, 1] + t[1], Y[n, 2] + t[2]
            for i in range(3):
                X_c[n, i] = R_rig[i, 0] * a + R_rig[i, 1] * b + R_rig[i, 2] * c + t_rig[i]
            behind += X_c[n, 2] <= 0
            x[n, 0], x[n, 1] = X_c[n, 0] / X_c[n, 2], X_c[n, 1] / X_c[n, 2]
    return behind


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED, **INNER)
def fill_row(g, q, Y, X_r, R, theta_row, places, factor, basis, rig, row, shift):
    """Fill one of a point's two rows of J: `shift` = q R_v, and `row` = (pose, rig, θ, dense β)."""
    for i in range(3):
        k, n = (i + 1) % 3, (i + 2) % 3
        shift[i] = q[0] * R[0, i] + q[1] * R[1, i] + q[2] * R[2, i]
        row[i], row[3 + i] = Y[k] * q[n] - Y[n] * q[k], q[i]
        if rig:
            row[6 + i], row[9 + i] = X_r[k] * g[n] - X_r[n] * g[k], g[i]
    at = 12 if rig else 6
    for i in range(len(places)):
        row[at + i] = factor[i] * theta_row[places[i]]
    at += len(places)
    for m in range(basis.shape[1]):
        row[at + m] = shift[0] * basis[0, m] + shift[1] * basis[1, m] + shift[2] * basis[2, m]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED)
def equations_kernel(
    blocks, index, free, basis, weights, r, x_d, D, D_k, Y, X_c, x, theta, R_rig, t_rig, R_views, places, factor, to,
    rig, U, V, W, Q, P, C, A, rows, shifts, theta_rows,
):  # fmt: skip
    """Add one camera's part to U, V, W, Q, P and C.

    Q (P, 3, 3) are the points' own blocks, P (P, 3, F + 1) their products with the shared unknowns and the residual,
    C (P, V, 3, 6) with the poses; all three stay as they are if no point is `free`. `to` says which of the F + 1
    unknowns of U each column of a row after the pose is; −1 is none.
    """
    start, released = blocks[0, 1], len(Q) > 0
    n = 6 + len(to)
    g, q = rows[2], rows[3]
    for block in range(len(blocks)):
        v = blocks[block, 0]
        R = R_views[v]
        for i in range(n):
            for k in range(i + 1):
                A[i, k] = 0.0
        for row in range(blocks[block, 1], blocks[block, 2]):
            at = row - start
            j = index[row]
            a, b, iz = x[at, 0], x[at, 1], 1 / X_c[at, 2]
            X_r = rows[4]
            for i in range(3):
                X_r[i] = X_c[at, i] - t_rig[i]
            for c in range(2):
                fill = theta_rows[c]
                if c == 0:
                    d0 = (theta[0] * D[at, 0, 0] + theta[4] * D[at, 1, 0]) * iz
                    d1 = (theta[0] * D[at, 0, 1] + theta[4] * D[at, 1, 1]) * iz
                    fill[0], fill[1], fill[2], fill[3], fill[4] = x_d[at, 0], 0.0, 1.0, 0.0, x_d[at, 1]
                    for i in range(D_k.shape[2]):
                        fill[5 + i] = theta[0] * D_k[at, 0, i] + theta[4] * D_k[at, 1, i]
                else:
                    d0, d1 = theta[1] * D[at, 1, 0] * iz, theta[1] * D[at, 1, 1] * iz
                    fill[0], fill[1], fill[2], fill[3], fill[4] = 0.0, x_d[at, 1], 0.0, 1.0, 0.0
                    for i in range(D_k.shape[2]):
                        fill[5 + i] = theta[1] * D_k[at, 1, i]
                g[0], g[1], g[2] = d0, d1, -(a * d0 + b * d1)
                for i in range(3):
                    q[i] = g[0] * R_rig[0, i] + g[1] * R_rig[1, i] + g[2] * R_rig[2, i]
                fill_row(g, q, Y[at], X_r, R, fill, places, factor, basis[j], rig, rows[c], shifts[c])
                rows[c, n - 1] = r[at, c]
            if len(weights) > 0:
                w = weights[row]
                for i in range(n):
                    a, b = rows[0, i], rows[1, i]
                    rows[0, i], rows[1, i] = w[0, 0] * a + w[0, 1] * b, w[1, 0] * a + w[1, 1] * b
                for i in range(3):
                    a, b = shifts[0, i], shifts[1, i]
                    shifts[0, i], shifts[1, i] = w[0, 0] * a + w[0, 1] * b, w[1, 0] * a + w[1, 1] * b
            first, second = rows[0], rows[1]
            for i in range(n):
                a, b = first[i], second[i]
                for k in range(i + 1):
                    A[i, k] += a * first[k] + b * second[k]
            if released:
                for i in range(3):
                    if free[j, i]:
                        a, b = shifts[0, i], shifts[1, i]
                        for k in range(3):
                            if free[j, k]:
                                Q[j, i, k] += a * shifts[0, k] + b * shifts[1, k]
                        for k in range(6):
                            C[j, v, i, k] += a * first[k] + b * second[k]
                        for k in range(6, n):
                            if to[k - 6] >= 0:
                                P[j, i, to[k - 6]] += a * first[k] + b * second[k]
        for i in range(6):
            for k in range(i + 1):
                V[v, i, k] += A[i, k]
                if k < i:
                    V[v, k, i] += A[i, k]
        for i in range(6, n):
            f = to[i - 6]
            if f >= 0:
                for k in range(6):
                    W[v, k, f] += A[i, k]
                for k in range(6, i + 1):
                    h = to[k - 6]
                    if h >= 0:
                        U[f, h] += A[i, k]
                        if k < i:
                            U[h, f] += A[i, k]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def factor_in_place(A, n, rows):
    """Lower Cholesky factor of the leading n × n of A, in place, the rows below multiplied by L⁻ᵀ; False if not > 0."""
    for j in range(n):
        own = A[j]
        d = own[j]
        for k in range(j):
            d -= own[k] * own[k]
        if not d > 0:
            return False
        d = math.sqrt(d)
        own[j] = d
        d = 1 / d
        for i in range(j + 1, rows):
            other = A[i]
            total = other[j]
            for k in range(j):
                total -= other[k] * own[k]
            other[j] = total * d
    return True


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED)
def shaped_step_kernel(U, O, B, E, N, C, mu, D2, D2_o, D2_e, S, L, Z, dz, do, de):
    """Solve (A + μD²) δ = −b, the group E of blocks eliminated first; return the promised decrease and max |D δ|.

    A consists of U (F + 1, F + 1; the residual is the last unknown), of two groups of small blocks, O and E, of their
    products with U's unknowns, B and N, and with one another, C (E, O, e, o). S (R + 1, R + 1) takes what is left when E
    is gone: O's unknowns, then U's. The longest move is −1 if A is not positive definite.
    """
    F, e, o = len(U) - 1, E.shape[1], O.shape[1]
    ahead = o * len(O)
    R = ahead + F
    for i in range(ahead):
        for k in range(i + 1):
            S[i, k] = 0.0
    for b in range(len(O)):
        for i in range(o):
            at = o * b + i
            for k in range(i + 1):
                S[at, o * b + k] = O[b, i, k]
            S[at, at] += mu * D2_o[b, i]
            for f in range(F + 1):
                S[ahead + f, at] = B[b, i, f]
    for f in range(F + 1):
        for k in range(f + 1):
            S[ahead + f, ahead + k] = U[f, k]
        if f < F:
            S[ahead + f, ahead + f] += mu * D2[f]
    for n in range(len(E)):
        l, z = L[n], Z[n]
        for i in range(e):
            for k in range(i + 1):
                l[i, k] = E[n, i, k]
            l[i, i] += mu * D2_e[n, i]
        if not factor_in_place(l, e, e):
            return 0.0, -1.0
        for i in range(e):
            row = z[i]
            for b in range(len(O)):
                for k in range(o):
                    row[o * b + k] = C[n, b, i, k]
            for f in range(F + 1):
                row[ahead + f] = N[n, i, f]
            for k in range(i):
                a, other = l[i, k], z[k]
                for f in range(R + 1):
                    row[f] -= a * other[f]
            a = 1 / l[i, i]
            for f in range(R + 1):
                row[f] *= a
        for i in range(0, e, 3):
            z0, z1, z2 = z[i], z[i + 1], z[i + 2]
            for f in range(R + 1):
                a, b, c, s = z0[f], z1[f], z2[f], S[f]
                for k in range(f + 1):
                    s[k] -= a * z0[k] + b * z1[k] + c * z2[k]
    if not factor_in_place(S, R, R + 1):
        return 0.0, -1.0
    promised, longest, d = 0.0, 0.0, Z[len(E), 0]  # d: all unknowns of S, and a 1 for the residual
    for i in range(R):
        d[i] = -S[R, i]
    d[R] = 1.0
    for i in range(R - 1, -1, -1):
        row = S[i]
        d[i] /= row[i]
        a = d[i]
        for k in range(i):
            d[k] -= a * row[k]
    for f in range(F):
        a, scale = d[ahead + f], D2[f]
        dz[f] = a
        promised += a * (mu * scale * a - U[F, f])
        longest = max(longest, a * a * scale)
    for b in range(len(O)):
        for i in range(o):
            a, scale = d[o * b + i], D2_o[b, i]
            do[b, i] = a
            promised += a * (mu * scale * a - B[b, i, F])
            longest = max(longest, a * a * scale)
    for n in range(len(E)):
        l, z, step = L[n], Z[n], de[n]
        for i in range(e - 1, -1, -1):
            total = 0.0
            for f in range(R + 1):
                total -= z[i, f] * d[f]
            for k in range(i + 1, e):
                total -= l[k, i] * step[k]
            a, scale = total / l[i, i], D2_e[n, i]
            step[i] = a
            promised += a * (mu * scale * a - N[n, i, F])
            longest = max(longest, a * a * scale)
    return promised, math.sqrt(longest)
