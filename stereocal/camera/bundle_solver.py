"""The iteration of bundle adjustment: Levenberg–Marquardt on block normal equations.

One step solves the damped equations of ``bundle`` by the Schur complement over the views; whether it is taken, and what
becomes of the damping μ, is decided by the gain ratio as in ``base.least_squares``. The iteration ends when

- gradient: every |b_i| / √(A_ii F) ≤ 1e-10: the residuals are orthogonal to all that can be changed;
- cost: the decrease that the undamped model still promises is ≤ 1e-14 F, or F has come down to rounding (1e-11 px a
point);
- step: no coordinate would move by more than 1e-12 of its own scale.

μ is ignored by these tests only when it is small: a heavily damped step is short and promises little far from any
optimum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.bundle import Bundle, BundleState, NormalEquations, normal_equations

_GRADIENT_TOLERANCE = 1e-10
_COST_TOLERANCE = 1e-14
_STEP_TOLERANCE = 1e-12
_PERFECT_FIT = 1e-11
# A step damped more than this says nothing about convergence.
_TRUSTED_DAMPING = 1e-3
_HOPELESS_DAMPING = 1e18


@dataclass
class BundleSolution:
    """Where the iteration ended.

    Attributes
    ----------
    state : BundleState
        The values.
    equations : NormalEquations
        At `state`, undamped.
    iterations : int
        Steps tried.
    converged : bool
        Whether a test ended it.
    reason : str
        ``"gradient"``, ``"cost"``, ``"step"``; ``"iterations"`` or ``"stalled"`` if it did not converge.
    gradient_norm : float
        Largest |b_i| / √(A_ii F).
    """

    state: BundleState
    equations: NormalEquations
    iterations: int
    converged: bool
    reason: str
    gradient_norm: float

    @property
    def cost(self) -> float:
        """F at the end."""
        return self.equations.cost


def solve_bundle(
    bundle: Bundle, state: BundleState, *, max_iterations: int = 200, initial_damping: float = 1e-3
) -> BundleSolution:
    """Minimise F from a starting state.

    Parameters
    ----------
    bundle : Bundle
        The measurements.
    state : BundleState
        Start; every point must be in front of its camera.
    max_iterations : int
        Limit on steps tried.
    initial_damping : float
        μ at the start, relative to the diagonal of the normal matrix.

    Returns
    -------
    BundleSolution
    """
    equations = normal_equations(bundle, state)
    D2_shared, D2_views = _diagonals(equations)
    mu, nu = initial_damping, 2.0
    iterations, reason = 0, ""
    floor = len(bundle.points) * _PERFECT_FIT**2
    while np.isfinite(equations.cost) and iterations < max_iterations:
        if equations.cost <= floor or gradient_norm(equations) <= _GRADIENT_TOLERANCE:
            reason = "cost" if equations.cost <= floor else "gradient"
            break
        iterations += 1
        step = _damped_step(equations, mu, D2_shared, D2_views)
        if step is None:
            mu, nu = mu * nu, nu * 2
            continue
        dz, dv = step
        promised = _promised(equations, dz, dv)
        trial_state = state.moved(bundle.G @ dz, dv)
        trial = normal_equations(bundle, trial_state)
        won = equations.cost - trial.cost
        trusted = mu <= _TRUSTED_DAMPING
        tiny = trusted and max(
            np.max(np.abs(dz) * np.sqrt(D2_shared), initial=0.0), np.max(np.abs(dv) * np.sqrt(D2_views), initial=0.0)
        ) <= _STEP_TOLERANCE * np.sqrt(equations.cost)
        flat = trusted and promised <= _COST_TOLERANCE * equations.cost
        # a loss where hardly anything was promised is rounding, not a wrong model
        rounding = won <= 0 and promised <= 1e-11 * equations.cost and abs(won) <= 1e-11 * equations.cost and trusted
        if won > 0:
            rho = won / promised if promised > 0 else 1.0
            state, equations = trial_state, trial
            new_shared, new_views = _diagonals(equations)
            D2_shared, D2_views = np.maximum(D2_shared, new_shared), np.maximum(D2_views, new_views)
            mu, nu = max(mu * max(1 / 10, 1 - (2 * rho - 1) ** 3), 1e-16), 2.0
        else:
            mu, nu = mu * nu, nu * 2
        if tiny or flat or rounding:
            reason = "step" if tiny else "cost"
            break
        if mu > _HOPELESS_DAMPING:
            break
    stopped = reason or ("iterations" if iterations >= max_iterations else "stalled")
    return BundleSolution(state, equations, iterations, bool(reason), stopped, gradient_norm(equations))


def schur_complement(equations: NormalEquations) -> tuple[Float, Float]:
    """Return S = U − Σ W V⁻¹ Wᵀ and all V⁻¹Wᵀ, (V, 6, F).

    Parameters
    ----------
    equations : NormalEquations
        Undamped or damped.

    Returns
    -------
    S : ndarray of shape (F, F)
    V_inv_Wt : ndarray of shape (V, 6, F)

    Raises
    ------
    numpy.linalg.LinAlgError
        If a V is singular: a view that does not determine its pose.
    """
    V_inv_Wt = np.linalg.solve(equations.V, equations.W.transpose(0, 2, 1))
    S = equations.U - np.einsum("vfi,vig->fg", equations.W, V_inv_Wt)
    return np.asarray(0.5 * (S + S.T)), np.asarray(V_inv_Wt)


def gradient_norm(equations: NormalEquations) -> float:
    """Return the largest |b_i| / √(A_ii F), the cosine of residuals and a column of the Jacobian."""
    if not np.isfinite(equations.cost) or equations.cost <= 0:
        return 0.0 if equations.cost == 0 else float(np.inf)
    D2_shared, D2_views = _diagonals(equations)
    largest = max(
        np.max(np.abs(equations.b_shared) / np.sqrt(D2_shared), initial=0.0),
        np.max(np.abs(equations.b_views) / np.sqrt(D2_views), initial=0.0),
    )
    return float(largest / np.sqrt(equations.cost))


def _diagonals(equations: NormalEquations) -> tuple[Float, Float]:
    shared, views = np.diag(equations.U), np.diagonal(equations.V, axis1=1, axis2=2)
    return np.where(shared > 0, shared, 1.0), np.where(views > 0, views, 1.0)


def _damped_step(
    equations: NormalEquations, mu: float, D2_shared: Float, D2_views: Float
) -> tuple[Float, Float] | None:
    """Solve (A + μD²) δ = −b by blocks; None if it cannot be done to any precision."""
    V = equations.V + mu * D2_views[:, :, None] * np.eye(6)
    U = equations.U + mu * np.diag(D2_shared)
    damped = NormalEquations(equations.cost, U, equations.b_shared, V, equations.b_views, equations.W)
    try:
        S, V_inv_Wt = schur_complement(damped)
        V_inv_b = np.linalg.solve(V, equations.b_views[:, :, None])[:, :, 0]
        rhs = -(equations.b_shared - np.einsum("vfi,vi->f", equations.W, V_inv_b))
        scale = 1 / np.sqrt(np.maximum(np.diag(S), 1e-300))
        dz = scale * np.linalg.solve(S * scale[:, None] * scale, scale * rhs) if len(rhs) else rhs
    except np.linalg.LinAlgError:
        return None
    dv = -(V_inv_b + V_inv_Wt @ dz)
    return (np.asarray(dz), np.asarray(dv)) if np.all(np.isfinite(dz)) and np.all(np.isfinite(dv)) else None


def _promised(equations: NormalEquations, dz: Float, dv: Float) -> float:
    """F(x) − ‖r + Jδ‖² = −2 bᵀδ − δᵀAδ."""
    linear = equations.b_shared @ dz + np.sum(equations.b_views * dv)
    quadratic = dz @ equations.U @ dz + np.einsum("vi,vij,vj->", dv, equations.V, dv)
    quadratic += 2 * np.einsum("f,vfi,vi->", dz, equations.W, dv)
    return float(-2 * linear - quadratic)
