"""Gold-Standard refinement: the F, or the motion, that makes the pictures' errors smallest.

The linear solvers minimise an algebraic error. With independent equal errors of the image points, maximum likelihood
asks for the F of rank 2 and the *corrected* points x̂, x̂' that minimise

    Σᵢ ‖xᵢ − x̂ᵢ‖² + ‖x'ᵢ − x̂'ᵢ‖²      subject to      x̂'ᵢᵀ F x̂ᵢ = 0.

Given F, the best x̂ᵢ, x̂'ᵢ are known (``epipolar.correct_matches``), so that only F is left to search for, and each
pair contributes one residual: its signed distance from the nearest pair that satisfies F. That is the same optimum as
the textbook's bundle adjustment over F and N points in space, at the cost of seven unknowns.

F must keep rank 2 on the way. Its singular value decomposition does that: with F₀ = U diag(1, s₀, 0) Vᵀ,

    F = U R(α) diag(1, s₀ + σ, 0) R(β)ᵀ Vᵀ,

three numbers α, three β and σ: seven, the degrees of freedom of F (Bartoli and Sturm, 2004). For an essential matrix
the unknowns are the motion: R = R(ω) R₀, and t = t₀ + b₁τ₁ + b₂τ₂, normalised, with b₁, b₂ orthogonal to t₀: five.

**With outliers left.** A threshold that parts good from bad throws away good matches beyond it and keeps bad ones
within, and either costs accuracy. Rather than choosing, :func:`refine_among_outliers` weights: a signed distance r is
taken to come from a mixture of good matches, normal with standard deviation σ, and bad ones, uniform over [−L, L],

    p(r) = π N(r; σ) + (1 − π) / 2L,        w(r) = π N(r; σ) / p(r),

w the probability that the match is good. σ² = Σ w r² / Σ w and π = mean w follow from the weights, the weights from
them, and the model from the weighted least squares: expectation maximisation, which climbs to a maximum of the
likelihood of all matches.

Sources: R. Hartley, A. Zisserman, *Multiple View Geometry* (2004), section 11.4; A. Bartoli, P. Sturm, *Nonlinear
estimation of the fundamental matrix with minimal parameters*, PAMI 26 (2004); P. Torr, A. Zisserman, *MLESAC*, CVIU 78
(2000) (the mixture).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.homogeneous import cross_matrix
from stereocal.base.least_squares import central_differences, minimize_least_squares
from stereocal.base.rotations import rotation_matrix
from stereocal.pair.epipolar import correct_matches, sampson_distance
from stereocal.pair.two_view_solvers import normalizing_transform

_ROUNDS = 12
_SETTLED = 0.02


class RefinedFundamental(NamedTuple):
    """F at the optimum, the covariance of its nine entries (row by row, ‖F‖ = 1), and the errors' RMS in pixels."""

    F: Float
    covariance: Float
    rms: float


class RefinedMotion(NamedTuple):
    """R and t at the optimum, the covariance of (ω, τ), and the errors' RMS in pixels."""

    R: Float
    t: Float
    covariance: Float
    rms: float


Refined = TypeVar("Refined", RefinedFundamental, RefinedMotion)


def signed_distances(left: Float, right: Float, F: Float) -> Float:
    """Return each pair's distance from the nearest pair that satisfies F, with the sign of x'ᵀ F x, in pixels.

    Parameters
    ----------
    left, right : ndarray of shape (N, 2)
    F : ndarray of shape (3, 3)

    Returns
    -------
    ndarray of shape (N,)
    """
    best_left, best_right = correct_matches(left, right, F)
    distance = np.sqrt(np.sum((left - best_left) ** 2, axis=1) + np.sum((right - best_right) ** 2, axis=1))
    lines = left @ F[:, :2].T + F[:, 2]
    side = lines[:, 0] * right[:, 0] + lines[:, 1] * right[:, 1] + lines[:, 2]
    return np.asarray(np.where(side < 0, -distance, distance))


def _first_order(left: Float, right: Float, F: Float) -> Float:
    """Signed square root of the Sampson distance: what the distance above is to first order."""
    lines = left @ F[:, :2].T + F[:, 2]
    side = lines[:, 0] * right[:, 0] + lines[:, 1] * right[:, 1] + lines[:, 2]
    return np.asarray(np.sign(side) * np.sqrt(sampson_distance(left, right, F)))


def refine_fundamental(
    F: Float, left: Float, right: Float, weights: Float | None = None, *, max_iterations: int = 30
) -> RefinedFundamental:
    """Minimise the sum of squared distances of the points from F, over all F of rank 2.

    Parameters
    ----------
    F : ndarray of shape (3, 3)
        Where to begin.
    left, right : ndarray of shape (N, 2)
        Matching pixels, N ≥ 7.
    weights : ndarray of shape (N,), optional
        Of the squared distances.
    max_iterations : int
        Limit on steps.

    Returns
    -------
    RefinedFundamental
        F with ‖F‖ = 1. The covariance is for the noise that the residuals show, N − 7 degrees of freedom.
    """
    T1, T2 = normalizing_transform(left), normalizing_transform(right)
    U, s, Vt = np.linalg.svd(np.linalg.inv(T2).T @ F @ np.linalg.inv(T1))
    U, Vt = U * np.linalg.det(U), Vt * np.linalg.det(Vt)

    def matrix(x: Float) -> Float:
        middle = rotation_matrix(x[:3]) @ np.diag([1.0, s[1] / s[0] + x[6], 0.0]) @ rotation_matrix(x[3:6]).T
        full = T2.T @ U @ middle @ Vt @ T1
        return np.asarray(full / np.linalg.norm(full))

    fit, covariance, rms = _fit(matrix, np.zeros(7), left, right, weights, max_iterations)
    best = matrix(fit)
    J = central_differences(lambda x: matrix(x).ravel(), fit)
    with np.errstate(invalid="ignore"):
        covariance = J @ covariance @ J.T
    return RefinedFundamental(best, covariance, rms)


def refine_motion(
    R: Float,
    t: Float,
    left: Float,
    right: Float,
    K_left: Float,
    K_right: Float,
    weights: Float | None = None,
    *,
    max_iterations: int = 30,
) -> RefinedMotion:
    """Minimise the sum of squared distances of the points from F = K_right⁻ᵀ [t]ₓ R K_left⁻¹, over R and t.

    Parameters
    ----------
    R : ndarray of shape (3, 3)
        Where to begin.
    t : ndarray of shape (3,)
        Unit vector.
    left, right : ndarray of shape (N, 2)
        Matching undistorted pixels, N ≥ 5.
    K_left, K_right : ndarray of shape (3, 3)
        Camera matrices.
    weights : ndarray of shape (N,), optional
        Of the squared distances.
    max_iterations : int
        Limit on steps.

    Returns
    -------
    RefinedMotion
        t is a unit vector; the covariance (5, 5) is that of ω (radians) and of τ (radians of t's direction).
    """
    inverse_left, inverse_right = np.linalg.inv(K_left), np.linalg.inv(K_right)
    across = np.linalg.svd(t[None, :])[2][1:]

    def motion(x: Float) -> tuple[Float, Float]:
        direction = t + x[3:] @ across
        return rotation_matrix(x[:3]) @ R, direction / np.linalg.norm(direction)

    def matrix(x: Float) -> Float:
        rotation, direction = motion(x)
        return np.asarray(inverse_right.T @ cross_matrix(direction) @ rotation @ inverse_left)

    fit, covariance, rms = _fit(matrix, np.zeros(5), left, right, weights, max_iterations)
    return RefinedMotion(*motion(fit), covariance, rms)


def _fit(
    matrix: Callable[[Float], Float],
    x0: Float,
    left: Float,
    right: Float,
    weights: Float | None,
    max_iterations: int,
) -> tuple[Float, Float, float]:
    """Minimise Σ w r² over the parameters of F, and return them, their covariance and the weighted RMS."""
    w = np.ones(len(left)) if weights is None else weights
    root = np.sqrt(w)
    total = float(w.sum())
    fit = minimize_least_squares(
        lambda x: root * signed_distances(left, right, matrix(x)),
        x0,
        # the derivative of the first-order distance is that of the distance itself, to first order in the noise
        jacobian=lambda x: root[:, None] * central_differences(lambda y: _first_order(left, right, matrix(y)), x),
        max_iterations=max_iterations,
        cost_tolerance=1e-12,
        gradient_tolerance=1e-8,
    )
    covariance = fit.covariance(degrees_of_freedom=max(round(total) - len(x0), 0))
    return fit.x, covariance, float(np.sqrt(fit.cost / total))


def refine_among_outliers(
    model: Refined,
    refine: Callable[[Refined, Float], Refined],
    to_F: Callable[[Refined], Float],
    left: Float,
    right: Float,
    reach: float,
) -> tuple[Refined, Float, float]:
    """Refine a model on all matches, each weighted by the probability that it is good.

    Parameters
    ----------
    model : RefinedFundamental or RefinedMotion
        Where to begin, near enough that most good matches are within `reach` of it.
    refine : callable
        Model and weights to a better model.
    to_F : callable
        Model to F, in pixels.
    left, right : ndarray of shape (N, 2)
        All matches, the wrong ones too.
    reach : float
        Distance up to which matches count as good at the start, pixels.

    Returns
    -------
    model : RefinedFundamental or RefinedMotion
    weights : ndarray of shape (N,)
        The probability that each match is good.
    log_likelihood : float
        Σ log p(r), by which answers from different starts are compared.
    """
    r = signed_distances(left, right, to_F(model))
    weights = (np.abs(r) <= reach).astype(float)
    extent = max(float(np.linalg.norm(np.ptp(right, axis=0))) / 2, 10 * reach)
    log_likelihood = -np.inf
    for _ in range(_ROUNDS):
        sigma = np.sqrt(np.sum(weights * r**2) / max(np.sum(weights), 1e-12)) + 1e-12
        share = float(np.clip(weights.mean(), 0.05, 1 - 1e-6))
        good = share * np.exp(-0.5 * (r / sigma) ** 2) / (np.sqrt(2 * np.pi) * sigma)
        density = good + (1 - share) / (2 * extent)
        update, log_likelihood = good / density, float(np.sum(np.log(density)))
        change = float(np.abs(update - weights).max())
        weights = update
        model = refine(model, weights)
        r = signed_distances(left, right, to_F(model))
        if change < _SETTLED:
            break
    return model, weights, log_likelihood
