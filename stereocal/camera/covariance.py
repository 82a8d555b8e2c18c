"""How sure the answer is: covariance from the normal equations.

At the optimum the unknowns scatter, to first order, with the covariance σ² A⁻¹, A = JᵀJ of all unknowns, and

    σ² = F / (residual components − unknowns)

is estimated from what is left over (a point has two components; a pose has six unknowns; a fixed parameter is none; a
prior counts as one component). By blocks, with S = U − Σ W V⁻¹ Wᵀ the Schur complement,

    Cov(z)       = σ² S⁻¹,
    Cov(z, v)    = −σ² S⁻¹ W_v V_v⁻¹,
    Cov(v, w)    = σ² (δ_vw V_v⁻¹ + V_v⁻¹ W_vᵀ S⁻¹ W_w V_w⁻¹).

Rotations are corrected in the engine by a small turn ω on the left. A turn ω changes the rotation vector r by
J_l(r)⁻¹ ω, J_l the left Jacobian of SO(3), which takes these covariances to those of the rotation vectors that the
user sees.

Any quantity y = f(z, v) follows by Cov(y) = J Cov Jᵀ: a projected pixel, a triangulated point, the baseline.

All of this is true if corner errors are independent, equal and zero-mean, and the model (board, lens) is right.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.rotations import left_jacobian_inverse, rotation_vectors
from stereocal.camera.bundle import Bundle, BundleState, NormalEquations
from stereocal.camera.bundle_solver import schur_complement


@dataclass(frozen=True, eq=False)
class BundleCovariance:
    """Covariance of all unknowns, by blocks, rotations as rotation vectors.

    Attributes
    ----------
    variance : float
        σ², px² of a residual component (of the weighted residuals, where there are weights).
    degrees_of_freedom : int
        Residual components minus unknowns.
    shared : ndarray of shape (n, n)
        Of all shared parameters: intrinsics of each camera, rig, shape; zero for what is fixed.
    shared_views : ndarray of shape (V, n, 6)
        Of shared parameters with a view's (rvec, tvec).
    views : ndarray of shape (V, 6, 6)
        Of each view's (rvec, tvec).
    """

    variance: float
    degrees_of_freedom: int
    shared: Float
    shared_views: Float
    views: Float


def bundle_covariance(bundle: Bundle, state: BundleState, equations: NormalEquations) -> BundleCovariance:
    """Return the covariance at the optimum.

    Parameters
    ----------
    bundle : Bundle
        The measurements.
    state : BundleState
        The optimum.
    equations : NormalEquations
        Undamped, at `state`.

    Returns
    -------
    BundleCovariance
        Infinite where the data do not determine the unknowns, or leave no degree of freedom.
    """
    free = bundle.G.shape[1]
    priors = 0 if bundle.prior_weights is None else int(np.count_nonzero(bundle.prior_weights))
    freedom = 2 * len(bundle.points) + priors - free - 6 * bundle.view_count
    n = bundle.G.shape[0]
    S_inv = inverse_of_schur(equations)
    if S_inv is None or freedom <= 0:
        shapes = ((n, n), (bundle.view_count, n, 6), (bundle.view_count, 6, 6))
        return BundleCovariance(np.inf, freedom, *(np.full(shape, np.inf) for shape in shapes))
    variance = equations.cost / freedom
    shared = bundle.G @ S_inv @ bundle.G.T
    if equations.factors is None:
        cross, views = pose_covariances(bundle.G, state.rvecs, equations, S_inv)
    else:
        from stereocal.camera.bundle_step_kernels import covariance_kernel

        cross, views = np.empty((bundle.view_count, n, 6)), np.empty((bundle.view_count, 6, 6))
        covariance_kernel(*equations.factors[:2], S_inv, bundle.G, state.rvecs, cross, views)
    if len(bundle.models) > 1:
        rig = np.eye(n)
        for part, J in zip(
            bundle.rig_slices[1:], left_jacobian_inverse(rotation_vectors(state.R_rig[1:])), strict=True
        ):
            rig[part.start : part.start + 3, part.start : part.start + 3] = J
        shared, cross = rig @ shared @ rig.T, rig @ cross
    return BundleCovariance(variance, freedom, variance * shared, variance * cross, variance * views)


def pose_covariances(G: Float, rvecs: Float, equations: NormalEquations, S_inv: Float) -> tuple[Float, Float]:
    """Return, for σ = 1, the covariances of each view's (rvec, tvec) with all shared parameters and with itself.

    Parameters
    ----------
    G : ndarray of shape (n, F)
        δ(all shared) = G δz.
    rvecs : ndarray of shape (V, 3)
        Rotation vectors of the views.
    equations : NormalEquations
        Undamped.
    S_inv : ndarray of shape (F, F)
        See :func:`inverse_of_schur`.

    Returns
    -------
    cross : ndarray of shape (V, n, 6)
    views : ndarray of shape (V, 6, 6)
    """
    count, free = len(equations.V), len(S_inv)
    V_inv_Wt = schur_complement(equations)[1]
    Y = V_inv_Wt.reshape(6 * count, free)
    cross = -(Y @ (S_inv @ G.T)).reshape(count, 6, len(G)).transpose(0, 2, 1)
    views = equations.V_inverse + (Y @ S_inv).reshape(count, 6, free) @ V_inv_Wt.transpose(0, 2, 1)
    turn = left_jacobian_inverse(rvecs)
    cross[:, :, :3] = cross[:, :, :3] @ turn.transpose(0, 2, 1)
    views[:, :3, :] = turn @ views[:, :3, :]
    views[:, :, :3] = views[:, :, :3] @ turn.transpose(0, 2, 1)
    return cross, views


def inverse_of_schur(equations: NormalEquations) -> Float | None:
    """Return S⁻¹; None where an unknown or a view has no influence at all.

    Where S is not positive definite by Cholesky's method, a direction that the data determine less well than rounding
    allows comes out with the variance that rounding implies, which is large: eigenvalues of S, its rows scaled to a
    unit diagonal, count as at least 1e-16 of the largest.
    """
    if equations.inverse is None and equations.factors is not None:
        free = len(equations.U)
        C_inv = np.linalg.inv(np.tril(equations.factors[2][:free, :free]))
        equations.inverse = C_inv.T @ C_inv
    if equations.inverse is not None:
        return equations.inverse
    try:
        S, _ = schur_complement(equations)
    except np.linalg.LinAlgError:
        return None
    diagonal = np.diag(S)
    if not np.all(diagonal > 0):
        return None
    scale = 1 / np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(S * scale[:, None] * scale)
    half = scale[:, None] * vectors / np.sqrt(np.maximum(values, 1e-16 * values[-1])) if len(values) else S
    equations.inverse = half @ half.T
    return equations.inverse
