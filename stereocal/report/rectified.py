"""Block 5, epipolar: what is left of Δy once the pair is rectified.

After rectification a point of the scene lies on the same row of both images, and a matcher searches that row only.
Half a pixel of Δy costs a block matcher part of its score; two pixels and thin structures are lost. Δy is therefore the
error that a stereo user feels first, and it needs no board size, no pose, and no truth.

It is measured on corners that the fit has not seen (:mod:`stereocal.report.held_out`), in pixels of the rectified
image, and signed: Δy = y_left − y_right. A pattern over the image is a distortion or a rotation that is off; a
scatter is noise.

For a rig with one camera above the other, rows are columns and Δy is Δx.

Source of the limits: Luxonis (depthai issue 646).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stereocal.base.checks import Float
from stereocal.pair.rectifying_rotations import rectifying_rotations
from stereocal.pair.rig import StereoRig
from stereocal.report.figures_geometry import draw_signed_map
from stereocal.report.verdicts import Block, Picture, judge


@dataclass(frozen=True)
class RectifiedCorners:
    """Corners where the rectified images show them, from the principal point, pixels.

    Attributes
    ----------
    left, right : ndarray of shape (…, 2)
        NaN where the distortion cannot be undone.
    focal_length : float
        Of the rectified images, pixels.
    axis : int
        The coordinate along the rows: 0 for a horizontal rig, 1 for a vertical one.
    baseline : float
        Signed: negative for a rig whose left (upper) camera comes first.
    """

    left: Float
    right: Float
    focal_length: float
    axis: int
    baseline: float

    @property
    def across(self) -> Float:
        """Δy: left minus right across the rows (Δx for a vertical rig), (…)."""
        return np.asarray(self.left[..., 1 - self.axis] - self.right[..., 1 - self.axis])


def rectify_corners(rig: StereoRig, left: Float, right: Float) -> RectifiedCorners:
    """Put corners where the rectified images show them.

    Parameters
    ----------
    rig : StereoRig
    left, right : ndarray of shape (…, 2)
        Pixels of the photographs.

    Returns
    -------
    RectifiedCorners
        Only the rotations of :func:`~stereocal.pair.rectification.rectify` and its focal length are needed here; where
        its images have their middle does not matter to a difference.
    """
    turned = rectifying_rotations(np.asarray(rig.R), np.ravel(rig.T))
    across = 1 - turned.axis
    f = (rig.left.K[across, across] + rig.right.K[across, across]) / 2
    P = np.diag([f, f, 1.0])
    a = np.asarray(rig.left.undistort_points(left.reshape(-1, 2), R=turned.R1, P=P)).reshape(left.shape)
    b = np.asarray(rig.right.undistort_points(right.reshape(-1, 2), R=turned.R2, P=P)).reshape(right.shape)
    return RectifiedCorners(a, b, float(f), turned.axis, turned.baseline)


def examine_epipolar(points: Float, differences: Float, image_size: tuple[int, int], *, held_out: bool) -> Block:
    """Judge the epipolar error.

    Parameters
    ----------
    points : ndarray of shape (M, 2)
        Left pixels.
    differences : ndarray of shape (M,)
        Δy, pixels; NaN where a point could not be undistorted.
    image_size : tuple of (width, height)
    held_out : bool
        Whether the corners were unseen by the fit they are judged on.

    Returns
    -------
    Block
    """
    known = np.isfinite(differences)
    at, delta = points[known], differences[known]
    size = np.abs(delta)
    whole = float(np.sqrt(np.mean(delta**2)))
    p95, largest = float(np.percentile(size, 95)), float(size.max())
    seen = (
        "corners that the fit has not seen" if held_out else "the corners of the fit (too few views to hold some out)"
    )
    cause = "The rotation between the cameras or a distortion is off, or the shutters are not synchronous."
    action = "If the map shows a pattern, add views there; if single pairs stand out, leave them out; check the timing."
    verdicts = (
        judge(
            "epipolar",
            "epipolar_rms",
            whole,
            f"Row difference after rectification, {seen}.",
            cause=cause,
            action=action,
        ),
        judge("epipolar", "epipolar_p95", p95, "95 of 100 corners lie within this.", cause=cause, action=action),
    )
    facts = {
        "held_out": held_out, "rms": whole, "mean": float(delta.mean()), "p95": p95, "max": largest,
        "unknown": int(np.count_nonzero(~known)),
    }  # fmt: skip
    lead = f"After rectification rows agree to {whole:.3f} px RMS (95 % within {p95:.3f}, at most {largest:.2f} px)."
    picture = Picture(
        "epipolar_map",
        "Signed Δy where the left camera saw the corner. One colour over a region is a pattern; a mixture is noise.",
        lambda: draw_signed_map(at, delta, image_size, title="Δy after rectification", label="y left − y right, px"),
    )
    return Block("epipolar", "Epipolar", lead, verdicts, facts, (), (picture,))
