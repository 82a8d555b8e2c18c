"""Views that disagree about where the cameras stand, named before the joint fit spreads their error over all.

Corners may be right in every image and yet not belong together: counted from opposite ends of the board, from two
photographs of different moments, from an image that is mirrored. No camera by itself notices, for turned or mirrored
corners fit a turned or reversed board as well. The joint fit then has no good optimum; it bends focal lengths until
no camera is left, and every view looks bad.

At its start, though, things are still apart: the poses are the first camera's, and where the others stand is the
median of all views (``rig_start``). There each view predicts its corners in the other cameras,

    e_v = max over cameras c ≥ 1 of the RMS of p̃(K_c, k_c, R_c R_v, R_c T_v + T_c, P_j) − y^c_vj,

and a view that is far off, where the median is not, is the odd one. Where half of them are far off there is no common
rig at all. Which side of the board a camera sees is the sign of n·t (n the board's normal, t the way to it): a mirrored
image, or corners counted in mirrored order, show the back.

Nothing is said where the joint fit is about as good as the first camera by itself: what looked odd at the start was
then the start's own error.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import ConvergenceError
from stereocal.camera.bundle import Bundle, BundleState, residuals
from stereocal.camera.bundle_solver import BundleSolution
from stereocal.camera.calibration import CameraCalibration
from stereocal.camera.odd_views import odd_view_warnings
from stereocal.pair.rig_start import Poses

# The joint fit is bad from this number of times the first camera's own RMS on, and not below this one in pixels.
_BAD_FIT, _BAD_PIXELS = 4.0, 1.0
# A view is odd beyond so many pixels and so many times the median view; a rig is none beyond these.
_ODD_PIXELS, _ODD_FACTOR = 4.0, 6.0
_NO_RIG_PIXELS, _NO_RIG_FACTOR = 10.0, 20.0


def odd_in_rig(
    names: Sequence[str], alone: Sequence[CameraCalibration | None], bundle: Bundle, start: BundleState,
    poses: list[Poses], solution: BundleSolution,
) -> list[str]:  # fmt: skip
    """Return sentences on views that are odd: to a camera by itself, or in the rig, by the numbers the rig gives them.

    A camera that a view in another order has spoilt predicts corners anywhere; what it says of other views is kept back
    until that one is put right.

    Parameters
    ----------
    names : sequence of str
        What the cameras are called.
    alone : sequence of CameraCalibration or None
        Each camera by itself.
    bundle, start, poses, solution
        See :func:`disagreement`.

    Returns
    -------
    list of str
    """
    found = [(name, c.odd, p) for name, c, p in zip(names, alone, poses, strict=True) if c is not None]
    named = [f"{name} camera: {said}" for name, odd, p in found for said in odd_view_warnings(odd, p.views.tolist())]
    apart = disagreement(bundle, start, poses, solution, named)
    spoilt = any(not view.from_behind for _, odd, _ in found for view in odd)
    return named if spoilt or not apart else [*named, apart]


def disagreement(
    bundle: Bundle, start: BundleState, poses: list[Poses], solution: BundleSolution, named: Sequence[str] = ()
) -> str:
    """Return a sentence that names the views that do not fit the rig of the others; empty where there are none.

    Parameters
    ----------
    bundle : Bundle
        Of a rig.
    start : BundleState
        Where its fit began: poses of the first camera, the median rig.
    poses : list of Poses
        Each camera's own.
    solution : BundleSolution
        Where the fit ended.
    named : sequence of str
        What is known to be odd already, a likelier cause than any.

    Returns
    -------
    str

    Raises
    ------
    ConvergenceError
        If most views are far off, and the fit did not converge or is far off too.
    """
    end = solution.equations.residuals
    rms = float(np.sqrt(np.vdot(end, end) / len(end)))
    if rms < _BAD_PIXELS:  # a healthy rig does not pay for more
        return ""
    own, predicted = _errors_at_start(bundle, start)
    if rms < _BAD_FIT * own:
        return ""
    middle = float(np.nanmedian(predicted))
    if middle > max(_NO_RIG_PIXELS, _NO_RIG_FACTOR * own):
        if not solution.converged or rms > max(_NO_RIG_PIXELS, _NO_RIG_FACTOR * own):
            raise ConvergenceError(
                f"the views agree on no common rig: where the first camera sees the board predicts the corners of the "
                f"others {middle:.0f} px off (median); {'; '.join(named) or _likely_cause(poses)}"
            )
        return ""
    odd = np.flatnonzero(predicted > max(_ODD_PIXELS, _ODD_FACTOR * middle))
    if len(odd) == 0:
        return ""
    them = "it" if len(odd) == 1 else "them"
    return (
        f"view {', '.join(map(str, odd))} {'does' if len(odd) == 1 else 'do'} not fit the rig that the others see: "
        "corners counted from opposite ends, or photographs that do not belong together; the whole fit suffers, leave "
        f"{them} out or put {them} right"
    )


def _errors_at_start(bundle: Bundle, start: BundleState) -> tuple[float, Float]:
    """The median RMS of the first camera's views, and e_v (NaN where no other camera saw the view)."""
    d = residuals(bundle, start)
    squares = np.nan_to_num(d[:, 0] ** 2 + d[:, 1] ** 2, nan=np.inf)
    rms = np.sqrt(np.add.reduceat(squares, bundle.offsets[:-1]) / np.diff(bundle.offsets))
    first = bundle.camera_of_block == 0
    views = bundle.view_of_block
    both = ~first & np.isin(views, views[first])
    predicted = np.full(bundle.view_count, np.nan)
    np.fmax.at(predicted, views[both], rms[both])
    return float(np.median(rms[first])), predicted


def _likely_cause(poses: list[Poses]) -> str:
    sides = [np.sign(np.einsum("vi,vi->v", p.R[:, :, 2], p.t)) for p in poses]
    seen_from = [float(np.median(side)) for side in sides]
    if min(seen_from) * max(seen_from) < 0:
        return (
            "one camera sees the board's front and another its back: an image is mirrored, or its corners are counted "
            "in mirrored order"
        )
    return "check that views of the same moment are paired, and that corners are counted from the same end in all"
