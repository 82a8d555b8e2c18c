"""Kannala and Brandt's fisheye: the angle from the axis is what the lens bends.

A fisheye sees rays at 90° from its axis, where r = tan θ is infinite and a polynomial in r is lost. So the distorted
radius is a polynomial in the angle θ = arctan r itself,

    θ_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸),        x_d = (θ_d / r) x,

k = 0 being the ideal equidistant fisheye, θ_d = θ. Undoing it solves the polynomial for θ on its first rising branch,
and r = tan θ; a θ of 90° or more is a ray that the plane z = 1 cannot hold: NaN.

Source: Kannala and Brandt, *A generic camera model and calibration method for conventional, wide-angle, and fish-eye
lenses*, PAMI 28 (2006); the same as ``cv2.fisheye``.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.distortion_base import ForwardModel
from stereocal.camera.distortion_inverse import first_turning_point, invert_radial, invert_radial_compiled

# Below this radius (θ_d/r − 1) is its series: the closed form divides two numbers that vanish.
_SMALL_RADIUS = 1e-4


class Fisheye(ForwardModel):
    """Kannala–Brandt: k1, k2, k3, k4 of θ_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸).

    Notes
    -----
    Answers to ``cv2.fisheye.distortPoints`` and ``cv2.fisheye.undistortPoints``.
    """

    name = "fisheye"
    parameter_names = ("k1", "k2", "k3", "k4")

    def neutral(self) -> Float:
        """Return zeros: the equidistant lens, which for this model is the one without correction."""
        return np.zeros(4)

    def distort(self, x: Float, k: Float) -> Float:
        """Return x θ_d / r."""
        return self.jacobians(x, k)[0]

    def undistort(self, x_d: Float, k: Float) -> Float:
        """Return x = (tan θ / θ_d) x_d; NaN where θ_d has no θ below 90° on the rising branch."""

        def g(theta: Float) -> tuple[Float, Float]:
            t = theta * theta
            value = theta * (1 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3]))))
            return value, 1 + t * (3 * k[0] + t * (5 * k[1] + t * (7 * k[2] + t * 9 * k[3])))

        theta_d = np.hypot(x_d[:, 0], x_d[:, 1])
        theta = invert_radial(g, theta_d, _last_angle(k))
        return np.asarray(
            x_d * np.where(theta_d > 0, np.tan(theta) / np.where(theta_d > 0, theta_d, 1.0), 1.0)[:, None]
        )

    def undistort_compiled(self, x_d: Float, k: Float) -> Float:
        """Return the same as `undistort`, from a kernel."""
        return invert_radial_compiled(x_d, k, np.zeros(3), _last_angle(k), of_angle=True)

    def jacobians(self, x: Float, k: Float) -> tuple[Float, Float, Float]:
        """Return x_d, ∂x_d/∂x = f I + (f_r / r) x xᵀ with f = θ_d / r, and ∂x_d/∂k = x θ³, θ⁵, θ⁷, θ⁹ / r."""
        s = np.sum(x * x, axis=1)
        r = np.sqrt(s)
        small = r < _SMALL_RADIUS
        safe = np.where(small, 1.0, r)
        theta = np.arctan(r)
        t = theta * theta
        theta_d = theta * (1 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3]))))
        slope = 1 + t * (3 * k[0] + t * (5 * k[1] + t * (7 * k[2] + t * 9 * k[3])))
        # θ = r − r³/3 + r⁵/5, hence f = 1 + (k1 − 1/3) s + (1/5 − k1 + k2) s² and f_r / r = 2 (k1 − 1/3) + 4 (…) s
        series2 = 0.2 - k[0] + k[1]
        f = np.where(small, 1 + s * ((k[0] - 1 / 3) + s * series2), theta_d / safe)
        f_r = np.where(small, 2 * (k[0] - 1 / 3) + 4 * series2 * s, (slope / (1 + s) - f) / safe**2)
        J = f[:, None, None] * np.eye(2) + f_r[:, None, None] * x[:, :, None] * x[:, None, :]
        theta_over_r = np.where(small, 1 - s / 3, theta / safe)
        powers = theta_over_r[:, None] * np.stack([t, t**2, t**3, t**4], axis=1)
        return x * f[:, None], J, x[:, :, None] * powers[:, None, :]


def _last_angle(k: Float) -> float:
    """Where θ_d stops to rise, or 90°."""
    turn = np.sqrt(first_turning_point(np.array([1, 3 * k[0], 5 * k[1], 7 * k[2], 9 * k[3]])))
    return float(min(turn, np.pi / 2))
