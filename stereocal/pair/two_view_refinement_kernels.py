# mypy: allow-untyped-defs
"""Distances, their derivatives and the refinement of F or of a motion, compiled: the twin of ``two_view_refinement``.

The equations and letters are those of the twin, and so is every decision; only sums are taken in another order. Points
come as four rows x, y, x', y' and are taken in chunks of 64: for a chunk, each of the nine derivatives ∂r/∂F and r
itself is a row of a flat scratch array with a stride known at compile time, so that the loop over the points becomes
vector instructions, and their products are sums along two rows.

Kernels take arrays and write into arrays; nothing is checked here.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

CHUNK = 64
SUMS = {"reassoc", "contract", "nsz"}  # sums of products may be regrouped: that is what makes them vectors
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
FIRST_DAMPING, LARGEST_DAMPING = 1e-4, 1e6
LEAST_SHARE = 0.05
LEAST_SIGMA = 1e-7


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def signed_sampson(F, points, r):
    """r = c/√w, c = x'ᵀ F x, w = ‖n‖² + ‖m‖², n = (F x)₁₂, m = (Fᵀ x')₁₂."""
    a, b, c, d, e, f, g, h, i = F
    for k in range(points.shape[1]):
        x, y, u, v = points[0, k], points[1, k], points[2, k], points[3, k]
        n0, n1 = a * x + b * y + c, d * x + e * y + f
        m0, m1 = a * u + d * v + g, b * u + e * v + h
        r[k] = (n0 * u + n1 * v + g * x + h * y + i) / math.sqrt(max(n0 * n0 + n1 * n1 + m0 * m0 + m1 * m1, 1e-300))


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def signed_reprojection(F, points, r):
    """Distance from the nearest pair that satisfies F, with the sign of c: Lindstrom's iteration (``epipolar``)."""
    a, b, c, d, e, f, g, h, i = F
    for k in range(points.shape[1]):
        x, y, u, v = points[0, k], points[1, k], points[2, k], points[3, k]
        n0, n1 = a * x + b * y + c, d * x + e * y + f
        m0, m1 = a * u + d * v + g, b * u + e * v + h
        value = n0 * u + n1 * v + g * x + h * y + i
        s0, s1, t0, t1 = n0, n1, m0, m1
        r[k] = 0.0
        for _ in range(3):
            curve = s0 * (a * t0 + b * t1) + s1 * (d * t0 + e * t1)
            half = 0.5 * (s0 * n0 + s1 * n1 + t0 * m0 + t1 * m1)
            below = half + math.sqrt(max(half * half - curve * value, 0.0))
            if below > 0:  # else no pair near this one satisfies F to second order: the last estimate stays
                step = value / below
                r[k] = step * math.sqrt(s0 * s0 + s1 * s1 + t0 * t0 + t1 * t1)
                p, q, o, w = x - step * t0, y - step * t1, u - step * s0, v - step * s1
                s0, s1 = a * p + b * q + c, d * p + e * q + f
                t0, t1 = a * o + d * w + g, b * o + e * w + h


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def accumulate(F, points, r, weights, rows, products):
    """Fill products (10, 10) with Σ w [g r]ᵀ[g r], g = ∂r/∂F of the signed Sampson distance."""
    a, b, c, d, e, f, g, h, i = F
    for p in range(10):
        for q in range(10):
            products[p, q] = 0.0
    count = points.shape[1]
    for start in range(0, count, CHUNK):
        size = min(CHUNK, count - start)
        for j in range(size):
            k = start + j
            x, y, u, v = points[0, k], points[1, k], points[2, k], points[3, k]
            n0, n1 = a * x + b * y + c, d * x + e * y + f
            m0, m1 = a * u + d * v + g, b * u + e * v + h
            value = n0 * u + n1 * v + g * x + h * y + i
            w = max(n0 * n0 + n1 * n1 + m0 * m0 + m1 * m1, 1e-300)
            root = math.sqrt(weights[k])
            one = root / math.sqrt(w)  # √weight / √w
            s = value / w
            n0, n1, m0, m1 = s * n0, s * n1, s * m0, s * m1
            rows[j] = one * (u * x - n0 * x - m0 * u)
            rows[CHUNK + j] = one * (u * y - n0 * y - m1 * u)
            rows[2 * CHUNK + j] = one * (u - n0)
            rows[3 * CHUNK + j] = one * (v * x - n1 * x - m0 * v)
            rows[4 * CHUNK + j] = one * (v * y - n1 * y - m1 * v)
            rows[5 * CHUNK + j] = one * (v - n1)
            rows[6 * CHUNK + j] = one * (x - m0)
            rows[7 * CHUNK + j] = one * (y - m1)
            rows[8 * CHUNK + j] = one
            rows[9 * CHUNK + j] = root * r[k]
        for p in range(10):
            for q in range(p + 1):
                total = 0.0
                for j in range(size):
                    total += rows[p * CHUNK + j] * rows[q * CHUNK + j]
                products[p, q] += total
    for p in range(10):
        for q in range(p):
            products[q, p] = products[p, q]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def multiply(A, B, out):
    """out = A B."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def turned_by(A, w0, w1, w2, out):
    """out = exp([w]ₓ) A (``base.rotations``)."""
    theta2 = w0 * w0 + w1 * w1 + w2 * w2
    theta = math.sqrt(theta2)
    if theta < 1e-4:
        s, c = 1 - theta2 / 6, 0.5 - theta2 / 24
    else:
        s, c = math.sin(theta) / theta, (1 - math.cos(theta)) / theta2
    for j in range(3):
        a0, a1, a2 = A[0, j], A[1, j], A[2, j]
        b0, b1, b2 = w1 * a2 - w2 * a1, w2 * a0 - w0 * a2, w0 * a1 - w1 * a0
        out[0, j] = a0 + s * b0 + c * (w1 * b2 - w2 * b1)
        out[1, j] = a1 + s * b1 + c * (w2 * b0 - w0 * b2)
        out[2, j] = a2 + s * b2 + c * (w0 * b1 - w1 * b0)


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def into_pixels(middle, to_right, to_left, half, out):
    """out (9,) = to_rightᵀ middle to_left, row by row."""
    multiply(middle, to_left, half)
    for i in range(3):
        for j in range(3):
            out[3 * i + j] = to_right[0, i] * half[0, j] + to_right[1, i] * half[1, j] + to_right[2, i] * half[2, j]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def crossed(t0, t1, t2, A, out):
    """out = [t]ₓ A."""
    for j in range(3):
        out[0, j] = t1 * A[2, j] - t2 * A[1, j]
        out[1, j] = t2 * A[0, j] - t0 * A[2, j]
        out[2, j] = t0 * A[1, j] - t1 * A[0, j]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def model_matrix(state, freedom, to_right, to_left, scratch, F):
    """F (9,), ‖F‖ = 1, of the state, from U diag(1, s, 0) Vᵀ (freedom 7) or [t]ₓ R (5); return the scale."""
    middle, half = scratch[0], scratch[1]
    if freedom == 7:
        for i in range(3):
            for j in range(3):
                middle[i, j] = state[i, 0] * state[3 + j, 0] + state[6, 1] * state[i, 1] * state[3 + j, 1]
    else:
        crossed(state[3, 0], state[3, 1], state[3, 2], state, middle)
    into_pixels(middle, to_right, to_left, half, F)
    size = 0.0
    for k in range(9):
        size += F[k] * F[k]
    scale = 1.0 / math.sqrt(size)
    for k in range(9):
        F[k] *= scale
    return scale


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def model_derivatives(state, freedom, scale, to_right, to_left, scratch, D):
    """Fill D (freedom, 9) with the derivatives of scale · F by the steps that `advance` takes."""
    middle, half, moved = scratch[0], scratch[1], scratch[2]
    for k in range(freedom):
        e0, e1, e2 = 1.0 * (k % 3 == 0), 1.0 * (k % 3 == 1), 1.0 * (k % 3 == 2)
        if freedom == 7 and k < 6:  # [e]ₓ U D Vᵀ, and U D ([e]ₓ V)ᵀ
            crossed(e0, e1, e2, state[:3] if k < 3 else state[3:6], moved)
            U, V = (moved, state[3:6]) if k < 3 else (state[:3], moved)
            for i in range(3):
                for j in range(3):
                    middle[i, j] = U[i, 0] * V[j, 0] + state[6, 1] * U[i, 1] * V[j, 1]
        elif freedom == 7:  # U diag(0, 1, 0) Vᵀ
            for i in range(3):
                for j in range(3):
                    middle[i, j] = state[i, 1] * state[3 + j, 1]
        elif k < 3:  # [t]ₓ [e]ₓ R
            crossed(e0, e1, e2, state, moved)
            crossed(state[3, 0], state[3, 1], state[3, 2], moved, middle)
        else:  # [b]ₓ R
            crossed(state[k + 1, 0], state[k + 1, 1], state[k + 1, 2], state, middle)
        into_pixels(middle, to_right, to_left, half, D[k])
        for j in range(9):
            D[k, j] *= scale


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def advance(state, freedom, step, out):
    """out = the state after a step."""
    turned_by(state[:3], step[0], step[1], step[2], out[:3])
    if freedom == 7:
        turned_by(state[3:6], step[3], step[4], step[5], out[3:6])
        out[6, 1] = state[6, 1] + step[6]
        return
    size = 0.0
    for j in range(3):
        out[3, j] = state[3, j] + step[3] * state[4, j] + step[4] * state[5, j]
        size += out[3, j] ** 2
    along = 0.0
    for j in range(3):
        out[3, j] /= math.sqrt(size)
        along += out[3, j] * state[4, j]
    size = 0.0
    for j in range(3):
        out[4, j] = state[4, j] - along * out[3, j]
        size += out[4, j] ** 2
    for j in range(3):
        out[4, j] /= math.sqrt(size)
    for j in range(3):
        a, b = (j + 1) % 3, (j + 2) % 3
        out[5, j] = out[3, a] * out[4, b] - out[3, b] * out[4, a]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def solve_damped(products, D, damping, A, step):
    """Solve (JᵀJ + damping diag JᵀJ) step = −Jᵀr with J = g Dᵀ, by Cholesky's decomposition; tell if it is positive."""
    p = D.shape[0]
    for i in range(p):
        step[i] = 0.0
        for k in range(9):
            step[i] -= D[i, k] * products[k, 9]
        for j in range(i + 1):
            total = 0.0
            for k in range(9):
                along = 0.0
                for m in range(9):
                    along += products[k, m] * D[j, m]
                total += D[i, k] * along
            A[i, j] = total
    for i in range(p):
        A[i, i] += damping * A[i, i]
    for i in range(p):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            if i == j:
                if not total > 0:
                    return False
                A[i, i] = math.sqrt(total)
            else:
                A[i, j] = total / A[j, j]
    for i in range(p):
        for k in range(i):
            step[i] -= A[i, k] * step[k]
        step[i] /= A[i, i]
    for i in range(p - 1, -1, -1):
        for k in range(i + 1, p):
            step[i] -= A[k, i] * step[k]
        step[i] /= A[i, i]
    return True


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def mixture_weights(r, extent, weights):
    """One expectation step: σ and π from the weights, the weights from them; return Σ log p and the largest change."""
    total, squares = 0.0, 0.0
    for k in range(len(r)):
        total += weights[k]
        squares += weights[k] * r[k] * r[k]
    sigma = max(math.sqrt(squares / max(total, 1e-12)), LEAST_SIGMA * extent)
    share = min(max(total / len(r), LEAST_SHARE), 1 - 1e-6)
    height, bad = share / (math.sqrt(2 * math.pi) * sigma), (1 - share) / (2 * extent)
    narrow = -0.5 / (sigma * sigma)
    log_likelihood, change = 0.0, 0.0
    density, batch = 1.0, 0
    for k in range(len(r)):
        good = height * math.exp(narrow * r[k] * r[k])
        update = good / (good + bad)
        change = max(change, abs(update - weights[k]))
        weights[k] = update
        density *= good + bad  # one logarithm for eight factors
        batch += 1
        if batch == 8:
            log_likelihood += math.log(density)
            density, batch = 1.0, 0
    return log_likelihood + math.log(density), change


@njit(cache=True, nogil=True, error_model="numpy")
def refine(state, freedom, to_right, to_left, points, weights, reach, extent, rounds, tolerance, exact, F, covariance):
    """Levenberg and Marquardt's steps on Σ w r², the weights renewed before each if extent > 0.

    If reach > 0 the weights begin as 1 for matches within that distance and 0 for the others.

    `state` (7, 3) and `weights` (N,) are overwritten, `F` (9,) receives the matrix, `covariance` (p, p) (JᵀWJ)⁻¹, or
    NaN if that is not positive. Returns the log-likelihood (0 without a mixture), Σ w r², and the number of steps.
    """
    count = points.shape[1]
    r, new_r, rows = np.zeros(count), np.zeros(count), np.empty(10 * CHUNK)
    new_F, products, D = np.empty(9), np.empty((10, 10)), np.empty((freedom, 9))
    A, step, scratch = np.empty((freedom, freedom)), np.empty(freedom), np.empty((3, 3, 3))
    new_state = state.copy()
    damping, log_likelihood, taken = FIRST_DAMPING, 0.0, 0
    scale = model_matrix(state, freedom, to_right, to_left, scratch, F)
    if exact:
        signed_reprojection(F, points, r)
    else:
        signed_sampson(F, points, r)
    if reach > 0:
        for k in range(count):
            weights[k] = 1.0 if abs(r[k]) <= reach else 0.0
    cost = 0.0
    for _ in range(rounds):
        change = 0.0
        if extent > 0:
            log_likelihood, change = mixture_weights(r, extent, weights)
        accumulate(F, points, r, weights, rows, products)
        model_derivatives(state, freedom, scale, to_right, to_left, scratch, D)
        cost = products[9, 9]
        gain, better = 0.0, False
        while damping <= LARGEST_DAMPING:
            if solve_damped(products, D, damping, A, step):
                advance(state, freedom, step, new_state)
                new_scale = model_matrix(new_state, freedom, to_right, to_left, scratch, new_F)
                if exact:
                    signed_reprojection(new_F, points, new_r)
                else:
                    signed_sampson(new_F, points, new_r)
                new_cost = 0.0
                for k in range(count):
                    new_cost += weights[k] * new_r[k] * new_r[k]
                if new_cost < cost:
                    gain, better = cost - new_cost, True
                    break
            damping *= 10
        if not better:
            damping = FIRST_DAMPING
            if extent <= 0 or change <= tolerance:
                break
            continue
        taken += 1
        damping = max(damping / 10, 1e-12)
        for i in range(7):
            for j in range(3):
                state[i, j] = new_state[i, j]
        for k in range(9):
            F[k] = new_F[k]
        for k in range(count):
            r[k] = new_r[k]
        scale, cost = new_scale, new_cost
        if gain <= tolerance * cost and change <= tolerance:
            break
    if extent > 0:
        log_likelihood, _ = mixture_weights(r, extent, weights)
    cost = 0.0
    for k in range(count):
        cost += weights[k] * r[k] * r[k]
    if covariance.size > 0:
        accumulate(F, points, r, weights, rows, products)
        model_derivatives(state, freedom, scale, to_right, to_left, scratch, D)
        if solve_damped(products, D, 0.0, A, step):
            invert_factor(A, covariance)
        else:
            for i in range(freedom):
                for j in range(freedom):
                    covariance[i, j] = np.nan
    return log_likelihood, cost, taken


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def invert_factor(L, out):
    """out = (L Lᵀ)⁻¹, column by column."""
    p = L.shape[0]
    for column in range(p):
        for i in range(p):
            total = 1.0 if i == column else 0.0
            for k in range(i):
                total -= L[i, k] * out[k, column]
            out[i, column] = total / L[i, i]
        for i in range(p - 1, -1, -1):
            total = out[i, column]
            for k in range(i + 1, p):
                total -= L[k, i] * out[k, column]
            out[i, column] = total / L[i, i]
