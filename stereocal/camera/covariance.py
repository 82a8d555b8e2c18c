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
from stereocal.base.homogeneous import cross_matrix
from stereocal.base.rotations import rotation_vector
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
    try:
        S, V_inv_Wt = schur_complement(equations)
        scale = 1 / np.sqrt(np.diag(S)) if free else np.zeros(0)
        S_inv = np.linalg.inv(S * scale[:, None] * scale) * scale[:, None] * scale
        determined = freedom > 0 and bool(np.all(np.diag(S_inv) > 0)) and bool(np.all(np.isfinite(S_inv)))
    except (np.linalg.LinAlgError, FloatingPointError):
        determined = False
    if not determined:
        views = bundle.view_count
        return BundleCovariance(np.inf, freedom, np.full((n, n), np.inf), np.full((views, n, 6), np.inf),
                                np.full((views, 6, 6), np.inf))  # fmt: skip
    variance = equations.cost / freedom
    shared = bundle.G @ S_inv @ bundle.G.T
    cross = -np.einsum("fg,vig->vfi", bundle.G @ S_inv, V_inv_Wt)
    views = np.linalg.inv(equations.V) + np.einsum("vif,fg,vjg->vij", V_inv_Wt, S_inv, V_inv_Wt)

    to_rvec = np.tile(np.eye(6), (bundle.view_count, 1, 1))
    for view, R in enumerate(state.R_views):
        to_rvec[view, :3, :3] = left_jacobian_inverse(rotation_vector(R))
    rig = np.eye(n)
    for camera, part in enumerate(bundle.rig_slices):
        if camera:
            turn = slice(part.start, part.start + 3)
            rig[turn, turn] = left_jacobian_inverse(rotation_vector(state.R_rig[camera]))
    return BundleCovariance(
        variance,
        freedom,
        variance * rig @ shared @ rig.T,
        variance * rig @ cross @ to_rvec.transpose(0, 2, 1),
        variance * to_rvec @ views @ to_rvec.transpose(0, 2, 1),
    )


def left_jacobian_inverse(rvec: Float) -> Float:
    """Return J_l(r)⁻¹ = I − ½[r]ₓ + (1/θ² − cot(θ/2)/(2θ)) [r]ₓ², which takes a turn on the left to the change of r.

    Parameters
    ----------
    rvec : ndarray of shape (3,)
        Rotation vector, θ < 2π.

    Returns
    -------
    ndarray of shape (3, 3)
    """
    theta = float(np.linalg.norm(rvec))
    rx = cross_matrix(rvec)
    if theta < 1e-3:
        return np.eye(3) - 0.5 * rx + (1 / 12 + theta**2 / 720) * (rx @ rx)
    return np.eye(3) - 0.5 * rx + (1 / theta**2 - 1 / (2 * theta * np.tan(theta / 2))) * (rx @ rx)
