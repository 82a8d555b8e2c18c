"""Block 6, metric: does the rig measure the board as it is?

Every pair of corners is triangulated from its two pixels alone, without the fitted pose, and the board that comes out
is measured: its scale, the side of its squares, how flat it is, and, if all views bend the same way, its
shape.

**Squares used in the fit cannot validate absolute scale.** The fit put the squares' size into T, so the mean square
comes out right whatever the true size: a board of 26 mm called 25 mm gives a perfect report and depths 4 % short.
What the squares do validate is that scale is the *same* everywhere: over the image, near and far. For the absolute
scale measure a distance that was not in the fit (``known_distance``).

The board's own shape comes from :mod:`stereocal.report.board_bend`.

Source: RealSense's definition of plane-fit RMS.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float
from stereocal.report.board_bend import BoardBend
from stereocal.report.evidence import Evidence
from stereocal.report.figures_board import draw_board_shape, heights_over_plane
from stereocal.report.rectified import rectify_corners
from stereocal.report.rig_parameters import depths
from stereocal.report.verdicts import Block, Picture, Table, Verdict, judge


def triangulate_corners(evidence: Evidence) -> Float:
    """Every corner from its two pixels: (V, N, 3) in the rectified left camera's frame; NaN where undistortion fails.

    For a rectified pair the depth is f·B/d; the point is the ray of the left pixel at that depth.
    """
    r = rectify_corners(evidence.rig, evidence.left, evidence.right)
    axis, across, f = r.axis, 1 - r.axis, r.focal_length
    disparity = r.left[..., axis] - r.right[..., axis]
    z = -r.baseline * f / np.where(np.abs(disparity) > 1e-9, disparity, np.nan)
    xyz = np.empty((*z.shape, 3))
    xyz[..., axis] = r.left[..., axis] * z / f
    xyz[..., across] = (r.left[..., across] + r.right[..., across]) / 2 * z / f  # of rows that should agree, the mean
    xyz[..., 2] = z
    return xyz


def square_sides(points: Float, columns: int, rows: int) -> Float:
    """Sides of all squares of triangulated boards: (V, N, 3) → (V, edges)."""
    grid = points.reshape(len(points), rows, columns, 3)
    across = np.linalg.norm(np.diff(grid, axis=2), axis=-1).reshape(len(points), -1)
    down = np.linalg.norm(np.diff(grid, axis=1), axis=-1).reshape(len(points), -1)
    return np.concatenate([across, down], axis=1)


def board_scales(points: Float, object_points: Float) -> Float:
    """Scale of each triangulated board against the board itself: (V, N, 3) → (V,).

    Each board is turned onto its own model (Kabsch) and compared along the model: s = Σ (R X)·Y / Σ‖X‖². Noise enters
    linearly, so that it averages out; the mean length of the sides would not do: noise makes every side longer.
    """
    X = object_points - object_points.mean(axis=0)
    Y = points - points.mean(axis=1, keepdims=True)
    U, _, Wt = np.linalg.svd(np.einsum("nj,vni->vij", X, Y))
    U[..., 2] *= np.sign(np.linalg.det(U @ Wt))[:, None]
    return np.asarray(np.einsum("vni,vij,nj->v", Y, U @ Wt, X) / np.sum(X**2))


def plane_distances(points: Float) -> Float:
    """Distance of each point from the plane through its own board: (V, N, 3) → (V, N)."""
    centred = points - points.mean(axis=1, keepdims=True)
    normals = np.linalg.svd(centred, full_matrices=False)[2][:, 2]
    return np.asarray(np.einsum("vnk,vk->vn", centred, normals))


def examine_metric(
    evidence: Evidence, bend: BoardBend | None, known_distances: Sequence[tuple[Any, Any, float]] = ()
) -> Block:
    """Measure and judge the triangulated boards.

    Parameters
    ----------
    evidence : Evidence
    bend : BoardBend, optional
        The step with the board's shape free; None if the views are too few.
    known_distances : sequence of ((xl, yl, xr, yr), (xl, yl, xr, yr), length)
        Pairs of points, each by its pixels in both photographs, and their true distance.

    Returns
    -------
    Block
    """
    points = triangulate_corners(evidence)
    whole = np.isfinite(points).all(axis=(1, 2))
    points = points[whole]
    size, unit = evidence.square_size, evidence.unit
    sides = square_sides(points, evidence.columns, evidence.rows)
    scales = board_scales(points, evidence.object_points)
    bias = 100 * (float(scales.mean()) - 1)
    flat = plane_distances(points)
    plane_rms = float(np.sqrt(np.mean(flat**2)))
    f, baseline = float(evidence.rig.left.K[0, 0]), float(evidence.rig.baseline)
    sigma_depth = points[..., 2] ** 2 * np.sqrt(2) * evidence.noise / (f * baseline)
    plane_sigma = float(np.sqrt(float(np.mean(sigma_depth**2))))
    measured = [_known_distance(evidence.rig, *known) for known in known_distances]
    verdicts = _judge_metric(
        bias, plane_rms / max(plane_sigma, 1e-300), None if bend is None else 100 * bend.rms / size, measured
    )
    near, far = (float(z) for z in np.percentile(evidence.points_left[..., 2].mean(axis=1), (25, 75)))
    facts = {
        "square_mean": float(sides.mean()), "square_sd": float(sides.std()), "scale_bias_percent": bias,
        "scale_sd_percent": 100 * float(scales.std()),
        "plane_rms": plane_rms, "plane_rms_expected": plane_sigma, "distance_quartiles": [near, far],
        "board_bend_rms": None if bend is None else bend.rms,
        "board_heights": None if bend is None else bend.heights.tolist(),
        "board_bend_f": None if bend is None else bend.f_statistic,
        "known_distances": [{"measured": found, "true": true} for found, true in measured],
    }  # fmt: skip
    scale = f"{100 + bias:.2f} ± {100 * float(scales.std()):.2f} %"
    side = f"{sides.mean():.4g} ± {sides.std():.2g} {unit}"
    lead = (
        f"Triangulated boards come out at {scale} of their size, single squares at {side} (size {size:g}); boards are "
        f"flat to {plane_rms:.3g} {unit} RMS, where corner noise alone gives {plane_sigma:.3g}. Squares used in the "
        "fit cannot validate absolute scale: measure a known distance for that."
    )
    rows = tuple(
        (
            name,
            f"{100 * k:.2f} %",
            f"{s.mean():.5g}",
            f"{s.std():.2g}",
            f"{float(np.sqrt(np.mean(d**2))):.3g}",
            f"{p[:, 2].mean():.4g}",
        )
        for name, k, s, d, p in zip(np.array(evidence.names)[whole], scales, sides, flat, points, strict=True)
    )
    table = Table(
        f"Each board, triangulated ({unit})",
        ("pair", "scale", "mean square", "sd", "off its plane, RMS", "distance"),
        rows,
        True,
    )
    pictures = () if bend is None else (_bend_picture(evidence, bend),)
    return Block("metric", "Metric", lead, verdicts, facts, (table,), pictures)


def _judge_metric(
    bias: float, flatness: float, bend: float | None, measured: Sequence[tuple[float, float]]
) -> tuple[Verdict, ...]:
    verdicts = [
        judge("metric", "square_bias", abs(bias), "Mean scale of the triangulated boards against the board's own. It "
              "cannot validate absolute scale: the fit has used the same squares.",
              cause="The geometry of the two cameras contradicts the board's.",
              action="Look at the flatness of the board and at the pairs that stand out."),
        judge("metric", "plane", flatness,
              "RMS distance of triangulated corners from their board's plane, over what corner noise alone gives.",
              cause="The board bends, or the shutters are not synchronous.",
              action="Glue the board to glass or aluminium.",
              at_worst="usable"),
    ]  # fmt: skip
    if bend is not None:
        verdicts.append(
            judge("metric", "board_shape", bend,
                  "How far the board's corners stand off its plane, RMS, the same in all views.",
                  cause="The board is bent, folded or printed on soft paper.",
                  action="Glue it to glass or aluminium, or calibrate with its shape as unknowns (board_warp).",
                  at_worst="usable")
        )  # fmt: skip
    if measured:
        worst_error = max(100 * abs(found / true - 1) for found, true in measured)
        verdicts.append(
            judge("metric", "known_distance", worst_error, "Distances that were not in the fit, against their length.",
                  cause="The squares' size is not what was said, or the print is stretched.",
                  action="Measure ten squares at once with a caliper and calibrate again with that size.")
        )  # fmt: skip
    return tuple(verdicts)


def _bend_picture(evidence: Evidence, bend: BoardBend) -> Picture:
    # a calibration that freed the board's shape has it in its points already: the step finds what is left of it
    heights = heights_over_plane(evidence.object_points) + bend.heights
    heights = heights.reshape(evidence.rows, evidence.columns)
    typical = float(np.median(bend.sigma))
    return Picture(
        "board_shape",
        f"The board's shape as all views together see it: height of each corner over its plane (σ {typical:.2g} "
        f"{evidence.unit} a corner), and its lines from the side: a curve is a bow, a kink a hinge, a mixture noise.",
        lambda: draw_board_shape(heights, unit=evidence.unit, sigma=typical),
    )


def _known_distance(rig: Any, first: ArrayLike, second: ArrayLike, true: float) -> tuple[float, float]:
    """Distance of two points given by (xl, yl, xr, yr), and what it should be."""
    pixels = np.array([first, second], dtype=np.float64)
    left, right = pixels[:, :2], pixels[:, 2:]
    z = depths(rig, left, right)
    rays = np.asarray(rig.left.undistort_points(left, P=np.eye(3)))
    ends = np.concatenate([rays, np.ones((2, 1))], axis=1) * z[:, None]
    return float(np.linalg.norm(ends[1] - ends[0])), float(true)
