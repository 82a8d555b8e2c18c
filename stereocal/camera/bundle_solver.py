"""The iteration of bundle adjustment: Levenberg–Marquardt on block normal equations.

One step solves the damped equations of ``bundle`` by the Schur complement over the views; whether it is taken, and what
becomes of the damping μ, is decided by the gain ratio as in ``base.least_squares``. The iteration ends when

- gradient: every |b_i| / √(A_ii F) ≤ 1e-10: the residuals are orthogonal to all that can be changed;
- cost: the decrease that is still to come is ≤ 1e-14 F, or F has come down to rounding (1e-9 px a point). To come is
  what the model promises; or, of steps that are hardly damped and win, what those after this one will: promises p then
  fall like a geometric series, of a ratio q that the last three tell (the larger counts), and p q / (1 − q) is left;
- step: no coordinate would move by more than 1e-12 of its own scale.

The last two count only while μ is small: a heavily damped step is short and promises little, far from any optimum.
Where residuals are large, μ may settle above that. If F then ceases to fall by more than rounding, the question is put
once more with a small μ.

The loop is written once. What it drives is an engine: :class:`NumpyEngine`, the equations of ``bundle`` as they
stand, for every lens and option, or with sums from a kernel (``bundle_sums``); or ``bundle_compiled.CompiledEngine``,
their twin in kernels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from stereocal.base.checks import Float, require_choice
from stereocal.camera.bundle import Bundle, BundleState, NormalEquations, normal_equations
from stereocal.camera.bundle_compiled import CompiledEngine, has_kernel
from stereocal.camera.bundle_sums import EquationsFromSums, has_sums

_GRADIENT_TOLERANCE = 1e-10
_COST_TOLERANCE = 1e-14
_STEP_TOLERANCE = 1e-12
_PERFECT_FIT = 1e-9
# A loss of F smaller than this part of it, where hardly anything was promised, is rounding and not a wrong model.
_ROUNDING = 1e-11
# Every residual is the difference of two pixel coordinates and carries this part of them as rounding (some ulps).
_ROUNDING_OF_PIXELS = 16 * np.finfo(np.float64).eps
# A step damped more than this says nothing about convergence.
_TRUSTED_DAMPING = 1e-3
_HOPELESS_DAMPING = 1e18
# D keeps the largest diagonals met. Coefficients that run away leave theirs behind by many powers of ten, and a μ that
# could not follow would go on shortening every step.
_LEAST_DAMPING = 1e-30
# A step damped less than this is as good as one of Gauss and Newton.
_NEGLIGIBLE_DAMPING = 1e-6


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


class BundleEngine(Protocol):
    """What the loop needs: F and its normal equations at a state, and a step from there."""

    cost: float

    @property
    def equations(self) -> NormalEquations:
        """The normal equations here."""

    def propose(self, mu: float) -> tuple[float, float, float] | None:
        """Try the step for damping μ; return (promised decrease, max |Dδ|, F there), None if it cannot be computed."""

    def accept(self) -> None:
        """Move to where the last proposal led."""

    def gradient_norm(self) -> float:
        """Return the largest |b_i| / √(A_ii F)."""

    def state(self) -> BundleState:
        """Return the state."""


def solve_bundle(
    bundle: Bundle,
    state: BundleState,
    *,
    max_iterations: int = 200,
    initial_damping: float = 1e-3,
    backend: str = "numba",
    in_valley: bool = False,
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
    backend : {"numba", "numpy"}
        The compiled twin, where it knows the lens models and options of the bundle, or the equations in NumPy.
    in_valley : bool
        Whether steps are to bend along a valley (``bundle_geodesic``): fewer steps, each of which takes longer.

    Returns
    -------
    BundleSolution
    """
    require_choice(backend, ("numba", "numpy"), "backend")
    compiled = backend == "numba" and has_kernel(bundle)
    engine: BundleEngine
    evaluate: Callable[[Bundle, BundleState], NormalEquations] = _compiled_equations if compiled else normal_equations
    if backend == "numba" and not compiled and has_sums(bundle):
        evaluate = EquationsFromSums()
    if in_valley and bundle.loss == "linear":
        from stereocal.camera.bundle_geodesic import GeodesicEngine

        engine = GeodesicEngine(bundle, state, evaluate)
    else:
        engine = CompiledEngine(bundle, state) if compiled else NumpyEngine(bundle, state, evaluate)
    mu, nu = initial_damping, 2.0
    iterations, reason, asked = 0, "", False
    last = (1e-300, np.inf)  # what the last two steps promised
    floor = len(bundle.points) * _PERFECT_FIT**2
    # rounding e of each residual r changes F by 2Σre, of the size of 2e√F: of exact corners that is more than 1e-11 F
    rounding_of_r = _ROUNDING_OF_PIXELS * float(np.abs(bundle.measured).max(initial=0.0))
    if bundle.whitening is not None:
        rounding_of_r *= float(np.abs(bundle.whitening).max(initial=0.0))
    while math.isfinite(engine.cost):
        cost = engine.cost
        gradient = engine.gradient_norm()
        if cost <= floor or gradient <= _GRADIENT_TOLERANCE:
            reason = "cost" if cost <= floor else "gradient"
        if reason or iterations >= max_iterations or mu > _HOPELESS_DAMPING:
            break
        iterations += 1
        trial = engine.propose(mu)
        if trial is None:
            mu, nu = mu * nu, nu * 2
            continue
        promised, longest, cost_there = trial
        won = cost - cost_there
        noise = max(_ROUNDING * cost, rounding_of_r * math.sqrt(cost))
        if mu <= _TRUSTED_DAMPING:
            q = max(promised / last[1], last[1] / last[0])
            to_come = promised * q / (1 - q) if won > 0 and mu <= _NEGLIGIBLE_DAMPING and q < 1 else np.inf
            rounding = won <= 0 and max(promised, -won) <= noise
            if longest <= _STEP_TOLERANCE * math.sqrt(cost):
                reason = "step"
            elif min(promised, to_come) <= _COST_TOLERANCE * cost or rounding:
                reason = "cost"
        if won > 0:
            rho = won / promised if promised > 0 else 1.0
            engine.accept()
            last = (last[1], promised)
            mu, nu, asked = max(mu * max(0.1, 1 - (2 * rho - 1) ** 3), _LEAST_DAMPING), 2.0, False
        elif not asked and mu > _TRUSTED_DAMPING and max(promised, -won) <= noise:
            mu, nu, asked = _TRUSTED_DAMPING, 2.0, True
        else:
            mu, nu = mu * nu, nu * 2
    stopped = reason or ("iterations" if iterations >= max_iterations else "stalled")
    return BundleSolution(engine.state(), engine.equations, iterations, bool(reason), stopped, engine.gradient_norm())


def _compiled_equations(bundle: Bundle, state: BundleState) -> NormalEquations:
    """What ``bundle.normal_equations`` returns, from the compiled twin."""
    return CompiledEngine(bundle, state).equations


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
    if equations.schur is None:
        free, rows = len(equations.U), 6 * len(equations.V)
        Wt = equations.W.transpose(0, 2, 1)
        V_inv_Wt = equations.V_inverse @ Wt
        S = equations.U - Wt.reshape(rows, free).T @ V_inv_Wt.reshape(rows, free)
        schur = (np.asarray(0.5 * (S + S.T)), np.asarray(V_inv_Wt))
        equations.schur = schur
        return schur
    return equations.schur


class NumpyEngine:
    """The equations of ``bundle``, as they stand there."""

    def __init__(
        self, bundle: Bundle, state: BundleState,
        evaluate: Callable[[Bundle, BundleState], NormalEquations] = normal_equations,
    ) -> None:  # fmt: skip
        self._bundle, self._state, self._evaluate = bundle, state, evaluate
        self.equations = evaluate(bundle, state)
        self.cost = self.equations.cost
        self._D2 = _diagonals(self.equations)
        self._there = (state, self.equations)

    def propose(self, mu: float) -> tuple[float, float, float] | None:
        """Solve (A + μD²) δ = −b and evaluate F at the end of δ."""
        step = damped_step(self.equations, mu, *self._D2)
        if step is None:
            return None
        dz, dv = self.bend(*step, mu)
        state = self._state.moved(self._bundle.G @ dz, dv)
        self._there = (state, self._evaluate(self._bundle, state))
        longest = max(np.max(np.abs(part) * np.sqrt(D2), initial=0.0) for part, D2 in zip(step, self._D2, strict=True))
        return _promised(self.equations, *step), float(longest), self._there[1].cost

    def bend(self, dz: Float, dv: Float, mu: float) -> tuple[Float, Float]:
        """Return the step that is taken for δ: δ itself."""
        return dz, dv

    def accept(self) -> None:
        """Move on; the scaling D keeps the largest diagonals met."""
        self._state, self.equations = self._there
        self.cost = self.equations.cost
        new = _diagonals(self.equations)
        self._D2 = (np.maximum(self._D2[0], new[0]), np.maximum(self._D2[1], new[1]))

    def gradient_norm(self) -> float:
        """Return the largest |b_i| / √(A_ii F), the cosine of residuals and a column of the Jacobian."""
        equations = self.equations
        if equations.cost <= 0:
            return 0.0
        D2_shared, D2_views = _diagonals(equations)
        slopes = [
            np.abs(equations.b_shared) / np.sqrt(D2_shared),
            (np.abs(equations.b_views) / np.sqrt(D2_views)).ravel(),
        ]
        return float(np.max(np.concatenate(slopes), initial=0.0) / np.sqrt(equations.cost))

    def state(self) -> BundleState:
        """Return the state."""
        return self._state


def _diagonals(equations: NormalEquations) -> tuple[Float, Float]:
    shared, views = np.diag(equations.U), np.diagonal(equations.V, axis1=1, axis2=2)
    return np.where(shared > 0, shared, 1.0), np.where(views > 0, views, 1.0)


def damped_step(equations: NormalEquations, mu: float, D2_shared: Float, D2_views: Float) -> tuple[Float, Float] | None:
    """Solve (A + μD²) δ = −b by blocks; None if A is singular to working precision."""
    V = equations.V + mu * D2_views[:, :, None] * np.eye(6)
    U = equations.U + mu * np.diag(D2_shared)
    damped = replace(equations, U=U, V=V, schur=None, half=None, eliminate=None)
    try:
        S, V_inv_Wt = schur_complement(damped)
        V_inv_b = (damped.V_inverse @ equations.b_views[:, :, None])[:, :, 0]
        rhs = -(equations.b_shared - np.einsum("vfi,vi->f", equations.W, V_inv_b))
        scale = 1 / np.sqrt(np.maximum(np.diag(S), 1e-300))
        with np.errstate(over="ignore", invalid="ignore"):  # coefficients that run away: such a step is none
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
