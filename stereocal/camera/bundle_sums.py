"""Normal equations for lenses that the kernels have no columns of: derivatives from the model, sums from a kernel.

``bundle_kernels`` knows OpenCV's lenses by their formulas. Any other lens gives ∂x_d/∂x and ∂x_d/∂k for all points in
one call (``distortion_base``), and what is left, the chain to pixels, poses and free parameters and the sums U, V, W,
is the same for all lenses. In NumPy it takes three quarters of the time of a step; here it is a kernel, which answers
to ``bundle.normal_equations`` to rounding. What the model said last is kept: steps along a valley (``bundle_geodesic``)
ask for other sums at the same place.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.bundle import Bundle, BundleState, NormalEquations


def has_sums(bundle: Bundle) -> bool:
    """Whether the kernel knows this bundle: one camera, least squares, a flat board, no priors."""
    return (
        len(bundle.models) == 1
        and bundle.loss == "linear"
        and bundle.whitening is None
        and bundle.shape_basis is None
        and bundle.prior_weights is None
    )


class EquationsFromSums:
    """F, U, V, W and b at a state, as ``bundle.normal_equations`` returns them; for bundles of the same points."""

    def __init__(self) -> None:
        self._last: tuple[BundleState, tuple[Float, Float, Float]] | None = None

    def __call__(self, bundle: Bundle, state: BundleState) -> NormalEquations:
        """Return the normal equations.

        Parameters
        ----------
        bundle : Bundle
            The measurements, see :func:`has_sums`; models and points as in all calls.
        state : BundleState
            Where.

        Returns
        -------
        NormalEquations
            Cost infinite if a point cannot be projected.
        """
        from stereocal.camera.bundle_sums_kernels import sums_kernel

        free, views = bundle.G.shape[1], bundle.view_count
        out = NormalEquations(
            np.inf, np.zeros((free, free)), np.zeros(free), np.zeros((views, 6, 6)), np.zeros((views, 6)),
            np.zeros((views, free, 6)), np.full_like(bundle.measured, np.nan),
        )  # fmt: skip
        lens = self._derivatives(bundle, state)
        if not np.all(np.isfinite(lens[0])):
            return out
        rows, columns = np.nonzero(bundle.G)
        cost = sums_kernel(
            bundle.points, bundle.measured, bundle.offsets, bundle.view_of_block, state.R_views, state.t_views,
            state.intrinsics[0], *lens, rows, columns, bundle.G[rows, columns], out.U, out.b_shared, out.V,
            out.b_views, out.W, out.residuals,
        )  # fmt: skip
        if np.isfinite(cost):
            out.cost = float(cost)
        return out

    def _derivatives(self, bundle: Bundle, state: BundleState) -> tuple[Float, Float, Float]:
        """x_d, ∂x_d/∂x and ∂x_d/∂k of all points; x_d NaN behind the camera."""
        if self._last is None or self._last[0] is not state:
            view = np.repeat(bundle.view_of_block, np.diff(bundle.offsets))
            X_c = np.matmul(state.R_views[view], bundle.points[:, :, None])[:, :, 0] + state.t_views[view]
            with np.errstate(all="ignore"):
                x = np.where(X_c[:, 2:] > 0, X_c[:, :2] / X_c[:, 2:], np.nan)
            self._last = state, bundle.models[0].jacobians_compiled(x, state.intrinsics[0][5:])
        return self._last[1]
