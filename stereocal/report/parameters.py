"""Block 3, parameters: every value with its σ, how they hang together, and whether they are plausible.

σ comes from the normal equations at the optimum (see :mod:`stereocal.camera.covariance`): it is right if the corner
errors are independent and the model holds, and too small otherwise; block 4 puts it to the test. Bouguet's toolbox
quotes about 3σ, OpenCV nothing for R and T.

The correlation of two parameters tells what the views cannot tell apart: fx with the boards' distance if no board is
tilted, cx with p2, k1 with k2. Values above 0.95 are common between distortion coefficients and harmless: the
coefficients are uncertain together, the distortion is not. The condition number is that of the correlation matrix, so
that units do not matter.

A lens never folds its image, so distortion must be monotonic wherever there are pixels; where the fitted polynomial is
not, the corners of the image are extrapolation.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stereocal.base.checks import Float
from stereocal.report.rig_parameters import lens_domain, rig_vector
from stereocal.report.verdicts import Block, Table, Verdict, judge


def correlation_matrix(covariance: Float) -> tuple[Float, Any]:
    """Correlations of the free parameters, and their indices."""
    sigma = np.sqrt(np.diag(covariance))
    free = np.flatnonzero((sigma > 0) & np.isfinite(sigma))
    part = covariance[np.ix_(free, free)]
    return part / np.outer(sigma[free], sigma[free]), free


def examine_parameters(calibration: Any, unit: str) -> Block:
    """Measure and judge the parameters.

    Parameters
    ----------
    calibration : StereoCalibration
        With ``parameter_names`` and ``covariance``.
    unit : str
        Of length.

    Returns
    -------
    Block
    """
    rig = calibration.rig
    names, covariance = list(calibration.parameter_names), np.asarray(calibration.covariance)
    values, sigma = rig_vector(rig), np.sqrt(np.diag(covariance))
    correlation, free = correlation_matrix(covariance)
    condition = float(np.linalg.cond(correlation)) if len(free) else float("inf")
    off = np.abs(correlation - np.eye(len(free)))
    strongest = []
    for flat in np.argsort(-off, axis=None)[:10:2]:
        i, j = np.unravel_index(flat, off.shape)
        strongest.append((names[free[i]], names[free[j]], float(correlation[i, j])))
    verdicts = _judge_parameters(rig, dict(zip(names, sigma, strict=True)), condition)
    baseline = float(getattr(calibration, "baseline_std", np.nan))
    rows = [
        (name, f"{v:.6g}", f"{s:.2g}" if s > 0 else "held", _percent(v, s))
        for name, v, s in zip(names, values, sigma, strict=True)
        if s > 0 or v != 0
    ]
    rows.append(("baseline", f"{rig.baseline:.6g}", f"{baseline:.2g}", _percent(rig.baseline, baseline)))
    header = ("parameter", "value", "σ", "σ / |value|")
    tables = (
        Table(
            f"Values and their standard deviations (px; lengths in {unit}; rotation in radians)",
            header,
            tuple(rows),
            True,
        ),
        Table(
            "Strongest correlations",
            ("", "", "ρ"),
            tuple((a, b, f"{rho:+.3f}") for a, b, rho in strongest),
            True,
        ),
    )
    facts = {
        "values": dict(zip(names, values.tolist(), strict=True)),
        "sigma": dict(zip(names, sigma.tolist(), strict=True)),
        "baseline": float(rig.baseline),
        "baseline_sigma": baseline,
        "condition": condition,
        "strongest_correlations": strongest,
    }
    by_name = dict(zip(names, sigma, strict=True))
    lead = (
        f"Focal length {rig.left.K[0, 0]:.2f} ± {by_name.get('left.fx', np.nan):.2f} px left, "
        f"{rig.right.K[0, 0]:.2f} ± {by_name.get('right.fx', np.nan):.2f} px right; baseline "
        f"{rig.baseline:.5g} ± {baseline:.2g} {unit}. The ± are one σ; Bouguet's toolbox quotes about three."
    )
    return Block("parameters", "Parameters", lead, verdicts, facts, tables)


def _percent(value: float, sigma: float) -> str:
    return f"{100 * sigma / abs(value):.2g} %" if value and sigma > 0 else ""


def _judge_parameters(rig: Any, sigma: dict[str, float], condition: float) -> tuple[Verdict, ...]:
    cameras = {"left": rig.left, "right": rig.right}
    aspect = max(abs(c.K[0, 0] / c.K[1, 1] - 1) for c in cameras.values())
    offset = max(
        float(np.hypot(c.K[0, 2] - (c.image_size[0] - 1) / 2, c.K[1, 2] - (c.image_size[1] - 1) / 2)) / c.image_size[0]
        for c in cameras.values()
    )
    relative = max(sigma.get(f"{s}.f{a}", 0.0) / c.K[i, i] for s, c in cameras.items() for i, a in enumerate("xy"))
    tilt = "Add views with the board tilted by 30° in different directions."
    return (
        judge("parameters", "focal_sigma", 100 * relative, "σ of fx and fy against their value; the worst of the four.",
              cause="The views do not tell focal length from distance.", action=tilt),
        judge("parameters", "aspect", 100 * aspect, "How far fx and fy differ; the camera that differs more.",
              cause="An anamorphic lens, a stretched image, or views without tilt.", action=tilt, at_worst="usable",
              decides=False),
        judge("parameters", "centre", 100 * offset, "Principal point from the middle of the image; the worse camera.",
              cause="A cropped image or a shifted sensor; or too few tilted views to fix the centre.", action=tilt,
              at_worst="usable", decides=False),
        judge("parameters", "monotonic", 100 * min(lens_domain(c).share for c in cameras.values()),
              "Pixels whose undistortion is unique; the worse camera.",
              cause="No corner was seen near the image's corners, so the distortion polynomial bends back there.",
              action="Add views with the board in the image's corners, or use a model with fewer coefficients.",
              at_worst="usable", decides=False),
        judge("parameters", "condition", condition, "Condition number of the parameters' correlation matrix.",
              cause="Some parameters cannot be told apart from these views.", action=tilt, at_worst="usable",
              decides=False),
    )  # fmt: skip
