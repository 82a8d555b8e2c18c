"""What a fit leaves open, in sentences: coefficients that trade with each other, kinks, a principal point adrift.

A lens of many coefficients (rational and beyond) can draw one curve in many ways. The fit still ends in an optimum, and
the numbers look like any others; what they cannot be trusted in is said by name.

**Coefficients that are not determined apart.** Numerator and denominator of the radial curve

    f(s) = c(s) / q(s),    c = 1 + k1 s + k2 s² + k3 s³,    q = 1 + k4 s + k5 s² + k6 s³,    s = r²,

may grow together along a flat valley: the coefficients' standard deviations are huge and their correlations next to
±1, and yet the curve, and every pixel drawn, is sure: in J C Jᵀ the large numbers cancel. What is to be reported then
is the distortion, not its coefficients.

**Kinks.** A common factor of c and q, (s − z)/(s − p) with z next to p, changes the curve only near s = p. If p is next
to the radii that the corners cover, this buys a wiggle of the curve, which bends to the noise of a few corners. Nothing
is gained but a lower F, and the covariance, which takes the wiggle for the lens, may be too small: for poles within a
hundredth of s_max by factors of 3 to 30 (known truth, ``benchmarks/study_lens_models.py``). Real lenses have their
poles far off. So the roots of q are looked at: one nearer to the stretch 0 … s_max that the corners cover than a
quarter of s_max is called a kink.

**The principal point.** A shift of it is drawn almost as well by a turn of all boards and p1, p2 (or the prism, or the
tilt). Uncertain by more than 2 % of the image, its valley is a curved one, and the standard deviations, which follow
the tangent, hold only near the optimum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.bundle import Bundle, BundleState, points_in_camera
from stereocal.camera.parameters import intrinsic_names

# Models of fewer coefficients have neither denominators nor valleys worth the time.
MANY_COEFFICIENTS = 6
_NOT_APART = 0.999
_NEAR_POLE = 0.25
_ADRIFT = 0.02
# The scale at which a lens draws its corners may differ from that of its centre by this factor.
_LIKE_ITSELF = 2.0
# Relative standard deviation of the focal length beyond which the views do not determine it.
UNDETERMINED = 0.5


def lens_doubts(
    bundle: Bundle, state: BundleState, covariance: Float, camera: int, size: tuple[int, int]
) -> tuple[str, ...]:
    """Return what one camera's fit leaves open, a sentence each.

    Parameters
    ----------
    bundle : Bundle
        The measurements.
    state : BundleState
        Their optimum.
    covariance : ndarray of shape (n, n)
        Of all shared parameters there.
    camera : int
        Which camera.
    size : (int, int)
        Its image, width and height.

    Returns
    -------
    tuple of str
        Empty where there is nothing to say.
    """
    model = bundle.models[camera]
    part = bundle.intrinsic_slices[camera]
    own = covariance[part, part]
    if not np.all(np.isfinite(own)):
        return ("no standard deviations can be given: as many unknowns as measurements, or one without influence",)
    std = np.sqrt(np.diag(own))
    found = []
    if max(std[2:4]) > _ADRIFT * max(size):
        found.append(
            f"the principal point is not determined well (± {std[2]:.0f}, {std[3]:.0f} px): it trades with the boards' "
            "turns and the lens; more tilt, a larger part of the image, or fix='principal_point' would settle it"
        )
    fy = float(state.intrinsics[camera][1])
    if std[1] > _ADRIFT * abs(fy) and model.parameter_count >= MANY_COEFFICIENTS:
        found.append(
            f"the focal length is open along with the lens's coefficients (fy = {fy:.4g} ± {std[1]:.2g}), and standard "
            f"deviations mean nothing; these views do not need model {model.name!r}, 'brown' has fewer coefficients"
        )
    if model.parameter_count >= MANY_COEFFICIENTS:
        if "k6" in model.parameter_names:
            radius = kink_radius(state.intrinsics[camera][5:], float(squared_radii(bundle, state, camera).max()))
            if radius is not None:
                found.append(
                    f"the lens curve has a kink at r = {radius:.2g} of the normalised plane, where a pole of it is "
                    "nearly cancelled by a zero: it bends to the noise of a few corners, and standard deviations "
                    f"may be too small; these views do not need model {model.name!r}, 'brown' has fewer coefficients"
                )
        apart = _not_apart(own, std, intrinsic_names(model))
        found += [apart] if apart else []
    return tuple(found)


def kink_radius(k: Float, s_max: float) -> float | None:
    """Return where a pole of the radial curve is next to the radii 0 … √s_max; None if none is.

    Parameters
    ----------
    k : ndarray of at least 8 numbers
        In OpenCV's order; k4, k5, k6 count.
    s_max : float
        Largest r² of the corners on the normalised plane.

    Returns
    -------
    float or None
        r nearest to the pole that is nearest.
    """
    w = np.roots([1.0, *k[5:8]])  # of q(1/w) w³: a coefficient that vanishes is a pole at infinity, w = 0
    poles = 1 / w[np.abs(w) > 1e-12 / s_max]
    if len(poles) == 0:
        return None
    nearest = np.clip(poles.real, 0.0, s_max)
    distance = np.abs(poles - nearest)
    i = int(np.argmin(distance))
    return float(np.sqrt(nearest[i])) if distance[i] < _NEAR_POLE * s_max else None


def squared_radii(bundle: Bundle, state: BundleState, camera: int) -> Float:
    """Return r² of a camera's corners on the normalised plane, (m,)."""
    X_c = points_in_camera(bundle, state, camera)[2]
    return np.asarray((X_c[:, 0] ** 2 + X_c[:, 1] ** 2) / X_c[:, 2] ** 2)


def draws_at_its_focal_length(bundle: Bundle, state: BundleState, camera: int) -> bool:
    """Whether a lens draws the corners at about the scale that K says: 1 at the centre, ``drawn_scale`` where they are.

    Coefficients that grow without end leave the 1 in numerator and denominator behind: the scale is then 1 at a centre
    that nothing shows, another everywhere else, and fy follows no measurement.

    Parameters
    ----------
    bundle : Bundle
        The measurements.
    state : BundleState
        Where.
    camera : int
        Which camera.

    Returns
    -------
    bool
    """
    return bool(1 / _LIKE_ITSELF < drawn_scale(bundle, state, camera) < _LIKE_ITSELF)


def drawn_scale(bundle: Bundle, state: BundleState, camera: int) -> float:
    """Return the scale at which a lens draws the corners, times the focal length in pixels a radian; the median.

    Parameters
    ----------
    bundle : Bundle
        The measurements.
    state : BundleState
        Where.
    camera : int
        Which camera.

    Returns
    -------
    float
        √|det ∂x_d/∂x| (1 + r²)^¾: an angle's square is drawn on the normalised plane (1 + r²)^(3/2) times as large, so
        that turning the camera, and its principal point with it, changes nothing. NaN where the lens has no answer.
    """
    X_c = points_in_camera(bundle, state, camera)[2]
    x = X_c[:, :2] / X_c[:, 2:]
    J = bundle.models[camera].jacobians_compiled(x, state.intrinsics[camera][5:])[1]
    of_area = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
    return float(np.median(np.sqrt(np.abs(of_area)) * (1 + np.sum(x * x, axis=1)) ** 0.75))


def _not_apart(covariance: Float, std: Float, names: Sequence[str]) -> str:
    """In words: coefficients of which one follows another; empty where none does."""
    scale = np.where(std > 0, std, np.inf)
    correlation = covariance / scale[:, None] / scale
    strength = np.abs(np.triu(correlation, 1))
    strength[:5, :5] = 0.0  # fx and fy belong together in every lens
    pairs = np.argwhere(strength > _NOT_APART)
    if len(pairs) == 0:
        return ""
    i, j = pairs[np.argmax(strength[pairs[:, 0], pairs[:, 1]])]
    involved = [name for at, name in enumerate(names) if at in pairs]
    return (
        f"{', '.join(involved[:-1])} and {involved[-1]} are not determined apart ({names[i]} and {names[j]} correlate "
        f"by {correlation[i, j]:.6f}); report the distortion, not its coefficients"
    )
