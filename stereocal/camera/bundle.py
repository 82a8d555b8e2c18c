"""Bundle adjustment for rigs of cameras and views of a board: the engine under every calibration.

Measured are corners y of a board, in views v (poses of the board), by cameras c. A camera may miss a view. Unknown are

    θ_c          fx, fy, cx, cy, s and the lens k of each camera,
    R_c, t_c     camera c relative to camera 0 (the first camera's are I, 0),
    R_v, t_v     the board relative to camera 0 in each view,
    β            the shape of the board, X = X₀ + Φβ, if it is not taken to be flat,

and wanted is the minimum of F = Σ ρ(‖p̃ − y‖²), [eq 19] for any number of cameras. A point goes

    Y = R_v X,    X_0 = Y + t_v,    X_c = R_c X_0 + t_c,    p̃ = K_c x_d(X_c / Z_c; k_c).

Rotations are corrected by a small turn on the left, R ← exp([ω]ₓ) R, which is free of singularities and makes the
derivatives bare cross products: with g = ∂p̃/∂X_c (2×3) and q = g R_c, rows read as vectors,

    ∂p̃/∂t_v = q,    ∂p̃/∂ω_v = Y × q,    ∂p̃/∂t_c = g,    ∂p̃/∂ω_c = (R_c X_0) × g,    ∂p̃/∂X = q R_v.

**Normal equations by blocks.** Order the unknowns as shared ones z (cameras, rig, board) and poses, six a view. No
residual has two poses in it, so that

    [ U    W  ] [ δz ]     [ b_z ]        U = Σ JzᵀJz,    V_v = Σ JvᵀJv  (6×6 blocks on the diagonal),
    [ Wᵀ   V  ] [ δv ] = − [ b_v ],       W_v = Σ JzᵀJv.

The poses are eliminated view by view (Schur complement):

    (U − Σ_v W_v V_v⁻¹ W_vᵀ) δz = −(b_z − Σ_v W_v V_v⁻¹ b_v),        δ_v = −V_v⁻¹ (b_v + W_vᵀ δz).

The work is linear in the number of views; a solver of the full system, as in OpenCV, is cubic. The same elimination
gives the covariance (see ``covariance``).

**What is free.** The user fixes or ties parameters. Both are one linear map, δ(all shared) = G δz: a column of G per
free unknown, with a single 1 for a plain parameter and, for a focal length shared by fx = a·fy, the numbers a and 1.

**Damping** is as in ``base.least_squares``: μD² with D² the diagonal of the normal matrix, gain ratio, Nielsen's rule.

This module is the equation, in NumPy, for every model and option; ``bundle_kernels`` holds its twin for OpenCV's
models, ``bundle_step_kernels`` that of the step, and ``bundle_compiled`` brings the arrays into their order. Boards of
unknown shape, of any model, have theirs in ``bundle_shaped``.

Sources: Triggs, McLauchlan, Hartley and Fitzgibbon, *Bundle adjustment: a modern synthesis* (2000); Lourakis and
Argyros (2009).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate, pairwise

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.rotations import rotation_matrices, rotation_matrix, rotation_vectors
from stereocal.camera.distortion_base import DistortionModel
from stereocal.camera.projection import perspective_jacobian

INTRINSIC_NAMES = ("fx", "fy", "cx", "cy", "skew")


@dataclass
class Bundle:
    """Measurements and unknowns of a rig, in flat arrays.

    Attributes
    ----------
    models : list of DistortionModel
        One a camera.
    points : ndarray of shape (M, 3)
        Board points X₀, one a measurement.
    measured : ndarray of shape (M, 2)
        y, pixels.
    offsets : ndarray of int, shape (B + 1,)
        Block i, the corners of one view in one camera, is rows offsets[i] : offsets[i + 1].
    camera_of_block, view_of_block : ndarray of int, shape (B,)
        Which camera and view. Blocks are sorted by camera.
    G : ndarray of shape (n_shared, n_free)
        δ(all shared) = G δz.
    view_count : int
        Number of views.
    whitening : ndarray of shape (M, 2, 2), optional
        Residuals are multiplied by it: the inverse square root of each corner's covariance.
    shape_index : ndarray of int, shape (M,), optional
        Which point of the board each measurement is of; needed with `shape_basis`.
    shape_basis : ndarray of shape (P, 3, m), optional
        Φ: the board's point j is X₀ + Φ[j] β.
    prior_weights, prior_means : ndarray of shape (n_shared,), optional
        Adds Σ (weight (parameter − mean))² to F.
    loss, loss_scale
        See ``losses``.
    """

    models: list[DistortionModel]
    points: Float
    measured: Float
    offsets: np.ndarray
    camera_of_block: np.ndarray
    view_of_block: np.ndarray
    G: Float
    view_count: int
    whitening: Float | None = None
    shape_index: np.ndarray | None = None
    shape_basis: Float | None = None
    prior_weights: Float | None = None
    prior_means: Float | None = None
    loss: str = "linear"
    loss_scale: float = 1.0

    @cached_property
    def intrinsic_slices(self) -> list[slice]:
        """Where θ_c stands among all shared parameters."""
        ends = accumulate((5 + model.parameter_count for model in self.models), initial=0)
        return [slice(a, b) for a, b in pairwise(ends)]

    @property
    def rig_slices(self) -> list[slice]:
        """Where (ω_c, t_c) of camera c ≥ 1 stands among all shared parameters; empty for camera 0."""
        start = self.intrinsic_slices[-1].stop
        return [slice(0, 0)] + [slice(start + 6 * i, start + 6 * i + 6) for i in range(len(self.models) - 1)]

    @property
    def shape_slice(self) -> slice:
        """Where β stands among all shared parameters."""
        start = self.intrinsic_slices[-1].stop + 6 * (len(self.models) - 1)
        return slice(start, start + (0 if self.shape_basis is None else self.shape_basis.shape[2]))

    @cached_property
    def by_axes(self) -> Float:
        """Rows X, Y, Z, u, v of all measurements, (5, M), as the kernels read them."""
        out = np.empty((5, len(self.points)))
        out[:3], out[3:] = self.points.T, self.measured.T
        return out

    def rows_of_camera(self, camera: int) -> tuple[slice, np.ndarray]:
        """Return the rows of a camera's measurements and its blocks."""
        blocks = np.flatnonzero(self.camera_of_block == camera)
        if len(blocks) == 0:
            return slice(0, 0), blocks
        return slice(int(self.offsets[blocks[0]]), int(self.offsets[blocks[-1] + 1])), blocks


@dataclass
class BundleState:
    """Values of the unknowns.

    Attributes
    ----------
    intrinsics : list of ndarray
        θ_c = (fx, fy, cx, cy, s, k…), one a camera.
    R_rig, t_rig : ndarray of shape (C, 3, 3), (C, 3)
        Camera c relative to camera 0.
    R_views, t_views : ndarray of shape (V, 3, 3), (V, 3)
        Board relative to camera 0.
    shape : ndarray of shape (m,)
        β.
    """

    intrinsics: list[Float]
    R_rig: Float
    t_rig: Float
    R_views: Float
    t_views: Float
    shape: Float = field(default_factory=lambda: np.zeros(0))

    @cached_property
    def rvecs(self) -> Float:
        """Rotation vectors of the views, (V, 3)."""
        return rotation_vectors(self.R_views)

    def shared_vector(self) -> Float:
        """Return all shared parameters in a row; the rig's rotations, which are corrected by ω, count as 0."""
        rig = [np.concatenate([np.zeros(3), t]) for t in self.t_rig[1:]]
        return np.concatenate([*self.intrinsics, *rig, self.shape])

    def moved(self, shared: Float, poses: Float) -> BundleState:
        """Return the state after the step `shared` (n_shared,) and `poses` (V, 6) = (ω_v, δt_v)."""
        intrinsics, at = [], 0
        for theta in self.intrinsics:
            intrinsics.append(theta + shared[at : at + len(theta)])
            at += len(theta)
        rig = shared[at : at + 6 * (len(self.t_rig) - 1)].reshape(-1, 6)
        R_rig, t_rig = self.R_rig.copy(), self.t_rig.copy()
        for c, step in enumerate(rig, start=1):
            R_rig[c] = rotation_matrix(step[:3]) @ R_rig[c]
            t_rig[c] = t_rig[c] + step[3:]
        turns = rotation_matrices(poses[:, :3])
        beta = self.shape + shared[at + rig.size :]
        return BundleState(intrinsics, R_rig, t_rig, turns @ self.R_views, self.t_views + poses[:, 3:], beta)


@dataclass
class NormalEquations:
    """F and its normal equations at a state: U (F, F), b_z (F,), V (V, 6, 6), b_v (V, 6), W (V, F, 6).

    `residuals` (M, 2) are p̃ − y there, neither weighted nor robust. `schur` and `half` keep the Schur complement S
    and C of S⁻¹ = C Cᵀ once ``bundle_solver`` and ``covariance`` have computed them. `eliminate`, which the compiled
    engine gives, returns L⁻¹ of the Cholesky factors of V (V, 6, 6), Z = L⁻¹ Wᵀ (V, 6, F) and the factor of S (F, F;
    its lower triangle); None where one is not positive definite.
    """

    cost: float
    U: Float
    b_shared: Float
    V: Float
    b_views: Float
    W: Float
    residuals: Float
    schur: tuple[Float, Float] | None = None
    half: Float | None = None
    eliminate: Callable[[], tuple[Float, Float, Float] | None] | None = None

    @cached_property
    def factors(self) -> tuple[Float, Float, Float] | None:
        """What `eliminate` returns."""
        return None if self.eliminate is None else self.eliminate()

    @cached_property
    def V_inverse(self) -> Float:
        """All V⁻¹, (V, 6, 6)."""
        return np.asarray(np.linalg.inv(self.V))


def residuals(bundle: Bundle, state: BundleState) -> Float:
    """Return p̃ − y of every measurement, (M, 2) pixels; NaN behind a camera or outside of a lens model's domain."""
    out = np.empty_like(bundle.measured)
    for c in range(len(bundle.models)):
        rows, _ = bundle.rows_of_camera(c)
        _, _, X_c = points_in_camera(bundle, state, c)
        with np.errstate(all="ignore"):
            x = np.where(X_c[:, 2:] > 0, X_c[:, :2] / X_c[:, 2:], np.nan)
        theta = state.intrinsics[c]
        x_d = bundle.models[c].distort_compiled(x, theta[5:])
        out[rows, 0] = theta[0] * x_d[:, 0] + theta[4] * x_d[:, 1] + theta[2] - bundle.measured[rows, 0]
        out[rows, 1] = theta[1] * x_d[:, 1] + theta[3] - bundle.measured[rows, 1]
    return out


def cost(bundle: Bundle, state: BundleState) -> float:
    """Return F = Σ ρ(‖p̃ − y‖²) + priors; infinite where a point cannot be projected."""
    r = residuals(bundle, state)
    if not np.all(np.isfinite(r)):
        return float(np.inf)
    if bundle.whitening is not None:
        r = np.einsum("nij,nj->ni", bundle.whitening, r)
    from stereocal.camera.losses import loss_and_weight

    value = float(np.sum(loss_and_weight(np.sum(r * r, axis=1), bundle.loss, bundle.loss_scale)[0]))
    return value + prior_equations(bundle, state)[0]


def normal_equations(bundle: Bundle, state: BundleState) -> NormalEquations:
    """Return F, U, V, W and b at a state.

    Parameters
    ----------
    bundle : Bundle
        The measurements.
    state : BundleState
        Where.

    Returns
    -------
    NormalEquations
        Cost infinite if a point cannot be projected.
    """
    from stereocal.camera.losses import loss_and_weight

    free = bundle.G.shape[1]
    out = NormalEquations(0.0, np.zeros((free, free)), np.zeros(free), np.zeros((bundle.view_count, 6, 6)),
                          np.zeros((bundle.view_count, 6)), np.zeros((bundle.view_count, free, 6)),
                          np.empty_like(bundle.measured))  # fmt: skip
    for c in range(len(bundle.models)):
        r, J_shared, J_pose = camera_jacobian(bundle, state, c)
        rows, blocks = bundle.rows_of_camera(c)
        out.residuals[rows] = r
        if not np.all(np.isfinite(r)):
            out.cost = np.inf
            return out
        if bundle.whitening is not None:
            half = bundle.whitening[rows]
            r, J_shared, J_pose = np.einsum("nij,nj->ni", half, r), half @ J_shared, half @ J_pose
        rho, weight = loss_and_weight(np.sum(r * r, axis=1), bundle.loss, bundle.loss_scale)
        out.cost += float(np.sum(rho))
        if bundle.loss != "linear":
            root = np.sqrt(weight)[:, None]
            r, J_shared, J_pose = r * root, J_shared * root[:, :, None], J_pose * root[:, :, None]
        for block in blocks:
            part = slice(int(bundle.offsets[block]) - rows.start, int(bundle.offsets[block + 1]) - rows.start)
            view = bundle.view_of_block[block]
            e = r[part].ravel()
            Jz, Jv = J_shared[part].reshape(len(e), free), J_pose[part].reshape(len(e), 6)
            out.U += Jz.T @ Jz
            out.b_shared += Jz.T @ e
            out.V[view] += Jv.T @ Jv
            out.b_views[view] += Jv.T @ e
            out.W[view] += Jz.T @ Jv
    prior_cost, prior_U, prior_b = prior_equations(bundle, state)
    out.cost += prior_cost
    if bundle.prior_weights is not None:
        out.U += prior_U
        out.b_shared += prior_b
    return out


def camera_jacobian(bundle: Bundle, state: BundleState, camera: int) -> tuple[Float, Float, Float]:
    """Return p̃ − y (m, 2), ∂p̃/∂z (m, 2, n_free) and ∂p̃/∂(ω_v, t_v) (m, 2, 6) of one camera's measurements."""
    rows, _ = bundle.rows_of_camera(camera)
    Y, X_0, X_c = points_in_camera(bundle, state, camera)
    theta, R_c = state.intrinsics[camera], state.R_rig[camera]
    with np.errstate(all="ignore"):
        x = np.where(X_c[:, 2:] > 0, X_c[:, :2] / X_c[:, 2:], np.nan)
    x_d, D, D_k = bundle.models[camera].jacobians(x, theta[5:])
    A = np.array([[theta[0], theta[4]], [0.0, theta[1]]])
    g = A @ D @ perspective_jacobian(x, X_c[:, 2])
    q = g @ R_c
    r = x_d @ A.T + theta[2:4] - bundle.measured[rows]

    J_pose = np.concatenate([np.cross(Y[:, None, :], q), q], axis=2)
    J_theta = np.zeros((len(x), 2, len(theta)))
    J_theta[:, 0, 0], J_theta[:, 1, 1] = x_d[:, 0], x_d[:, 1]
    J_theta[:, 0, 2] = J_theta[:, 1, 3] = 1
    J_theta[:, 0, 4] = x_d[:, 1]
    J_theta[:, :, 5:] = A @ D_k
    J_shared = J_theta @ bundle.G[bundle.intrinsic_slices[camera]]
    if camera > 0:
        J_rig = np.concatenate([np.cross((X_0 @ R_c.T)[:, None, :], g), g], axis=2)
        J_shared += J_rig @ bundle.G[bundle.rig_slices[camera]]
    if bundle.shape_basis is not None and bundle.shape_index is not None:
        J_X = q @ state.R_views[_view_of_row(bundle, camera)]
        # all of β is free: its part of G is the identity, in the last columns
        unknowns = bundle.shape_basis.shape[2]
        J_shared[:, :, -unknowns:] = J_X @ bundle.shape_basis[bundle.shape_index[rows]]
    return r, J_shared, J_pose


def _view_of_row(bundle: Bundle, camera: int) -> np.ndarray:
    _, blocks = bundle.rows_of_camera(camera)
    return np.repeat(bundle.view_of_block[blocks], np.diff(bundle.offsets)[blocks])


def points_in_camera(bundle: Bundle, state: BundleState, camera: int) -> tuple[Float, Float, Float]:
    """Return Y = R_v X, X_0 = Y + t_v and X_c = R_c X_0 + t_c of one camera's measurements, (m, 3) each."""
    rows, _ = bundle.rows_of_camera(camera)
    view = _view_of_row(bundle, camera)
    X = bundle.points[rows]
    if bundle.shape_basis is not None and bundle.shape_index is not None:
        X = X + (bundle.shape_basis @ state.shape)[bundle.shape_index[rows]]
    Y = np.einsum("nij,nj->ni", state.R_views[view], X)
    X_0 = Y + state.t_views[view]
    return Y, X_0, X_0 @ state.R_rig[camera].T + state.t_rig[camera]


def prior_equations(bundle: Bundle, state: BundleState) -> tuple[float, Float, Float]:
    """Return F, U and b of the priors Σ (w (s − m))² alone."""
    if bundle.prior_weights is None or bundle.prior_means is None:
        return 0.0, np.zeros(0), np.zeros(0)
    e = bundle.prior_weights * (state.shared_vector() - bundle.prior_means)
    J = bundle.prior_weights[:, None] * bundle.G
    return float(e @ e), J.T @ J, J.T @ e
