# mypy: allow-untyped-defs
"""Steps of bundle adjustment, compiled: the twin of what ``bundle_solver`` does by blocks.

The poses are eliminated view by view. With V = L Lᵀ (Cholesky, 6 × 6), M = L⁻¹ and Z = M [Wᵀ b_v], a matrix of 6 rows
and F + 1 columns a view,

    S = U − Σ Zᵀ Z,        δ_v = −Mᵀ Z [δz 1]ᵀ.

Rows that ride along below a matrix while it is factored come out multiplied by L⁻ᵀ: an identity below V becomes Mᵀ, and
the right hand side b, the last row of U, what is left to be solved by L.

Kernels take arrays and write into arrays; nothing is checked here.
"""

from __future__ import annotations

import math

from numba import njit

FUSED = {"contract"}  # a b + c may be rounded once; sums are short here, and no faster regrouped into vectors
# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED, **INNER)
def cholesky_in_place(A, n, rows):
    """Lower Cholesky factor L of the leading n × n of A, in place, the rows below multiplied by L⁻ᵀ.

    Returns whether A is positive definite.
    """
    for j in range(n):
        d = A[j, j]
        for k in range(j):
            d -= A[j, k] * A[j, k]
        if not d > 0:
            return False
        d = math.sqrt(d)
        A[j, j] = d
        d = 1 / d
        for i in range(j + 1, rows):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            A[i, j] = total * d
    return True


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED, **INNER)
def eliminate_poses(V, W, mu, D2_v, L, Z, S):
    """Fill L, followed by Mᵀ, and Z of V + μD², and subtract ZᵀZ from S; return whether all are positive definite."""
    six = V.shape[1]  # loops of known length would be written out one by one, which takes long to compile
    for v in range(len(V)):
        A = L[v]
        for i in range(six):
            for j in range(six):
                A[i, j] = V[v, i, j]
                A[6 + i, j] = 0.0
            A[i, i] += mu * D2_v[v, i]
            A[6 + i, i] = 1.0
        if not cholesky_in_place(A, six, len(A)):
            return False
        for i in range(six):
            z = Z[v, i]
            for f in range(len(z)):
                z[f] = 0.0
            for k in range(i + 1):
                a, w = A[6 + k, i], W[v, k]
                for f in range(len(z)):
                    z[f] += a * w[f]
        z0, z1, z2 = Z[v, 0], Z[v, 1], Z[v, 2]
        z3, z4, z5 = Z[v, 3], Z[v, 4], Z[v, 5]
        for f in range(len(S)):
            s = S[f]
            a, b, c = z0[f], z1[f], z2[f]
            d, e, g = z3[f], z4[f], z5[f]
            for k in range(len(z0)):
                s[k] -= a * z0[k] + b * z1[k] + c * z2[k] + d * z3[k] + e * z4[k] + g * z5[k]
    return True


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def turn_and_shift(step, pose, new):
    """Fill [R | t] after a step (w, δt): t + δt, and x + s w × x + d w × (w × x) for each column x of R."""
    a, b, c = step[0], step[1], step[2]
    theta2 = a * a + b * b + c * c
    theta = math.sqrt(theta2)
    if theta < 1e-2:
        s = 1 - theta2 / 6 + theta2 * theta2 / 120
        d = 0.5 - theta2 / 24 + theta2 * theta2 / 720
    else:
        s = math.sin(theta) / theta
        d = (1 - math.cos(theta)) / theta2
    for j in range(3):
        x, y, z = pose[0, j], pose[1, j], pose[2, j]
        p = b * z - c * y
        q = c * x - a * z
        r = a * y - b * x
        new[0, j] = x + s * p + d * (b * r - c * q)
        new[1, j] = y + s * q + d * (c * p - a * r)
        new[2, j] = z + s * r + d * (a * q - b * p)
        new[j, 3] = pose[j, 3] + step[3 + j]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FUSED)
def step_kernel(
    U, V, W, mu, D2, D2_v, L, Z, S, dz, dv, places, sizes, to, factor, theta, rigs, poses, theta_new, rigs_new,
    poses_new,
):  # fmt: skip
    """Renew the scaling D², solve (A + μD²) δ = −b for δ = (dz, dv) and write the state after that step.

    dz is followed by a 1 and, as all rows of F + 1 numbers, filled up with 0. Returns the promised decrease
    −2 bᵀδ − δᵀAδ = −bᵀδ + μ ‖D δ‖², and the longest move, max |D δ|, which is −1 if the equations cannot be solved.
    """
    F, six = len(U) - 1, V.shape[1]
    for i in range(F + 1):
        for j in range(F + 1):
            S[i, j] = U[i, j]
        if i < F:
            if U[i, i] > D2[i]:
                D2[i] = U[i, i]
            elif D2[i] == 0:
                D2[i] = 1.0
            S[i, i] += mu * D2[i]
    for v in range(len(V)):
        for i in range(six):
            if V[v, i, i] > D2_v[v, i]:
                D2_v[v, i] = V[v, i, i]
            elif D2_v[v, i] == 0:
                D2_v[v, i] = 1.0
    if not (eliminate_poses(V, W, mu, D2_v, L, Z, S) and cholesky_in_place(S, F, len(S))):
        return 0.0, -1.0
    promised, longest = 0.0, 0.0
    for i in range(F - 1, -1, -1):
        total = -S[F, i]
        for k in range(i + 1, F):
            total -= S[k, i] * dz[k]
        total /= S[i, i]
        dz[i] = total
        promised += total * (mu * D2[i] * total - U[F, i])
        longest = max(longest, total * total * D2[i])
    for v in range(len(V)):
        step = dv[v]
        for i in range(six):
            step[i] = 0.0
        for k in range(six):
            total = 0.0
            for f in range(len(dz)):
                total -= Z[v, k, f] * dz[f]
            for i in range(k + 1):
                step[i] += L[v, 6 + i, k] * total
        for i in range(six):
            total = step[i]
            promised += total * (mu * D2_v[v, i] * total - W[v, i, F])
            longest = max(longest, total * total * D2_v[v, i])
        turn_and_shift(step, poses[v], poses_new[v])
    for c in range(len(theta)):
        for i in range(len(theta[c])):
            theta_new[c, i] = theta[c, i]
        for i in range(6 if c == 0 else 12, sizes[c] - 1):
            theta_new[c, places[c, i]] += factor[c, i] * dz[to[c, i]]
        step = dv[len(V)]
        for i in range(six):
            step[i] = dz[to[c, 6 + i]] if c > 0 and to[c, 6] >= 0 else 0.0
        turn_and_shift(step, rigs[c], rigs_new[c])
    return promised, math.sqrt(longest)
