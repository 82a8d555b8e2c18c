# mypy: allow-untyped-defs
"""Kernels of :mod:`stereocal.board.subpixel`: the fit of the blurred saddle, one corner after the other."""

from __future__ import annotations

import numpy as np
from numba import njit

_FAST = {"reassoc", "contract", "nsz", "arcp"}

# A kernel that only other kernels call needs no entrance for Python, which would take as long to compile again.
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST, **INNER)
def _gauss(z, m, out):
    """exp(-z^2): Taylor's polynomial of z^2/64, raised to the 64th power by six squarings (to 2e-9; z is cut at 6)."""
    for i in range(m):
        x = z[i] * z[i]
        t = (x if x < 36.0 else 36.0) * (1.0 / 64.0)
        p = 1.0 - t * (1.0 - t * (0.5 - t * (1.0 / 6.0 - t * (1.0 / 24.0 - t * (1.0 / 120.0 - t * (1.0 / 720.0))))))
        p *= p
        p *= p
        p *= p
        p *= p
        p *= p
        out[i] = p * p


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST, **INNER)
def _erf(z, gauss, m, out):
    """erf(z), given exp(-z^2): Abramowitz and Stegun 7.1.26, to 1.5e-7."""
    for i in range(m):
        x = abs(z[i])
        t = 1.0 / (1.0 + 0.3275911 * x)
        value = 1.0 - gauss[i] * t * (
            0.254829592 + t * (-0.284496736 + t * (1.421413741 + t * (-1.453152027 + t * 1.061405429)))
        )
        out[i] = value if z[i] >= 0 else -value


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _gather(image, cx, cy, step, geometry, half, band, light, sparse, px, py, grey):
    """Pixels of the window that tell of the edges; returns how many.

    The window is the parallelogram |xi|, |eta| <= half steps around the corner; of it the pixels within `band` pixels
    of one of the two lines: the others see flat squares. The change of the light over the window is taken out: with
    light = (a, its slopes along xi and eta, those of b over b), grey becomes a + (grey - a(xi, eta)) b / b(xi, eta).
    With sparse = 2 only every second pixel is taken, as the white squares of a chessboard; with 4 every fourth.
    """
    height, width = image.shape
    reach_x = half * (abs(step[0]) + abs(step[2]))
    reach_y = half * (abs(step[1]) + abs(step[3]))
    x0, x1 = max(0, int(np.ceil(cx - reach_x))), min(width - 1, int(np.floor(cx + reach_x)))
    y0, y1 = max(0, int(np.ceil(cy - reach_y))), min(height - 1, int(np.floor(cy + reach_y)))
    length1 = np.sqrt(step[0] * step[0] + step[1] * step[1])
    length2 = np.sqrt(step[2] * step[2] + step[3] * step[3])
    area = abs(step[0] * step[3] - step[1] * step[2])
    # the distance of a pixel from line 1 is |eta| * area / length1
    near1, near2 = band * length1 / area, band * length2 / area
    count = 0
    for y in range(y0, y1 + 1):
        dy = y - cy
        row = image[y]
        for x in range(x0, x1 + 1):
            if (sparse == 2 and (x + y) & 1) or (sparse == 4 and (x & 1 or y & 1)):
                continue
            dx = x - cx
            xi = geometry[0] * dx + geometry[1] * dy
            eta = geometry[2] * dx + geometry[3] * dy
            if abs(xi) <= half and abs(eta) <= half and (abs(eta) <= near1 or abs(xi) <= near2):
                level = light[0] + light[1] * xi + light[2] * eta
                px[count], py[count] = dx, dy
                grey[count] = light[0] + (row[x] - level) / (1.0 + light[3] * xi + light[4] * eta)
                count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _keep_explained(m, px, py, grey, residual, limit):
    """Move the pixels whose residual is at most `limit` to the front; returns how many."""
    count = 0
    for i in range(m):
        if abs(residual[i]) <= limit:
            px[count], py[count], grey[count] = px[i], py[i], grey[i]
            count += 1
    return count


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST, **INNER)
def _dot(a, b, m):
    total = 0.0
    for i in range(m):
        total += a[i] * b[i]
    return total


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST, **INNER)
def _model(m, px, py, grey, geometry, theta, scratch, J, residual):
    """Residuals grey - model, and the model's derivatives by the seven unknowns; returns the sum of squares.

    theta = (cx, cy, angle of line 1, angle of line 2, s, a, b). J is in the basis (offset of line 1, its turn,
    offset of line 2, its turn, s, a, b), which is one product a pixel cheaper; the caller turns offsets into (cx, cy).
    Every loop writes one array, so that LLVM vectorises it.
    """
    cx, cy, s, a, b = theta[0], theta[1], theta[4], theta[5], theta[6]
    c1, s1, c2, s2 = np.cos(theta[2]), np.sin(theta[2]), np.cos(theta[3]), np.sin(theta[3])
    # xi, eta = the inverse of the steps applied to the pixel; bends of the two lines, half the second difference
    xi_x, xi_y, eta_x, eta_y = geometry[0], geometry[1], geometry[2], geometry[3]
    bend1, bend2 = 0.5 * geometry[4], 0.5 * geometry[5]
    inverse = 1.0 / s
    slope = b * 2.0 / np.sqrt(np.pi) * inverse
    zu, zv, gu, gv, eu, ev = scratch[0], scratch[1], scratch[2], scratch[3], scratch[4], scratch[5]
    j0, j1, j2, j3, j4, j6 = J[0], J[1], J[2], J[3], J[4], J[6]
    for i in range(m):
        dx, dy = px[i] - cx, py[i] - cy
        xi = xi_x * dx + xi_y * dy
        zu[i] = (c1 * dy - s1 * dx - bend1 * xi * xi) * inverse
    for i in range(m):
        dx, dy = px[i] - cx, py[i] - cy
        eta = eta_x * dx + eta_y * dy
        zv[i] = (c2 * dy - s2 * dx - bend2 * eta * eta) * inverse
    _gauss(zu, m, gu)
    _gauss(zv, m, gv)
    _erf(zu, gu, m, eu)
    _erf(zv, gv, m, ev)
    for i in range(m):
        j0[i] = slope * gu[i] * ev[i]
    for i in range(m):
        j1[i] = -j0[i] * (c1 * (px[i] - cx) + s1 * (py[i] - cy))
    for i in range(m):
        j2[i] = slope * gv[i] * eu[i]
    for i in range(m):
        j3[i] = -j2[i] * (c2 * (px[i] - cx) + s2 * (py[i] - cy))
    for i in range(m):
        j4[i] = -(j0[i] * zu[i] + j2[i] * zv[i])
    for i in range(m):
        j6[i] = eu[i] * ev[i]
    for i in range(m):
        residual[i] = grey[i] - a - b * j6[i]
    return _dot(residual, residual, m)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=_FAST, **INNER)
def _four_dots(a, b0, b1, b2, b3, m):
    """Four dot products in one pass: four sums that do not wait for each other."""
    t0, t1, t2, t3 = 0.0, 0.0, 0.0, 0.0
    for i in range(m):
        x = a[i]
        t0 += x * b0[i]
        t1 += x * b1[i]
        t2 += x * b2[i]
        t3 += x * b3[i]
    return t0, t1, t2, t3


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _normal_equations(m, J, residual, N, g):
    """N = J^T J and g = J^T residual."""
    for p in range(7):
        N[p, 0], N[p, 1], N[p, 2], N[p, 3] = _four_dots(J[p], J[0], J[1], J[2], J[3], m)
        if p >= 4:
            N[p, 4], N[p, 5], N[p, 6], g[p] = _four_dots(J[p], J[4], J[5], J[6], residual, m)
    g[0], g[1], g[2], g[3] = _four_dots(residual, J[0], J[1], J[2], J[3], m)
    for p in range(7):
        for q in range(p):
            N[q, p] = N[p, q]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
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


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
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


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _start(m, px, py, grey, geometry, theta, scratch, J, residual):
    """Levels a, b by linear least squares at the given lines and blur."""
    theta[5], theta[6] = 0.0, 1.0
    _model(m, px, py, grey, geometry, theta, scratch, J, residual)
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


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _propose(theta, N, g, damping, A, L, x, trial):
    """The damped step from theta to trial; returns how far the corner moves, -1 where N is not positive definite."""
    for p in range(7):
        for q in range(7):
            A[p, q] = N[p, q]
        A[p, p] += damping * N[p, p] + 1e-12
    if not _cholesky(A, L):
        return -1.0
    _solve(L, g, x)
    # u = n1.(p - c): an offset of line 1 by x0 is n1.dc = -x0; both offsets together move the corner
    c1, s1, c2, s2 = np.cos(theta[2]), np.sin(theta[2]), np.cos(theta[3]), np.sin(theta[3])
    d = -s1 * c2 + c1 * s2
    trial[0] = theta[0] + (-x[0] * c2 + x[2] * c1) / d
    trial[1] = theta[1] + (x[2] * s1 - x[0] * s2) / d
    trial[2], trial[3] = theta[2] + x[1], theta[3] + x[3]
    trial[4], trial[5], trial[6] = theta[4] + x[4], theta[5] + x[5], theta[6] + x[6]
    # no edge is sharper than the pixel, whose own width makes s = sqrt(2 / 12) = 0.41
    trial[4] = min(max(trial[4], 0.5 * theta[4], 0.35), 2 * theta[4])
    return np.sqrt((trial[0] - theta[0]) ** 2 + (trial[1] - theta[1]) ** 2)


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _descend(m, px, py, grey, geometry, theta, damping, tolerance, iterations, work):
    """Levenberg-Marquardt from theta, in place, to a corner that moves less than `tolerance`.

    Returns the sum of squares and whether it converged; N is left as at the end, for the covariance.
    """
    scratch, J, residual, trial_J, trial_residual, N, A, L, g, x, trial = work
    cost, converged = _model(m, px, py, grey, geometry, theta, scratch, J, residual), 0.0
    for _ in range(iterations):
        _normal_equations(m, J, residual, N, g)
        if theta[4] <= 0.35 and g[4] < 0:
            # the sharpest edge there is, and the picture asks for a sharper one: the others are fitted with it held
            for p in range(7):
                N[4, p] = N[p, 4] = 0.0
            N[4, 4], g[4] = 1.0, 0.0
        moved, accepted, proposed = 0.0, False, 1e30
        for _ in range(8):
            shift = _propose(theta, N, g, damping, A, L, x, trial)
            if shift >= 0:
                proposed = min(proposed, shift)
                trial_cost = _model(m, px, py, grey, geometry, trial, scratch, trial_J, trial_residual)
                if trial_cost <= cost * (1 + 1e-12):
                    accepted, cost = True, trial_cost
                    moved = max(shift, 0.1 * abs(trial[4] - theta[4]))
                    for p in range(7):
                        theta[p] = trial[p]
                    J, trial_J = trial_J, J
                    residual, trial_residual = trial_residual, residual
                    damping = max(damping * 0.1, 1e-9)
                    break
            damping *= 10
        if not accepted:
            # no step lowers the sum: the optimum, to rounding, if the steps have become small
            converged = 1.0 if proposed < 1e-2 else 0.0
            break
        converged = 1.0 if moved < max(tolerance, 2e-2) else 0.0
        if moved < tolerance:
            break
    _normal_equations(m, J, residual, N, g)
    return cost, converged


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _corner_covariance(theta, variance, work, covariance):
    """Of (cx, cy), from the columns of N's inverse for the two offsets; left alone where N is not positive definite."""
    N, L, g, x = work[5], work[7], work[8], work[9]
    if not _cholesky(N, L):
        return
    for p in range(7):
        g[p] = 0.0
    g[0] = 1.0
    _solve(L, g, x)
    q00, q02 = x[0] * variance, x[2] * variance
    g[0], g[2] = 0.0, 1.0
    _solve(L, g, x)
    q22 = x[2] * variance
    c1, s1, c2, s2 = np.cos(theta[2]), np.sin(theta[2]), np.cos(theta[3]), np.sin(theta[3])
    d = -s1 * c2 + c1 * s2
    ax, bx, ay, by = -c2 / d, c1 / d, -s2 / d, s1 / d
    covariance[0, 0] = ax * ax * q00 + 2 * ax * bx * q02 + bx * bx * q22
    covariance[1, 1] = ay * ay * q00 + 2 * ay * by * q02 + by * by * q22
    covariance[0, 1] = ax * ay * q00 + (ax * by + ay * bx) * q02 + bx * by * q22
    covariance[1, 0] = covariance[0, 1]


@njit(cache=True, nogil=True, error_model="numpy", **INNER)
def _most_pixels(steps, half):
    """How many pixels the largest window can hold."""
    most = 4
    for n in range(half.size):
        wide = 2 * half[n] * (abs(steps[n, 0]) + abs(steps[n, 2])) + 2
        high = 2 * half[n] * (abs(steps[n, 1]) + abs(steps[n, 3])) + 2
        most = max(most, int(wide * high) + 8)
    return most


@njit(cache=True, nogil=True, error_model="numpy")
def fit_saddles(
    image,
    corners,
    steps,
    bends,
    half,
    band,
    light,
    blur,
    cold,
    tolerance,
    iterations,
    limit,
    sparse,
    theta,
    covariance,
    info,
):
    """Fit I = a + b erf(u/s) erf(v/s) around each corner by Levenberg-Marquardt.

    corners (n, 2); steps (n, 4): the steps along i and along j; bends (n, 2): how far each line bends away from its
    tangent, second difference times normal; half, band (n,): half window in steps, half width of the bands along the
    lines in pixels; light (n, 5): see _gather; blur (n,): start of s, if `cold`; else lines, s and levels start from
    theta. limit (n,): where positive, the corner starts from theta too, and pixels whose residual at the start is
    larger are left out; sparse (n,): of so many pixels one is taken, 1, 2 or 4. Writes theta (n, 7), covariance
    (n, 2, 2) of (cx, cy), info (n, 4): residual variance, pixels, converged, 0.
    """
    capacity = _most_pixels(steps, half)
    px, py, grey = np.empty(capacity), np.empty(capacity), np.empty(capacity)
    scratch, J, trial_J = np.empty((6, capacity)), np.empty((7, capacity)), np.empty((7, capacity))
    for i in range(capacity):
        J[5, i] = trial_J[5, i] = 1.0
    residual, trial_residual = np.empty(capacity), np.empty(capacity)
    N, A, L = np.empty((7, 7)), np.empty((7, 7)), np.empty((7, 7))
    g, x, trial, geometry = np.empty(7), np.empty(7), np.empty(7), np.empty(6)
    work = (scratch, J, residual, trial_J, trial_residual, N, A, L, g, x, trial)
    for n in range(corners.shape[0]):
        t = theta[n]
        for k in range(4):
            info[n, k] = 0.0
            covariance[n, k >> 1, k & 1] = np.nan
        ix, iy, jx, jy = steps[n, 0], steps[n, 1], steps[n, 2], steps[n, 3]
        det = ix * jy - iy * jx
        geometry[0], geometry[1], geometry[2], geometry[3] = jy / det, -jx / det, -iy / det, ix / det
        geometry[4], geometry[5] = bends[n, 0], bends[n, 1]
        cx, cy = corners[n, 0], corners[n, 1]
        m = _gather(image, cx, cy, steps[n], geometry, half[n], band[n], light[n], sparse[n], px, py, grey)
        from_theta = not cold and limit[n] > 0
        if from_theta and m >= 16:
            t[0], t[1] = t[0] - cx, t[1] - cy
            _model(m, px, py, grey, geometry, t, scratch, J, residual)
            m = _keep_explained(m, px, py, grey, residual, limit[n])
        info[n, 1] = m
        if m < 16:
            for p in range(7):
                t[p] = np.nan
            continue
        if not from_theta:
            t[0] = t[1] = 0.0
        if cold:
            t[2], t[3], t[4] = np.arctan2(iy, ix), np.arctan2(jy, jx), blur[n]
            _start(m, px, py, grey, geometry, t, scratch, J, residual)
        damping = 1e-3 if cold else 1e-5
        cost, converged = _descend(m, px, py, grey, geometry, t, damping, tolerance, iterations, work)
        variance = cost / max(m - 7, 1)
        info[n, 0], info[n, 2] = variance, converged
        _corner_covariance(t, variance, work, covariance[n])
        t[0], t[1] = t[0] + cx, t[1] + cy
