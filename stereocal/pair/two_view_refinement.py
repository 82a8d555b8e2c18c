"""Gold-Standard refinement: the F, or the motion, that makes the pictures' errors smallest.

The linear solvers minimise an algebraic error. With independent equal errors of the image points, maximum likelihood
asks for the F of rank 2 and the *corrected* points x̂, x̂' that minimise

    Σᵢ ‖xᵢ − x̂ᵢ‖² + ‖x'ᵢ − x̂'ᵢ‖²      subject to      x̂'ᵢᵀ F x̂ᵢ = 0.

Given F, the best x̂ᵢ, x̂'ᵢ are known (``epipolar.correct_matches``), so that only F is left to search for, and each
pair contributes one residual rᵢ: its signed distance from the nearest pair that satisfies F. That is the same optimum
as the textbook's bundle adjustment over F and N points in space, at the cost of the seven unknowns of F, or the five of
a motion (``two_view_models``).

**The derivative.** To first order r is the signed Sampson distance c/√w with c = x'ᵀ F x and w = ‖n‖² + ‖m‖², where
n = (F x)₁₂ and m = (Fᵀ x')₁₂, and

    ∂r/∂F = (x' xᵀ)/√w − (c/w) (n̂ xᵀ + x' m̂ᵀ)/√w,        n̂ = (n, 0), m̂ = (m, 0),

nine numbers a match. With D the derivatives of F by the unknowns, J = (∂r/∂F) Dᵀ, and all that Levenberg and
Marquardt's step (JᵀWJ + λ diag JᵀWJ) δ = −JᵀW r needs is one 10 × 10 matrix Σ w [∂r/∂F, r]ᵀ [∂r/∂F, r].

**With outliers left.** A threshold that parts good from bad throws away good matches beyond it and keeps bad ones
within, and either costs accuracy. Rather than choosing, matches are weighted: a signed distance r is taken to come from
a mixture of good ones, normal with standard deviation σ, and bad ones, uniform over [−L, L],

    p(r) = π N(r; σ) + (1 − π) / 2L,        w(r) = π N(r; σ) / p(r),

w the probability that the match is good. σ² = Σ w r² / Σ w and π = mean w follow from the weights, the weights from
them, and a better model from one step of weighted least squares: generalised expectation maximisation, which climbs to
a maximum of the likelihood Π p of all matches, by which answers from different starts can be compared.

Sources: R. Hartley, A. Zisserman, *Multiple View Geometry* (2004), section 11.4; P. Torr, A. Zisserman, *MLESAC*, CVIU
78 (2000) (the mixture); A. Dempster, N. Laird, D. Rubin, J. R. Stat. Soc. B 39 (1977) (one step is enough).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stereocal.base.checks import Float
from stereocal.pair.epipolar import correct_matches
from stereocal.pair.two_view_models import TwoViewModel

# λ at the start, and where a step is given up; the least share of good matches; what counts as settled.
_FIRST_DAMPING, _LARGEST_DAMPING = 1e-4, 1e6
_LEAST_SHARE = 0.05
# The least σ as a share of L: matches without noise would make the likelihood infinite.
_LEAST_SIGMA = 1e-7
_TOLERANCE = 1e-10


class Refined(NamedTuple):
    """A model at the optimum.

    `F` (3, 3) is the model's matrix, `weights` (N,) are the probabilities that each match is good, `cost` is Σ w r² in
    pixels², `covariance` (p, p) is (JᵀWJ)⁻¹, to be multiplied by the noise's variance, and `log_likelihood` Σ log p is
    0 without a mixture.
    """

    model: TwoViewModel
    F: Float
    weights: Float
    cost: float
    covariance: Float
    log_likelihood: float


def refine_model(
    model: TwoViewModel,
    points: Float,
    weights: Float | None = None,
    *,
    reach: float = 0.0,
    extent: float = 0.0,
    rounds: int = 30,
    tolerance: float = _TOLERANCE,
    exact: bool = True,
    covariance: bool = True,
    backend: str = "numba",
) -> Refined:
    """Minimise Σ w r² over the members of the model's family.

    Parameters
    ----------
    model : TwoViewModel
        Where to begin.
    points : ndarray of shape (4, N)
        Rows x, y of the left and x', y' of the right picture, pixels.
    weights : ndarray of shape (N,), optional
        Of the squared distances; 1 by default.
    reach : float
        If above 0, the weights begin as 1 for matches within this distance of the model, pixels, and 0 for the others.
    extent : float
        L of the mixture, pixels: the weights are where it begins and are renewed before each step. 0: they stay.
    rounds : int
        Limit on steps.
    tolerance : float
        Relative decrease of the cost, and change of the weights, at which to stop.
    exact : bool
        Whether r is the distance itself or its first-order estimate.
    covariance : bool
        Whether it is wanted.
    backend : {"numba", "numpy"}
        The compiled kernel, or its readable twin.

    Returns
    -------
    Refined
    """
    state = model.state.copy()
    w = np.ones(points.shape[1]) if weights is None else np.array(weights, dtype=np.float64)
    if backend == "numpy":
        return _refine(model, points, w, reach, extent, rounds, tolerance, exact, covariance)
    from stereocal.pair.two_view_refinement_kernels import refine

    F, inverse = np.empty(9), np.empty((model.freedom, model.freedom) if covariance else (0, 0))
    likelihood, cost, _ = refine(
        state,
        model.freedom,
        model.to_right,
        model.to_left,
        points,
        w,
        reach,
        extent,
        rounds,
        tolerance,
        exact,
        F,
        inverse,
    )
    model = TwoViewModel(state, model.freedom, model.to_right, model.to_left)
    return Refined(model, F.reshape(3, 3), w, cost, inverse, likelihood)


def signed_distances(points: Float, F: Float, *, exact: bool = True) -> Float:
    """Return each pair's distance from the nearest pair that satisfies F, with the sign of x'ᵀ F x, in pixels.

    Parameters
    ----------
    points : ndarray of shape (4, N)
    F : ndarray of shape (3, 3)
    exact : bool
        Or its first-order estimate, Sampson's.

    Returns
    -------
    ndarray of shape (N,)
    """
    c, w, *_ = _parts(points, F)
    if not exact:
        return np.asarray(c / np.sqrt(w))
    left, right = points[:2].T, points[2:].T
    best_left, best_right = correct_matches(left, right, F, backend="numpy")
    distance = np.sqrt(np.sum((left - best_left) ** 2, axis=1) + np.sum((right - best_right) ** 2, axis=1))
    return np.asarray(np.where(c < 0, -distance, distance))


def _parts(points: Float, F: Float) -> tuple[Float, Float, Float, Float, Float, Float]:
    """c, w, x, x', n̂ and m̂ of the module's text; the vectors as rows (3, N)."""
    ones = np.ones((1, points.shape[1]))
    x, xp = np.vstack([points[:2], ones]), np.vstack([points[2:], ones])
    line, other = F @ x, F.T @ xp
    n, m = line * [[1.0], [1], [0]], other * [[1.0], [1], [0]]
    w = np.maximum(np.sum(n**2, axis=0) + np.sum(m**2, axis=0), 1e-300)
    return np.sum(xp * line, axis=0), w, x, xp, n, m


def _gradient(points: Float, F: Float) -> Float:
    """∂r/∂F of each match, (N, 9)."""
    c, w, x, xp, n, m = _parts(points, F)
    outer = xp[:, None] * x[None] - c / w * (n[:, None] * x[None] + xp[:, None] * m[None])
    return np.asarray((outer / np.sqrt(w)).reshape(9, -1).T)


def _mixture(r: Float, weights: Float, extent: float) -> tuple[Float, float]:
    """One expectation step: the weights that follow from σ and π of these weights, and Σ log p."""
    sigma = max(float(np.sqrt(np.sum(weights * r**2) / max(np.sum(weights), 1e-12))), _LEAST_SIGMA * extent)
    share = float(np.clip(weights.mean(), _LEAST_SHARE, 1 - 1e-6))
    good = share * np.exp(-0.5 * (r / sigma) ** 2) / (np.sqrt(2 * np.pi) * sigma)
    density = good + (1 - share) / (2 * extent)
    return np.asarray(good / density), float(np.sum(np.log(density)))


def _refine(
    model: TwoViewModel,
    points: Float,
    weights: Float,
    reach: float,
    extent: float,
    rounds: int,
    tolerance: float,
    exact: bool,
    covariance: bool,
) -> Refined:
    """The readable twin of ``two_view_refinement_kernels.refine``."""
    r = signed_distances(points, model.F, exact=exact)
    if reach > 0:
        weights = (np.abs(r) <= reach).astype(np.float64)
    damping, likelihood = _FIRST_DAMPING, 0.0
    for _ in range(rounds):
        change = 0.0
        if extent > 0:
            update, likelihood = _mixture(r, weights, extent)
            change, weights = float(np.abs(update - weights).max()), update
        J = _gradient(points, model.F) @ model.derivatives().T
        A, b = J.T @ (weights[:, None] * J), J.T @ (weights * r)
        cost = float(np.sum(weights * r**2))
        found, damping = _step(model, points, weights, A, b, cost, damping, exact)
        if found is None:
            damping = _FIRST_DAMPING
            if extent <= 0 or change <= tolerance:
                break
            continue
        model, r, gain = found
        damping = max(damping / 10, 1e-12)
        if gain <= tolerance * (cost - gain) and change <= tolerance:
            break
    if extent > 0:
        weights, likelihood = _mixture(r, weights, extent)
    inverse = np.empty((0, 0))
    if covariance:
        J = _gradient(points, model.F) @ model.derivatives().T
        inverse = _inverse(J.T @ (weights[:, None] * J))
    return Refined(model, model.F, weights, float(np.sum(weights * r**2)), inverse, likelihood)


def _step(
    model: TwoViewModel, points: Float, weights: Float, A: Float, b: Float, cost: float, damping: float, exact: bool
) -> tuple[tuple[TwoViewModel, Float, float] | None, float]:
    """Raise λ until a step lowers the cost: the model after it, its distances, and by how much; and λ."""
    while damping <= _LARGEST_DAMPING:
        damped = A + damping * np.diag(np.diag(A))
        if np.all(np.linalg.eigvalsh(damped) > 0):
            further = model.advanced(np.asarray(np.linalg.solve(damped, -b)))
            r = signed_distances(points, further.F, exact=exact)
            gain = cost - float(np.sum(weights * r**2))
            if gain > 0:
                return (further, r, gain), damping
        damping *= 10
    return None, damping


def _inverse(A: Float) -> Float:
    """A⁻¹, or NaN if A is not positive."""
    with np.errstate(invalid="ignore"):
        positive = bool(np.all(np.linalg.eigvalsh(A) > 0)) if np.isfinite(A).all() else False
    return np.asarray(np.linalg.inv(A)) if positive else np.full_like(A, np.nan)
