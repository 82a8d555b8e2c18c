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
is followed along the ray, f(x) = s·y, s from 0 to 1 in steps of 1/16, halved where a dozen of Newton's do not solve one
(continuation). Each answer is checked: residual ≤ 1e-12, and a positive determinant all the way from the centre
(:func:`open_way`).

That way cannot be read off from stations at fixed places: between two of them the determinant may pass through zero, or
through a pole, and come back. So an interval of the way counts as positive only where D(t) = det ∂f/∂x (t·x) is seen to
be smooth there, with D₀, D_m, D₁ at its ends and its middle,

    |D_m − (D₀ + D₁)/2| ≤ ½ min(D₀, D_m, D₁),

and is halved otherwise. A parabola with these three values is nowhere less than half of the smallest: the rule is exact
for it, and what it has to fear is a D whose higher terms win within 1/32 of the way. Towards a fold D goes to zero and
towards a pole to infinity, so that intervals shrink there until one of them shows a D that is not positive, or until
they are too many; such a point has no answer either. The pole of a radial denominator is known beforehand, and is a
bound of the domain (``limit``), though a tilted sensor, a homography, may bring what lies beyond infinity back.

Backward models are formulas with the same folds: :func:`inside_domain` masks them in ``BackwardModel.undistort``.

``distortion_inverse_kernels`` is the compiled twin for OpenCV's family, the fisheye and the rational function.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stereocal.base.checks import Float

MapWithJacobian = Callable[[Float], tuple[Float, Float]]

_TOLERANCE = 1e-12
_MAX_NEWTON = 60
_NEWTON_PER_STEP = 12
_LONGEST_STEP, _SHORTEST_STEP = 1 / 16, 1 / 64
_FIRST_LEVEL = 4
_LAST_LEVEL = 40
_MOST_INTERVALS = 1000
_DIRECTIONS = 64
_SURVEYS = 12


def invert_map(f: MapWithJacobian, y: Float, limit: float = np.inf) -> Float:
    """Return x with f(x) = y inside the star-shaped domain of f about the origin; NaN where there is none.

    Parameters
    ----------
    f : callable
        x (N, 2) to f(x) (N, 2) and ∂f/∂x (N, 2, 2).
    y : ndarray of shape (N, 2)
        Points to take back.
    limit : float
        Radius that the domain is known not to reach beyond: that of a pole.

    Returns
    -------
    ndarray of shape (N, 2)
    """
    if len(y) == 0:
        return y.copy()
    with np.errstate(all="ignore"):
        x, good = _newton(f, y, y.copy())
        good = inside_domain(f, x, good & (np.hypot(*x.T) < limit))
        hard = np.flatnonzero(~good & np.all(np.isfinite(y), axis=1))
        if len(hard):
            followed, arrived = _follow(f, y[hard])
            x[hard], good[hard] = followed, inside_domain(f, followed, arrived & (np.hypot(*followed.T) < limit))
    x[~good] = np.nan
    return x


def _follow(f: MapWithJacobian, y: Float) -> tuple[Float, np.ndarray]:
    """Continuation f(x) = s·y from the centre; return where each x came to and which of them arrived, s = 1."""
    x, s, step = np.zeros_like(y), np.zeros(len(y)), np.full(len(y), _LONGEST_STEP)
    going = np.arange(len(y))
    while len(going):
        there, solved = _newton(f, (s[going] + step[going])[:, None] * y[going], x[going], _NEWTON_PER_STEP)
        came, failed = going[solved], going[~solved]
        x[came], s[came] = there[solved], s[came] + step[came]
        step[failed] *= 0.5
        going = going[(s[going] < 1) & (step[going] >= _SHORTEST_STEP)]
    return x, s == 1


def _newton(f: MapWithJacobian, y: Float, x: Float, most: int = _MAX_NEWTON) -> tuple[Float, np.ndarray]:
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
    for _ in range(most):
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


def inside_domain(f: MapWithJacobian, x: Float, asked: np.ndarray) -> np.ndarray:
    """Tell which of the points that are asked after lie in the star-shaped domain of f about the origin.

    Parameters
    ----------
    f : callable
        x (N, 2) to f(x) (N, 2) and ∂f/∂x (N, 2, 2).
    x : ndarray of shape (N, 2)
        Points.
    asked : ndarray of bool, shape (N,)
        Which of them are in question; the others are outside.

    Returns
    -------
    ndarray of bool, shape (N,)
    """
    with np.errstate(all="ignore"):
        radius = np.hypot(x[:, 0], x[:, 1])
        inside = asked & np.isfinite(radius)
        if inside.any():
            doubtful = np.flatnonzero(inside & ~(radius <= _safe_radius(f, float(np.max(radius[inside])))))
            inside[doubtful] = open_way(f, x[doubtful]) == 1
    return inside


def _safe_radius(f: MapWithJacobian, reach: float) -> float:
    """Radius of a disc about the centre, at most `reach`, without a fold: a survey that settles most points."""
    angles = np.arange(_DIRECTIONS) * (2 * np.pi / _DIRECTIONS)
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    for _ in range(_SURVEYS):
        free = float(np.min(open_way(f, reach * directions)))
        if free == 1:
            return reach
        if free >= 0.5:
            # the nearest fold may lie between two directions, a little nearer than in either
            return 0.95 * free * reach
        reach *= free + 0.5**_FIRST_LEVEL  # the fold is not much further: look closer
    return 0.0


def open_way(f: MapWithJacobian, x: Float) -> Float:
    """Return how far one can go from the centre to each x with det ∂f/∂x > 0, as a part of the way; 1 is all of it.

    Parameters
    ----------
    f : callable
        x (N, 2) to f(x) (N, 2) and ∂f/∂x (N, 2, 2).
    x : ndarray of shape (N, 2)
        Ends of the ways.

    Returns
    -------
    ndarray of shape (N,)
        Below 1, where the interval begins that holds the fold.

    Notes
    -----
    A way is walked in intervals [i, i + 1] / 2^level by the rule of the module's essay. The level rises by one where D
    is not smooth, and sinks by one behind an interval where it is, down to the first.
    """

    def determinant(t: Float, way: np.ndarray) -> Float:
        return _determinant(f(t[:, None] * x[way])[1])

    far, way = np.zeros(len(x)), np.arange(len(x))
    i, level = np.zeros(len(x), dtype=np.int64), np.full(len(x), _FIRST_LEVEL)
    D_0 = determinant(far, way)
    for _ in range(_MOST_INTERVALS):
        if len(way) == 0:
            break
        h = 0.5**level
        D_m, D_1 = np.split(determinant(np.concatenate([(i + 0.5) * h, (i + 1) * h]), np.concatenate([way, way])), 2)
        least = np.minimum(np.minimum(D_0, D_m), D_1)
        smooth = np.abs(D_m - 0.5 * (D_0 + D_1)) <= 0.5 * least
        i, level, D_0 = np.where(smooth, i + 1, 2 * i), np.where(smooth, level, level + 1), np.where(smooth, D_1, D_0)
        coarser = smooth & (i % 2 == 0) & (level > _FIRST_LEVEL)
        i, level = np.where(coarser, i // 2, i), level - coarser
        positive = (least > 0) & np.isfinite(D_m + D_1)
        far[way[positive]] = (i * 0.5**level)[positive]
        on = positive & (far[way] < 1) & (level <= _LAST_LEVEL)
        way, i, level, D_0 = way[on], i[on], level[on], D_0[on]
    return far


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
