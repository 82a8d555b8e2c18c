"""Block 8, disparity: what the calibration does to a real pair of photographs.

A scene pair is the one test that no board takes part in. It is rectified, matched, and three things are measured.

**Rows.** If the calibration is right, a point lies on the same row left and right, also where no board ever was. The
right image is shifted by −4 … 4 rows, matched each time, and the answers that the left-right check confirms are
counted: most are confirmed where the rows agree. The peak of a parabola through the three largest counts is the row
offset, for the whole image and for its parts. It is judged as Δy is, by Luxonis' limits.

**Consistency**: the share of the disparities that the right image confirms (:mod:`stereocal.report.left_right`).

**Fill**: the share of the pixels whose window and search lie in the images that have a disparity. It is shown and not
judged: fill alone rewards wrong matches and smoothing.

With a sweep (:func:`stereocal.sweep.disparity_sweep.sweep_disparity`) the paper's figures 7 and 8 are redrawn [sec-3].
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.pair.rectification import rectify
from stereocal.reconstruction.block_matching import match_bm, valid_region
from stereocal.reconstruction.sad import as_gray_pair
from stereocal.report.figures_curves import draw_sweep_speckles, draw_sweep_windows
from stereocal.report.figures_images import draw_disparity, draw_rectified_pair
from stereocal.report.left_right import confirmed_pixels, mirror
from stereocal.report.verdicts import Block, Picture, Table, judge

Image = NDArray[np.uint8]

_SHIFTS = tuple(range(-4, 5))
_PARTS = (3, 3)


def match_both(
    left: Image, right: Image, count: int, block: int
) -> tuple[NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_]]:
    """Disparity of the left image, which of it the right image confirms, and about which it can be asked."""
    options: dict[str, Any] = {"num_disparities": count, "block_size": block}
    disparity = match_bm(left, right, **options)
    back = match_bm(mirror(right), mirror(left), **options)[:, ::-1]
    columns, _ = valid_region(left.shape, count, 0, block)
    return disparity, *confirmed_pixels(disparity, back, columns)


def row_offsets(left: Image, right: Image, count: int, *, block: int = 15) -> tuple[float, Float]:
    """By how many rows the right image lies lower than it should, in the whole image and in its ninths.

    Parameters
    ----------
    left, right : ndarray of shape (H, W), uint8
        A rectified pair.
    count : int
        Disparities to search.
    block : int
        Window.

    Returns
    -------
    whole : float
        Rows; NaN if too little is confirmed at any shift.
    parts : ndarray of shape (3, 3)
        The same for each ninth of the image.
    """
    counts = []
    for shift in _SHIFTS:
        moved = np.roll(right, -shift, axis=0)
        _, confirmed, _ = match_both(left, moved, count, block)
        confirmed[: max(_SHIFTS)] = confirmed[-max(_SHIFTS) :] = False
        counts.append([[float(part.sum()) for part in np.array_split(band, _PARTS[1], axis=1)]
                       for band in np.array_split(confirmed, _PARTS[0], axis=0)])  # fmt: skip
    table = np.array(counts)
    least = 0.005 * left.size / np.prod(_PARTS)
    parts = np.array([[_peak(table[:, r, c], float(least)) for c in range(_PARTS[1])] for r in range(_PARTS[0])])
    return _peak(table.sum(axis=(1, 2)), 0.005 * left.size), parts


def _peak(counts: Float, least: float) -> float:
    """Where a parabola through the largest count and its neighbours peaks; NaN if there are fewer than `least`."""
    k = int(np.argmax(counts))
    if counts[k] < least:
        return float("nan")
    if k in (0, len(counts) - 1):
        return float(_SHIFTS[k])
    before, top, after = counts[k - 1 : k + 2]
    curvature = before - 2 * top + after
    return _SHIFTS[k] + (0.5 * (before - after) / curvature if curvature else 0.0)


def examine_scene(
    rig: Any, left: Any, right: Any, *, num_disparities: int = 64, block_size: int = 21, sweep: Any = None
) -> Block:
    """Rectify and match a pair of photographs, and judge what comes out.

    Parameters
    ----------
    rig : StereoRig
    left, right : array_like of shape (H, W) or (H, W, 3)
        Photographs as taken.
    num_disparities, block_size : int
        Of the matcher (StereoBM's recipe, with its defaults).
    sweep : SweepTable, optional
        The paper's sweep of the same pair.

    Returns
    -------
    Block
    """
    rectification = rectify(rig)
    pair = rectification.apply(np.asarray(left), np.asarray(right))
    gray = as_gray_pair(*pair)
    disparity, confirmed, asked = match_both(*gray, num_disparities, block_size)
    valid = np.isfinite(disparity)
    columns, rows = valid_region(gray[0].shape, num_disparities, 0, block_size)
    computable = len(columns) * len(rows)
    consistency = 100 * float(confirmed.sum() / max(asked.sum(), 1))
    offset, parts = row_offsets(*gray, num_disparities)
    seen = parts[np.isfinite(parts)]
    spread = float(np.sqrt(np.mean(seen**2))) if seen.size else float("nan")
    off = "Away from where boards were seen the lens is extrapolated, or the rotation between the cameras is off."
    verdicts = (
        judge("disparity", "scene_rows", spread,
              "How many rows left and right differ on this scene, RMS over the ninths of the image.",
              cause=off,
              action="Add views with the board in the image's corners and edges; check the board's flatness."),
        judge("disparity", "consistency", consistency, "Disparities that the right image confirms to a pixel.",
              cause="Repeated or blank surfaces, reflections, or rows that do not agree.",
              action="If the rows agree, choose another scene with more texture, or a larger window.",
              at_worst="usable"),
    )  # fmt: skip
    fill = valid.sum() / max(computable, 1)
    facts: dict[str, Any] = {
        "row_offset": offset, "row_offset_rms": spread, "row_offset_parts": parts.tolist(),
        "consistency_percent": consistency,
        "disparities": int(valid.sum()), "computable": computable, "fill": float(fill),
        "num_disparities": num_disparities, "block_size": block_size,
    }  # fmt: skip
    lead = (
        f"On the scene the rows differ by {spread:.2f} px RMS over the ninths of the image; {fill:.0%} of the pixels "
        f"that can have a disparity have one, and the right image confirms {consistency:.0f} % of them. Fill alone "
        "says little: smoothing raises it."
    )
    pictures = [
        Picture("scene_rectified",
                "The scene, rectified: follow a line from a point on the left to the same point on the right.",
                lambda: draw_rectified_pair(*pair), wide=True),
        Picture("scene_disparity", "Disparity: bright is near. Grey has no answer.",
                lambda: draw_disparity(disparity, image=pair[0]), wide=True),
    ]  # fmt: skip
    if sweep is not None:
        text, more, found = _sweep_findings(sweep)
        lead, facts["sweep"] = f"{lead} {text}", found
        pictures += more
    cells = tuple(tuple("–" if np.isnan(v) else f"{v:+.2f}" for v in row) for row in parts)
    table = Table(
        "Row offset in each ninth of the image, px (– too little to tell)", ("left", "middle", "right"), cells
    )
    return Block("disparity", "Disparity", lead, verdicts, facts, (table,), tuple(pictures))


def _sweep_findings(sweep: Any) -> tuple[str, list[Picture], dict[str, Any]]:
    """What the paper's sweep says on this pair, its figures, and its facts."""
    count, blocks = sweep.column("count"), list(sweep.block_sizes)
    best = sweep.best_block()
    near = [b for b, c in zip(blocks, count[:, 0], strict=True) if c >= 0.98 * count[:, 0].max()]
    holds = any(27 <= b <= 31 for b in near)
    text = (
        f"The most disparities above 0 come from windows of {best} (within 2 % from {near[0]} to {near[-1]}); the "
        f"paper's 27 to 31 {'lie within that' if holds else 'do not hold here'}. Small windows answer less because "
        "they are not unique and their islands are filtered away, and large ones because they fit in fewer places: the "
        "falling branch is mostly geometry (dashed)."
    )
    shown = dict.fromkeys((sweep.speckle_sizes[0], sweep.speckle_sizes[-1]))
    by_speckle = {s: count[:, sweep.speckle_sizes.index(s)] for s in shown}
    some = [b for b in (5, 7, 15, 29, 41, 99) if b in blocks] or blocks[:4]
    by_block = {b: count[blocks.index(b)] for b in some}
    pictures = [
        Picture("sweep_windows", "The paper's figure 7: disparities above 0 over the window's size. Dashed: as many "
                "pixels can have one. Below: their fill, and how many the right image confirms.",
                lambda: draw_sweep_windows(blocks, by_speckle, computable=sweep.column("computable")[:, 0],
                                           consistency=sweep.column("consistency")[:, 0])),
        Picture("sweep_speckles", "The paper's figure 8: disparities above 0 over the speckle filter's size.",
                lambda: draw_sweep_speckles(sweep.speckle_sizes, by_block)),
    ]  # fmt: skip
    facts = {"best_block": best, "within_2_percent": [near[0], near[-1]], "paper_holds": holds}
    return text, pictures, facts
