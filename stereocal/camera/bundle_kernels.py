# mypy: allow-untyped-defs
"""Normal equations of bundle adjustment, compiled: the twin of ``bundle.normal_equations``.

The equations and letters are those of ``bundle``. What differs is the order of the work:

- A block (the corners of one view in one camera) is taken in chunks of 64 points. Every quantity of a chunk is a row of
  one flat array, `J`, at an offset known at compile time, so that each loop runs over the points and the compiler turns
  it into vector instructions without having to prove that arrays do not overlap. A chunk is filled up to a multiple of
  8 points, the width of a vector; points that only fill up have the weight 0, and so has 1/Z, which makes their x, and
  with it every derivative, vanish.
- The Jacobian is never kept. A column of it is a row here, ∂u of all points and then ∂v, and JᵀJ is taken at once, four
  columns by four: sixteen sums that stay in registers while eight columns are read (``tile_products``).
- Derivatives are first taken by the block's own pose (a turn ω and a shift δt in the camera's frame) and the camera's
  parameters. Of the outcome A = JᵀJ, a matrix of at most 26 × 26, the parts for view and rig follow by 6×6 matrices,
  from R_c R_v with ω = ω_c + R_c ω_v and δt = δt_c − [R_c t_v]ₓ ω_c + R_c δt_v.
- The residual is one more column, the last, and counts as one more unknown, F: so b is the last row of U, b_v that of
  W, and the solver's right hand sides ride along with its matrices.
- G, of which no row holds more than one number, is passed as `to` (which unknown) and `factor` (that number).

First calls wait for the compiler, and it takes its time for every operation that is written down: 5 ms for an array's
element, 20 for a loop. That is why one function serves all cameras, and long formulas stand once.

Kernels take arrays and write into arrays; nothing is checked here.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from stereocal.camera.tile_products import add_tile

CHUNK = 64
STRIDE = 2 * CHUNK  # a row of J: ∂u of the chunk, then ∂v
# Rows of J: the pose (ω, δt), fx fy cx cy s, the lens in OpenCV's order (a fisheye's k1 … k4 first), the residual p̃ − y
WX, WY, WZ, TX, TY, TZ, FX, FY, CX, CY, SK = range(0, 11 * STRIDE, STRIDE)
K1, K2, P1, P2, K3, K4, K5, K6, S1, S2, S3, S4, TAU_X, TAU_Y, LAST = range(11 * STRIDE, 26 * STRIDE, STRIDE)
# and what stands behind them: Y = R X, 1/Z, x = X_c / Z_c, x_d, D = ∂x_d/∂x, |x|², 1/denominator and f of the lens
Y0, Y1, Y2, IZ, U_, V_, UD, VD, D00, D01, D10, D11, S_, F_, X_0, X_1, X_2, YU, YV, WT = range(
    26 * STRIDE, 26 * STRIDE + 20 * CHUNK, CHUNK
)
LENGTH = 26 * STRIDE + 20 * CHUNK
WIDEST = 28  # columns of a camera, up to whole tiles of four
TILTED, FISHEYE = 2, 3  # in `kinds`; 1 is a lens of OpenCV with more coefficients than five

SUMS = {"reassoc", "contract", "nsz"}  # sums of products may be regrouped: that is what makes them vectors
# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def place_block(rig, view, pose, T):
    """Fill the block's pose [R | t], 3 × 4, and T, which takes (ω_v, δt_v, ω_c, δt_c) to its turn and shift."""
    for i in range(3):
        a, b, c = rig[i, 0], rig[i, 1], rig[i, 2]
        for j in range(4):
            pose[i, j] = a * view[0, j] + b * view[1, j] + c * view[2, j]
        for j in range(3):
            T[i, j] = T[3 + i, 3 + j] = rig[i, j]
        k, n = (i + 1) % 3, (i + 2) % 3
        T[3 + k, 6 + n] = pose[i, 3]  # −[R_c t_v]ₓ
        T[3 + n, 6 + k] = -pose[i, 3]
        pose[i, 3] += rig[i, 3]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def into_camera(data, first, m, full, pose, J):
    """Fetch the m points of a chunk and fill Y = R X, 1/Z and x = X_c / Z_c; return how many are behind the camera."""
    for i in range(len(data)):
        row, to = data[i, first : first + m], J[X_0 + i * CHUNK :]
        for j in range(m):
            to[j] = row[j]
        for j in range(m, full):
            to[j] = row[0]
    for j in range(full):
        J[WT + j] = 1.0 if j < m else 0.0
    for i in range(3):
        a, b, c = pose[i, 0], pose[i, 1], pose[i, 2]
        to = J[Y0 + i * CHUNK :]
        for j in range(full):
            to[j] = a * J[X_0 + j] + b * J[X_1 + j] + c * J[X_2 + j]
    t0, t1, t2 = pose[0, 3], pose[1, 3], pose[2, 3]
    behind = 0
    for j in range(full):
        Z = J[Y2 + j] + t2
        behind += Z <= 0
        iz = J[WT + j] / Z
        J[IZ + j] = iz
        J[U_ + j] = (J[Y0 + j] + t0) * iz
        J[V_ + j] = (J[Y1 + j] + t1) * iz
    return behind


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def brown_chunk(full, theta, J):
    """Fill x_d, D and ∂x_d/∂(k1 k2 p1 p2 k3) of OpenCV's family without the tilt.

    The terms of ``distortion_brown``, gathered by what they multiply: x_d = t x + s (a, b), with t_u = ∂t/∂u and so on.
    """
    k1, k2, k3 = theta[5], theta[6], theta[9]
    k4, k5, k6 = theta[10], theta[11], theta[12]
    p1, p2 = theta[7], theta[8]
    s1, s2 = theta[13], theta[14]
    s3, s4 = theta[15], theta[16]
    for j in range(full):
        h = CHUNK + j
        u = J[U_ + j]
        v = J[V_ + j]
        s = u * u + v * v
        q = 1 / (1 + s * (k4 + s * (k5 + s * k6)))
        f = (1 + s * (k1 + s * (k2 + s * k3))) * q
        slope = 2 * q * (k1 + s * (2 * k2 + 3 * s * k3) - f * (k4 + s * (2 * k5 + 3 * s * k6)))
        t = f + 2 * (p1 * v + p2 * u)
        t_u = u * slope + 2 * p2
        t_v = v * slope + 2 * p1
        a = p2 + s1 + s * s2
        b = p1 + s3 + s * s4
        J[UD + j] = u * t + s * a
        J[VD + j] = v * t + s * b
        a = 2 * (a + s * s2)
        b = 2 * (b + s * s4)
        J[D00 + j] = t + u * (t_u + a)
        J[D01 + j] = u * t_v + v * a
        J[D10 + j] = v * t_u + u * b
        J[D11 + j] = t + v * (t_v + b)
        J[S_ + j] = s
        J[F_ + j] = f
        w = s * q
        J[K1 + j] = u * w
        J[K1 + h] = v * w
        w *= s
        J[K2 + j] = u * w
        J[K2 + h] = v * w
        w *= s
        J[K3 + j] = u * w
        J[K3 + h] = v * w
        w = 2 * u * v
        J[P1 + j] = w
        J[P2 + h] = w
        J[P1 + h] = s + 2 * v * v
        J[P2 + j] = s + 2 * u * u


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def further_coefficients(full, J):
    """Fill ∂x_d/∂(k4 k5 k6 s1 s2 s3 s4): −f times those of k1 k2 k3, and the prism's."""
    for j in range(full):
        h = CHUNK + j
        f = J[F_ + j]
        J[K4 + j] = -f * J[K1 + j]
        J[K4 + h] = -f * J[K1 + h]
        J[K5 + j] = -f * J[K2 + j]
        J[K5 + h] = -f * J[K2 + h]
        J[K6 + j] = -f * J[K3 + j]
        J[K6 + h] = -f * J[K3 + h]
        s = J[S_ + j]
        J[S1 + j] = J[S3 + h] = s
        J[S2 + j] = J[S4 + h] = s * s
        J[S1 + h] = J[S3 + j] = J[S2 + h] = J[S4 + j] = 0.0


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def tilt_matrices(tau_x, tau_y, M):
    """Fill the homography of a tilted sensor, M[0], and its derivatives by τx and τy, M[1] and M[2]."""
    cx, sx, cy, sy = math.cos(tau_x), math.sin(tau_x), math.cos(tau_y), math.sin(tau_y)
    R = np.zeros((3, 3, 3))  # R_y R_x, and the same differentiated by τx and τy
    R[0, 0, 0], R[0, 0, 1], R[0, 0, 2] = cy, sx * sy, -cx * sy
    R[0, 1, 1], R[0, 1, 2] = cx, sx
    R[0, 2, 0], R[0, 2, 1], R[0, 2, 2] = sy, -sx * cy, cx * cy
    R[1, 0, 1], R[1, 0, 2], R[1, 1, 1], R[1, 1, 2] = cx * sy, sx * sy, -sx, cx
    R[1, 2, 1], R[1, 2, 2] = -cx * cy, -sx * cy
    R[2, 0, 0], R[2, 0, 1], R[2, 0, 2] = -sy, sx * cy, -cx * cy
    R[2, 2, 0], R[2, 2, 1], R[2, 2, 2] = cy, sx * sy, -cx * sy
    for n in range(3):  # [[R33, 0, −R13], [0, R33, −R23], [0, 0, 1]] R, and the product rule
        for k in range(3):
            for i in range(2):
                M[n, i, k] = R[n, 2, 2] * R[0, i, k] - R[n, i, 2] * R[0, 2, k]
                if n > 0:
                    M[n, i, k] += R[0, 2, 2] * R[n, i, k] - R[0, i, 2] * R[n, 2, k]
            M[n, 2, k] = R[n, 2, k]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def tilt_chunk(full, theta, J):
    """Take x_d, D and ∂x_d/∂k of the other coefficients through the tilt of the sensor; fill ∂x_d/∂τ."""
    M = np.empty((3, 3, 3))
    tilt_matrices(theta[17], theta[18], M)
    for j in range(full):
        h = CHUNK + j
        a, b = J[UD + j], J[VD + j]
        w = 1 / (M[0, 2, 0] * a + M[0, 2, 1] * b + M[0, 2, 2])
        u = (M[0, 0, 0] * a + M[0, 0, 1] * b + M[0, 0, 2]) * w
        v = (M[0, 1, 0] * a + M[0, 1, 1] * b + M[0, 1, 2]) * w
        for n in range(1, 3):
            x = M[n, 0, 0] * a + M[n, 0, 1] * b + M[n, 0, 2]
            y = M[n, 1, 0] * a + M[n, 1, 1] * b + M[n, 1, 2]
            z = M[n, 2, 0] * a + M[n, 2, 1] * b + M[n, 2, 2]
            J[TAU_X - STRIDE + n * STRIDE + j] = (x - u * z) * w
            J[TAU_X - STRIDE + n * STRIDE + h] = (y - v * z) * w
        h00, h01 = (M[0, 0, 0] - u * M[0, 2, 0]) * w, (M[0, 0, 1] - u * M[0, 2, 1]) * w
        h10, h11 = (M[0, 1, 0] - v * M[0, 2, 0]) * w, (M[0, 1, 1] - v * M[0, 2, 1]) * w
        J[UD + j], J[VD + j] = u, v
        for k in range(D00, D10, CHUNK):
            a, b = J[k + j], J[k + STRIDE + j]
            J[k + j], J[k + STRIDE + j] = h00 * a + h01 * b, h10 * a + h11 * b
        for k in range(K1, TAU_X, STRIDE):
            a, b = J[k + j], J[k + h]
            J[k + j], J[k + h] = h00 * a + h01 * b, h10 * a + h11 * b


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def fisheye_chunk(full, theta, J):
    """Fill x_d, D and ∂x_d/∂k of the Kannala–Brandt lens; below r = 1e-4 its series (``distortion_fisheye``)."""
    k1, k2, k3, k4 = theta[5], theta[6], theta[7], theta[8]
    for j in range(full):
        u, v = J[U_ + j], J[V_ + j]
        s = u * u + v * v
        r = math.sqrt(s)
        angle = math.atan(r)
        t = angle * angle
        if r < 1e-4:
            over_r = 1 - s / 3
            f = 1 + s * ((k1 - 1 / 3) + s * (0.2 - k1 + k2))
            f_r = 2 * (k1 - 1 / 3) + 4 * (0.2 - k1 + k2) * s
        else:
            over_r = angle / r
            f = over_r * (1 + t * (k1 + t * (k2 + t * (k3 + t * k4))))
            f_r = ((1 + t * (3 * k1 + t * (5 * k2 + t * (7 * k3 + t * 9 * k4)))) / (1 + s) - f) / s
        J[UD + j], J[VD + j] = u * f, v * f
        J[D00 + j] = f + f_r * u * u
        J[D01 + j] = J[D10 + j] = f_r * u * v
        J[D11 + j] = f + f_r * v * v
        for k in range(K1, K1 + 4 * STRIDE, STRIDE):
            over_r *= t
            J[k + j], J[k + CHUNK + j] = u * over_r, v * over_r


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def pixel_chunk(full, theta, count, J):
    """Take the lens to pixels through A = [[fx, s], [0, fy]]: fill all rows of J that `count` coefficients use.

    With g = A D Π a point's row by the pose is (Y × g, g).
    """
    fx, fy, sk = theta[0], theta[1], theta[4]
    cx, cy = theta[2], theta[3]
    for j in range(full):
        h = CHUNK + j
        weight = J[WT + j]
        iz = J[IZ + j]
        x = J[U_ + j]
        y = J[V_ + j]
        X = J[Y0 + j]
        Y = J[Y1 + j]
        Z = J[Y2 + j]
        b = J[D10 + j]
        a = (fx * J[D00 + j] + sk * b) * iz
        d = J[D11 + j]
        b *= fy * iz
        c = (fx * J[D01 + j] + sk * d) * iz
        d *= fy * iz
        e = -(x * a + y * c)
        J[TX + j] = a
        J[TY + j] = c
        J[TZ + j] = e
        J[WX + j] = Y * e - Z * c
        J[WY + j] = Z * a - X * e
        J[WZ + j] = X * c - Y * a
        e = -(x * b + y * d)
        J[TX + h] = b
        J[TY + h] = d
        J[TZ + h] = e
        J[WX + h] = Y * e - Z * d
        J[WY + h] = Z * b - X * e
        J[WZ + h] = X * d - Y * b
        x = J[UD + j]
        y = J[VD + j]
        J[FX + j] = x
        J[FY + h] = y
        J[SK + j] = y
        J[CX + j] = J[CY + h] = weight
        J[FX + h] = J[FY + j] = J[SK + h] = J[CX + h] = J[CY + j] = 0.0
        J[LAST + j] = fx * x + sk * y + weight * (cx - J[YU + j])
        J[LAST + h] = fy * y + weight * (cy - J[YV + j])
    for k in range(K1, K1 + count * STRIDE, STRIDE):
        row = J[k : k + STRIDE]
        for j in range(full):
            b = row[CHUNK + j]
            row[j] = fx * row[j] + sk * b
            row[CHUNK + j] = fy * b


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def weigh_chunk(first, m, rows, whitening, loss, scale, J):
    """Multiply the rows of a chunk by their whitening and by √w of the loss; return Σρ."""
    if whitening.shape[1] > 0:
        for at in rows:
            for j in range(m):
                a, b = J[at + j], J[at + CHUNK + j]
                J[at + j] = whitening[0, first + j] * a + whitening[1, first + j] * b
                J[at + CHUNK + j] = whitening[2, first + j] * a + whitening[3, first + j] * b
    total = 0.0
    for j in range(m):
        e = J[LAST + j] ** 2 + J[LAST + CHUNK + j] ** 2
        w = 1.0
        if loss == 0:
            total += e
        elif loss == 1:
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
        if w != 1:
            for at in rows:
                J[at + j] *= w
                J[at + CHUNK + j] *= w
    return total


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def add_products(rows, full, J, A):
    """Add JᵀJ of the rows listed (a multiple of four) to the lower triangle of A, by tiles of 4 × 4."""
    for i in range(0, len(rows), 4):
        for k in range(0, i + 4, 4):
            add_tile(J, rows, i, k, full, CHUNK, A)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def with_rig(A, n, T, Q, P):
    """Fill P = Eᵀ A E with E = diag(T, I): the unknowns of view and rig in place of the block's own pose."""
    six, twelve = T.shape  # loops of known length would be written out one by one, which takes long to compile
    for i in range(n):  # Q = A[:, pose] T
        for j in range(twelve):
            Q[i, j] = 0.0
        for k in range(six):
            a = A[max(i, k), min(i, k)]
            for j in range(twelve):
                Q[i, j] += a * T[k, j]
    for i in range(twelve):
        for j in range(twelve):
            P[i, j] = 0.0
        for k in range(six):
            a = T[k, i]
            for j in range(twelve):
                P[i, j] += a * Q[k, j]
    for i in range(six, n):
        for j in range(twelve):
            P[6 + i, j] = Q[i, j]
        for j in range(6, i + 1):
            P[6 + i, 6 + j] = A[i, j]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def add_block(P, size, to, factor, fresh, U, V, W):
    """Add the lower triangle of a block's P to U and to its view's V (6, 6) and W (6, F + 1), cleared if `fresh`."""
    six = len(V)
    for i in range(six):
        if fresh:
            for j in range(W.shape[1]):
                W[i, j] = 0.0
            for j in range(six):
                V[i, j] = 0.0
        for j in range(i + 1):
            V[i, j] += P[i, j]
        for j in range(i):
            V[j, i] += P[i, j]
    for i in range(six, size):
        g = to[i]
        if g < 0:  # a rig that is held
            continue
        f = factor[i]
        for j in range(six):
            W[j, g] += f * P[i, j]
        for j in range(six, i + 1):
            k = to[j]
            if k >= 0:
                product = f * factor[j] * P[i, j]
                U[g, k] += product
                if j < i:
                    U[k, g] += product


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations_kernel(
    data, whitening, blocks, loss, scale, lenses, kinds, rows, sizes, to, factor, theta, rigs, poses, U, V, W,
    residuals, J, A, P, Q, T, pose,
):  # fmt: skip
    """Fill U, V, W and the residuals at a state; return F and the largest |b_i| / √(A_ii F).

    F is infinite if a point is behind its camera. `data` and `blocks`, `rows`, `sizes`,
    `to` and `factor` are those of ``bundle_compiled``. `kinds` is None, or says which lenses are more than five
    coefficients; `loss` is None if there are neither weights nor a robust loss. Where these are None the branches are
    not even compiled: that saves a second at the first call.
    """
    F = len(U) - 1
    for i in range(F + 1):
        for j in range(F + 1):
            U[i, j] = 0.0
    cost = 0.0
    for block in range(len(blocks)):
        c, v = blocks[block, 0], blocks[block, 1]
        n = sizes[c] - 6 if c > 0 else sizes[c]
        place_block(rigs[c], poses[v], pose, T)
        for i in range(len(A)):
            for j in range(i + 1):
                A[i, j] = 0.0
        first, last = blocks[block, 2], blocks[block, 3]
        while first < last:
            m = min(CHUNK, last - first)
            full = (m + 7) // 8 * 8
            if into_camera(data, first, m, full, pose, J) > 0:
                return np.inf, np.inf
            if kinds is None:
                brown_chunk(full, theta[c], J)
            elif kinds[c] == FISHEYE:
                fisheye_chunk(full, theta[c], J)
            else:
                brown_chunk(full, theta[c], J)
                further_coefficients(full, J)
                if kinds[c] == TILTED:
                    tilt_chunk(full, theta[c], J)
            pixel_chunk(full, theta[c], lenses[c], J)
            for j in range(m):
                residuals[0, first + j] = J[LAST + j]
                residuals[1, first + j] = J[LAST + CHUNK + j]
            if loss is not None:
                cost += weigh_chunk(first, m, rows[c, :n], whitening, loss, scale, J)
            add_products(rows[c], full, J, A)
            first += CHUNK
        if c > 0:
            with_rig(A, n, T, Q, P)
            add_block(P, sizes[c], to[c], factor[c], blocks[block, 4], U, V[v], W[v])
        else:
            add_block(A, n, to[c], factor[c], blocks[block, 4], U, V[v], W[v])
    if loss is None:
        cost = U[F, F]
    if not 0 < cost < np.inf:
        return (0.0, 0.0) if cost == 0 else (np.inf, np.inf)
    largest = 0.0
    for i in range(F):
        if U[i, i] > 0:
            largest = max(largest, U[F, i] * U[F, i] / U[i, i])
    for v in range(len(V)):
        for i in range(V.shape[1]):
            if V[v, i, i] > 0:
                largest = max(largest, W[v, i, F] * W[v, i, F] / V[v, i, i])
    return cost, math.sqrt(largest / cost)
