"""The rational function model: a 3×6 matrix on the monomials of degree two [eq 17].

    χ = [x², xy, y², x, y, 1]ᵀ of the distorted point,        (x_u, y_u, 1) ~ W χ:

    x_u = W₁ᵀχ / W₃ᵀχ,        y_u = W₂ᵀχ / W₃ᵀχ.

Both components share the denominator W₃ᵀχ; the paper prints W₃ for one and W₄ for the other, but W has three rows, and
with two denominators a straight line would not become a conic, which is the point of the model (Claus and
Fitzgibbon, 2005).

Here k is W row by row, W₁ then W₂ then W₃. The scale of W is free, and its right half acts as a homography of
the plane, the work that K and the poses already do. A calibration therefore holds that half at the identity and
frees the nine coefficients of the quadratic monomials.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.distortion_base import BackwardModel

_NAMES = tuple(f"w{row}{column}" for row in (1, 2, 3) for column in range(1, 7))


class RationalFunction(BackwardModel):
    """Rational function: w11 … w36, row by row; (x_u, y_u) = (W₁ᵀχ / W₃ᵀχ, W₂ᵀχ / W₃ᵀχ), [eq 17] corrected.

    Notes
    -----
    OpenCV has no such model; its ``CALIB_RATIONAL_MODEL`` is a ratio of polynomials in r², ``"rational"`` here.
    """

    name = "rational_function"
    parameter_names = _NAMES
    fixed_by_default = tuple(name for name in _NAMES if name[2] in "456")

    def neutral(self) -> Float:
        """Return W = [0 | I]: the ideal lens."""
        return np.hstack([np.zeros((3, 3)), np.eye(3)]).ravel()

    def distort_compiled(self, x: Float, k: Float) -> Float:
        """Return the same as `distort`, from a kernel: a calibration asks for it at every step."""
        from stereocal.camera.distortion_inverse_kernels import invert_map_kernel

        x_d = np.empty_like(x, order="C")
        invert_map_kernel(np.ascontiguousarray(x), k, np.inf, x_d)
        return x_d

    def undistort_compiled(self, x_d: Float, k: Float) -> Float:
        """Return the same as `undistort`, from a kernel."""
        from stereocal.camera.distortion_inverse_kernels import map_inside_kernel

        x_u = np.empty_like(x_d, order="C")
        map_inside_kernel(np.ascontiguousarray(x_d), k, x_u)
        return x_u

    def jacobians_compiled(self, x: Float, k: Float) -> tuple[Float, Float, Float]:
        """Return the same as `jacobians`, from a kernel."""
        from stereocal.camera.distortion_inverse_kernels import rational_function_jacobians_kernel

        x_d = self.distort_compiled(x, k)
        D, D_k = np.empty((len(x), 2, 2)), np.empty((len(x), 2, 18))
        rational_function_jacobians_kernel(x_d, k, D, D_k)
        return x_d, D, D_k

    def undistort_jacobians(self, x_d: Float, k: Float) -> tuple[Float, Float, Float]:
        """Return x_u = h₁₂/h₃, and dx_u = (dh₁₂ − x_u dh₃) / h₃ by x_d and by W."""
        x_u, J = self.undistort_slope(x_d, k)
        chi = _monomials(x_d)
        with np.errstate(all="ignore"):
            chi_h = chi / (chi @ k[12:, None])
        J_k = np.zeros((len(x_d), 2, 18))
        J_k[:, 0, 0:6] = J_k[:, 1, 6:12] = chi_h
        J_k[:, :, 12:] = -x_u[:, :, None] * chi_h[:, None, :]
        return x_u, J, J_k

    def undistort_slope(self, x_d: Float, k: Float) -> tuple[Float, Float]:
        """Return x_u and dx_u by x_d: dh = W dχ, dχ = (2x, y, 0, 1, 0, 0) dx + (0, x, 2y, 0, 1, 0) dy."""
        W = k.reshape(3, 6)
        h = _monomials(x_d) @ W.T
        x, y = x_d[:, :1], x_d[:, 1:]
        by_x = 2 * x * W[:, 0] + y * W[:, 1] + W[:, 3]
        by_y = x * W[:, 1] + 2 * y * W[:, 2] + W[:, 4]
        with np.errstate(all="ignore"):
            x_u = h[:, :2] / h[:, 2:]
            J = np.stack([by_x[:, :2] - x_u * by_x[:, 2:], by_y[:, :2] - x_u * by_y[:, 2:]], axis=2) / h[:, 2:, None]
        return x_u, np.asarray(J)


def _monomials(x: Float) -> Float:
    """χ = [x², xy, y², x, y, 1] of each point."""
    u, v = x[:, 0], x[:, 1]
    return np.stack([u * u, u * v, v * v, u, v, np.ones_like(u)], axis=1)
