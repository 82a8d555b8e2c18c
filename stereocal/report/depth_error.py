"""Block 7, depth: how far off a depth is, from disparity noise and from the calibration itself.

With Z = f·B/d a disparity error σ_d makes a depth error

    σ_Z = Z² σ_d / (f B),

which grows with the square of the distance and averages out over many pixels. The calibration's own error does not
average out: it is the same in every picture. Through Z's derivative by each parameter θ and their covariance Σ
(:mod:`stereocal.report.rig_parameters`) it is σ_cal² = (∂Z/∂θ) Σ (∂Z/∂θ)ᵀ, taken over that part of the image where
corners were seen (elsewhere the lens is extrapolated) and averaged as RMS.
Both together are √(σ_Z² + σ_cal²): what the page promises.

To compare the two, the calibration's part is quoted as the disparity error that would cause it, σ_cal·f·B/Z²: below a
quarter of a pixel it does not limit what a dense matcher achieves.

**What the covariance cannot know.** Σ describes the noise, not a wrong model. Block 6 frees the board's shape for one
step and tells how much depth moves with it; that shift is judged here as the depth error that the model hides.

Sources: RealSense's and Middlebury's σ_Z; the covariance part after Strobl, Sepp and Hirzinger (2009), in our notation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.pair.rig import StereoRig
from stereocal.report.board_bend import BoardBend
from stereocal.report.evidence import Evidence
from stereocal.report.figures_curves import draw_depth_uncertainty
from stereocal.report.rig_parameters import depth_jacobian, scene_points
from stereocal.report.verdicts import Block, Picture, Table, judge

DISPARITY_NOISE = 0.25
"""σ_d of dense matching with subpixel interpolation, pixels, unless it is measured."""


@dataclass(frozen=True)
class DepthSensitivity:
    """∂Z/∂θ at points of the scene, for some distances.

    Attributes
    ----------
    distances : ndarray of shape (D,)
    index : ndarray of int, shape (M,)
        Which distance each point has.
    jacobian : ndarray of shape (M, n)
        ∂Z/∂θ at fixed pixels.
    """

    distances: Float
    index: NDArray[np.int64]
    jacobian: Float

    def sigma(self, covariance: Float) -> Float:
        """RMS over the image of the depth error that a covariance of θ causes, (D,); NaN where nothing is seen."""
        return self._rms(np.einsum("mi,ij,mj->m", self.jacobian, covariance, self.jacobian))

    def shift(self, change: Float) -> Float:
        """RMS over the image of the change of depth when θ changes, (D,)."""
        return self._rms((self.jacobian @ change) ** 2)

    def _rms(self, squares: Float) -> Float:
        counts = np.bincount(self.index, minlength=len(self.distances))
        sums = np.bincount(self.index, squares, minlength=len(self.distances))
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.sqrt(sums / counts)


def depth_sensitivity(rig: StereoRig, pixels: Float, distances: Float) -> DepthSensitivity:
    """Derivative of depth by the calibration's parameters, at pixels of the left image and for some distances.

    Parameters
    ----------
    rig : StereoRig
    pixels : ndarray of shape (P, 2)
        Where in the left image.
    distances : ndarray of shape (D,)
        Z, board units.
    """
    at = np.tile(pixels, (len(distances), 1))
    index = np.repeat(np.arange(len(distances)), len(pixels))
    kept, left, right = scene_points(rig, at, distances[index])
    return DepthSensitivity(distances, index[kept], depth_jacobian(rig, left, right))


def _hidden_shift(sensitivity: DepthSensitivity, bend: BoardBend) -> float:
    """Change of depth at the first distance when the board is freed, with the part that chance explains taken off."""
    square = float(sensitivity.shift(bend.parameter_change)[0]) ** 2
    chance = float(np.nan_to_num(sensitivity.sigma(bend.change_covariance)[0])) ** 2
    return float(np.sqrt(max(square - chance, 0.0)))


def seen_pixels(evidence: Evidence, count: int = 40) -> Float:
    """Some pixels of the left image where corners were seen, spread over the views: (count, 2)."""
    points = evidence.left.reshape(-1, 2)
    return points[np.linspace(0, len(points) - 1, min(count, len(points))).astype(int)]


def examine_depth(
    evidence: Evidence, covariance: Float, bend: BoardBend | None, *, disparity_noise: float | None = None
) -> Block:
    """Measure and judge the depth error.

    Parameters
    ----------
    evidence : Evidence
    covariance : ndarray of shape (n, n)
        Of the calibration's parameters.
    bend : BoardBend, optional
        The step with the board's shape free.
    disparity_noise : float, optional
        σ_d, pixels; by default 0.25.

    Returns
    -------
    Block
    """
    rig, unit = evidence.rig, evidence.unit
    sigma_d = DISPARITY_NOISE if disparity_noise is None else float(disparity_noise)
    board = evidence.points_left[..., 2].mean(axis=1)
    near, middle, far = (float(v) for v in (board.min(), np.median(board), board.max()))
    z = np.concatenate([[middle], np.geomspace(0.5 * near, 4 * far, 9)])
    f, B = float(rig.left.K[0, 0]), float(rig.baseline)
    noise = z**2 * sigma_d / (f * B)
    sensitivity = depth_sensitivity(rig, seen_pixels(evidence), z)
    own = sensitivity.sigma(covariance)
    hidden_shift = float("nan") if bend is None else _hidden_shift(sensitivity, bend)
    at_board = float(own[0])
    z, noise, own = z[1:], noise[1:], own[1:]
    to_disparity = f * B / middle**2
    promise = float(np.hypot(middle**2 * sigma_d / (f * B), at_board))
    tilt = "Add views: more of them, tilted, and near the distances that you will measure at."
    verdicts = [
        judge("depth", "calibration_disparity", at_board * to_disparity,
              "The calibration's own depth error where the boards stood, as the disparity error that would cause it.",
              cause="Too few views, or views that leave the geometry loose (no tilt, all alike), or noisy corners.",
              action=tilt),
    ]  # fmt: skip
    if np.isfinite(hidden_shift):
        verdicts.append(
            judge("depth", "depth_bias", hidden_shift * to_disparity,
                  "How far depth moves when the board may bend, as disparity: an error that σ does not show.",
                  cause="The board is not flat, and the flat model pushed its bend into lens and geometry.",
                  action="Glue the board to glass or aluminium and photograph it again.")
        )  # fmt: skip
    lead = (
        f"At {middle:.4g} {unit}, where the boards stood, expect σ_Z = {promise:.2g} {unit} "
        f"({100 * promise / middle:.2g} %): "
        f"{middle**2 * sigma_d / (f * B):.2g} from {sigma_d:g} px of disparity noise, {at_board:.2g} from the "
        "calibration."
    )
    facts = {
        "disparity_noise": sigma_d, "board_distance": middle, "board_range": [near, far], "sigma_z_at_board": promise,
        "calibration_sigma_at_board": at_board, "calibration_disparity": at_board * to_disparity,
        "hidden_shift": hidden_shift, "distance": z.tolist(), "sigma_from_disparity": noise.tolist(),
        "sigma_from_calibration": own.tolist(),
    }  # fmt: skip
    picture = Picture(
        "depth_uncertainty",
        f"σ_Z over distance as a share of Z, for {sigma_d:g} px of disparity noise. Outside the shaded range no board "
        "stood, and the calibration is extrapolated.",
        lambda: draw_depth_uncertainty(z, noise, own, board_range=(near, far), unit=unit),
    )
    return Block(
        "depth",
        "Depth",
        lead,
        tuple(verdicts),
        facts,
        (_sigma_table(z, noise, own, f * B, unit),),
        (picture,),
    )


def _sigma_table(z: Float, noise: Float, own: Float, focal_baseline: float, unit: str) -> Table:
    """σ_Z over distance, in rows."""
    both = np.hypot(noise, own)
    rows = tuple(
        (f"{d:.4g}", f"{focal_baseline / d:.3g}", f"{a:.2g}", f"{b:.2g}", f"{c:.2g}", f"{100 * c / d:.2g}")
        for d, a, b, c in zip(z, noise, own, both, strict=True)
    )
    header = ("distance", "disparity, px", "from disparity noise", "from the calibration", "σ_Z", "% of Z")
    return Table(f"σ_Z over distance ({unit})", header, rows)
