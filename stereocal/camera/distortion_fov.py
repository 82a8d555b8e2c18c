"""The field-of-view model: one parameter, the opening angle ω of an ideal fisheye [eq 15].

In a lens whose image radius is proportional to the angle, r_d = θ / ω; a pinhole has r_u = tan θ. Scaled to agree at
the centre for small ω, this reads

    r_u = tan(r_d ω) / (2 tan(ω/2)),        r_d = arctan(2 r_u tan(ω/2)) / ω,

closed in both directions, rising everywhere, with the domain r_d < π / (2ω) for undistorting. ω = 0 is the ideal
lens. Near ω = 0 both radii are even functions of ω, so that the derivative by ω vanishes there, and a calibration has
to start at an ω > 0.

Source: Devernay and Faugeras, *Straight lines have to be straight*, Machine Vision and Applications 13 (2001).
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.distortion_base import DistortionModel

# Below this ω (or r) formulas that divide by it are replaced by their series.
_SMALL = 1e-3


class FieldOfView(DistortionModel):
    """Field of view: ω, radians; (x_u, y_u) = tan(r_d ω) / (2 r_d tan(ω/2)) (x_d, y_d), [eq 15]."""

    name = "fov"
    parameter_names = ("omega",)

    def start(self) -> Float:
        """Return ω = 0.5: at ω = 0 the derivative by ω vanishes."""
        return np.array([0.5])

    def stuck(self, k: Float) -> tuple[str, ...]:
        """Return ω near 0, where a lens that draws pincushions ends: the model has none such."""
        return ("omega",) if abs(k[0]) < _SMALL else ()

    def distort(self, x: Float, k: Float) -> Float:
        """Return x arctan(2 r tan(ω/2)) / (r ω)."""
        return self.jacobians(x, k)[0]

    def undistort(self, x_d: Float, k: Float) -> Float:
        """Return x_d tan(r_d ω) / (2 r_d tan(ω/2)); NaN for r_d ≥ π / (2ω)."""
        omega = abs(float(k[0]))
        r = np.hypot(x_d[:, 0], x_d[:, 1])
        if omega < _SMALL:  # tan(rω)/(2r tan(ω/2)) = 1 + ω²(r²/3 − 1/12) + O(ω⁴)
            return np.asarray(x_d * (1 + omega**2 * (r * r / 3 - 1 / 12))[:, None])
        angle = r * omega
        tiny = angle < _SMALL
        ratio = np.where(tiny, omega * (1 + angle**2 / 3), np.tan(angle) / np.where(tiny, 1.0, r))
        scale = np.where(angle < np.pi / 2, ratio / (2 * np.tan(omega / 2)), np.nan)
        return np.asarray(x_d * scale[:, None])

    def jacobians(self, x: Float, k: Float) -> tuple[Float, Float, Float]:
        """Return x_d = x f, ∂x_d/∂x and ∂x_d/∂ω = x f_ω, with f = arctan(a r) / (r ω), a = 2 tan(ω/2)."""
        omega = float(k[0])
        s = np.sum(x * x, axis=1)
        eye, outer = np.eye(2), x[:, :, None] * x[:, None, :]
        if abs(omega) < _SMALL:  # f = 1 + ω² (1/12 − s/3) + O(ω⁴)
            f = 1 + omega**2 * (1 / 12 - s / 3)
            J = f[:, None, None] * eye - (2 / 3) * omega**2 * outer
            return x * f[:, None], J, (x * (2 * omega * (1 / 12 - s / 3))[:, None])[:, :, None]
        a = 2 * np.tan(omega / 2)
        a_omega = 1 + a * a / 4
        z = a * a * s
        small = z < 1e-3
        r = np.sqrt(np.where(small, 1.0, s))
        # arctan(ar)/(ar) and its derivative by s, in series where ar is small
        A = np.where(small, 1 - z * (1 / 3 - z * (1 / 5 - z * (1 / 7 - z / 9))), np.arctan(a * r) / (a * r))
        series = a * a * (-1 / 3 + z * (2 / 5 - z * (3 / 7 - z * 4 / 9)))
        A_s = np.where(small, series, (1 / (1 + z) - A) / (2 * np.where(small, 1.0, s)))
        f = a / omega * A
        J = f[:, None, None] * eye + (2 * a / omega * A_s)[:, None, None] * outer
        # d arctan(ar)/dω = r a_ω / (1 + a² r²)
        f_omega = a_omega / (omega * (1 + z)) - f / omega
        return x * f[:, None], J, (x * f_omega[:, None])[:, :, None]
