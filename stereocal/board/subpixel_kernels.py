"""Kernels of :mod:`stereocal.board.subpixel`: the fit of the blurred saddle, one corner after the other."""

from __future__ import annotations

import numpy as np
from numba import njit

_FAST = {"reassoc", "contract", "nsz", "arcp"}


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _gauss(x):
    """exp(-x) for x >= 0: Taylor's polynomial of x/64, raised to the 64th power by six squarings (to 2e-9)."""
    t = min(x, 60.0) * (1.0 / 64.0)
    p = 1.0 - t * (1.0 - t * (0.5 - t * (1.0 / 6.0 - t * (1.0 / 24.0 - t * (1.0 / 120.0 - t * (1.0 / 720.0))))))
    p *= p
    p *= p
    p *= p
    p *= p
    p *= p
    return p * p


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _erf(z, gauss):
    """erf(z), given gauss = exp(-z^2): Abramowitz and Stegun 7.1.26, to 1.5e-7."""
    x = abs(z)
    t = 1.0 / (1.0 + 0.3275911 * x)
    value = 1.0 - gauss * t * (
        0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429)))
    )
    return value if z >= 0 else -value


@njit(cache=True, nogil=True, error_model="numpy")
def _gather(image, cx, cy, step, half, px, py, grey):
    """Pixels of the parallelogram |xi|, |eta| <= half steps around the corner; returns how many."""
    height, width = image.shape
    ix, iy, jx, jy = step[0], step[1], step[2], step[3]
    det = ix * jy - iy * jx
    reach_x = half * (abs(ix) + abs(jx))
    reach_y = half * (abs(iy) + abs(jy))
    x0, x1 = max(0, int(np.ceil(cx - reach_x))), min(width - 1, int(np.floor(cx + reach_x)))
    y0, y1 = max(0, int(np.ceil(cy - reach_y))), min(height - 1, int(np.floor(cy + reach_y)))
    count = 0
    for y in range(y0, y1 + 1):
        dy = y - cy
        for x in range(x0, x1 + 1):
            dx = x - cx
            if abs(dx * jy - dy * jx) <= half * abs(det) and abs(ix * dy - iy * dx) <= half * abs(det):
                if count == px.size:
                    return count
                px[count], py[count], grey[count] = dx, dy, image[y, x]
                count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _model(m, px, py, grey, geometry, theta, J, residual):
    """Residuals grey - model, and the model's derivatives by the seven unknowns; returns the sum of squares.

    theta = (cx, cy, angle of line 1, angle of line 2, s, a, b). J is in the basis (offset of line 1, its turn, offset of
    line 2, its turn, s, a, b), which has one product a pixel less; the caller turns offsets into (cx, cy).
    """
    cx, cy, s, a, b = theta[0], theta[1], theta[4], theta[5], theta[6]
    c1, s1, c2, s2 = np.cos(theta[2]), np.sin(theta[2]), np.cos(theta[3]), np.sin(theta[3])
    # xi, eta = the inverse of the steps applied to the pixel; bends of the two lines, half the second difference
    xi_x, xi_y, eta_x, eta_y = geometry[0], geometry[1], geometry[2], geometry[3]
    bend1, bend2 = 0.5 * geometry[4], 0.5 * geometry[5]
    inverse = 1.0 / s
    slope = 2.0 / np.sqrt(np.pi) * inverse
    j0, j1, j2, j3, j4, j6 = J[0], J[1], J[2], J[3], J[4], J[6]
    for i in range(m):
        dx, dy = px[i] - cx, py[i] - cy
        xi, eta = xi_x * dx + xi_y * dy, eta_x * dx + eta_y * dy
        u = (-s1 * dx + c1 * dy) - bend1 * xi * xi
        v = (-s2 * dx + c2 * dy) - bend2 * eta * eta
        zu, zv = u * inverse, v * inverse
        gu, gv = _gauss(zu * zu), _gauss(zv * zv)
        eu, ev = _erf(zu, gu), _erf(zv, gv)
        pu, pv = b * slope * gu * ev, b * slope * gv * eu
        j0[i] = pu
        j1[i] = -pu * (c1 * dx + s1 * dy)
        j2[i] = pv
        j3[i] = -pv * (c2 * dx + s2 * dy)
        j4[i] = -(pu * zu + pv * zv)
        j6[i] = eu * ev
        residual[i] = grey[i] - a - b * (eu * ev)
    total = 0.0
    for i in range(m):
        total += residual[i] * residual[i]
    return total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST)
def _dot(a, b, m):
    total = 0.0
    for i in range(m):
        total += a[i] * b[i]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _normal_equations(m, J, residual, N, g):
    for p in range(7):
        for q in range(p + 1):
            N[p, q] = _dot(J[p], J[q], m)
            N[q, p] = N[p, q]
        g[p] = _dot(J[p], residual, m)


@njit(cache=True, nogil=True, error_model="numpy")
def _cholesky(A, L):
    """A = L L^T; False if A is not positive definite."""
    n = A.shape[0]
    for i in range(n):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i == j:
                if not total > 1e-14 * abs(A[i, i]):
                    return False
                L[i, i] = np.sqrt(total)
            else:
                L[i, j] = total / L[j, j]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _solve(L, g, x):
    n = g.size
    for i in range(n):
        total = g[i]
        for k in range(i):
            total -= L[i, k] * x[k]
        x[i] = total / L[i, i]
    for i in range(n - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, n):
            total -= L[k, i] * x[k]
        x[i] = total / L[i, i]


@njit(cache=True, nogil=True, error_model="numpy")
def _start(m, px, py, grey, geometry, theta, J, residual):
    """Levels a, b by linear least squares at the given lines and blur."""
    theta[5], theta[6] = 0.0, 1.0
    _model(m, px, py, grey, geometry, theta, J, residual)
    sf, sff, sg, sfg = 0.0, 0.0, 0.0, 0.0
    for i in range(m):
        f = J[6, i]
        sf += f
        sff += f * f
        sg += grey[i]
        sfg += f * grey[i]
    det = m * sff - sf * sf
    theta[6] = (m * sfg - sf * sg) / det
    theta[5] = (sg - theta[6] * sf) / m


@njit(cache=True, nogil=True, error_model="numpy")
def fit_saddles(image, corners, steps, bends, half, blur, tolerance, iterations, theta, covariance, info):
    """Fit I = a + b erf(u/s) erf(v/s) around each corner by Levenberg-Marquardt.

    corners (n, 2); steps (n, 4): the steps along i and along j; bends (n, 2): how far each line bends away from its
    tangent, second difference times normal; half (n,): half window in steps; blur (n,): start of s. Writes theta (n, 7),
    covariance (n, 2, 2) of (cx, cy), info (n, 4): residual variance, pixels, converged, 0.
    """
    capacity = 4
    for n in range(corners.shape[0]):
        wide = 2 * half[n] * (abs(steps[n, 0]) + abs(steps[n, 2])) + 2
        high = 2 * half[n] * (abs(steps[n, 1]) + abs(steps[n, 3])) + 2
        capacity = max(capacity, int(wide * high) + 8)
    px, py, grey = np.empty(capacity), np.empty(capacity), np.empty(capacity)
    residual, trial_residual = np.empty(capacity), np.empty(capacity)
    J, trial_J = np.empty((7, capacity)), np.empty((7, capacity))
    J[5], trial_J[5] = 1.0, 1.0
    N, A, L = np.empty((7, 7)), np.empty((7, 7)), np.zeros((7, 7))
    g, x, trial, geometry = np.empty(7), np.empty(7), np.empty(7), np.empty(6)
    for n in range(corners.shape[0]):
        t = theta[n]
        info[n] = 0.0
        covariance[n] = np.nan
        m = _gather(image, corners[n, 0], corners[n, 1], steps[n], half[n], px, py, grey)
        info[n, 1] = m
        if m < 16:
            t[:] = np.nan
            continue
        ix, iy, jx, jy = steps[n, 0], steps[n, 1], steps[n, 2], steps[n, 3]
        det = ix * jy - iy * jx
        geometry[0], geometry[1], geometry[2], geometry[3] = jy / det, -jx / det, -iy / det, ix / det
        geometry[4], geometry[5] = bends[n, 0], bends[n, 1]
        t[0] = t[1] = 0.0
        t[2], t[3], t[4] = np.arctan2(iy, ix), np.arctan2(jy, jx), blur[n]
        _start(m, px, py, grey, geometry, t, J, residual)
        cost = _model(m, px, py, grey, geometry, t, J, residual)
        damping = 1e-3
        for _ in range(iterations):
            _normal_equations(m, J, residual, N, g)
            moved, accepted = 0.0, False
            for _ in range(8):
                A[:] = N
                for p in range(7):
                    A[p, p] += damping * N[p, p] + 1e-12
                if not _cholesky(A, L):
                    damping *= 10
                    continue
                _solve(L, g, x)
                # u = n1.(p - c): an offset of line 1 by x0 is n1.dc = -x0; both offsets together move the corner
                c1, s1, c2, s2 = np.cos(t[2]), np.sin(t[2]), np.cos(t[3]), np.sin(t[3])
                d = -s1 * c2 + c1 * s2
                trial[0] = t[0] + (-x[0] * c2 + x[2] * c1) / d
                trial[1] = t[1] + (x[2] * s1 - x[0] * s2) / d
                trial[2], trial[3] = t[2] + x[1], t[3] + x[3]
                trial[4], trial[5], trial[6] = t[4] + x[4], t[5] + x[5], t[6] + x[6]
                trial[4] = min(max(trial[4], 0.5 * t[4], 0.2), 2 * t[4])
                trial_cost = _model(m, px, py, grey, geometry, trial, trial_J, trial_residual)
                if trial_cost <= cost * (1 + 1e-12):
                    accepted = True
                    moved = np.sqrt((trial[0] - t[0]) ** 2 + (trial[1] - t[1]) ** 2)
                    moved = max(moved, 0.1 * abs(trial[4] - t[4]))
                    t[:] = trial
                    cost = trial_cost
                    J, trial_J = trial_J, J
                    residual, trial_residual = trial_residual, residual
                    damping = max(damping * 0.1, 1e-9)
                    break
                damping *= 10
            if not accepted:
                break
            if moved < tolerance:
                info[n, 2] = 1.0
                break
        _normal_equations(m, J, residual, N, g)
        variance = cost / max(m - 7, 1)
        info[n, 0] = variance
        if _cholesky(N, L):
            c1, s1, c2, s2 = np.cos(t[2]), np.sin(t[2]), np.cos(t[3]), np.sin(t[3])
            d = -s1 * c2 + c1 * s2
            # columns of N's inverse for the two offsets
            g[:] = 0
            g[0] = 1
            _solve(L, g, x)
            q00, q02 = x[0] * variance, x[2] * variance
            g[0] = 0
            g[2] = 1
            _solve(L, g, x)
            q22 = x[2] * variance
            ax, bx = -c2 / d, c1 / d
            ay, by = -s2 / d, s1 / d
            covariance[n, 0, 0] = ax * ax * q00 + 2 * ax * bx * q02 + bx * bx * q22
            covariance[n, 1, 1] = ay * ay * q00 + 2 * ay * by * q02 + by * by * q22
            covariance[n, 0, 1] = ax * ay * q00 + (ax * by + ay * bx) * q02 + bx * by * q22
            covariance[n, 1, 0] = covariance[n, 0, 1]
        t[0] += corners[n, 0]
        t[1] += corners[n, 1]
