"""Undoing a map of the plane where it can be undone, and nowhere else.

A lens model with polynomial terms bends back on itself: with k1 = −0.3 the radius r(1 + k1 r²) grows to r = 1.05, and
falls again. Beyond, several ideal points share one distorted point, and an iteration that knows nothing of it returns
whichever it happens to meet, a wrong point in silence (``cv2.undistortPoints`` does). So the inverse is defined here
on a *domain*: the largest star-shaped region about the centre on which the map keeps its orientation,

    domain = { x : det ∂f/∂x (t·x) > 0 for all 0 ≤ t ≤ 1 },

and what lies outside of its image has no answer (NaN).

For radial maps, r ↦ g(r), the domain is a disc, r < r_max, with g′(r_max) = 0 its first zero, and the inverse is a
scalar root, bracketed in [0, r_max] and found by Newton steps that fall back on bisection (:func:`invert_radial`).

For general maps (:func:`invert_map`) Newton's method, h = −(∂f/∂x)⁻¹ (f(x) − y), runs on all points at once with
backtracking: a step is halved until the residual shrinks and det ∂f/∂x stays positive. Where that fails, the solution
is followed along the ray, f(x) = s·y for s = 1/16, 2/16, …, 1 (continuation). Each answer is then checked: residual ≤
1e-12, and a positive determinant at 32 stations on the way from the centre.

``distortion_inverse_kernels`` is the compiled twin for OpenCV's family, the fisheye and the rational function.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stereocal.base.checks import Float

MapWithJacobian = Callable[[Float], tuple[Float, Float]]

_TOLERANCE = 1e-12
_MAX_NEWTON = 60
_STATIONS = 32
_CONTINUATION_STEPS = 16


def invert_map(f: MapWithJacobian, y: Float) -> Float:
    """Return x with f(x) = y inside the star-shaped domain of f about the origin; NaN where there is none.

    Parameters
    ----------
    f : callable
        x (N, 2) to f(x) (N, 2) and ∂f/∂x (N, 2, 2).
    y : ndarray of shape (N, 2)
        Points to take back.

    Returns
    -------
    ndarray of shape (N, 2)
    """
    if len(y) == 0:
        return y.copy()
    with np.errstate(all="ignore"):
        x, good = _newton(f, y, y.copy())
        good = _inside_domain(f, x, good)
        hard = np.flatnonzero(~good & np.all(np.isfinite(y), axis=1))
        if len(hard):
            followed = np.zeros((len(hard), 2))
            alive = np.ones(len(hard), dtype=bool)
            for s in np.arange(1, _CONTINUATION_STEPS + 1) / _CONTINUATION_STEPS:
                followed, solved = _newton(f, s * y[hard], followed)
                alive &= solved
            x[hard] = followed
            good[hard] = _inside_domain(f, followed, alive)
    x[~good] = np.nan
    return x


def _newton(f: MapWithJacobian, y: Float, x: Float) -> tuple[Float, np.ndarray]:
    """Damped Newton on every point; return x and which of them solved f(x) = y with det > 0."""
    value, J = f(x)
    determinant = _determinant(J)
    # A start outside of the domain is drawn to the centre, where every lens is nearly ideal.
    for _ in range(8):
        outside = ~(determinant > 0)
        if not outside.any():
            break
        x = np.where(outside[:, None], 0.5 * x, x)
        value, J = f(x)
        determinant = _determinant(J)
    size = np.maximum(1.0, np.hypot(y[:, 0], y[:, 1]))
    error = np.hypot(*(value - y).T)
    active = np.flatnonzero(error > 1e-15 * size)
    for _ in range(_MAX_NEWTON):
        if len(active) == 0:
            break
        r = value[active] - y[active]
        Ja, det = J[active], determinant[active]
        h = -np.stack([Ja[:, 1, 1] * r[:, 0] - Ja[:, 0, 1] * r[:, 1], Ja[:, 0, 0] * r[:, 1] - Ja[:, 1, 0] * r[:, 0]], 1)
        h /= det[:, None]
        pending, accepted = active, np.zeros(0, dtype=int)
        for _ in range(24):
            trial = x[pending] + h
            v, Jt = f(trial)
            d = _determinant(Jt)
            e = np.hypot(*(v - y[pending]).T)
            better = (e < error[pending]) & (d > 0)
            take = pending[better]
            x[take], value[take], J[take], determinant[take] = trial[better], v[better], Jt[better], d[better]
            error[take] = e[better]
            accepted = np.concatenate([accepted, take])
            pending, h = pending[~better], 0.5 * h[~better]
            # Below the tolerance there is nothing left to win but rounding.
            still = error[pending] > _TOLERANCE * size[pending]
            pending, h = pending[still], h[still]
            if len(pending) == 0:
                break
        active = accepted[error[accepted] > 1e-15 * size[accepted]]
    return x, (error <= _TOLERANCE * size) & (determinant > 0)


def _inside_domain(f: MapWithJacobian, x: Float, solved: np.ndarray) -> np.ndarray:
    """Which of the solved x have det ∂f/∂x > 0 at stations all the way from the centre."""
    inside = solved.copy()
    if not inside.any():
        return inside
    # One polar survey settles most points: inside its safe radius no station can fail.
    reach = float(np.max(np.hypot(*x[inside].T)))
    angles = np.arange(64) * (2 * np.pi / 64)
    radii = reach * np.arange(1, 129) / 128
    survey = (radii[:, None, None] * np.stack([np.cos(angles), np.sin(angles)], 1)).reshape(-1, 2)
    positive = (_determinant(f(survey)[1]) > 0).reshape(128, 64).all(axis=1)
    if positive.all():
        return inside
    safe = radii[int(np.argmin(positive))] - reach / 64
    doubtful = np.flatnonzero(inside & (np.hypot(*x.T) > safe))
    for t in np.arange(1, _STATIONS + 1) / _STATIONS:
        keep = _determinant(f(t * x[doubtful])[1]) > 0
        inside[doubtful[~keep]] = False
        doubtful = doubtful[keep]
        if len(doubtful) == 0:
            break
    return inside


def _determinant(J: Float) -> Float:
    return np.asarray(J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0])


def invert_radial(g: Callable[[Float], tuple[Float, Float]], y: Float, limit: float) -> Float:
    """Return r in [0, limit) with g(r) = y for a g that rises on [0, limit); NaN where y is beyond g(limit).

    Parameters
    ----------
    g : callable
        r (N,) to g(r) (N,) and g′(r) (N,).
    y : ndarray of shape (N,)
        Radii to take back, ≥ 0.
    limit : float
        End of the rising branch; may be infinite.

    Returns
    -------
    ndarray of shape (N,)
    """
    # Far out a polynomial overflows, to infinity or, over another, to nothing: both say that r is too large.
    with np.errstate(all="ignore"):
        low = np.zeros_like(y)
        if np.isfinite(limit):
            high = np.full_like(y, limit)
            # where the branch ends at a pole, g(limit) is enormous, and rounding decides its sign
            solvable = np.isfinite(y) & ~(np.abs(g(high)[0]) <= y)
        else:
            high = np.maximum(2 * y, 1e-300)
            for _ in range(1100):
                short = g(high)[0] < y
                if not short.any():
                    break
                high = np.where(short, 2 * high, high)
            solvable = np.isfinite(y)
        r = np.minimum(y, 0.5 * (low + high))
        for _ in range(200):
            value, slope = g(r)
            below = value <= y
            low = np.where(below, r, low)
            high = np.where(below, high, r)
            step = r - (value - y) / slope
            r_new = np.where((step > low) & (step < high), step, 0.5 * (low + high))
            r_new = np.where(value == y, r, r_new)
            moved = np.abs(r_new - r) > 1e-16 * np.maximum(r_new, 1e-300)
            r = r_new
            if not (moved & solvable).any():
                break
    return np.where(solvable, r, np.nan)


def invert_radial_compiled(y: Float, a: Float, b: Float, limit: float, *, of_angle: bool = False) -> Float:
    """Return x = y r / |y| with r (1 + a₁ s + a₂ s² + …) / (1 + b₁ s + …) = |y|, s = r², from a kernel.

    Parameters
    ----------
    y : ndarray of shape (N, 2)
        Points to take back.
    a : ndarray of at most 4 numbers
        Coefficients of the numerator.
    b : ndarray of 3 numbers
        Coefficients of the denominator.
    limit : float
        End of the rising branch; may be infinite.
    of_angle : bool
        Whether r is the angle from the axis, whose tangent is |x|.

    Returns
    -------
    ndarray of shape (N, 2)
        NaN where |y| is beyond the rising branch.
    """
    from stereocal.camera.distortion_inverse_kernels import invert_radial_kernel

    numerator = np.zeros(4)
    numerator[: len(a)] = a
    x = np.empty(y.shape)
    invert_radial_kernel(np.ascontiguousarray(y), numerator, np.ascontiguousarray(b), limit, of_angle, x)
    return x


def first_turning_point(coefficients: Float) -> float:
    """Return the smallest positive root s of c₀ + c₁ s + c₂ s² + … (c₀ > 0), or infinity if there is none.

    Notes
    -----
    With w = 1/s the equation is c₀ wⁿ + c₁ wⁿ⁻¹ + … = 0, and its leading coefficient is one that does not vanish:
    a coefficient of 1e-300 then moves roots towards w = 0, where it would overflow as a divisor.
    """
    w = np.roots(np.asarray(coefficients, dtype=np.float64))
    real = w[(np.abs(w.imag) <= 1e-9 * np.abs(w)) & (w.real > np.finfo(np.float64).tiny)].real
    return float(1 / real.max()) if len(real) else np.inf
