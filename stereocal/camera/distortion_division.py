"""The division model: one parameter k, and a straight line becomes a circle [eq 16].

    x_u = x_d / (1 + k r_d²)

Backward it is a formula; forward a quadratic, k r_u r_d² − r_d + r_u = 0, of whose roots the one that tends to r_u as
k → 0 is

    r_d = 2 r_u / (1 + √(1 − 4 k r_u²)),

written without the difference of near numbers. It rises for r_d < 1/√|k|: for a barrel (k < 0) that is where the ray
reaches 90°, for a pincushion (k > 0) where the curve turns, at r_u = 1 / (2√k). Outside there is no answer (NaN).

Source: Fitzgibbon, *Simultaneous linear estimation of multiple view geometry and lens distortion*, CVPR 2001.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.distortion_base import BackwardModel


class Division(BackwardModel):
    """Division: k; (x_u, y_u) = 1/(1 + k r_d²) (x_d, y_d), [eq 16]."""

    name = "division"
    parameter_names = ("k",)

    def undistort(self, x_d: Float, k: Float) -> Float:
        """Return x_d / (1 + k r_d²); NaN for r_d ≥ 1/√|k|."""
        s = np.sum(x_d * x_d, axis=1)
        with np.errstate(all="ignore"):
            return np.where((np.abs(k[0]) * s < 1)[:, None], x_d / (1 + k[0] * s)[:, None], np.nan)

    def distort(self, x: Float, k: Float) -> Float:
        """Return 2x / (1 + √(1 − 4 k r²)); NaN where 4 k r² > 1."""
        with np.errstate(invalid="ignore"):
            root = np.sqrt(1 - 4 * k[0] * np.sum(x * x, axis=1))
        return np.asarray(x * (2 / (1 + root))[:, None])

    def undistort_jacobians(self, x_d: Float, k: Float) -> tuple[Float, Float, Float]:
        """Return x_u = x_d f, ∂x_u/∂x_d = f I − 2 k f² x_d x_dᵀ and ∂x_u/∂k = −s f² x_d, f = 1/(1 + k s)."""
        s = np.sum(x_d * x_d, axis=1)
        f = 1 / (1 + k[0] * s)
        outer = x_d[:, :, None] * x_d[:, None, :]
        J = f[:, None, None] * np.eye(2) - (2 * k[0] * f * f)[:, None, None] * outer
        return x_d * f[:, None], J, (-x_d * (s * f * f)[:, None])[:, :, None]
