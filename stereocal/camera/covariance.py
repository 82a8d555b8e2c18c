"""How sure the answer is: covariance from the normal equations.

At the optimum the unknowns scatter, to first order, with the covariance σ² A⁻¹, A = JᵀJ of all unknowns, and

    σ² = F / (residual components − unknowns)

is estimated from what is left over (a point has two components; a pose has six unknowns; a fixed parameter is none; a
prior counts as one component; for robust losses see ``losses``). By blocks, with S = U − Σ W V⁻¹ Wᵀ the Schur
complement,

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
from scipy.linalg.lapack import dtrtri

from stereocal.base.checks import Float
from stereocal.base.rotations import left_jacobian_inverse, rotation_vectors
from stereocal.camera.bundle import Bundle, BundleState, NormalEquations
from stereocal.camera.bundle_solver import schur_complement
from stereocal.camera.losses import robust_variance

# Smallest eigenvalue of V, over the largest, at which Cholesky's method may fail by rounding alone.
_ROUNDING = 1e-14


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
    half = half_of_inverse(equations)
    if half is None or freedom <= 0 or not _poses_are_held(equations):
        shapes = ((n, n), (bundle.view_count, n, 6), (bundle.view_count, 6, 6))
        return BundleCovariance(np.inf, freedom, *(np.full(shape, np.inf) for shape in shapes))
    variance = equations.cost / freedom
    if bundle.loss != "linear":
        r = equations.residuals
        if bundle.whitening is not None:
            r = np.einsum("nij,nj->ni", bundle.whitening, r)
        variance = robust_variance(np.sum(r * r, axis=1), bundle.loss, bundle.loss_scale, freedom)
    G_half = bundle.G @ half
    shared = G_half @ G_half.T
    cross, views = pose_covariances(G_half, half, state.rvecs, equations)
    if len(bundle.models) > 1:
        rig = np.eye(n)
        for part, J in zip(
            bundle.rig_slices[1:], left_jacobian_inverse(rotation_vectors(state.R_rig[1:])), strict=True
        ):
            rig[part.start : part.start + 3, part.start : part.start + 3] = J
        shared, cross = rig @ shared @ rig.T, rig @ cross
    return BundleCovariance(variance, freedom, variance * shared, variance * cross, variance * views)


def _poses_are_held(equations: NormalEquations) -> bool:
    """Whether each view's corners determine its pose to better than rounding."""
    if equations.factors is not None:  # the kernel has found V's Cholesky factors
        return True
    values = np.linalg.eigvalsh(equations.V)
    return bool(np.all(values[:, 0] > _ROUNDING * values[:, -1]))


def pose_covariances(G_half: Float, half: Float, rvecs: Float, equations: NormalEquations) -> tuple[Float, Float]:
    """Return, for σ = 1, the covariances of each view's (rvec, tvec) with all shared parameters and with itself.

    With V⁻¹ = MᵀM, Z = M Wᵀ, S⁻¹ = C Cᵀ and K = M diag(J, I)ᵀ, J = J_l⁻¹ of the view, these are −G C (Z C)ᵀ K and
    Kᵀ (I + Z C (Z C)ᵀ) K: products of rows of E = [I, Z C, −Z C (G C)ᵀ]ᵀ K.

    Parameters
    ----------
    G_half : ndarray of shape (n, F)
        G C, with δ(all shared) = G δz.
    half : ndarray of shape (F, F)
        C, see :func:`half_of_inverse`.
    rvecs : ndarray of shape (V, 3)
        Rotation vectors of the views.
    equations : NormalEquations
        Undamped.

    Returns
    -------
    cross : ndarray of shape (V, n, 6)
    views : ndarray of shape (V, 6, 6)
    """
    if equations.factors is None:
        M = np.linalg.inv(np.linalg.cholesky(equations.V))
        Z = M @ equations.W.transpose(0, 2, 1)
    else:
        M, Z, _ = equations.factors
    count, free, n = len(M), len(half), len(G_half)
    E = np.empty((count, 6, 6 + free + n))
    E[:, :, :6] = np.eye(6)
    E[:, :, 6:] = (Z.reshape(6 * count, free) @ np.hstack([half, -half @ G_half.T])).reshape(count, 6, free + n)
    K = M.copy()
    K[:, :, :3] = M[:, :, :3] @ left_jacobian_inverse(rvecs).transpose(0, 2, 1)
    rows = E.transpose(0, 2, 1) @ K
    own = rows[:, : 6 + free]
    return rows[:, 6 + free :], own.transpose(0, 2, 1) @ own


def half_of_inverse(equations: NormalEquations) -> Float | None:
    """Return C with S⁻¹ = C Cᵀ, the inverse of the Schur complement; None where an unknown or a view has no influence.

    Where S is not positive definite by Cholesky's method, a direction that the data determine less well than rounding
    allows comes out with the variance that rounding implies, which is large: eigenvalues of S, its rows scaled to a
    unit diagonal, count as at least 1e-16 of the largest.
    """
    if equations.half is None and equations.factors is not None:
        # of the triangle alone, which takes a fifth of the time that a general inverse does
        equations.half = np.triu(dtrtri(equations.factors[2].T)[0]) if len(equations.U) else equations.U
    if equations.half is not None:
        return equations.half
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
    equations.half = half
    return equations.half
