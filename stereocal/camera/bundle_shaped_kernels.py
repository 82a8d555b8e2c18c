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


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def products(J, n, length, A):
    """Fill the lower triangle of A = J Jᵀ, of the first n rows and `length` columns of J."""
    for i in range(n):
        x = J[i]
        for k in range(i + 1):
            y, total = J[k], 0.0
            for j in range(length):
                total += x[j] * y[j]
            A[i, k] = total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED)
def equations_kernel(
    blocks, index, free, basis, weights, r, x_d, D, D_k, Y, X_c, x, theta, R_rig, t_rig, R_views, places, factor, to,
    rig, U, V, W, Q, P, C, J, A, g, q, shift, of_theta,
):  # fmt: skip
    """Add one camera's part to U, V, W, Q, P and C.

    Q (P, 3, 3) are the points' own blocks, P (P, 3, F + 1) their products with the shared unknowns and the residual,
    C (P, V, 3, 6) with the poses; all three stay as they are if no point is `free`. `to` says which of the F + 1
    unknowns of U each column after the pose is; −1 is none. J holds a block's columns as rows, ∂u and ∂v by turns;
    `shift` ∂u and ∂v by the point. Slices would be counted references, and take longer than what is done with them.
    """
    start, released, n = blocks[0, 1], len(Q) > 0, 6 + len(to)
    lens, bow, theta_at = D_k.shape[2], basis.shape[2], 12 if rig else 6
    bow_at = theta_at + len(places)
    for block in range(len(blocks)):
        v, begin = blocks[block, 0], blocks[block, 1]
        for row in range(begin, blocks[block, 2]):
            at, j = row - start, index[row]
            iz = 1 / X_c[at, 2]
            for c in range(2):
                h, fx, sk = 2 * (row - begin) + c, theta[c], theta[4] if c == 0 else 0.0
                d0 = (fx * D[at, c, 0] + sk * D[at, 1, 0]) * iz
                d1 = (fx * D[at, c, 1] + sk * D[at, 1, 1]) * iz
                g[0], g[1], g[2] = d0, d1, -(x[at, 0] * d0 + x[at, 1] * d1)
                for i in range(4):
                    of_theta[i] = 0.0
                of_theta[c], of_theta[2 + c] = x_d[at, c], 1.0
                of_theta[4] = x_d[at, 1] if c == 0 else 0.0
                for i in range(lens):
                    of_theta[5 + i] = fx * D_k[at, c, i] + sk * D_k[at, 1, i]
                for i in range(3):
                    q[i] = g[0] * R_rig[0, i] + g[1] * R_rig[1, i] + g[2] * R_rig[2, i]
                for i in range(3):
                    k, m = (i + 1) % 3, (i + 2) % 3
                    shift[c, i] = q[0] * R_views[v, 0, i] + q[1] * R_views[v, 1, i] + q[2] * R_views[v, 2, i]
                    J[i, h], J[3 + i, h] = Y[at, k] * q[m] - Y[at, m] * q[k], q[i]
                    if rig:
                        J[6 + i, h] = (X_c[at, k] - t_rig[k]) * g[m] - (X_c[at, m] - t_rig[m]) * g[k]
                        J[9 + i, h] = g[i]
                for i in range(len(places)):
                    J[theta_at + i, h] = factor[i] * of_theta[places[i]]
                for i in range(bow):
                    J[bow_at + i, h] = (
                        shift[c, 0] * basis[j, 0, i] + shift[c, 1] * basis[j, 1, i] + shift[c, 2] * basis[j, 2, i]
                    )
                J[n - 1, h] = r[at, c]
            h = 2 * (row - begin)
            if len(weights) > 0:
                w00, w01, w10, w11 = weights[row, 0, 0], weights[row, 0, 1], weights[row, 1, 0], weights[row, 1, 1]
                for i in range(n):
                    a, b = J[i, h], J[i, h + 1]
                    J[i, h], J[i, h + 1] = w00 * a + w01 * b, w10 * a + w11 * b
                for i in range(3):
                    a, b = shift[0, i], shift[1, i]
                    shift[0, i], shift[1, i] = w00 * a + w01 * b, w10 * a + w11 * b
            if released:
                for i in range(3):
                    if free[j, i]:
                        a, b = shift[0, i], shift[1, i]
                        for k in range(3):
                            if free[j, k]:
                                Q[j, i, k] += a * shift[0, k] + b * shift[1, k]
                        for k in range(6):
                            C[j, v, i, k] += a * J[k, h] + b * J[k, h + 1]
                        for k in range(6, n):
                            if to[k - 6] >= 0:
                                P[j, i, to[k - 6]] += a * J[k, h] + b * J[k, h + 1]
        products(J, n, 2 * (blocks[block, 2] - blocks[block, 1]), A)
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
def shaped_step_kernel(U, H, B, E, N, C, mu, D2, D2_h, D2_e, S, L, Z, dz, dh, de):
    """Solve (A + μD²) δ = −b, the group E of blocks eliminated first; return the promised decrease and max |D δ|.

    A consists of U (F + 1, F + 1; the residual is the last unknown), of two groups of small blocks, E and H, of their
    products with U's unknowns, N and B, and with one another, C (E, H, e, h). S (R + 1, R + 1) takes what is left when
    E is gone: H's unknowns, then U's. The longest move is −1 if A is not positive definite.
    """
    F, e, h = len(U) - 1, E.shape[1], H.shape[1]
    ahead = h * len(H)
    R = ahead + F
    for i in range(ahead):
        for k in range(i + 1):
            S[i, k] = 0.0
    for b in range(len(H)):
        for i in range(h):
            at = h * b + i
            for k in range(i + 1):
                S[at, h * b + k] = H[b, i, k]
            S[at, at] += mu * D2_h[b, i]
            for f in range(F + 1):
                S[ahead + f, at] = B[b, i, f]
    for f in range(F + 1):
        for k in range(f + 1):
            S[ahead + f, ahead + k] = U[f, k]
        if f < F:
            S[ahead + f, ahead + f] += mu * D2[f]
    for n in range(len(E)):
        factor, z = L[n], Z[n]
        for i in range(e):
            for k in range(i + 1):
                factor[i, k] = E[n, i, k]
            factor[i, i] += mu * D2_e[n, i]
        if not factor_in_place(factor, e, e):
            return 0.0, -1.0
        for i in range(e):
            row = z[i]
            for b in range(len(H)):
                for k in range(h):
                    row[h * b + k] = C[n, b, i, k]
            for f in range(F + 1):
                row[ahead + f] = N[n, i, f]
            for k in range(i):
                a, other = factor[i, k], z[k]
                for f in range(R + 1):
                    row[f] -= a * other[f]
            a = 1 / factor[i, i]
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
    for b in range(len(H)):
        for i in range(h):
            a, scale = d[h * b + i], D2_h[b, i]
            dh[b, i] = a
            promised += a * (mu * scale * a - B[b, i, F])
            longest = max(longest, a * a * scale)
    for n in range(len(E)):
        factor, z, step = L[n], Z[n], de[n]
        for i in range(e - 1, -1, -1):
            total = 0.0
            for f in range(R + 1):
                total -= z[i, f] * d[f]
            for k in range(i + 1, e):
                total -= factor[k, i] * step[k]
            a, scale = total / factor[i, i], D2_e[n, i]
            step[i] = a
            promised += a * (mu * scale * a - N[n, i, F])
            longest = max(longest, a * a * scale)
    return promised, math.sqrt(longest)
