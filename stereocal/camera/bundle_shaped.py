"""The compiled engine for a board whose shape is unknown: what a corner does not touch is not multiplied.

Released points (``board_shape``) add three unknowns a board point, so that J has hundreds of columns; but a corner
depends on the cameras, on one pose and on ONE point. Order the unknowns as shared ones z (cameras, rig), poses v and
points p. JᵀJ is then small blocks on the diagonal, V_v (6 × 6) and Q_p (3 × 3), and their products with each other,
C_pv, and with z, W_v and P_p:

    [ U    W    P  ] [ δz ]     [ b_z ]
    [ Wᵀ   V    Cᵀ ] [ δv ] = − [ b_v ]
    [ Pᵀ   C    Q  ] [ δp ]     [ b_p ]

No two points share a row of J and no two poses do, so that either group goes block by block, exactly as the poses do
in ``bundle``. Of the two the larger one goes first, points where 3 P > 6 V; what is left, of the size of z and the
smaller group, is dense and solved by Cholesky's method. A bow has few unknowns, which all corners touch: they count
among z, and no points are left.

The residual is one more unknown of z, the last, as in ``bundle_kernels``, so that b rides along. The lens is the NumPy
one, so that every model is served; weights, losses and priors are those of ``bundle``. The readable twin is
``bundle.normal_equations`` with its dense Φ and ``bundle_solver.NumpyEngine``.

Source: Triggs et al., *Bundle adjustment: a modern synthesis* (2000), section 6.1: either group may be eliminated.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.bundle import Bundle, BundleState, NormalEquations, prior_equations
from stereocal.camera.losses import loss_and_weight


def has_sparse_shape(bundle: Bundle) -> bool:
    """Whether the compiled twin knows this bundle: a shape, plain or tied parameters, priors on no released point."""
    if bundle.shape_basis is None or bundle.shape_index is None:
        return False
    plain = bool((np.count_nonzero(bundle.G, axis=1) <= 1).all())
    return plain and (bundle.prior_weights is None or not bundle.prior_weights[bundle.shape_slice].any())


def is_released(basis: Float) -> bool:
    """Whether Φ picks single coordinates, each for one unknown."""
    return bool((np.count_nonzero(basis, axis=(0, 1)) == 1).all() and np.count_nonzero(basis == 1) == basis.shape[2])


class ShapedEngine:
    """What ``bundle_solver.NumpyEngine`` does, by kernels, for a bundle with a `shape_basis`."""

    def __init__(self, bundle: Bundle, state: BundleState) -> None:
        from stereocal.camera import bundle_shaped_kernels

        self._kernels, self._bundle, self._state = bundle_shaped_kernels, bundle, state
        basis = np.asarray(bundle.shape_basis)
        released = is_released(basis)
        self._free = np.asarray(basis.any(axis=2) & released)
        self._dense = np.zeros((len(basis), 3, 0)) if released else np.ascontiguousarray(basis)
        self._points = len(basis) if released else 0
        self._F = bundle.G.shape[1] - (basis.shape[2] if released else 0)
        self._index = np.asarray(bundle.shape_index)
        self._cameras = [self._layout(c) for c in range(len(bundle.models))]
        self._sums, self.residuals, self.cost = self._evaluate(state)
        self._there = (state, self._sums, self.residuals, self.cost)
        self._points_first = 3 * self._points > 6 * bundle.view_count
        self._D2: tuple[Float, ...] = tuple(np.zeros(len(d)) for d in self._diagonals())
        self._work = self._work_arrays()
        self._scale()

    def _layout(self, c: int) -> tuple[Any, ...]:
        """Of a camera: rows, blocks (view, first row, end), free parameters' places and factors, places in z."""
        bundle, F = self._bundle, self._F
        rows, blocks = bundle.rows_of_camera(c)
        where = np.stack([bundle.view_of_block[blocks], bundle.offsets[blocks], bundle.offsets[blocks + 1]], axis=1)
        own = bundle.G[bundle.intrinsic_slices[c], :F]
        places, to = np.nonzero(own)
        rig = c > 0
        of_rig = bundle.G[bundle.rig_slices[c], :F]
        held = np.full(len(of_rig), -1)
        ends = np.where(of_rig.any(axis=1), of_rig.argmax(axis=1), held) if F else held
        dense = np.arange(F - self._dense.shape[2], F)
        where = np.ascontiguousarray(where, dtype=np.int64)
        columns = np.concatenate([ends, to, dense, [F]]).astype(np.int64)
        n, widest = 6 + len(columns), 2 * int(np.diff(where[:, 1:], axis=1).max(initial=0))
        scratch = (
            np.empty((n, widest)), np.empty((n, n)), np.empty(3), np.empty(3), np.empty((2, 3)), np.empty(len(own)),
        )  # fmt: skip
        return rows, where, places, own[places, to], columns, rig, scratch

    def _work_arrays(self) -> tuple[Float, ...]:
        views, count, F = self._bundle.view_count, self._points, self._F
        (E, e), (H, h) = ((count, 3), (views, 6)) if self._points_first else ((views, 6), (count, 3))
        R = F + h * H
        return (
            np.empty((R + 1, R + 1)), np.empty((E, e, e)), np.empty((E + 1, e, R + 1)), np.empty(F), np.empty((H, h)),
            np.empty((E, e)),
        )  # fmt: skip

    def _evaluate(self, state: BundleState) -> tuple[tuple[Float, ...], Float, float]:
        """U, V, W, Q, P, C at a state, the residuals and F."""
        bundle, F, count, views = self._bundle, self._F, self._points, self._bundle.view_count
        sums = (
            np.zeros((F + 1, F + 1)), np.zeros((views, 6, 6)), np.zeros((views, 6, F + 1)), np.zeros((count, 3, 3)),
            np.zeros((count, 3, F + 1)), np.zeros((count, views, 3, 6)),
        )  # fmt: skip
        if count:
            sums[3][:, range(3), range(3)] = ~self._free
        X = bundle.points + self._offsets(state)[self._index]
        residuals, cost = np.empty_like(bundle.measured), 0.0
        for c, (rows, blocks, places, factor, to, rig, scratch) in enumerate(self._cameras):
            m = rows.stop - rows.start
            if m == 0:
                continue
            Y, X_c, x = np.empty((m, 3)), np.empty((m, 3)), np.empty((m, 2))
            poses = (state.R_rig[c], state.t_rig[c], state.R_views, state.t_views)
            R_rig, t_rig, R_views, t_views = (np.ascontiguousarray(part) for part in poses)
            place = (blocks, X, R_rig, t_rig, R_views, t_views, Y, X_c, x)
            if self._kernels.place_kernel(*place) > 0:
                return sums, residuals, np.inf
            theta = state.intrinsics[c]
            x_d, D, D_k = (np.ascontiguousarray(part) for part in bundle.models[c].jacobians(x, theta[5:]))
            r = x_d * theta[:2] + theta[2:4] - bundle.measured[rows]
            r[:, 0] += theta[4] * x_d[:, 1]
            residuals[rows] = r
            if not np.isfinite(r).all():
                return sums, residuals, np.inf
            rho, weights = self._weights(r, rows)
            cost += rho
            self._kernels.equations_kernel(
                blocks, self._index, self._free, self._dense, weights, r, x_d, D, D_k, Y, X_c, x, theta, R_rig, t_rig,
                R_views, places, factor, to, rig, *sums, *scratch,
            )  # fmt: skip
        if bundle.prior_weights is not None:
            more, U, b = prior_equations(bundle, state)
            sums[0][:F, :F] += U[:F, :F]
            sums[0][F, :F] += b[:F]
            sums[0][:F, F] += b[:F]
            cost += more
        return sums, residuals, cost

    def _weights(self, r: Float, rows: slice) -> tuple[float, Float]:
        """Σρ of a camera's residuals, and what its rows of J are multiplied by, (M, 2, 2) of all or none."""
        bundle = self._bundle
        if bundle.whitening is None and bundle.loss == "linear":
            return float(np.vdot(r, r)), np.zeros((0, 2, 2))
        half = np.tile(np.eye(2), (len(r), 1, 1)) if bundle.whitening is None else bundle.whitening[rows]
        white = np.einsum("nij,nj->ni", half, r)
        rho, weight = loss_and_weight(np.sum(white * white, axis=1), bundle.loss, bundle.loss_scale)
        weights = np.zeros((len(bundle.points), 2, 2))
        weights[rows] = half * np.sqrt(weight)[:, None, None]
        return float(np.sum(rho)), weights

    def _offsets(self, state: BundleState) -> Float:
        """Φβ, (P, 3)."""
        if self._points == 0:
            return np.asarray(self._dense @ state.shape)
        offsets = np.zeros(self._free.shape)
        offsets[self._free] = state.shape
        return offsets

    def _diagonals(self) -> tuple[Float, Float, Float]:
        U, V, _, Q, _, _ = self._sums
        of_views, of_points = (np.diagonal(A, axis1=1, axis2=2).ravel() for A in (V, Q))
        return np.diag(U)[: self._F], of_views, of_points

    def _scale(self) -> None:
        """D², the largest diagonals met, is renewed."""
        for D2, diagonal in zip(self._D2, self._diagonals(), strict=True):
            np.maximum(D2, diagonal, out=D2)
            D2[D2 == 0] = 1.0

    def propose(self, mu: float) -> tuple[float, float, float] | None:
        """Solve (A + μD²) δ = −b and evaluate F at the end of δ."""
        step = self._solve(mu)
        if step is None:
            return None
        promised, longest, dz, dv, dp = step
        G = self._bundle.G
        state = self._state.moved(G @ np.concatenate([dz, dp[self._free[: self._points]]]), dv)
        self._there = (state, *self._evaluate(state))
        return promised, longest, self._there[3]

    def _solve(self, mu: float) -> tuple[float, float, Float, Float, Float] | None:
        """The promised decrease, max |Dδ|, and δ of z, poses and points."""
        U, V, W, Q, P, C = self._sums
        D2, D2_v, D2_p = self._D2[0], self._D2[1].reshape(-1, 6), self._D2[2].reshape(-1, 3)
        if self._points_first:
            arrays = (U, V, W, Q, P, C, mu, D2, D2_v, D2_p)
        else:
            arrays = (U, Q, P, V, W, np.ascontiguousarray(C.transpose(1, 0, 3, 2)), mu, D2, D2_p, D2_v)
        promised, longest = self._kernels.shaped_step_kernel(*arrays, *self._work)
        dz, dh, de = self._work[3:]
        if longest == -1.0 or not np.isfinite(longest):
            return None
        return promised, longest, dz, *((dh, de) if self._points_first else (de, dh))

    def accept(self) -> None:
        """Move on; the scaling D keeps the largest diagonals met."""
        self._state, self._sums, self.residuals, self.cost = self._there
        if np.isfinite(self.cost):
            self._scale()

    def gradient_norm(self) -> float:
        """Return the largest |b_i| / √(A_ii F), the cosine of residuals and a column of the Jacobian."""
        if self.cost <= 0:
            return 0.0
        U, _, W, _, P, _ = self._sums
        b = np.concatenate([U[self._F, : self._F], W[:, :, self._F].ravel(), P[:, :, self._F].ravel()])
        diagonal = np.concatenate(self._diagonals())
        slopes = np.abs(b) / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
        return float(slopes.max(initial=0.0) / np.sqrt(self.cost))

    @property
    def equations(self) -> NormalEquations:
        """The normal equations here, in full, as ``bundle`` has them."""
        U, V, W, Q, P, C = self._sums
        F, views = self._F, len(V)
        free = self._free[: self._points].ravel()
        at = F + np.arange(np.count_nonzero(free))
        all_U, b = np.zeros((F + len(at),) * 2), np.empty(F + len(at))
        all_U[:F, :F], b[:F] = U[:F, :F], U[F, :F]
        all_W = np.empty((views, F + len(at), 6))
        all_W[:, :F] = W[:, :, :F].transpose(0, 2, 1)
        if len(at):
            own = P.reshape(-1, F + 1)[free]
            all_U[at, :F], all_U[:F, at], b[at] = own[:, :F], own[:, :F].T, own[:, F]
            all_W[:, at] = C.transpose(1, 0, 2, 3).reshape(views, -1, 6)[:, free]
            number = np.cumsum(free).reshape(-1, 3) - 1 + F
            for i in range(3):
                for k in range(3):
                    both = self._free[:, i] & self._free[:, k]
                    all_U[number[both, i], number[both, k]] = Q[both, i, k]
        return NormalEquations(self.cost, all_U, b, V, W[:, :, F], all_W, self.residuals)

    def state(self) -> BundleState:
        """Return the state."""
        return self._state
