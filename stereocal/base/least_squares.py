"""Levenberg–Marquardt: the solver of every small fit in the library.

Wanted is the x that minimises the cost F(x) = ‖r(x)‖² of m residuals r in n unknowns. Around x the residuals are
linear, r(x + h) ≈ r + J h, so that the best step solves the normal equations JᵀJ h = −Jᵀr (Gauss–Newton). Far from the
solution that step may go too far; Levenberg (1944) and Marquardt (1963) shorten it and turn it downhill by a damping
μ D², D diagonal:

    (JᵀJ + μ D²) h = −Jᵀ r,        dᵢ = the largest norm that column i of J has had so far.

D makes the answer independent of the units of x (Moré, 1978). Whether μ was right is told by the gain ratio

    ρ = (F(x) − F(x + h)) / (F(x) − ‖r + J h‖²),

what the step won over what the linear model promised. A step that wins (ρ > 0) is taken, and μ is multiplied by
max(1/3, 1 − (2ρ − 1)³): down to a third when the model is good, unchanged at ρ = ½, up when it flatters. A step that
loses is refused and μ grows by ν = 2, 4, 8, … (Nielsen, 1999). There is no line search and nothing to tune.

The step is computed from the QR factors of [J; √μ D], not from JᵀJ, whose condition number is the square of J's.

Iteration ends when one of three tests holds, and the result says which:

- gradient: every |cos ∠(column of J, r)| ≤ gradient_tolerance: the residual is orthogonal to all that can be changed;
- step: ‖D h‖ ≤ step_tolerance · ‖D x‖: x no longer moves;
- cost: the promised and the actual decrease of F are both ≤ cost_tolerance · F.

Sources: K. Madsen, H. B. Nielsen and O. Tingleff, *Methods for non-linear least squares problems* (2004);
J. J. Moré, *The Levenberg–Marquardt algorithm: implementation and theory* (1978).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_array
from stereocal.base.errors import InputError


@dataclass(frozen=True)
class LeastSquaresResult:
    """What :func:`minimize_least_squares` found.

    Attributes
    ----------
    x : ndarray of shape (n,)
        The minimiser.
    cost : float
        F = ‖r‖² there.
    residuals : ndarray of shape (m,)
        r there.
    jacobian : ndarray of shape (m, n)
        J there.
    gradient_norm : float
        Largest |cos| of the angle between r and a column of J; 0 at an optimum.
    iterations : int
        Steps tried, taken or refused.
    converged : bool
        Whether one of the three tests ended it, rather than the limit of iterations.
    reason : str
        Which test: ``"gradient"``, ``"step"``, ``"cost"``, or ``"iterations"`` if none did.
    """

    x: Float
    cost: float
    residuals: Float
    jacobian: Float
    gradient_norm: float
    iterations: int
    converged: bool
    reason: str

    def covariance(self, *, degrees_of_freedom: int | None = None) -> Float:
        """Return σ² (JᵀJ)⁻¹ with σ² = F / (m − n), the covariance of x for independent equal errors.

        Parameters
        ----------
        degrees_of_freedom : int, optional
            m − n unless given.

        Returns
        -------
        ndarray of shape (n, n)
            Infinite where J does not determine x or no residual is left over.
        """
        m, n = self.jacobian.shape
        freedom = m - n if degrees_of_freedom is None else degrees_of_freedom
        singular_values, Vt = np.linalg.svd(self.jacobian, full_matrices=False)[1:]
        if freedom <= 0 or singular_values[-1] <= singular_values[0] * 1e-14:
            return np.full((n, n), np.inf)
        scaled = Vt.T / singular_values
        return np.asarray(self.cost / freedom * (scaled @ scaled.T))


def minimize_least_squares(
    residuals: Callable[[Float], Float],
    x0: ArrayLike,
    *,
    jacobian: Callable[[Float], Float] | None = None,
    max_iterations: int = 100,
    gradient_tolerance: float = 1e-10,
    step_tolerance: float = 1e-12,
    cost_tolerance: float = 1e-15,
    initial_damping: float = 1e-3,
) -> LeastSquaresResult:
    """Minimise F(x) = ‖r(x)‖² by Levenberg–Marquardt.

    Parameters
    ----------
    residuals : callable
        x of shape (n,) to r of shape (m,). Where r cannot be evaluated it returns NaN or infinity: such a step is
        refused like one that loses.
    x0 : array_like of shape (n,)
        Where to begin.
    jacobian : callable, optional
        x to J = ∂r/∂x of shape (m, n); central differences if absent.
    max_iterations : int
        Limit on steps tried.
    gradient_tolerance, step_tolerance, cost_tolerance : float
        The three tests, all free of units; see the module.
    initial_damping : float
        μ at the start, relative to the scaled normal matrix, whose diagonal is 1.

    Returns
    -------
    LeastSquaresResult

    Raises
    ------
    InputError
        If r(x0) is not finite.

    Notes
    -----
    Agrees with ``scipy.optimize.least_squares(method="lm")`` on Moré, Garbow and Hillstrom's test problems (tests).
    """
    x = as_array(np.ravel(np.asarray(x0, dtype=np.float64)), (None,), "x0").copy()
    differentiate = jacobian or (lambda at: central_differences(residuals, at))
    r = np.asarray(residuals(x), dtype=np.float64)
    if not np.all(np.isfinite(r)):
        raise InputError("the residuals are not finite at the start x0; start from a point where they are")
    J = np.asarray(differentiate(x), dtype=np.float64)
    cost = float(r @ r)
    D = _column_norms(J)
    mu, nu = initial_damping, 2.0
    reason = ""
    iterations = 0
    while iterations < max_iterations:
        if _gradient_norm(J, r) <= gradient_tolerance:
            reason = "gradient"
            break
        iterations += 1
        h = np.linalg.lstsq(np.vstack([J, np.diag(np.sqrt(mu) * D)]), np.concatenate([-r, np.zeros(len(x))]))[0]
        promised = cost - float(np.sum((r + J @ h) ** 2))
        with np.errstate(all="ignore"):
            r_new = np.asarray(residuals(x + h), dtype=np.float64)
            cost_new = float(r_new @ r_new)
        if not np.isfinite(cost_new):
            cost_new = np.inf
        won = cost - cost_new
        small_step = np.linalg.norm(D * h) <= step_tolerance * np.linalg.norm(D * x)
        small_gain = max(promised, abs(won)) <= cost_tolerance * cost
        if won > 0:
            rho = won / promised if promised > 0 else 1.0
            x, r, cost = x + h, r_new, cost_new
            J = np.asarray(differentiate(x), dtype=np.float64)
            D = np.maximum(D, _column_norms(J))
            mu, nu = mu * max(1 / 3, 1 - (2 * rho - 1) ** 3), 2.0
        else:
            mu, nu = mu * nu, nu * 2
        if small_step or small_gain:
            reason = "step" if small_step else "cost"
            break
    return LeastSquaresResult(x, cost, r, J, _gradient_norm(J, r), iterations, bool(reason), reason or "iterations")


def central_differences(function: Callable[[Float], Float], x: Float) -> Float:
    """Return J = ∂f/∂x by (f(x + hᵢ) − f(x − hᵢ)) / 2hᵢ, hᵢ = ε^⅓ max(|xᵢ|, 1).

    Parameters
    ----------
    function : callable
        x of shape (n,) to f of shape (m,).
    x : ndarray of shape (n,)
        Where.

    Returns
    -------
    ndarray of shape (m, n)
        Exact to about ε^⅔ = 4e-11, relative, which the tests of every analytic derivative of the library rely on.
    """
    columns = []
    for i, h in enumerate(np.finfo(float).eps ** (1 / 3) * np.maximum(np.abs(x), 1.0)):
        step = np.zeros_like(x)
        step[i] = h
        above, below = x + step, x - step
        columns.append((np.asarray(function(above)) - np.asarray(function(below))) / (above[i] - below[i]))
    return np.stack(columns, axis=-1)


def _column_norms(J: Float) -> Float:
    norms = np.sqrt(np.sum(J * J, axis=0))
    return np.where(norms > 0, norms, 1.0)


def _gradient_norm(J: Float, r: Float) -> float:
    """Largest |cos| between r and a column of J; 0 where r is 0."""
    length = float(np.linalg.norm(r))
    if length == 0:
        return 0.0
    return float(np.max(np.abs(J.T @ r) / _column_norms(J), initial=0.0)) / length
