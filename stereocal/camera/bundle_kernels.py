# mypy: allow-untyped-defs
"""Bundle adjustment, compiled: the twin of ``bundle`` and ``bundle_solver`` for the lens models of OpenCV's family.

The equations and letters are those of ``bundle``. What differs is the order of the work:

- A block (the corners of one view in one camera) is taken in chunks of 64 points. For a chunk, every column of the
  Jacobian is a row of a flat scratch array with a stride known at compile time, so that each loop runs over the points
  and the compiler turns it into vector instructions without having to prove that arrays do not overlap. AᵀA is then one
  small matrix product.
- Derivatives are first taken by the block's own pose (a turn ω and a shift δt in the camera's frame) and the camera's
  parameters. Of the outcome AᵀA, a matrix of at most 24 × 24, the parts for view and rig follow by 6×6 matrices, from
  R_c R_v with ω = ω_c + R_c ω_v and δt = δt_c − [R_c t_v]ₓ ω_c + R_c δt_v.
- G, of which no row holds more than one number, is passed as `target` (which free unknown) and `factor` (that number).

Kernels take arrays and write into arrays; nothing is checked here.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

CHUNK = 64
STRIDE = 2 * CHUNK  # a row of J: ∂u of the chunk, then ∂v
MAX_COLUMNS = 24  # 6 of the pose, 5 of K, 12 of the lens, 1 of the residual
SCRATCH_ROWS = 24

SUMS = {"reassoc", "contract", "nsz"}  # sums of products may be regrouped: that is what makes them vectors
# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
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


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def lens_column(column, m, fx, fy, sk, at, tmp, J):
    """Fill one column of θ = fx fy cx cy s, k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4, through A = [[fx, s], [0, fy]].

    There are three kinds, and within a kind only numbers differ, so that no loop has a branch in it.
    """
    if column < 5:  # ∂u, ∂v = e (x_d, y_d, 1)
        e0 = 1.0 if column == 0 else 0.0
        e1 = 1.0 if column == 4 else 0.0
        e2 = 1.0 if column == 2 else 0.0
        f1 = 1.0 if column == 1 else 0.0
        f2 = 1.0 if column == 3 else 0.0
        for j in range(m):
            J[at + j] = e0 * tmp[6 * CHUNK + j] + e1 * tmp[7 * CHUNK + j] + e2
            J[at + CHUNK + j] = f1 * tmp[7 * CHUNK + j] + f2
    elif column < 7 or 9 <= column < 13:  # radial: x w, with w = s, s², s³ over the denominator, and −f times that
        power = column - 4 if column < 7 else 3 if column == 9 else column - 9
        c1 = 1.0 if power == 1 else 0.0
        c2 = 1.0 if power == 2 else 0.0
        c3 = 1.0 if power == 3 else 0.0
        one = 1.0 if column < 10 else 0.0
        minus = 0.0 if column < 10 else -1.0
        for j in range(m):
            s = tmp[12 * CHUNK + j]
            w = s * (c1 + s * (c2 + s * c3)) * tmp[13 * CHUNK + j] * (one + minus * tmp[14 * CHUNK + j])
            a, b = tmp[4 * CHUNK + j] * w, tmp[5 * CHUNK + j] * w
            J[at + j] = fx * a + sk * b
            J[at + CHUNK + j] = fy * b
    else:  # tangential and thin prism: quadratic and quartic forms
        a_uu, a_uv, a_vv, a_ss, b_uu, b_uv, b_vv, b_ss = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if column == 7:
            a_uv, b_uu, b_vv = 2.0, 1.0, 3.0
        elif column == 8:
            a_uu, a_vv, b_uv = 3.0, 1.0, 2.0
        elif column == 13:
            a_uu, a_vv = 1.0, 1.0
        elif column == 14:
            a_ss = 1.0
        elif column == 15:
            b_uu, b_vv = 1.0, 1.0
        else:
            b_ss = 1.0
        for j in range(m):
            u, v, s = tmp[4 * CHUNK + j], tmp[5 * CHUNK + j], tmp[12 * CHUNK + j]
            a = a_uu * u * u + a_uv * u * v + a_vv * v * v + a_ss * s * s
            b = b_uu * u * u + b_uv * u * v + b_vv * v * v + b_ss * s * s
            J[at + j] = fx * a + sk * b
            J[at + CHUNK + j] = fy * b


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def chunk_jacobian(X, y, first, m, R, t, theta, columns, tmp, J):
    """Fill the rows of J (MAX_COLUMNS × STRIDE, flat) with ∂u, ∂v by ω, δt, θ[columns] and, last, the residual p̃ − y.

    Returns whether every point is in front of the camera. `tmp` is (SCRATCH_ROWS × CHUNK, flat).
    """
    fx, fy, cx, cy, sk = theta[0], theta[1], theta[2], theta[3], theta[4]
    k1, k2, p1, p2, k3, k4 = theta[5], theta[6], theta[7], theta[8], theta[9], theta[10]
    k5, k6, s1, s2, s3, s4 = theta[11], theta[12], theta[13], theta[14], theta[15], theta[16]
    r00, r01, r02 = R[0, 0], R[0, 1], R[0, 2]
    r10, r11, r12 = R[1, 0], R[1, 1], R[1, 2]
    r20, r21, r22 = R[2, 0], R[2, 1], R[2, 2]
    t0, t1, t2 = t[0], t[1], t[2]
    nearest = 1e300
    for j in range(m):  # Y = R X, x = X_c / Z_c
        a, b, c = X[0, first + j], X[1, first + j], X[2, first + j]
        Y0 = r00 * a + r01 * b + r02 * c
        Y1 = r10 * a + r11 * b + r12 * c
        Y2 = r20 * a + r21 * b + r22 * c
        iz = 1 / (Y2 + t2)
        nearest = min(nearest, Y2 + t2)
        tmp[0 * CHUNK + j] = Y0
        tmp[1 * CHUNK + j] = Y1
        tmp[2 * CHUNK + j] = Y2
        tmp[3 * CHUNK + j] = iz
        tmp[4 * CHUNK + j] = (Y0 + t0) * iz
        tmp[5 * CHUNK + j] = (Y1 + t1) * iz
    if not nearest > 0:
        return False
    for j in range(m):  # the lens: x_d, D = ∂x_d/∂x
        u, v = tmp[4 * CHUNK + j], tmp[5 * CHUNK + j]
        s = u * u + v * v
        q = 1 / (1 + s * (k4 + s * (k5 + s * k6)))
        f = (1 + s * (k1 + s * (k2 + s * k3))) * q
        f_s = ((k1 + s * (2 * k2 + 3 * s * k3)) - f * (k4 + s * (2 * k5 + 3 * s * k6))) * q
        cross = 2 * u * v * f_s + 2 * p1 * u + 2 * p2 * v
        prism_u, prism_v = s1 + 2 * s2 * s, s3 + 2 * s4 * s
        tmp[6 * CHUNK + j] = u * f + 2 * p1 * u * v + p2 * (s + 2 * u * u) + s * (s1 + s2 * s)
        tmp[7 * CHUNK + j] = v * f + p1 * (s + 2 * v * v) + 2 * p2 * u * v + s * (s3 + s4 * s)
        tmp[8 * CHUNK + j] = f + 2 * u * u * f_s + 2 * p1 * v + 6 * p2 * u + 2 * u * prism_u
        tmp[9 * CHUNK + j] = cross + 2 * v * prism_u
        tmp[10 * CHUNK + j] = cross + 2 * u * prism_v
        tmp[11 * CHUNK + j] = f + 2 * v * v * f_s + 6 * p1 * v + 2 * p2 * u + 2 * v * prism_v
        tmp[12 * CHUNK + j] = s
        tmp[13 * CHUNK + j] = q
        tmp[14 * CHUNK + j] = f
    for j in range(m):  # g = A D Π, then (Y × g, g)
        u, v, iz = tmp[4 * CHUNK + j], tmp[5 * CHUNK + j], tmp[3 * CHUNK + j]
        Y0, Y1, Y2 = tmp[0 * CHUNK + j], tmp[1 * CHUNK + j], tmp[2 * CHUNK + j]
        d10, d11 = tmp[10 * CHUNK + j], tmp[11 * CHUNK + j]
        g0 = (fx * tmp[8 * CHUNK + j] + sk * d10) * iz
        g1 = (fx * tmp[9 * CHUNK + j] + sk * d11) * iz
        g2 = -(u * g0 + v * g1)
        h0 = fy * d10 * iz
        h1 = fy * d11 * iz
        h2 = -(u * h0 + v * h1)
        J[0 * STRIDE + j] = Y1 * g2 - Y2 * g1
        J[1 * STRIDE + j] = Y2 * g0 - Y0 * g2
        J[2 * STRIDE + j] = Y0 * g1 - Y1 * g0
        J[3 * STRIDE + j] = g0
        J[4 * STRIDE + j] = g1
        J[5 * STRIDE + j] = g2
        J[0 * STRIDE + CHUNK + j] = Y1 * h2 - Y2 * h1
        J[1 * STRIDE + CHUNK + j] = Y2 * h0 - Y0 * h2
        J[2 * STRIDE + CHUNK + j] = Y0 * h1 - Y1 * h0
        J[3 * STRIDE + CHUNK + j] = h0
        J[4 * STRIDE + CHUNK + j] = h1
        J[5 * STRIDE + CHUNK + j] = h2
    for i in range(len(columns)):
        lens_column(columns[i], m, fx, fy, sk, (6 + i) * STRIDE, tmp, J)
    last = (6 + len(columns)) * STRIDE
    for j in range(m):
        J[last + j] = fx * tmp[6 * CHUNK + j] + sk * tmp[7 * CHUNK + j] + cx - y[0, first + j]
        J[last + CHUNK + j] = fy * tmp[7 * CHUNK + j] + cy - y[1, first + j]
    return True


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def weigh_chunk(first, m, count, whitening, loss, scale, J):
    """Multiply the rows of a chunk by their whitening and by √w of the loss; return Σρ."""
    if whitening.shape[1] > 0:
        for i in range(count):
            at = i * STRIDE
            for j in range(m):
                a, b = J[at + j], J[at + CHUNK + j]
                J[at + j] = whitening[0, first + j] * a + whitening[1, first + j] * b
                J[at + CHUNK + j] = whitening[2, first + j] * a + whitening[3, first + j] * b
    last = (count - 1) * STRIDE
    total = 0.0
    if loss == 0:
        for j in range(m):
            total += J[last + j] * J[last + j] + J[last + CHUNK + j] * J[last + CHUNK + j]
        return total
    for j in range(m):
        e = J[last + j] * J[last + j] + J[last + CHUNK + j] * J[last + CHUNK + j]
        w = 1.0
        if loss == 1:
            if e > scale * scale:
                root = math.sqrt(e)
                total += 2 * scale * root - scale * scale
                w = scale / root
            else:
                total += e
        else:
            total += scale * scale * math.log1p(e / (scale * scale))
            w = 1 / (1 + e / (scale * scale))
        w = math.sqrt(w)
        for i in range(count):
            J[i * STRIDE + j] *= w
            J[i * STRIDE + CHUNK + j] *= w
    return total


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def fill_up(count, m, J):
    """Fill the chunk up with zeros to its full width."""
    for i in range(count):
        for j in range(m, CHUNK):
            J[i * STRIDE + j] = 0.0
            J[i * STRIDE + CHUNK + j] = 0.0


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def scatter_block(
    A, n, camera, view, R_c, Rt, columns, target, factor, first_intrinsic, first_rig, AM, U, b, V, b_v, W
):
    """Add a block's AᵀA, by its own pose and θ, to the normal equations of views, rig and free parameters.

    Rt is R_c t_v. M_v = diag(R_c, R_c) takes (ω_v, δt_v) to the block's pose, B = [[I, 0], [−[R_c t_v]ₓ, I]] the rig's.
    """
    last = n - 1
    for i in range(n):  # AM = A[:, pose] diag(R_c, R_c)
        for j in range(3):
            AM[i, j] = A[i, 0] * R_c[0, j] + A[i, 1] * R_c[1, j] + A[i, 2] * R_c[2, j]
            AM[i, 3 + j] = A[i, 3] * R_c[0, j] + A[i, 4] * R_c[1, j] + A[i, 5] * R_c[2, j]
    for i in range(6):
        for j in range(6):
            h, k = 3 * (i // 3), i % 3
            V[view, i, j] += R_c[0, k] * AM[h, j] + R_c[1, k] * AM[h + 1, j] + R_c[2, k] * AM[h + 2, j]
        b_v[view, i] += AM[last, i]
    for i in range(len(columns)):
        to = target[first_intrinsic + columns[i]]
        c = factor[first_intrinsic + columns[i]]
        for j in range(len(columns)):
            U[to, target[first_intrinsic + columns[j]]] += c * factor[first_intrinsic + columns[j]] * A[6 + i, 6 + j]
        b[to] += c * A[6 + i, last]
        for j in range(6):
            W[view, to, j] += c * AM[6 + i, j]
    if camera == 0 or target[first_rig] < 0:
        return
    for i in range(n):  # A[:, pose] B into A: B = [[I, 0], [−[R_c t_v]ₓ, I]]
        a, b3, c3 = A[i, 3], A[i, 4], A[i, 5]
        A[i, 0] += Rt[2] * -b3 + Rt[1] * c3
        A[i, 1] += Rt[2] * a - Rt[0] * c3
        A[i, 2] += Rt[0] * b3 - Rt[1] * a
    for j in range(6):  # and Bᵀ from the left
        a, b3, c3 = A[3, j], A[4, j], A[5, j]
        A[0, j] += Rt[1] * c3 - Rt[2] * b3
        A[1, j] += Rt[2] * a - Rt[0] * c3
        A[2, j] += Rt[0] * b3 - Rt[1] * a
        a, b3, c3 = AM[3, j], AM[4, j], AM[5, j]
        AM[0, j] += Rt[1] * c3 - Rt[2] * b3
        AM[1, j] += Rt[2] * a - Rt[0] * c3
        AM[2, j] += Rt[0] * b3 - Rt[1] * a
    for i in range(6):
        to = target[first_rig + i]
        for j in range(6):
            U[to, target[first_rig + j]] += A[i, j]
            W[view, to, j] += AM[i, j]
        for j in range(len(columns)):
            at = target[first_intrinsic + columns[j]]
            total = factor[first_intrinsic + columns[j]] * A[6 + j, i]
            U[to, at] += total
            U[at, to] += total
        b[to] += A[last, i]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def clear(U, b, V, b_v, W):
    """Set the normal equations to 0."""
    for f in range(len(b)):
        b[f] = 0.0
        for g in range(len(b)):
            U[f, g] = 0.0
    for v in range(len(V)):
        for i in range(6):
            b_v[v, i] = 0.0
            for j in range(6):
                V[v, i, j] = 0.0
            for f in range(len(b)):
                W[v, f, i] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations_kernel(
    X, y, offsets, cameras, views, whitening, loss, scale, theta, R_rig, t_rig, R_views, t_views, column_lists,
    column_counts, first_intrinsics, first_rigs, target, factor, U, b, V, b_v, W, tmp, J,
):  # fmt: skip
    """Fill U, b, V, b_v, W at a state; return F, infinite if a point is behind its camera."""
    clear(U, b, V, b_v, W)
    A = np.empty((MAX_COLUMNS, MAX_COLUMNS))
    AM = np.empty((MAX_COLUMNS, 6))
    R = np.empty((3, 3))
    t = np.empty(3)
    Rt = np.empty(3)
    cost = 0.0
    for block in range(len(cameras)):
        c, v = cameras[block], views[block]
        for i in range(3):
            Rt[i] = 0.0
            for k in range(3):
                Rt[i] += R_rig[c, i, k] * t_views[v, k]
            t[i] = Rt[i] + t_rig[c, i]
            for j in range(3):
                total = 0.0
                for k in range(3):
                    total += R_rig[c, i, k] * R_views[v, k, j]
                R[i, j] = total
        columns = column_lists[c, : column_counts[c]]
        n = 7 + len(columns)
        AtA = np.empty((n, n))
        for i in range(n):
            for j in range(n):
                A[i, j] = 0.0
        for first in range(offsets[block], offsets[block + 1], CHUNK):
            m = min(CHUNK, offsets[block + 1] - first)
            if not chunk_jacobian(X, y, first, m, R, t, theta[c], columns, tmp, J):
                return np.inf
            cost += weigh_chunk(first, m, n, whitening, loss, scale, J)
            fill_up(n, m, J)
            rows = J.reshape(MAX_COLUMNS, STRIDE)[:n]
            np.dot(rows, rows.T, AtA)
            for i in range(n):
                for j in range(n):
                    A[i, j] += AtA[i, j]
        scatter_block(A, n, c, v, R_rig[c], Rt, columns, target, factor, first_intrinsics[c], first_rigs[c],
                      AM, U, b, V, b_v, W)  # fmt: skip
    return cost if np.isfinite(cost) else np.inf


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
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
        for i in range(j + 1, n):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            A[i, j] = total / d
    return True


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS)
def damped_step_kernel(U, b, V, b_v, W, mu, D2, D2_v, dz, dv, S, L, Z):
    """Renew the scaling D² and solve (A + μD²)(dz, dv) = −(b, b_v) by the Schur complement.

    Returns the longest move, max |D δ|, or −1 if the equations cannot be solved.
    With V = L Lᵀ and Z = L⁻¹ [Wᵀ b_v], S = U − Σ ZᵀZ. Z (V, 6, F + 1) and L (V, 6, 6) are kept for the way back.
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
        S[F, i] = -b[i]  # the right hand side rides along as a last row
    for v in range(count):
        for i in range(6):
            for j in range(6):
                L[v, i, j] = V[v, i, j]
            L[v, i, i] += mu * D2_v[v, i]
        if not cholesky_in_place(L[v], b_v.shape[1]):
            return -1.0
        for i in range(6):
            inverse = 1 / L[v, i, i]
            for f in range(F):
                Z[v, i, f] = W[v, f, i]
            Z[v, i, F] = b_v[v, i]
            for k in range(i):
                below = L[v, i, k]
                for f in range(F + 1):
                    Z[v, i, f] -= below * Z[v, k, f]
            for f in range(F + 1):
                Z[v, i, f] *= inverse
        for i in range(6):
            for f in range(F):
                z = Z[v, i, f]
                for g in range(f + 1):
                    S[f, g] -= z * Z[v, i, g]
            z = Z[v, i, F]
            for f in range(F):
                S[F, f] += z * Z[v, i, f]
    if not cholesky_in_place(S, F):
        return -1.0
    for i in range(F):
        total = S[F, i]
        for k in range(i):
            total -= S[i, k] * dz[k]
        dz[i] = total / S[i, i]
    for i in range(F - 1, -1, -1):
        total = dz[i]
        for k in range(i + 1, F):
            total -= S[k, i] * dz[k]
        dz[i] = total / S[i, i]
    for v in range(count):  # L^T dv = −(Z_b + Z dz)
        for i in range(5, -1, -1):
            total = Z[v, i, F]
            for f in range(F):
                total += Z[v, i, f] * dz[f]
            total = -total
            for k in range(i + 1, 6):
                total -= L[v, k, i] * dv[v, k]
            dv[v, i] = total / L[v, i, i]
    longest = 0.0
    for i in range(F):
        longest = max(longest, abs(dz[i]) * math.sqrt(D2[i]))
    for v in range(count):
        for i in range(6):
            longest = max(longest, abs(dv[v, i]) * math.sqrt(D2_v[v, i]))
    return longest


@njit(cache=True, nogil=True, error_model="numpy")
def promised_kernel(U, b, V, b_v, W, dz, dv):
    """F(x) − ‖r + Jδ‖² = −2 bᵀδ − δᵀAδ."""
    total = 0.0
    for i in range(len(b)):
        row = 2 * b[i]
        for j in range(len(b)):
            row += U[i, j] * dz[j]
        total += row * dz[i]
    for v in range(len(V)):
        for i in range(6):
            row = 2 * b_v[v, i]
            for j in range(6):
                row += V[v, i, j] * dv[v, j]
            for f in range(len(b)):
                row += 2 * W[v, f, i] * dz[f]
            total += row * dv[v, i]
    return -total


@njit(cache=True, nogil=True, error_model="numpy")
def move_kernel(dz, dv, target, factor, first_intrinsics, first_rigs, theta, R_rig, t_rig, R_views, t_views,
                theta_new, R_rig_new, t_rig_new, R_views_new, t_views_new):  # fmt: skip
    """Write the state after a step."""
    turn = np.empty((3, 3))
    for c in range(len(theta)):
        end = first_intrinsics[c + 1] - first_intrinsics[c]
        for i in range(theta.shape[1]):
            theta_new[c, i] = theta[c, i]
            at = first_intrinsics[c] + i
            if i < end and target[at] >= 0:
                theta_new[c, i] += factor[at] * dz[target[at]]
        for i in range(3):
            t_rig_new[c, i] = t_rig[c, i]
            for j in range(3):
                R_rig_new[c, i, j] = R_rig[c, i, j]
        if c > 0 and target[first_rigs[c]] >= 0:
            z = target[first_rigs[c]]
            rotation_of(dz[z], dz[z + 1], dz[z + 2], turn)
            for i in range(3):
                t_rig_new[c, i] += dz[z + 3 + i]
                for j in range(3):
                    R_rig_new[c, i, j] = (
                        turn[i, 0] * R_rig[c, 0, j] + turn[i, 1] * R_rig[c, 1, j] + turn[i, 2] * R_rig[c, 2, j]
                    )
    for v in range(len(dv)):
        rotation_of(dv[v, 0], dv[v, 1], dv[v, 2], turn)
        for i in range(3):
            t_views_new[v, i] = t_views[v, i] + dv[v, 3 + i]
            for j in range(3):
                R_views_new[v, i, j] = (
                    turn[i, 0] * R_views[v, 0, j] + turn[i, 1] * R_views[v, 1, j] + turn[i, 2] * R_views[v, 2, j]
                )


@njit(cache=True, nogil=True, error_model="numpy")
def gradient_norm_kernel(U, b, V, b_v, cost):
    """Largest |b_i| / √(A_ii F)."""
    largest = 0.0
    for i in range(len(b)):
        if U[i, i] > 0:
            largest = max(largest, abs(b[i]) / math.sqrt(U[i, i]))
    for v in range(len(V)):
        for i in range(6):
            if V[v, i, i] > 0:
                largest = max(largest, abs(b_v[v, i]) / math.sqrt(V[v, i, i]))
    return largest / math.sqrt(cost) if cost > 0 else 0.0
