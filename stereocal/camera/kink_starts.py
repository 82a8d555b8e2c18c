"""Starts of a rational lens with a pole among the corners: where its lower minima lie.

A curve f(s) = c(s)/q(s), s = r², with a pair of poles next to the radii of the corners and zeros next to them has a
kink there (``lens_doubts``), which bends to the noise of the corners around it. Each stretch of radii has a minimum of
its own, and whether a fit falls into one of them depends on where it began. To tell the lowest, the smooth fit is not
enough of a start: the kink is put at one place after another,

    q = ((1 − s/p)² + w²) / (1 + w²),        p = 0.1 … 1 of the largest s,    w = 0.1,

with the c, linear in k1, k2, k3, that draws the curve found so far as well as it can, Σ (c/q − f)² over the corners.
Everything else stays, and each start goes its way.

That the lowest minimum of such a lens is rarely the best camera is another matter; it is said in the result's warnings.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.bundle import Bundle, BundleState
from stereocal.camera.lens_doubts import squared_radii

_PLACES = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0)
_WIDTH = 0.1
# Where k1, k2, k3 and k4, k5, k6 stand among fx, fy, cx, cy, s and the lens.
_NUMERATOR, _DENOMINATOR = [5, 6, 9], [10, 11, 12]
_ENOUGH_RADII = 400


def kink_starts(bundle: Bundle, state: BundleState) -> Iterator[BundleState]:
    """Yield the state with a kink of the lens's curve at one radius after another.

    Parameters
    ----------
    bundle : Bundle
        Of one camera with one of OpenCV's rational models.
    state : BundleState
        The best fit so far.

    Yields
    ------
    BundleState
    """
    if not np.all(np.any(bundle.G[_NUMERATOR + _DENOMINATOR], axis=1)):
        return  # where some of the six are held there is no room for a kink
    theta = state.intrinsics[0]
    s = np.sort(squared_radii(bundle, state, 0))
    farthest = float(s[-1])
    s = s[:: max(1, len(s) // _ENOUGH_RADII)]
    powers = np.stack([s, s**2, s**3], axis=1)
    f = (1 + powers @ theta[_NUMERATOR]) / (1 + powers @ theta[_DENOMINATOR])
    for place in _PLACES:
        p = place * farthest
        k456 = np.array([-2 / p, 1 / p**2, 0.0]) / (1 + _WIDTH**2)
        q = 1 + powers @ k456
        moved = theta.copy()
        moved[_NUMERATOR] = _least_squares(powers / q[:, None], f - 1 / q)
        moved[_DENOMINATOR] = k456
        yield replace(state, intrinsics=[moved])


def _least_squares(A: Float, b: Float) -> Float:
    return np.asarray(np.linalg.lstsq(A, b)[0])
