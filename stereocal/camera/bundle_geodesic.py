"""Following a curved valley: Levenberg–Marquardt steps with geodesic acceleration.

Lenses of many coefficients leave F flat along a curve, not along a line: numerator and denominator of a rational lens
grow together, a shift of the principal point is undone by turns of all boards and a little of every coefficient. A
straight step δ leaves such a valley sideways as its square grows, the damping shortens it, and the way becomes
thousands of steps long.

The residuals along the step are r(x + tδ) ≈ r + t Jδ + ½ t² r″, with r″ the second derivative along δ. A path
x + tδ + ½ t² a stays in the valley to second order if its acceleration a undoes r″ as far as J can,

    (A + μD²) δ = −Jᵀr,        (A + μD²) a = −Jᵀ r″,        x ← x + δ + ½ a.

It is taken where it is a correction, 2 ‖D ½a‖ ≤ ¾ ‖Dδ‖; elsewhere the series says nothing and the straight step is left
as it is. Whether the whole was right, the gain ratio decides as always. r″ is a central difference along δ alone,

    r″ ≈ (r(x + hδ) − 2r(x) + r(x − hδ)) / h²,        h = 0.1,

and Jᵀr″ needs no J: it is the gradient of a fit whose residuals at x are r″, that is, whose corners lie at p̃ − r″. So a
step costs about twice as much, and pays where valleys are long: a tilted sensor that had not arrived after 2,000 steps
does so in 300.

Source: Transtrum and Sethna, *Improvements to the Levenberg–Marquardt algorithm for nonlinear least-squares
minimization* (2012).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.bundle import residuals
from stereocal.camera.bundle_solver import NumpyEngine, damped_step

# How long the step is on which r″ is measured, as a part of δ, and how long ½a may be, as a part of δ.
_DIFFERENCE = 0.1
_LONGEST = 0.375


class GeodesicEngine(NumpyEngine):
    """The equations of ``bundle``, with steps that bend along a valley; for the quadratic loss.

    Made like :class:`~stereocal.camera.bundle_solver.NumpyEngine`: of a bundle, a start, and what gives the equations.
    """

    def bend(self, dz: Float, dv: Float, mu: float) -> tuple[Float, Float]:
        """Return δ + ½a, or δ where ½a is no small correction of it."""
        second = self._second_derivative(dz, dv)
        if not np.all(np.isfinite(second)):
            return dz, dv
        # corners at p̃ − r″ make the residuals r″, and their gradient Jᵀr″; priors are linear and have no r″
        corners = self.equations.residuals + self._bundle.measured - second
        bent = self._evaluate(replace(self._bundle, measured=corners, prior_weights=None), self._state)
        equations = replace(self.equations, b_shared=bent.b_shared, b_views=bent.b_views)
        acceleration = damped_step(equations, mu, *self._D2)
        if acceleration is None:
            return dz, dv
        az, av = 0.5 * acceleration[0], 0.5 * acceleration[1]
        return (dz + az, dv + av) if self._length(az, av) <= _LONGEST * self._length(dz, dv) else (dz, dv)

    def _second_derivative(self, dz: Float, dv: Float) -> Float:
        """r″ of all residuals along δ, (M, 2)."""
        h = _DIFFERENCE
        ahead, behind = (
            residuals(self._bundle, self._state.moved(self._bundle.G @ (sign * h * dz), sign * h * dv))
            for sign in (1, -1)
        )
        return (ahead - 2 * self.equations.residuals + behind) / h**2

    def _length(self, dz: Float, dv: Float) -> float:
        """‖D δ‖."""
        return float(np.sqrt(np.sum(dz**2 * self._D2[0]) + np.sum(dv**2 * self._D2[1])))
