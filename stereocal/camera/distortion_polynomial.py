"""The paper's model: two radial coefficients, in either direction [eq 18].

The paper prints

    (x_u, y_u) = (x_d, y_d) (1 + k1 r_d² + k2 r_d⁴),

distorted → undistorted. Zhang (2000), OpenCV and the paper's own code apply the same polynomial the other way,

    (x_d, y_d) = (x_u, y_u) (1 + k1 r_u² + k2 r_u⁴).

The two are different families of curves that meet only to first order: the inverse of r(1 + k1 r² + k2 r⁴) begins r(1
− k1 r² + (3 k1² − k2) r⁴ − …), so that a k1 taken from one and used in the other has the wrong sign. Both stand here,
as ``"polynomial"`` (the usual direction, the default) and ``"polynomial_printed"`` (the printed one).
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.distortion_base import BackwardModel, ForwardModel
from stereocal.camera.distortion_inverse import first_turning_point, invert_radial, invert_radial_compiled


class Pinhole(ForwardModel):
    """No distortion: x_d = x; no parameters. A skew, if any, stands in K[0, 1]."""

    name = "pinhole"
    parameter_names = ()

    def distort(self, x: Float, k: Float) -> Float:
        """Return x."""
        return x.copy()

    def undistort(self, x_d: Float, k: Float) -> Float:
        """Return x_d."""
        return x_d.copy()

    def jacobians(self, x: Float, k: Float) -> tuple[Float, Float, Float]:
        """Return x, the identity, and a derivative of no columns."""
        return x.copy(), np.tile(np.eye(2), (len(x), 1, 1)), np.zeros((len(x), 2, 0))


class Polynomial(ForwardModel):
    """Two radial coefficients, k1, k2: x_d = x_u (1 + k1 r_u² + k2 r_u⁴), the usual direction of [eq 18].

    Notes
    -----
    Zhang's model, and OpenCV's with ``CALIB_ZERO_TANGENT_DIST | CALIB_FIX_K3``.
    """

    name = "polynomial"
    parameter_names = ("k1", "k2")

    def distort(self, x: Float, k: Float) -> Float:
        """Return x (1 + k1 r² + k2 r⁴)."""
        s = np.sum(x * x, axis=1)
        return np.asarray(x * (1 + s * (k[0] + s * k[1]))[:, None])

    def undistort(self, x_d: Float, k: Float) -> Float:
        """Return x with distort(x, k) = x_d; NaN where r_d is beyond the turning point of r(1 + k1 r² + k2 r⁴)."""
        return _inverse(x_d, k)

    def undistort_compiled(self, x_d: Float, k: Float) -> Float:
        """Return the same as `undistort`, from a kernel."""
        limit = np.sqrt(first_turning_point(np.array([1, 3 * k[0], 5 * k[1]])))
        return invert_radial_compiled(x_d, k, np.zeros(3), float(limit))

    def jacobians(self, x: Float, k: Float) -> tuple[Float, Float, Float]:
        """Return x_d, ∂x_d/∂x and ∂x_d/∂k."""
        return _jacobians(x, k)


class PolynomialPrinted(BackwardModel):
    """Two radial coefficients, k1, k2: x_u = x_d (1 + k1 r_d² + k2 r_d⁴), [eq 18] as the paper prints it."""

    name = "polynomial_printed"
    parameter_names = ("k1", "k2")

    def undistort(self, x_d: Float, k: Float) -> Float:
        """Return x_d (1 + k1 r_d² + k2 r_d⁴); NaN beyond the turning point, where no x is its own image."""
        s = np.sum(x_d * x_d, axis=1)
        inside = s < first_turning_point(np.array([1, 3 * k[0], 5 * k[1]]))
        return np.where(inside[:, None], x_d * (1 + s * (k[0] + s * k[1]))[:, None], np.nan)

    def distort(self, x: Float, k: Float) -> Float:
        """Return x_d with undistort(x_d, k) = x; NaN where there is none."""
        return _inverse(x, k)

    def undistort_jacobians(self, x_d: Float, k: Float) -> tuple[Float, Float, Float]:
        """Return x_u, ∂x_u/∂x_d and ∂x_u/∂k."""
        return _jacobians(x_d, k)


def _inverse(y: Float, k: Float) -> Float:
    """The x with x (1 + k1 r² + k2 r⁴) = y on the rising branch."""
    limit = np.sqrt(first_turning_point(np.array([1, 3 * k[0], 5 * k[1]])))

    def g(r: Float) -> tuple[Float, Float]:
        s = r * r
        return r * (1 + s * (k[0] + s * k[1])), 1 + s * (3 * k[0] + 5 * s * k[1])

    length = np.hypot(y[:, 0], y[:, 1])
    r = invert_radial(g, length, float(limit))
    return np.asarray(y * np.where(length > 0, r / np.where(length > 0, length, 1.0), 1.0)[:, None])


def _jacobians(x: Float, k: Float) -> tuple[Float, Float, Float]:
    """Of x ↦ x f(s), f = 1 + k1 s + k2 s²: ∂/∂x = f I + 2 f′ x xᵀ, ∂/∂k = x [s, s²]."""
    s = np.sum(x * x, axis=1)
    f, f_s = 1 + s * (k[0] + s * k[1]), k[0] + 2 * s * k[1]
    J = f[:, None, None] * np.eye(2) + 2 * f_s[:, None, None] * x[:, :, None] * x[:, None, :]
    return x * f[:, None], J, x[:, :, None] * np.stack([s, s * s], axis=1)[:, None, :]
