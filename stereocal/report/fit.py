"""Block 2, fit: how large the residuals are, in every convention that people quote, and whether they are only noise.

**Conventions.** The same residuals d_k of N corners give different numbers in different tools:

    OpenCV           √(Σ‖d‖² / N)            both coordinates count in one distance
    an axis (Kalibr) √(Σ‖d‖² / 2N)           = OpenCV / √2
    mean distance    Σ‖d‖ / N  (MATLAB)      = OpenCV · √π/2 for Gaussian noise

Noise of σ = 0.1 px an axis reads as 0.141, 0.100 and 0.125 px. Compare figures of one convention only.

**Is it only noise?** If the model holds, residuals are independent noise of one size. A systematic part s_c of the
cells c of the image shows in the cell means m_c: E‖m_c‖² = ‖s_c‖² + 2σ²/n_c. So

    S² = mean over cells of (‖m_c‖² − 2σ²/n_c),

kept at 0 from below, estimates the size S of the pattern over the image, and S/σ is judged. The same with the radial
part of the residual over rings of the radius judges the radial lens model alone; and a Gaussian leaves 0.006 % of its
residuals beyond 4σ, so that many more are blunders.

**Joint over mono.** Each camera alone can explain its own images; the pair adds only six parameters for all views. If
the joint RMS is much above the mono RMS, the two cameras did not see the same thing: pairs mixed up, corner order
turned, shutters not synchronous, or a rig that moved.

Sources: OpenCV's calibrateCamera; Kalibr issue 697; mrcal's tour (residual plots); the cell statistic is ours.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stereocal.base.checks import Float
from stereocal.report.evidence import Evidence, rms
from stereocal.report.figures_residuals import (
    draw_residual_radius,
    draw_residual_scatter,
    draw_residual_vectors,
    draw_view_errors,
)
from stereocal.report.style import LEFT, RIGHT
from stereocal.report.verdicts import Block, Picture, Table, Verdict, judge

_SIDES = ("left", "right")


def rms_conventions(residuals: Float) -> dict[str, float]:
    """RMS in every convention: ``opencv``, ``per_axis``, ``mean_distance``, ``median_distance``, pixels.

    Parameters
    ----------
    residuals : ndarray of shape (…, 2)
    """
    distance = np.linalg.norm(residuals.reshape(-1, 2), axis=1)
    whole = float(np.sqrt(np.mean(distance**2)))
    return {
        "opencv": whole,
        "per_axis": whole / np.sqrt(2),
        "mean_distance": float(distance.mean()),
        "median_distance": float(np.median(distance)),
    }


def outlying_views(view_rms: Float) -> list[int]:
    """Views whose RMS stands out: above the median by 5 robust σ (1.4826 MAD) and by half of it."""
    middle = float(np.median(view_rms))
    spread = 1.4826 * float(np.median(np.abs(view_rms - middle)))
    return [int(i) for i in np.flatnonzero((view_rms > middle + 5 * spread) & (view_rms > 1.5 * middle))]


def pattern_over_image(
    points: Float, residuals: Float, image_size: tuple[int, int], *, cells: int = 8, least: int = 12
) -> float:
    """Size S of the systematic part of residuals over the image, in units of their σ an axis.

    Parameters
    ----------
    points : ndarray of shape (M, 2)
    residuals : ndarray of shape (M, 2)
    image_size : tuple of (width, height)
    cells : int
        Cells along the width.
    least : int
        Cells with fewer corners are left out.

    Returns
    -------
    float
        S/σ per axis; 0 if no cell has enough corners.
    """
    side = image_size[0] / cells
    index = (points[:, 0] // side).astype(int) + 1000 * (points[:, 1] // side).astype(int)
    return _systematic(index, residuals, least)


def radial_trend(radius: Float, radial: Float, *, rings: int = 8) -> float:
    """Size of the systematic part of radial residuals over rings of equal count, in units of their σ."""
    order = np.argsort(np.argsort(radius))
    return _systematic(order * rings // len(radius), radial[:, None], 12)


def _systematic(groups: Any, values: Float, least: int) -> float:
    """√(weighted mean over groups of (‖mean‖²/d − σ²/n)) / σ, kept at 0 from below; d the number of components."""
    _, inverse, counts = np.unique(groups, return_inverse=True, return_counts=True)
    sums = np.zeros((len(counts), values.shape[1]))
    np.add.at(sums, inverse, values)
    keep = counts >= least
    if not keep.any():
        return 0.0
    means = sums[keep] / counts[keep, None]
    variance = float(np.mean((values - values.mean(axis=0)) ** 2))
    excess = np.mean(means**2, axis=1) - variance / counts[keep]
    size = float(np.average(excess, weights=counts[keep]))
    return float(np.sqrt(max(size, 0.0) / max(variance, 1e-300)))


def radial_parts(points: Float, residuals: Float, K: Float) -> tuple[Float, Float]:
    """Distance of points from the principal point, and the outward part of their residuals."""
    offset = points - np.array([K[0, 2], K[1, 2]])
    radius = np.linalg.norm(offset, axis=1)
    return radius, np.sum(offset * residuals, axis=1) / np.maximum(radius, 1e-9)


def examine_fit(evidence: Evidence, mono_rms: Sequence[float | None]) -> Block:
    """Measure and judge the fit.

    Parameters
    ----------
    evidence : Evidence
    mono_rms : sequence of two floats or None
        RMS of each camera calibrated alone, OpenCV's convention.

    Returns
    -------
    Block
    """
    residuals = dict(zip(_SIDES, evidence.residuals, strict=True))
    conventions = {"joint": rms_conventions(evidence.residuals)}
    conventions |= {side: rms_conventions(d) for side, d in residuals.items()}
    view_rms = np.sqrt(np.mean(np.sum(evidence.residuals**2, axis=-1), axis=-1))  # (2, V)
    outliers = outlying_views(np.sqrt(np.mean(view_rms**2, axis=0)))
    points = {"left": evidence.left.reshape(-1, 2), "right": evidence.right.reshape(-1, 2)}
    flat = {side: d.reshape(-1, 2) for side, d in residuals.items()}
    pattern = max(pattern_over_image(points[s], flat[s], evidence.image_size) for s in _SIDES)
    cameras = {"left": evidence.rig.left, "right": evidence.rig.right}
    radial = {s: radial_parts(points[s], flat[s], np.asarray(cameras[s].K)) for s in _SIDES}
    trend = max(radial_trend(*radial[s]) for s in _SIDES)
    everything = evidence.residuals.ravel()
    tails = 100 * float(np.mean(np.abs(everything) > 4 * np.sqrt(np.mean(everything**2))))
    joint = conventions["joint"]["opencv"]
    both = [m for m in mono_rms if m is not None]
    mono = float(np.sqrt(np.mean(np.square(both)))) if len(both) == 2 else float("nan")
    verdicts = _judge_fit(evidence, joint / mono if both else None, outliers, pattern, trend, tails)
    facts = {
        "rms": conventions,
        "mono_rms": dict(zip(_SIDES, mono_rms, strict=True)),
        "joint_over_mono": joint / mono,
        "noise_per_axis": evidence.noise,
        "view_rms": {side: view_rms[i].tolist() for i, side in enumerate(_SIDES)},
        "views": list(evidence.names),
        "outliers": [evidence.names[i] for i in outliers],
        "pattern_over_image": pattern,
        "radial_trend": trend,
        "beyond_4_sigma_percent": tails,
    }
    lead = f"The joint fit leaves {joint:.3f} px (OpenCV's RMS), which is {joint / np.sqrt(2):.3f} px an axis"
    lead += f"; each camera alone leaves {both[0]:.3f} and {both[1]:.3f} px." if len(both) == 2 else "."
    names = list(evidence.names)
    pictures = (
        Picture("reprojection_views", "RMS of each pair. Bars that stand out are named; look at those photographs.",
                lambda: draw_view_errors(view_rms[0], view_rms[1], names=names, joint_rms=joint, outliers=outliers)),
        Picture("reprojection_scatter", "Every residual. A round cloud inside the circle, with 5 % outside, is noise.",
                lambda: draw_residual_scatter(flat["left"], flat["right"])),
        *(
            Picture(f"residual_vectors_{side}", f"Residuals of the {side} camera over its image. Dark arrows are means "
                    "of cells; if they flow together, the lens or the board is not as the model says.",
                    lambda side=side, colour=colour: draw_residual_vectors(  # type: ignore[misc]
                        points[side], flat[side], evidence.image_size, title=side, colour=colour))
            for side, colour in zip(_SIDES, (LEFT, RIGHT), strict=True)
        ),
        Picture("residual_radius", "Outward part of each residual against the distance from the centre. A curve "
                "off the zero line means that the radial distortion is too stiff.",
                lambda: draw_residual_radius([radial[s][0] for s in _SIDES], [radial[s][1] for s in _SIDES])),
    )  # fmt: skip
    return Block("fit", "Fit", lead, verdicts, facts, (_conventions_table(conventions),), pictures)


def _judge_fit(
    evidence: Evidence, ratio: float | None, outliers: list[int], pattern: float, trend: float, tails: float
) -> tuple[Verdict, ...]:
    verdicts = [
        judge("fit", "rms_per_axis", evidence.noise,
              "Residual an axis, degrees of freedom taken off: what the corners are off by, if the model is right.",
              cause="Blurred or noisy photographs, a bent board, a lens the model cannot follow, or pairs mixed up.",
              action="Look at the pairs with the highest bars; sharpen, hold still, glue the board to glass or board."),
    ]  # fmt: skip
    if ratio is not None:
        verdicts.append(
            judge("fit", "joint_mono", ratio, "How much worse the two cameras are explained together than each alone.",
                  cause="The cameras did not see the same: pairs mixed up, corner order turned, shutters not "
                  "synchronous, or the cameras moved against each other.",
                  action="Check that equal names are equal moments; hold the board still for each pair; tighten "
                  "the rig.")
        )  # fmt: skip
    named = ", ".join(evidence.names[i] for i in outliers[:5])
    verdicts += [
        judge("fit", "outlier_views", len(outliers), "Pairs whose RMS is far above the others'.",
              cause=f"Something is wrong in {named}.",
              action="Look at them: blur, a hand in front of the board, glare; leave them out and calibrate again.",
              at_worst="usable"),
        judge("fit", "structure", pattern, "Systematic part of the residuals over the image, in units of their noise.",
              cause="The lens model is too stiff, or the board is not flat.",
              action="Try the rational model; check the board's flatness (below)."),
        judge("fit", "radial_trend", trend, "Systematic outward residual over the radius, in units of the noise.",
              cause="The radial distortion is too stiff for this lens.",
              action="Try the rational model, or the fisheye model for lenses beyond 120°."),
        judge("fit", "tails", tails, "Residual components beyond four standard deviations.",
              cause="Some corners are not noisy but wrong: glare, a covered corner, letters near the board.",
              action="Calibrate with a robust loss, or leave out the pairs named above.", at_worst="usable"),
    ]  # fmt: skip
    return tuple(verdicts)


def _conventions_table(conventions: dict[str, dict[str, float]]) -> Table:
    rows = tuple(
        (side, *(f"{c[key]:.4f}" for key in ("opencv", "per_axis", "mean_distance", "median_distance")))
        for side, c in conventions.items()
    )
    header = ("", "OpenCV √(Σ‖d‖²/N)", "an axis (Kalibr)", "mean distance (MATLAB)", "median distance")
    return Table("The same residuals in every convention, px", header, rows)


def view_errors(evidence: Evidence) -> Float:
    """RMS of each view over both cameras, (V,)."""
    return np.array([rms(evidence.residuals[:, v]) for v in range(evidence.view_count)])
