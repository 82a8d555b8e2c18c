"""Block 1, data: which pairs were used, and whether they show the lens and the rig enough to fit them.

**Coverage of the image.** A distortion model is only as good as the part of the image where it saw a corner; outside it
extrapolates a polynomial. BoofCV's measure is used: a strip along the border (4 % of the mean side) in 15 cells a side,
and the inside in 10×10 cells; a cell counts as seen with one corner in it.

**Variety of the views.** ROS ``camera_calibration`` describes a view by four numbers in [0, 1]: with A the area of the
quadrilateral of the outer corners and w = √A,

    X = (x̄ − w/2) / (W − w),   Y = (ȳ − w/2) / (H − w),   size = √(A / (W H)),   skew = min(1, 2·|π/2 − angle at a
    corner|),

and asks for ranges of 0.7, 0.7, 0.4 and 0.5 (size and skew from 0). Skew is what perspective does to a right angle: it
is the sign of a tilted board.

**Does the tilt suffice?** Zhang's closed form solves V b = 0 for the six entries b of K⁻ᵀK⁻¹; each view gives two
rows. With singular values σ₁ ≤ σ₂ ≤ …, one null vector (σ₁ ≈ 0) is the answer, and a second (σ₂ ≈ 0) means that the
views leave a whole family of cameras: they are parallel, or too few. BoofCV's geometry score is min(1, (σ₂/σ₃)/0.2).
Two changes are ours. The corners are undistorted first: distortion looks like perspective to a homography, and boards
held at 4° score 0.96 on a wide lens as they are, 0.17 without its distortion. And where σ₃ is nothing but noise too
(below a hundredth of σ₆) the score is 0: parallel views leave two equations, and a ratio of two zeros may be
anything. Pixels are scaled to about ±1 around the image's middle, or the unit of b's entries would decide the ratio.

Sources: ROS camera_calibration (``get_parameters``, ``compute_goodenough``); P. Abeles, BoofCV
(``ScoreCalibrationFill``, ``ScoreCalibrationGeometricDiversity``); Zhang (2000).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.homography import fit_homography
from stereocal.report.advice import photographs_to_add, view_tilts
from stereocal.report.evidence import Evidence
from stereocal.report.figures_geometry import draw_coverage
from stereocal.report.style import LEFT, RIGHT
from stereocal.report.thumbnails import Thumbnail, make_thumbnails
from stereocal.report.verdicts import Block, Picture, Table, Verdict, judge

_RANGES = ("x", "y", "size", "skew")


def view_parameters(corners: Float, columns: int, image_size: tuple[int, int]) -> Float:
    """Describe views as ROS does, by X, Y, size and skew, each in [0, 1].

    Parameters
    ----------
    corners : ndarray of shape (V, N, 2)
        Pixels, row by row.
    columns : int
        Corners in a row.
    image_size : tuple of (width, height)

    Returns
    -------
    ndarray of shape (V, 4)
    """
    width, height = image_size
    outer = corners[:, [0, columns - 1, -1, -columns]]
    diagonal_1, diagonal_2 = outer[:, 2] - outer[:, 0], outer[:, 3] - outer[:, 1]
    area = 0.5 * np.abs(diagonal_1[:, 0] * diagonal_2[:, 1] - diagonal_1[:, 1] * diagonal_2[:, 0])
    side = np.sqrt(area)
    centre = corners.mean(axis=1)
    x = (centre[:, 0] - side / 2) / np.maximum(width - side, 1)
    y = (centre[:, 1] - side / 2) / np.maximum(height - side, 1)
    along, across = outer[:, 0] - outer[:, 1], outer[:, 2] - outer[:, 1]
    cosine = np.sum(along * across, axis=1) / (np.linalg.norm(along, axis=1) * np.linalg.norm(across, axis=1))
    skew = 2 * np.abs(np.pi / 2 - np.arccos(np.clip(cosine, -1, 1)))
    return np.clip(np.stack([x, y, np.sqrt(area / (width * height)), skew], axis=1), 0, 1)


def parameter_ranges(parameters: Float) -> Float:
    """Ranges of X, Y, size and skew over the views; size and skew count from 0, as in ROS."""
    low = parameters.min(axis=0) * np.array([1, 1, 0, 0])
    return np.asarray(parameters.max(axis=0) - low)


def seen_cells(
    points: Float, image_size: tuple[int, int], *, border_cells: int = 15, inner_cells: int = 10
) -> tuple[Float, Float]:
    """Which cells of the border strip and of the inside hold a corner (BoofCV's fill score).

    Parameters
    ----------
    points : ndarray of shape (M, 2)
    image_size : tuple of (width, height)
    border_cells : int
        Cells along each side.
    inner_cells : int
        Cells along each axis of the inside.

    Returns
    -------
    border : ndarray of bool, shape (4 * border_cells,)
        Clockwise from the top left.
    inside : ndarray of bool, shape (inner_cells, inner_cells)
    """
    width, height = image_size
    strip = max(5.0, 0.04 * (width + height) / 2)
    x, y = points[:, 0] + 0.5, points[:, 1] + 0.5  # from the outer edge of the image
    border = np.zeros(4 * border_cells, dtype=bool)
    along_x = np.clip((x / width * border_cells).astype(int), 0, border_cells - 1)
    along_y = np.clip((y / height * border_cells).astype(int), 0, border_cells - 1)
    border[along_x[y < strip]] = True
    border[border_cells + along_y[x >= width - strip]] = True
    border[2 * border_cells + (border_cells - 1 - along_x[y >= height - strip])] = True
    border[3 * border_cells + (border_cells - 1 - along_y[x < strip])] = True
    inner = (x >= strip) & (x < width - strip) & (y >= strip) & (y < height - strip)
    column = ((x[inner] - strip) / (width - 2 * strip) * inner_cells).astype(int)
    row = ((y[inner] - strip) / (height - 2 * strip) * inner_cells).astype(int)
    inside = np.zeros((inner_cells, inner_cells), dtype=bool)
    inside[row, column] = True
    return border, inside


def geometry_score(corners: Float, object_points: Float, image_size: tuple[int, int]) -> float:
    """BoofCV's score of the views' geometry, min(1, (σ₂/σ₃)/0.2) of Zhang's linear system, σ ascending.

    Parameters
    ----------
    corners : ndarray of shape (V, N, 2)
        Undistorted pixels.
    object_points : ndarray of shape (N, 3)
        A flat board's points; z is ignored.
    image_size : tuple of (width, height)

    Returns
    -------
    float
        From 0 (the views leave a family of cameras) to 1.
    """
    half = max(image_size) / 2
    centre = (np.array(image_size) - 1) / 2
    plane = object_points[:, :2] - object_points[:, :2].mean(axis=0)
    plane = plane / np.abs(plane).max()
    rows = []
    for view in corners:
        H = fit_homography(plane, (view - centre) / half, refine=False)
        H = H / np.linalg.norm(H[:, :2]) * np.sqrt(2)
        v11, v12, v22 = (_zhang_row(H[:, i], H[:, j]) for i, j in ((0, 0), (0, 1), (1, 1)))
        rows += [v12, v11 - v22]
    values = np.sort(np.linalg.svd(np.array(rows), compute_uv=False))
    values = np.concatenate([np.zeros(6 - len(values)), values])
    if values[2] < 0.01 * values[5]:
        return 0.0
    return float(min(1.0, values[1] / values[2] / 0.2))


def _undistorted(camera: Any, corners: Float) -> Float:
    """Corners as an ideal camera draws them, without the views in which one cannot be undone."""
    flat = np.asarray(camera.undistort_points(corners.reshape(-1, 2))).reshape(corners.shape)
    return flat[np.isfinite(flat).all(axis=(1, 2))]


def _zhang_row(a: Float, b: Float) -> Float:
    """v with v·b = aᵀ B b for the symmetric B = K⁻ᵀK⁻¹ packed as (B11, B12, B22, B13, B23, B33)."""
    return np.array(
        [
            a[0] * b[0],
            a[0] * b[1] + a[1] * b[0],
            a[1] * b[1],
            a[2] * b[0] + a[0] * b[2],
            a[2] * b[1] + a[1] * b[2],
            a[2] * b[2],
        ]
    )


def examine_data(evidence: Evidence, pairs: Sequence[Mapping[str, Any]], images: Sequence[Any] | None) -> Block:
    """Measure and judge the data: pairs used, coverage, variety, sharpness.

    Parameters
    ----------
    evidence : Evidence
    pairs : sequence of mapping
        One a pair, used or not: ``left``, ``right``, ``used``, ``reason``; optionally ``left_edge_width``,
        ``right_edge_width``.
    images : sequence of (left, right), optional
        Photographs of `pairs`.

    Returns
    -------
    Block
    """
    size = evidence.image_size
    sides = {"left": evidence.left, "right": evidence.right}
    parameters = {side: view_parameters(corners, evidence.columns, size) for side, corners in sides.items()}
    ranges = {side: parameter_ranges(p) for side, p in parameters.items()}
    cells = {side: seen_cells(corners.reshape(-1, 2), size) for side, corners in sides.items()}
    cameras = {"left": evidence.rig.left, "right": evidence.rig.right}
    scores = {
        side: geometry_score(_undistorted(cameras[side], c), evidence.object_points, size) for side, c in sides.items()
    }
    tilts = view_tilts(evidence)
    advice = photographs_to_add(evidence, tilts)
    verdicts = _judge_data(evidence, pairs, ranges, cells, scores, tilts, advice)
    used, rejected = evidence.view_count, [p for p in pairs if not p["used"]]
    lead = f"{used} of {max(len(pairs), used)} pairs were used."
    if rejected:
        lead += f" {len(rejected)} {'was' if len(rejected) == 1 else 'were'} left out; the reason stands by each."
    if advice:
        lead += " Photographs that would help most: " + "; ".join(advice) + "."
    facts = {
        "pairs_found": len(pairs),
        "pairs_used": used,
        "rejected": [{key: p.get(key) for key in ("left", "right", "reason")} for p in rejected],
        "ranges": {side: dict(zip(_RANGES, map(float, r), strict=True)) for side, r in ranges.items()},
        "border_seen": {side: float(c[0].mean()) for side, c in cells.items()},
        "inside_seen": {side: float(c[1].mean()) for side, c in cells.items()},
        "geometry_score": scores,
        "tilt_degrees": [float(t) for t in tilts],
        "photographs_to_add": list(advice),
    }
    pictures = tuple(
        Picture(
            f"coverage_{side}",
            f"Where the {side} camera saw corners. × marks cells without one; green along the edge: border cells seen, "
            "dotted: not seen.",
            lambda side=side, corners=corners, colour=colour: draw_coverage(  # type: ignore[misc]
                corners.reshape(-1, 2), size, border=list(cells[side][0]), colour=colour, title=f"coverage, {side}"
            ),
        )
        for (side, corners), colour in zip(sides.items(), (LEFT, RIGHT), strict=True)
    )
    thumbnails: tuple[Thumbnail, ...] = make_thumbnails(evidence, pairs, images) if images is not None else ()
    tables = (_rejected_table(rejected),) if rejected and not thumbnails else ()
    return Block("data", "Data", lead, verdicts, facts, tables, pictures, thumbnails)


def _judge_data(
    evidence: Evidence,
    pairs: Sequence[Mapping[str, Any]],
    ranges: Mapping[str, Float],
    cells: Mapping[str, tuple[Float, Float]],
    scores: Mapping[str, float],
    tilts: Float,
    advice: Sequence[str],
) -> tuple[Verdict, ...]:
    add = f"Add photographs: {'; '.join(advice)}." if advice else "Add photographs from more directions."
    verdicts = [
        judge("data", "views", evidence.view_count, "Pairs in which the whole board was found left and right.",
              cause="Few pairs leave every parameter to chance.",
              action="Take 15 to 20 pairs, the board held still, each with another place and tilt.", decides=False),
        judge("data", "geometry_score", min(scores.values()),
              "Whether the boards' tilts single out one camera, from Zhang's linear system.",
              cause=f"The boards face the camera too squarely: the median tilt is {np.median(tilts):.0f}°.",
              action="Tilt the board by about 30° to the left, to the right, up and down, a few pairs each.",
              decides=False),
    ]  # fmt: skip
    ways = (
        (
            "range_x",
            "from left to right",
            "Hold the board farther to the left and to the right, up to the image's edge.",
        ),
        ("range_y", "from top to bottom", "Hold the board higher and lower, up to the image's edge."),
        ("range_size", "from far to near", "Come nearer, until the board fills most of the image's height."),
        ("range_skew", "in tilt", "Tilt the board by 30 to 45°, also about its diagonals."),
    )
    for i, (key, how, cure) in enumerate(ways):
        verdicts.append(
            judge("data", key, min(r[i] for r in ranges.values()),
                  f"How far the boards range {how}, of 1; the camera that saw less.",
                  cause=f"The boards differ little {how}.", action=cure, at_worst="usable", decides=False)
        )  # fmt: skip
    places = "Hold the board so close to the image's edge that its outer corners nearly leave it, on all four sides."
    for key, index, what, cure in (("inner_cells", 1, "inside", add), ("border_cells", 0, "border strip", places)):
        value = 100 * min(float(c[index].mean()) for c in cells.values())
        verdicts.append(
            judge("data", key, value, f"Cells of the image's {what} with a corner in them; the camera that saw less.",
                  cause="Where no corner was seen, the lens model extrapolates.", action=cure, at_worst="usable",
                  decides=False)
        )  # fmt: skip
    widths = [p[key] for p in pairs if p["used"] for key in ("left_edge_width", "right_edge_width") if p.get(key)]
    if widths:
        verdicts.append(
            judge("data", "edge_width", float(np.median(widths)), "How wide the board's edges are drawn: sharpness.",
                  cause="The photographs are out of focus, or the board moved.",
                  action="Focus once, lock the focus, and hold the board still or use a shorter exposure.",
                  at_worst="usable", decides=False)
        )  # fmt: skip
    return tuple(verdicts)


def _rejected_table(rejected: Sequence[Mapping[str, Any]]) -> Table:
    rows = tuple((str(p.get("left")), str(p.get("right")), str(p.get("reason") or "")) for p in rejected)
    return Table("Pairs left out", ("left", "right", "reason"), rows)
