# mypy: allow-untyped-defs
"""Normal equations of bundle adjustment, compiled: the twin of ``bundle.normal_equations``.

The equations and letters are those of ``bundle``. What differs is the order of the work:

- A block (the corners of one view in one camera) is taken in chunks of 64 points. Every quantity of a chunk is a row of
  a flat scratch array with a stride known at compile time, so that each loop runs over the points and the compiler
  turns it into vector instructions without having to prove that arrays do not overlap. A chunk is filled up to a
  multiple of 8 points, the width of a vector; points that only fill up get 1/Z = 0, which makes their x, and with it
  every derivative, vanish.
- J is never kept. A column of a chunk is a row here, ∂u of all points and then ∂v, and JᵀJ is taken at once, four
  columns by four: sixteen sums that stay in registers while eight columns are read.
- Derivatives are first taken by the block's own pose (a turn ω and a shift δt in the camera's frame) and the camera's
  parameters. Of the outcome A = JᵀJ, a matrix of at most 26 × 26, the parts for view and rig follow by 6×6 matrices,
  from R_c R_v with ω = ω_c + R_c ω_v and δt = δt_c − [R_c t_v]ₓ ω_c + R_c δt_v.
- G, of which no row holds more than one number, is passed as `target` (which free unknown) and `factor` (that number).

Rows of `tmp`: 0–2 Y, 3 1/Z, 4–5 x, 6–7 x_d, 8–11 D = ∂x_d/∂x, 12 s = |x|², 13 1/denominator, 14 f.
Rows of `J`: 0–5 pose, 6–10 fx fy cx cy s, 11–24 the lens in OpenCV's order, 25 the residual p̃ − y.

Kernels take arrays and write into arrays; nothing is checked here.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

CHUNK = 64
STRIDE = 2 * CHUNK  # a row of J: ∂u of the chunk, then ∂v
J_ROWS = 26
TMP_ROWS = 15
LENS = 11  # first row of J that belongs to the lens
LAST = 25  # the residual
A_SIZE = 28  # J_ROWS, up to whole tiles of four
TILTED, FISHEYE = 1, 2  # in `unusual`

SUMS = {"reassoc", "contract", "nsz"}  # sums of products may be regrouped: that is what makes them vectors
# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def into_camera(X, first, m, full, R, t, tmp):
    """Fill Y = R X, 1/Z and x = X_c / Z_c of a chunk; return the least Z."""
    r00, r01, r02 = R[0, 0], R[0, 1], R[0, 2]
    r10, r11, r12 = R[1, 0], R[1, 1], R[1, 2]
    r20, r21, r22 = R[2, 0], R[2, 1], R[2, 2]
    t0, t1, t2 = t[0], t[1], t[2]
    X0, X1, X2 = X[0, first : first + m], X[1, first : first + m], X[2, first : first + m]
    for j in range(m):
        tmp[12 * CHUNK + j], tmp[13 * CHUNK + j], tmp[14 * CHUNK + j] = X0[j], X1[j], X2[j]
    for j in range(m, full):
        tmp[12 * CHUNK + j], tmp[13 * CHUNK + j], tmp[14 * CHUNK + j] = X0[0], X1[0], X2[0]
    nearest = 1e300
    for j in range(full):
        a, b, c = tmp[12 * CHUNK + j], tmp[13 * CHUNK + j], tmp[14 * CHUNK + j]
        Z = r20 * a + r21 * b + r22 * c + t2
        nearest = min(nearest, Z)
        tmp[0 * CHUNK + j] = r00 * a + r01 * b + r02 * c
        tmp[1 * CHUNK + j] = r10 * a + r11 * b + r12 * c
        tmp[2 * CHUNK + j] = Z - t2
        tmp[3 * CHUNK + j] = 1 / Z
    for j in range(m, full):
        tmp[3 * CHUNK + j] = 0.0
    for j in range(full):
        iz = tmp[3 * CHUNK + j]
        tmp[4 * CHUNK + j] = (tmp[0 * CHUNK + j] + t0) * iz
        tmp[5 * CHUNK + j] = (tmp[1 * CHUNK + j] + t1) * iz
    return nearest


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def brown_chunk(full, theta, count, tmp, J):
    """Fill x_d, D and ∂x_d/∂k of OpenCV's family without the tilt (``distortion_brown``), `count` coefficients."""
    k1, k2, p1, p2, k3, k4 = theta[5], theta[6], theta[7], theta[8], theta[9], theta[10]
    k5, k6, s1, s2, s3, s4 = theta[11], theta[12], theta[13], theta[14], theta[15], theta[16]
    for j in range(full):
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
    for j in range(full):  # k1 k2 p1 p2 k3
        u, v, s, w = tmp[4 * CHUNK + j], tmp[5 * CHUNK + j], tmp[12 * CHUNK + j], tmp[13 * CHUNK + j]
        w1, w2, w3 = s * w, s * s * w, s * s * s * w
        J[11 * STRIDE + j], J[11 * STRIDE + CHUNK + j] = u * w1, v * w1
        J[12 * STRIDE + j], J[12 * STRIDE + CHUNK + j] = u * w2, v * w2
        J[13 * STRIDE + j], J[13 * STRIDE + CHUNK + j] = 2 * u * v, s + 2 * v * v
        J[14 * STRIDE + j], J[14 * STRIDE + CHUNK + j] = s + 2 * u * u, 2 * u * v
        J[15 * STRIDE + j], J[15 * STRIDE + CHUNK + j] = u * w3, v * w3
    if count > 5:  # k4 k5 k6: −f times k1 k2 k3
        for j in range(full):
            f = -tmp[14 * CHUNK + j]
            J[16 * STRIDE + j], J[16 * STRIDE + CHUNK + j] = f * J[11 * STRIDE + j], f * J[11 * STRIDE + CHUNK + j]
            J[17 * STRIDE + j], J[17 * STRIDE + CHUNK + j] = f * J[12 * STRIDE + j], f * J[12 * STRIDE + CHUNK + j]
            J[18 * STRIDE + j], J[18 * STRIDE + CHUNK + j] = f * J[15 * STRIDE + j], f * J[15 * STRIDE + CHUNK + j]
    if count > 8:  # s1 s2 s3 s4
        for j in range(full):
            s = tmp[12 * CHUNK + j]
            J[19 * STRIDE + j], J[19 * STRIDE + CHUNK + j] = s, 0.0
            J[20 * STRIDE + j], J[20 * STRIDE + CHUNK + j] = s * s, 0.0
            J[21 * STRIDE + j], J[21 * STRIDE + CHUNK + j] = 0.0, s
            J[22 * STRIDE + j], J[22 * STRIDE + CHUNK + j] = 0.0, s * s


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
def tilt_chunk(full, theta, tmp, J):
    """Take x_d, D and ∂x_d/∂k of the other coefficients through the tilt of the sensor; fill ∂x_d/∂τ."""
    M = np.empty((3, 3, 3))
    tilt_matrices(theta[17], theta[18], M)
    for j in range(full):
        a, b = tmp[6 * CHUNK + j], tmp[7 * CHUNK + j]
        w = 1 / (M[0, 2, 0] * a + M[0, 2, 1] * b + M[0, 2, 2])
        u = (M[0, 0, 0] * a + M[0, 0, 1] * b + M[0, 0, 2]) * w
        v = (M[0, 1, 0] * a + M[0, 1, 1] * b + M[0, 1, 2]) * w
        x, y, z = M[1, 0, 0] * a + M[1, 0, 1] * b, M[1, 1, 0] * a + M[1, 1, 1] * b, M[1, 2, 0] * a + M[1, 2, 1] * b
        z += M[1, 2, 2]
        J[23 * STRIDE + j] = (x + M[1, 0, 2] - u * z) * w
        J[23 * STRIDE + CHUNK + j] = (y + M[1, 1, 2] - v * z) * w
        x, y, z = M[2, 0, 0] * a + M[2, 0, 1] * b, M[2, 1, 0] * a + M[2, 1, 1] * b, M[2, 2, 0] * a + M[2, 2, 1] * b
        z += M[2, 2, 2]
        J[24 * STRIDE + j] = (x + M[2, 0, 2] - u * z) * w
        J[24 * STRIDE + CHUNK + j] = (y + M[2, 1, 2] - v * z) * w
        h00, h01 = (M[0, 0, 0] - u * M[0, 2, 0]) * w, (M[0, 0, 1] - u * M[0, 2, 1]) * w
        h10, h11 = (M[0, 1, 0] - v * M[0, 2, 0]) * w, (M[0, 1, 1] - v * M[0, 2, 1]) * w
        tmp[6 * CHUNK + j], tmp[7 * CHUNK + j] = u, v
        for k in range(8, 10):
            a, b = tmp[k * CHUNK + j], tmp[(k + 2) * CHUNK + j]
            tmp[k * CHUNK + j], tmp[(k + 2) * CHUNK + j] = h00 * a + h01 * b, h10 * a + h11 * b
        for k in range(LENS, LENS + 12):
            a, b = J[k * STRIDE + j], J[k * STRIDE + CHUNK + j]
            J[k * STRIDE + j], J[k * STRIDE + CHUNK + j] = h00 * a + h01 * b, h10 * a + h11 * b


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def fisheye_chunk(full, theta, tmp, J):
    """Fill x_d, D and ∂x_d/∂k of the Kannala–Brandt lens; below r = 1e-4 its series (``distortion_fisheye``)."""
    k1, k2, k3, k4 = theta[5], theta[6], theta[7], theta[8]
    for j in range(full):
        u, v = tmp[4 * CHUNK + j], tmp[5 * CHUNK + j]
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
        tmp[6 * CHUNK + j], tmp[7 * CHUNK + j] = u * f, v * f
        tmp[8 * CHUNK + j], tmp[9 * CHUNK + j] = f + f_r * u * u, f_r * u * v
        tmp[10 * CHUNK + j], tmp[11 * CHUNK + j] = f_r * u * v, f + f_r * v * v
        for k in range(LENS, LENS + 4):
            over_r *= t
            J[k * STRIDE + j], J[k * STRIDE + CHUNK + j] = u * over_r, v * over_r


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def pixel_chunk(y, first, m, full, theta, count, tmp, J):
    """Take the lens to pixels through A = [[fx, s], [0, fy]]: fill all rows of J that `count` coefficients use.

    With g = A D Π a point's row by the pose is (Y × g, g).
    """
    fx, fy, cx, cy, sk = theta[0], theta[1], theta[2], theta[3], theta[4]
    for j in range(full):
        u, v, iz = tmp[4 * CHUNK + j], tmp[5 * CHUNK + j], tmp[3 * CHUNK + j]
        Y0, Y1, Y2 = tmp[0 * CHUNK + j], tmp[1 * CHUNK + j], tmp[2 * CHUNK + j]
        d10, d11 = tmp[10 * CHUNK + j], tmp[11 * CHUNK + j]
        g0 = (fx * tmp[8 * CHUNK + j] + sk * d10) * iz
        g1 = (fx * tmp[9 * CHUNK + j] + sk * d11) * iz
        g2 = -(u * g0 + v * g1)
        h0 = fy * d10 * iz
        h1 = fy * d11 * iz
        h2 = -(u * h0 + v * h1)
        J[0 * STRIDE + j], J[0 * STRIDE + CHUNK + j] = Y1 * g2 - Y2 * g1, Y1 * h2 - Y2 * h1
        J[1 * STRIDE + j], J[1 * STRIDE + CHUNK + j] = Y2 * g0 - Y0 * g2, Y2 * h0 - Y0 * h2
        J[2 * STRIDE + j], J[2 * STRIDE + CHUNK + j] = Y0 * g1 - Y1 * g0, Y0 * h1 - Y1 * h0
        J[3 * STRIDE + j], J[3 * STRIDE + CHUNK + j] = g0, h0
        J[4 * STRIDE + j], J[4 * STRIDE + CHUNK + j] = g1, h1
        J[5 * STRIDE + j], J[5 * STRIDE + CHUNK + j] = g2, h2
    for j in range(full):
        a, b = tmp[6 * CHUNK + j], tmp[7 * CHUNK + j]
        J[6 * STRIDE + j], J[6 * STRIDE + CHUNK + j] = a, 0.0
        J[7 * STRIDE + j], J[7 * STRIDE + CHUNK + j] = 0.0, b
        J[8 * STRIDE + j], J[8 * STRIDE + CHUNK + j] = 1.0, 0.0
        J[9 * STRIDE + j], J[9 * STRIDE + CHUNK + j] = 0.0, 1.0
        J[10 * STRIDE + j], J[10 * STRIDE + CHUNK + j] = b, 0.0
    for k in range(LENS, LENS + count):
        row = J[k * STRIDE : (k + 1) * STRIDE]
        for j in range(full):
            a, b = row[j], row[CHUNK + j]
            row[j] = fx * a + sk * b
            row[CHUNK + j] = fy * b
    y0, y1 = y[0, first : first + m], y[1, first : first + m]
    for j in range(m):
        a, b = tmp[6 * CHUNK + j], tmp[7 * CHUNK + j]
        J[LAST * STRIDE + j] = fx * a + sk * b + cx - y0[j]
        J[LAST * STRIDE + CHUNK + j] = fy * b + cy - y1[j]
    for j in range(m, full):  # what does not vanish with x: the columns of cx and cy, and the residual
        J[8 * STRIDE + j], J[9 * STRIDE + CHUNK + j] = 0.0, 0.0
        J[LAST * STRIDE + j], J[LAST * STRIDE + CHUNK + j] = 0.0, 0.0


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def weigh_chunk(first, m, rows, whitening, loss, scale, J):
    """Multiply the rows of a chunk by their whitening and by √w of the loss; return Σρ."""
    if whitening.shape[1] > 0:
        for i in rows:
            at = i * STRIDE
            for j in range(m):
                a, b = J[at + j], J[at + CHUNK + j]
                J[at + j] = whitening[0, first + j] * a + whitening[1, first + j] * b
                J[at + CHUNK + j] = whitening[2, first + j] * a + whitening[3, first + j] * b
    total = 0.0
    if loss == 0:
        for j in range(m):
            total += J[LAST * STRIDE + j] ** 2 + J[LAST * STRIDE + CHUNK + j] ** 2
        return total
    for j in range(m):
        e = J[LAST * STRIDE + j] ** 2 + J[LAST * STRIDE + CHUNK + j] ** 2
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
        for i in rows:
            J[i * STRIDE + j] *= w
            J[i * STRIDE + CHUNK + j] *= w
    return total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def add_products(rows, full, J, A):
    """Add JᵀJ of the rows listed (a multiple of four) to the lower triangle of A, by tiles of 4 × 4."""
    for i in range(0, len(rows), 4):
        x0, x1, x2, x3 = J[rows[i]], J[rows[i + 1]], J[rows[i + 2]], J[rows[i + 3]]
        for k in range(0, i + 4, 4):
            y0, y1, y2, y3 = J[rows[k]], J[rows[k + 1]], J[rows[k + 2]], J[rows[k + 3]]
            s00, s01, s02, s03, s10, s11, s12, s13 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            s20, s21, s22, s23, s30, s31, s32, s33 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for j in range(full):
                a0, a1, a2, a3, b0, b1, b2, b3 = x0[j], x1[j], x2[j], x3[j], y0[j], y1[j], y2[j], y3[j]
                h = CHUNK + j
                c0, c1, c2, c3, d0, d1, d2, d3 = x0[h], x1[h], x2[h], x3[h], y0[h], y1[h], y2[h], y3[h]
                s00, s01 = s00 + a0 * b0 + c0 * d0, s01 + a0 * b1 + c0 * d1
                s02, s03 = s02 + a0 * b2 + c0 * d2, s03 + a0 * b3 + c0 * d3
                s10, s11 = s10 + a1 * b0 + c1 * d0, s11 + a1 * b1 + c1 * d1
                s12, s13 = s12 + a1 * b2 + c1 * d2, s13 + a1 * b3 + c1 * d3
                s20, s21 = s20 + a2 * b0 + c2 * d0, s21 + a2 * b1 + c2 * d1
                s22, s23 = s22 + a2 * b2 + c2 * d2, s23 + a2 * b3 + c2 * d3
                s30, s31 = s30 + a3 * b0 + c3 * d0, s31 + a3 * b1 + c3 * d1
                s32, s33 = s32 + a3 * b2 + c3 * d2, s33 + a3 * b3 + c3 * d3
            tile = ((s00, s01, s02, s03), (s10, s11, s12, s13), (s20, s21, s22, s23), (s30, s31, s32, s33))
            for a in range(4):
                for b in range(4):
                    A[i + a, k + b] += tile[a][b]


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def add_block(A, n, T, camera, view, to, factor, rig, C, P, U, b, V, b_v, W):
    """Add a block's A = JᵀJ, by its own pose and θ, to the normal equations of views and rig, and to C, those of θ.

    T (6, 12) takes (ω_v, δt_v, ω_c, δt_c) to the block's pose. Only the lower triangle of A is filled. `to` and
    `factor` are those of the columns of θ in use, `rig` the first free unknown of the rig, or −1.
    """
    last, columns = n - 1, n - 7
    for i in range(columns + 1):
        for j in range(i + 1):
            C[i, j] += A[6 + i, 6 + j]
    for i in range(6):
        for j in range(i):
            A[j, i] = A[i, j]
    if camera == 0:  # whose own pose is the view's: T = I
        for i in range(n):
            for j in range(6):
                P[i, j] = A[i, j]
        for i in range(6):
            for j in range(6):
                V[view, i, j] += A[i, j]
    else:
        for i in range(n):  # P = A[:, pose] T
            for j in range(12):
                P[i, j] = 0.0
            for k in range(6):
                for j in range(12):
                    P[i, j] += A[i, k] * T[k, j]
        for k in range(6):
            for i in range(6):
                for j in range(6):
                    V[view, i, j] += T[k, i] * P[k, j]
    for k in range(6):
        b_v[view, k] += P[last, k]
    for i in range(columns):
        for j in range(6):
            W[view, to[i], j] += factor[i] * P[6 + i, j]
    if rig < 0:
        return
    for k in range(6):
        for i in range(6):
            for j in range(6):
                W[view, rig + i, j] += T[k, 6 + i] * P[k, j]
                U[rig + i, rig + j] += T[k, 6 + i] * P[k, 6 + j]
        for i in range(columns):
            product = factor[i] * P[6 + i, 6 + k]
            U[rig + k, to[i]] += product
            U[to[i], rig + k] += product
        b[rig + k] += P[last, 6 + k]


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations_kernel(
    X, y, offsets, cameras, views, whitening, loss, scale, theta, R_rig, t_rig, R_views, t_views, lenses, unusual,
    column_lists, column_counts, to, factor, rigs, U, b, V, b_v, W, residuals, tmp, J,
):  # fmt: skip
    """Fill U, b, V, b_v, W and the residuals at a state; return F, infinite if a point is behind its camera.

    J is (J_ROWS, STRIDE). `lenses` are numbers of coefficients; `to` and `factor` (C, columns) belong to the columns of
    each camera. `unusual` is None, or says which cameras are tilted or a fisheye; `loss` is None if there are neither
    weights nor a robust loss. Where these are None the branches are not even compiled: that saves a second at the first
    call.
    """
    U[:], b[:], V[:], b_v[:], W[:] = 0.0, 0.0, 0.0, 0.0, 0.0
    A, P, T = np.empty((A_SIZE, A_SIZE)), np.empty((A_SIZE, 12)), np.zeros((6, 12))
    C = np.zeros((len(theta), A_SIZE, A_SIZE))
    R, t, Rt = np.empty((3, 3)), np.empty(3), np.empty(3)
    flat = J.reshape(J_ROWS * STRIDE)
    rows = np.empty(A_SIZE, np.int64)
    cost = 0.0
    for block in range(len(cameras)):
        c, v = cameras[block], views[block]
        for i in range(3):
            Rt[i] = R_rig[c, i, 0] * t_views[v, 0] + R_rig[c, i, 1] * t_views[v, 1] + R_rig[c, i, 2] * t_views[v, 2]
            t[i] = Rt[i] + t_rig[c, i]
            for j in range(3):
                R[i, j] = (
                    R_rig[c, i, 0] * R_views[v, 0, j]
                    + R_rig[c, i, 1] * R_views[v, 1, j]
                    + R_rig[c, i, 2] * R_views[v, 2, j]
                )
        for i in range(3):  # T = [[R_c, 0, I, 0], [0, R_c, −[R_c t_v]ₓ, I]]
            for j in range(3):
                T[i, j] = T[3 + i, 3 + j] = R_rig[c, i, j]
            T[i, 6 + i] = T[3 + i, 9 + i] = 1.0
            T[3 + (i + 1) % 3, 6 + (i + 2) % 3], T[3 + (i + 2) % 3, 6 + (i + 1) % 3] = Rt[i], -Rt[i]
        columns, lens = column_counts[c], lenses[c]
        n = 7 + columns
        tiles = (n + 3) // 4 * 4
        for i in range(tiles):  # rows that only fill up a tile repeat the residual; nobody reads their products
            rows[i] = i if i < 6 else 6 + column_lists[c, i - 6] if i < n - 1 else LAST
        A[:tiles, :tiles] = 0.0
        for first in range(offsets[block], offsets[block + 1], CHUNK):
            m = min(CHUNK, offsets[block + 1] - first)
            full = (m + 7) // 8 * 8
            if not into_camera(X, first, m, full, R, t, tmp) > 0:
                return np.inf
            if unusual is None:
                brown_chunk(full, theta[c], lens, tmp, flat)
            elif unusual[c] == FISHEYE:
                fisheye_chunk(full, theta[c], tmp, flat)
            else:
                brown_chunk(full, theta[c], lens, tmp, flat)
                if unusual[c] == TILTED:
                    tilt_chunk(full, theta[c], tmp, flat)
            pixel_chunk(y, first, m, full, theta[c], lens, tmp, flat)
            for j in range(m):
                residuals[first + j, 0] = J[LAST, j]
                residuals[first + j, 1] = J[LAST, CHUNK + j]
            if loss is not None:
                cost += weigh_chunk(first, m, rows[:n], whitening, loss, scale, flat)
            else:
                for j in range(m):
                    cost += J[LAST, j] ** 2 + J[LAST, CHUNK + j] ** 2
            add_products(rows[:tiles], full, J, A)
        rig = rigs[c] if c > 0 else -1
        add_block(A, n, T, c, v, to[c], factor[c], rig, C[c], P, U, b, V, b_v, W)
    for c in range(len(theta)):
        columns = column_counts[c]
        for i in range(columns):
            b[to[c, i]] += factor[c, i] * C[c, columns, i]
            for j in range(columns):
                product = C[c, i, j] if j <= i else C[c, j, i]
                U[to[c, i], to[c, j]] += factor[c, i] * factor[c, j] * product
    return cost if np.isfinite(cost) else np.inf
