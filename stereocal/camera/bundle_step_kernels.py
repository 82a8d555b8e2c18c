# mypy: allow-untyped-defs
"""Steps of bundle adjustment, compiled: the twin of what ``bundle_solver`` and ``covariance`` do by blocks.

The poses are eliminated view by view. With V = L Lᵀ (Cholesky, 6 × 6) and Z = L⁻¹ [Wᵀ b_v], a matrix of 6 rows a view,
Σ W V⁻¹ Wᵀ is the product ZᵀZ over all views, and its last row Σ W V⁻¹ b_v: so Z is kept by unknowns, (F + 1, 6V), and
the product runs along the views. After that come the unknowns that all views share, and the poses one by one.

Kernels take arrays and write into arrays; nothing is checked here.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

SUMS = {"reassoc", "contract", "nsz"}  # sums of products may be regrouped: that is what makes them vectors
# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def cholesky_in_place(A, n):
    """Lower Cholesky factor of the leading n × n of A, in place; return whether A is positive definite."""
    for j in range(n):
        d = A[j, j]
        for k in range(j):
            d -= A[j, k] * A[j, k]
        if not d > 0:
            return False
        d = math.sqrt(d)
        A[j, j] = d
        d = 1 / d
        for i in range(j + 1, n):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            A[i, j] = total * d
    return True


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def eliminate_poses(V, b_v, W, mu, D2_v, L, Z):
    """Fill L and Z of V + μD²; return whether every V is positive definite."""
    F = W.shape[1]
    for v in range(len(V)):
        for i in range(6):
            for j in range(i + 1):
                L[v, i, j] = V[v, i, j]
            L[v, i, i] += mu * D2_v[v, i]
        if not cholesky_in_place(L[v], b_v.shape[1]):
            return False
        l10, l20, l21, l30, l31, l32 = L[v, 1, 0], L[v, 2, 0], L[v, 2, 1], L[v, 3, 0], L[v, 3, 1], L[v, 3, 2]
        l40, l41, l42, l43 = L[v, 4, 0], L[v, 4, 1], L[v, 4, 2], L[v, 4, 3]
        l50, l51, l52, l53, l54 = L[v, 5, 0], L[v, 5, 1], L[v, 5, 2], L[v, 5, 3], L[v, 5, 4]
        i0, i1, i2 = 1 / L[v, 0, 0], 1 / L[v, 1, 1], 1 / L[v, 2, 2]
        i3, i4, i5 = 1 / L[v, 3, 3], 1 / L[v, 4, 4], 1 / L[v, 5, 5]
        for f in range(F + 1):
            w = W[v, f] if f < F else b_v[v]
            z0 = w[0] * i0
            z1 = (w[1] - l10 * z0) * i1
            z2 = (w[2] - l20 * z0 - l21 * z1) * i2
            z3 = (w[3] - l30 * z0 - l31 * z1 - l32 * z2) * i3
            z4 = (w[4] - l40 * z0 - l41 * z1 - l42 * z2 - l43 * z3) * i4
            z5 = (w[5] - l50 * z0 - l51 * z1 - l52 * z2 - l53 * z3 - l54 * z4) * i5
            to = Z[f, 6 * v : 6 * v + 6]
            to[0], to[1], to[2], to[3], to[4], to[5] = z0, z1, z2, z3, z4, z5
    return True


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def subtract_products(Z, S):
    """Subtract Z Zᵀ from the lower triangle of S, by tiles of 4 × 4 (both are filled up to whole ones)."""
    for i in range(0, len(S), 4):
        x0, x1, x2, x3 = Z[i], Z[i + 1], Z[i + 2], Z[i + 3]
        for k in range(0, i + 4, 4):
            y0, y1, y2, y3 = Z[k], Z[k + 1], Z[k + 2], Z[k + 3]
            s00, s01, s02, s03, s10, s11, s12, s13 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            s20, s21, s22, s23, s30, s31, s32, s33 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(len(x0)):
                a0, a1, a2, a3, b0, b1, b2, b3 = x0[j], x1[j], x2[j], x3[j], y0[j], y1[j], y2[j], y3[j]
                s00, s01, s02, s03 = s00 + a0 * b0, s01 + a0 * b1, s02 + a0 * b2, s03 + a0 * b3
                s10, s11, s12, s13 = s10 + a1 * b0, s11 + a1 * b1, s12 + a1 * b2, s13 + a1 * b3
                s20, s21, s22, s23 = s20 + a2 * b0, s21 + a2 * b1, s22 + a2 * b2, s23 + a2 * b3
                s30, s31, s32, s33 = s30 + a3 * b0, s31 + a3 * b1, s32 + a3 * b2, s33 + a3 * b3
            tile = ((s00, s01, s02, s03), (s10, s11, s12, s13), (s20, s21, s22, s23), (s30, s31, s32, s33))
            for a in range(4):
                for b in range(4):
                    S[i + a, k + b] -= tile[a][b]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def rotation_of(w0, w1, w2, R):
    """R = exp([w]ₓ), Rodrigues' formula (``base.rotations``)."""
    theta2 = w0 * w0 + w1 * w1 + w2 * w2
    theta = math.sqrt(theta2)
    if theta < 1e-2:
        s = 1 - theta2 / 6 + theta2 * theta2 / 120
        c = 0.5 - theta2 / 24 + theta2 * theta2 / 720
    else:
        s = math.sin(theta) / theta
        c = (1 - math.cos(theta)) / theta2
    R[0, 0] = 1 - c * (w1 * w1 + w2 * w2)
    R[1, 1] = 1 - c * (w0 * w0 + w2 * w2)
    R[2, 2] = 1 - c * (w0 * w0 + w1 * w1)
    R[0, 1], R[1, 0] = c * w0 * w1 - s * w2, c * w0 * w1 + s * w2
    R[0, 2], R[2, 0] = c * w0 * w2 + s * w1, c * w0 * w2 - s * w1
    R[1, 2], R[2, 1] = c * w1 * w2 - s * w0, c * w1 * w2 + s * w0


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def turn_and_shift(step, R, t, turn, R_new, t_new):
    """R_new = exp([ω]ₓ) R, t_new = t + δt of a step (ω, δt)."""
    rotation_of(step[0], step[1], step[2], turn)
    for i in range(3):
        t_new[i] = t[i] + step[3 + i]
        for j in range(3):
            R_new[i, j] = turn[i, 0] * R[0, j] + turn[i, 1] * R[1, j] + turn[i, 2] * R[2, j]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def move(dz, dv, column_lists, column_counts, to, factor, rigs, theta, R_rig, t_rig, R_views, t_views,
         theta_new, R_rig_new, t_rig_new, R_views_new, t_views_new):  # fmt: skip
    """Write the state after a step."""
    turn = np.empty((3, 3))
    none = np.zeros(6)
    for c in range(len(theta)):
        for i in range(theta.shape[1]):
            theta_new[c, i] = theta[c, i]
        for i in range(column_counts[c]):
            theta_new[c, column_lists[c, i]] += factor[c, i] * dz[to[c, i]]
        step = dz[rigs[c] : rigs[c] + 6] if rigs[c] >= 0 else none
        turn_and_shift(step, R_rig[c], t_rig[c], turn, R_rig_new[c], t_rig_new[c])
    for v in range(len(dv)):
        turn_and_shift(dv[v], R_views[v], t_views[v], turn, R_views_new[v], t_views_new[v])


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def step_kernel(
    U, b, V, b_v, W, mu, D2, D2_v, dz, dv, S, L, Z, theta, R_rig, t_rig, R_views, t_views, theta_new, R_rig_new,
    t_rig_new, R_views_new, t_views_new, column_lists, column_counts, to, factor, rigs,
):  # fmt: skip
    """Renew the scaling D², solve (A + μD²) δ = −b for δ = (dz, dv) and write the state after that step.

    Returns the promised decrease −2 bᵀδ − δᵀAδ = −bᵀδ + μ ‖D δ‖², and the longest move, max |D δ|, which is −1 if the
    equations cannot be solved.
    """
    F, count = len(b), len(V)
    for i in range(F):
        D2[i] = max(D2[i], U[i, i])
        if D2[i] <= 0:
            D2[i] = 1.0
    for v in range(count):
        for i in range(6):
            D2_v[v, i] = max(D2_v[v, i], V[v, i, i])
            if D2_v[v, i] <= 0:
                D2_v[v, i] = 1.0
    for i in range(F):
        for j in range(F):
            S[i, j] = U[i, j]
        S[i, i] += mu * D2[i]
        S[F, i] = b[i]  # the right hand side rides along as a last row
    if not eliminate_poses(V, b_v, W, mu, D2_v, L, Z):
        return 0.0, -1.0
    subtract_products(Z, S)
    if not cholesky_in_place(S, F):
        return 0.0, -1.0
    promised, longest = 0.0, 0.0
    for i in range(F):
        total = -S[F, i]
        for k in range(i):
            total -= S[i, k] * dz[k]
        dz[i] = total / S[i, i]
    for i in range(F - 1, -1, -1):
        total = dz[i]
        for k in range(i + 1, F):
            total -= S[k, i] * dz[k]
        dz[i] = total / S[i, i]
        longest = max(longest, abs(dz[i]) * math.sqrt(D2[i]))
        promised += dz[i] * (mu * D2[i] * dz[i] - b[i])
    for i in range(6 * count):  # Lᵀ dv = −(Z_b + Z dz)
        dv[i // 6, i % 6] = -Z[F, i]
    for f in range(F):
        row, z = Z[f], dz[f]
        for v in range(count):
            for i in range(6):
                dv[v, i] -= row[6 * v + i] * z
    for v in range(count):
        for i in range(5, -1, -1):
            total = dv[v, i]
            for k in range(i + 1, 6):
                total -= L[v, k, i] * dv[v, k]
            dv[v, i] = total / L[v, i, i]
            longest = max(longest, abs(dv[v, i]) * math.sqrt(D2_v[v, i]))
            promised += dv[v, i] * (mu * D2_v[v, i] * dv[v, i] - b_v[v, i])
    move(dz, dv, column_lists, column_counts, to, factor, rigs, theta, R_rig, t_rig, R_views, t_views,
         theta_new, R_rig_new, t_rig_new, R_views_new, t_views_new)  # fmt: skip
    return promised, longest


@njit(cache=True, nogil=True, error_model="numpy")
def gradient_norm_kernel(U, b, V, b_v, cost):
    """Largest |b_i| / √(A_ii F)."""
    largest = 0.0
    for i in range(len(b)):
        if U[i, i] > 0:
            largest = max(largest, b[i] * b[i] / U[i, i])
    for v in range(len(V)):
        for i in range(6):
            if V[v, i, i] > 0:
                largest = max(largest, b_v[v, i] * b_v[v, i] / V[v, i, i])
    return math.sqrt(largest / cost) if cost > 0 else 0.0


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def covariance_kernel(L, Z, S_inverse, G, rvecs, cross, views):
    """Fill, for σ = 1, the covariances of each view's (rvec, tvec) with all shared parameters and with itself.

    With J the matrix that takes ω to the change of the rotation vector, K = L⁻¹ diag(J, I)ᵀ and Y = Z K, these are
    −G S⁻¹ Y and KᵀK + YᵀS⁻¹Y.
    """
    F, n = len(S_inverse), len(G)
    K, Y, T = np.zeros((6, 6)), np.empty((F, 6)), np.empty((F, 6))
    for v in range(len(L)):
        a, b, c = rvecs[v, 0], rvecs[v, 1], rvecs[v, 2]
        theta2 = a * a + b * b + c * c
        theta = math.sqrt(theta2)
        d = 1 / 12 + theta2 / 720 + theta2 * theta2 / 30240
        if theta > 1e-2:
            d = 1 / theta2 - 1 / (2 * theta * math.tan(theta / 2))
        K[:] = 0.0  # diag(J, I)ᵀ with J = I − ½[r]ₓ + d [r]ₓ²
        K[0, 0], K[1, 1], K[2, 2] = 1 - d * (b * b + c * c), 1 - d * (a * a + c * c), 1 - d * (a * a + b * b)
        K[1, 0], K[0, 1] = 0.5 * c + d * a * b, -0.5 * c + d * a * b
        K[2, 0], K[0, 2] = -0.5 * b + d * a * c, 0.5 * b + d * a * c
        K[2, 1], K[1, 2] = 0.5 * a + d * b * c, -0.5 * a + d * b * c
        K[3, 3], K[4, 4], K[5, 5] = 1.0, 1.0, 1.0
        for i in range(6):
            for k in range(i):
                for j in range(6):
                    K[i, j] -= L[v, i, k] * K[k, j]
            for j in range(6):
                K[i, j] /= L[v, i, i]
        for f in range(F):
            for j in range(6):
                Y[f, j], T[f, j] = 0.0, 0.0
            for k in range(6):
                for j in range(6):
                    Y[f, j] += Z[f, 6 * v + k] * K[k, j]
        for i in range(6):
            for j in range(6):
                views[v, i, j] = 0.0
        for f in range(F):
            for g in range(F):
                for j in range(6):
                    T[f, j] += S_inverse[f, g] * Y[g, j]
            for i in range(6):
                for j in range(6):
                    views[v, i, j] += Y[f, i] * T[f, j]
        for k in range(6):
            for i in range(6):
                for j in range(6):
                    views[v, i, j] += K[k, i] * K[k, j]
        for p in range(n):
            for j in range(6):
                cross[v, p, j] = 0.0
            for f in range(F):
                if G[p, f] != 0:
                    for j in range(6):
                        cross[v, p, j] -= G[p, f] * T[f, j]
