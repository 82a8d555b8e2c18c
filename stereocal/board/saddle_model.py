"""The readable twin of :mod:`stereocal.board.subpixel_kernels`: one blurred saddle, fitted by Gauss and Newton with
care.

    I(p) = a + b erf(u / s) erf(v / s),     u = n1 . (p - c) - d1 xi^2 / 2,     v = n2 . (p - c) - d2 eta^2 / 2

with n = (-sin t, cos t) the normal of a line of angle t, (xi, eta) the pixel in grid steps from the corner, and d1,
d2 the bends of the lines (:mod:`stereocal.board.subpixel`). With g(z) = 2/sqrt(pi) exp(-z^2), the derivative of erf,
and

    Pu = b g(u/s) erf(v/s) / s = dI/du,        Pv = b erf(u/s) g(v/s) / s = dI/dv,

the derivatives by the unknowns (cx, cy, t1, t2, s, a, b) are

    dI/dc = -Pu n1 - Pv n2,  dI/dt1 = -Pu (e1 . (p - c)),  dI/dt2 = -Pv (e2 . (p - c)),  dI/ds = -(Pu u + Pv v) / s,
    dI/da = 1,               dI/db = erf(u/s) erf(v/s),

e = (cos t, sin t) along the line. The bend moves with c too, by less than a thousandth of the line itself: that is
left out, as it only changes the way to the solution.
"""

from __future__ import annotations

import numpy as np
from scipy.special import erf

from stereocal.base.checks import Float


def saddle_image(theta: Float, pixels: Float, steps: Float, bends: Float) -> tuple[Float, Float]:
    """Blurred saddle a + b erf(u/s) erf(v/s) and its derivatives.

    Parameters
    ----------
    theta : ndarray of shape (7,)
        cx, cy, angle of line 1, angle of line 2 (radians), s, a, b.
    pixels : ndarray of shape (m, 2)
        x, y.
    steps : ndarray of shape (4,)
        Grid steps along line 1 and along line 2, px.
    bends : ndarray of shape (2,)
        d1, d2, px.

    Returns
    -------
    values : ndarray of shape (m,)
    jacobian : ndarray of shape (m, 7)
    """
    c, (t1, t2), (s, a, b) = theta[:2], theta[2:4], theta[4:]
    d = pixels - c
    xi, eta = np.linalg.solve(steps.reshape(2, 2).T, d.T)
    n1, n2 = np.array([-np.sin(t1), np.cos(t1)]), np.array([-np.sin(t2), np.cos(t2)])
    e1, e2 = np.array([np.cos(t1), np.sin(t1)]), np.array([np.cos(t2), np.sin(t2)])
    u, v = d @ n1 - bends[0] * xi**2 / 2, d @ n2 - bends[1] * eta**2 / 2
    Eu, Ev = erf(u / s), erf(v / s)
    slope = 2 / np.sqrt(np.pi) * b / s
    Pu, Pv = slope * np.exp(-((u / s) ** 2)) * Ev, slope * np.exp(-((v / s) ** 2)) * Eu
    by_center = -Pu[:, None] * n1 - Pv[:, None] * n2
    others = [-Pu * (d @ e1), -Pv * (d @ e2), -(Pu * u + Pv * v) / s, np.ones(len(d)), Eu * Ev]
    return a + b * Eu * Ev, np.column_stack([by_center, *others])


def fit_saddle(
    image: Float, corner: Float, steps: Float, bends: Float, half: float, band: float, blur: float, iterations: int = 50
) -> tuple[Float, Float]:
    """Least-squares fit of one blurred saddle by Levenberg-Marquardt, and the covariance of its unknowns.

    Parameters
    ----------
    image : ndarray of shape (H, W)
        Grey values.
    corner : ndarray of shape (2,)
        Where to start, and the middle of the window.
    steps, bends
        As in :func:`saddle_image`.
    half : float
        The window is \\|xi\\|, \\|eta\\| <= half.
    band : float
        Of it, the pixels within this many pixels of one of the two lines.
    blur : float
        Start of s, px.
    iterations : int
        At most.

    Returns
    -------
    theta : ndarray of shape (7,)
    covariance : ndarray of shape (7, 7)
        (J^T J)^-1 sigma^2 with sigma^2 the residuals' sum of squares over (m - 7).
    """
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    pixels = np.column_stack([x.ravel(), y.ravel()]).astype(np.float64)
    xi, eta = np.linalg.solve(steps.reshape(2, 2).T, (pixels - corner).T)
    area = abs(steps[0] * steps[3] - steps[1] * steps[2])
    from_line1 = np.abs(eta) * area / np.hypot(steps[0], steps[1])
    from_line2 = np.abs(xi) * area / np.hypot(steps[2], steps[3])
    inside = (np.abs(xi) <= half) & (np.abs(eta) <= half) & ((from_line1 <= band) | (from_line2 <= band))
    pixels, grey = pixels[inside], image.ravel()[inside].astype(np.float64)

    theta = np.array([*corner, np.arctan2(steps[1], steps[0]), np.arctan2(steps[3], steps[2]), blur, 0.0, 1.0])
    shape, _ = saddle_image(theta, pixels, steps, bends)
    theta[5:] = np.linalg.lstsq(np.column_stack([np.ones(len(shape)), shape]), grey, rcond=None)[0]
    damping = 1e-3
    values, J = saddle_image(theta, pixels, steps, bends)
    for _ in range(iterations):
        N, g = J.T @ J, J.T @ (grey - values)
        step = np.linalg.solve(N + damping * np.diag(np.diag(N)), g)
        trial = theta + step
        new_values, new_J = saddle_image(trial, pixels, steps, bends)
        if trial[4] > 0 and np.sum((grey - new_values) ** 2) <= np.sum((grey - values) ** 2):
            theta, values, J, damping = trial, new_values, new_J, max(damping / 10, 1e-9)
            if np.abs(step[:2]).max() < 1e-7:
                break
        else:
            damping *= 10
    variance = np.sum((grey - values) ** 2) / (len(grey) - 7)
    return theta, variance * np.linalg.inv(J.T @ J)
