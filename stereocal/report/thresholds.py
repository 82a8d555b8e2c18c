"""Every threshold of the report in one table, each with its source.

A threshold without a source is an opinion. Where a figure is published by people who ship cameras or calibrators, it is
theirs and named; where there is none, the source says "ours" and why. None is a law: an error of half a pixel is ruin
for a 12-megapixel metrology rig and nothing for a robot that avoids walls. The page therefore shows the figure first,
and the limit beside it.

Sources: the calibration rules of ROS ``camera_calibration``, of BoofCV, of Luxonis (depthai issue 646), of Kalibr's
users (kalibr issues 103, 697), OpenCV's calibration tutorial, and Intel's definitions for RealSense depth quality.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Threshold:
    """The limits of one figure.

    Attributes
    ----------
    name : str
        What is judged, in a few words.
    good, usable : float
        The figure is good up to (or from) `good`, usable up to (or from) `usable`, else bad.
    unit : str
    source : str
    higher_is_better : bool
    """

    name: str
    good: float
    usable: float
    unit: str
    source: str
    higher_is_better: bool = False

    def grade(self, value: float) -> Literal["good", "usable", "bad"]:
        """Grade a figure; NaN is bad."""
        if not math.isfinite(value):
            return "bad"
        sign = -1.0 if self.higher_is_better else 1.0
        if sign * value <= sign * self.good:
            return "good"
        return "usable" if sign * value <= sign * self.usable else "bad"

    @property
    def spelt(self) -> str:
        """The limits in words."""
        unit = f" {self.unit}" if self.unit else ""
        word = "from" if self.higher_is_better else "up to"
        if self.good == self.usable:
            return f"good {word} {self.good:g}{unit}, else bad"
        return f"good {word} {self.good:g}{unit}, usable {word} {self.usable:g}{unit}"


_ROS = "ROS camera_calibration's rule"
_BOOFCV = "BoofCV's geometry score, on undistorted corners; the limits are ours"

THRESHOLDS: dict[str, Threshold] = {
    # data
    "views": Threshold(
        "pairs used",
        10,
        5,
        "pairs",
        "OpenCV's calibration tutorial asks for at least 10; the lower limit is ours",
        True,
    ),
    "range_x": Threshold("range of position, x", 0.7, 0.4, "", f"{_ROS}; the lower limit is ours", True),
    "range_y": Threshold("range of position, y", 0.7, 0.4, "", f"{_ROS}; the lower limit is ours", True),
    "range_size": Threshold("range of size", 0.4, 0.2, "", f"{_ROS}; the lower limit is ours", True),
    "range_skew": Threshold("range of tilt (skew)", 0.5, 0.25, "", f"{_ROS}; the lower limit is ours", True),
    "geometry_score": Threshold("variety of tilt (geometry score)", 0.5, 0.25, "", _BOOFCV, True),
    "inner_cells": Threshold(
        "inner cells of the image seen", 80, 50, "%", "BoofCV's 10x10 cells; the limits are ours", True
    ),
    "border_cells": Threshold(
        "border cells of the image seen", 30, 5, "%", "BoofCV's border strip of 4 %; the limits are ours", True
    ),
    "edge_width": Threshold(
        "edge width of the board", 3.0, 5.0, "px", "ours: wider edges cost corner accuracy in proportion", False
    ),
    # fit
    "rms_per_axis": Threshold(
        "noise left in the corners, an axis",
        0.2,
        0.5,
        "px",
        "Kalibr's users aim for 0.1 to 0.2 px an axis (kalibr issues 103, 697); the upper limit is ours",
    ),
    "joint_mono": Threshold(
        "stereo RMS over mono RMS", 1.2, 1.5, "", "ours: above 1.5 points to flips, pairing or timing"
    ),
    "outlier_views": Threshold(
        "pairs that stand out", 0, 2, "pairs", "ours: RMS above the median by 5 robust σ and by half"
    ),
    "structure": Threshold(
        "pattern over the image", 0.35, 0.7, "σ", "ours: systematic part of the residuals over their noise"
    ),
    "radial_trend": Threshold("trend with the radius", 0.3, 0.6, "σ", "ours: systematic radial part over the noise"),
    "tails": Threshold("residuals beyond 4 σ", 0.3, 2.0, "%", "ours: a Gaussian has 0.006 %, blunders have the rest"),
    # parameters
    "aspect": Threshold("fx against fy", 1.0, 3.0, "%", "ours: pixels of today's sensors are square"),
    "centre": Threshold("centre from the image's middle", 6.0, 12.0, "% of the width", "ours"),
    "monotonic": Threshold(
        "distortion monotonic over the image", 100, 97, "% of the pixels", "ours: a lens does not fold its image", True
    ),
    "focal_sigma": Threshold("σ of the focal length", 0.5, 2.0, "%", "ours"),
    "condition": Threshold("condition number", 1e5, 1e8, "", "ours, on scaled columns"),
    # generalisation
    "held_out_rms": Threshold(
        "held-out noise, an axis",
        0.2,
        0.5,
        "px",
        "the same limits as for the fit: what holds for seen views must hold for unseen ones",
    ),
    "held_out_ratio": Threshold("held-out RMS over fitted RMS", 1.3, 2.0, "", "ours"),
    "halves": Threshold(
        "two halves against the promised σ", 3.0, 5.0, "σ", "ours: an honest covariance gives 1 on average, 2.5 rarely"
    ),
    # epipolar
    "epipolar_rms": Threshold(
        "held-out |Δy|, RMS", 0.5, 1.0, "px", "Luxonis: factory below 0.5, users' limit 1.0 px (depthai issue 646)"
    ),
    "epipolar_p95": Threshold("held-out |Δy|, 95 %", 1.0, 2.0, "px", "ours: twice the limits for the RMS"),
    # metric
    "square_bias": Threshold("scale of the triangulated boards", 0.2, 1.0, "%", "ours"),
    "plane": Threshold("flatness of the triangulated boards", 1.5, 2.5, "σ", "ours: over what corner noise explains"),
    "board_shape": Threshold("bend of the board", 0.5, 2.0, "% of a square", "ours"),
    "known_distance": Threshold("known distance", 0.5, 2.0, "%", "ours"),
    # depth
    "calibration_disparity": Threshold(
        "calibration's share of depth error",
        0.25,
        1.0,
        "px of disparity",
        "ours: 0.25 px is what dense matching leaves, so a calibration below it does not limit depth",
    ),
    "depth_bias": Threshold(
        "depth error the model hides",
        0.35,
        0.6,
        "px of disparity",
        "ours: beyond, depth is off by twice what is promised",
    ),
    # disparity
    "scene_rows": Threshold(
        "row offset on the scene", 0.5, 1.0, "px", "Luxonis: factory below 0.5, users' limit 1.0 px (depthai issue 646)"
    ),
    "consistency": Threshold("left-right consistency", 80, 60, "%", "ours: of the pixels with a disparity", True),
}
"""Threshold by key."""
