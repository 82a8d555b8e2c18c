"""Block 8, disparity: what the calibration does to a real pair of photographs.

A scene pair is the one test that no board takes part in. It is rectified, matched, and three things are measured.

**Rows.** If the calibration is right, a point lies on the same row left and right, also where no board ever was. The
right image is shifted by −4 … 4 rows and matched each time; the rows agree where matched pixels differ least.
Compared are the same pixels at every shift, those that the left-right check confirms at any. The sum of absolute
differences rises by the same slope on both sides of its minimum, so that the row offset is where two such lines
through the three lowest points meet. It is found for the whole image and for each of its ninths; their RMS is judged
as Δy is, by Luxonis' limits: the whole alone would follow the part with the most texture.

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
from stereocal.pair.search_direction import turn_back, turn_for_matching
from stereocal.reconstruction.block_matching import match_bm, valid_region
from stereocal.reconstruction.sad import as_gray_pair
from stereocal.report.figures_curves import draw_sweep_speckles, draw_sweep_windows
from stereocal.report.figures_images import draw_disparity, draw_rectified_pair
from stereocal.report.left_right import confirmed_pixels, mirror
from stereocal.report.verdicts import Block, Picture, Table, judge

Image = NDArray[np.uint8]

_SHIFTS = tuple(range(-4, 5))
_WORST = 30.0
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
        Rows; NaN if too little is confirmed.
    parts : ndarray of shape (3, 3)
        The same for each ninth of the image.
    """
    costs, mask = [], np.zeros(left.shape, dtype=bool)
    for shift in _SHIFTS:
        moved = np.roll(right, -shift, axis=0)
        disparity, confirmed, _ = match_both(left, moved, count, block)
        mask |= confirmed
        costs.append(_difference(left, moved, disparity))
    mask[: max(_SHIFTS)] = mask[-max(_SHIFTS) :] = False
    cells = [
        [np.ix_(rows, columns) for columns in np.array_split(np.arange(left.shape[1]), _PARTS[1])]
        for rows in np.array_split(np.arange(left.shape[0]), _PARTS[0])
    ]
    least = 0.005 * left.size
    parts = [[_lowest([c[cell][mask[cell]] for c in costs], least / np.prod(_PARTS)) for cell in row] for row in cells]
    return _lowest([c[mask] for c in costs], least), np.array(parts)


def _difference(left: Image, right: Image, disparity: NDArray[np.float32]) -> Float:
    """How much each pixel differs from its match, grey levels, cut at 30; 30 where there is no match."""
    y, x = np.nonzero(np.isfinite(disparity))
    at = np.clip(x - disparity[y, x], 0, left.shape[1] - 1)
    low = np.floor(at).astype(np.int64)
    part = at - low
    matched = (1 - part) * right[y, low] + part * right[y, np.minimum(low + 1, left.shape[1] - 1)]
    cost = np.full(left.shape, _WORST)
    cost[y, x] = np.minimum(np.abs(left[y, x] - matched), _WORST)
    return cost


def _lowest(costs: list[Float], least: float) -> float:
    """Where two lines of equal slope through the smallest mean cost and its neighbours meet; NaN for too few pixels."""
    if len(costs[0]) < least:
        return float("nan")
    mean = np.array([c.mean() for c in costs])
    k = int(np.argmin(mean))
    if k in (0, len(mean) - 1):
        return float(_SHIFTS[k])
    before, lowest, after = mean[k - 1 : k + 2]
    rise = max(before, after) - lowest
    return float(_SHIFTS[k] + (0.5 * (before - after) / rise if rise > 0 else 0.0))


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
    rectification = rectify(rig, view="common")  # OpenCV's own frame can show mostly ghosts of a wide lens
    pair = rectification.apply(np.asarray(left), np.asarray(right))
    gray = as_gray_pair(*(turn_for_matching(view, rectification) for view in pair))
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
                lambda: draw_rectified_pair(*pair, axis=rectification.axis), wide=True),
        Picture("scene_disparity", "Disparity: bright is near. Grey has no answer.",
                lambda: draw_disparity(np.abs(turn_back(disparity, rectification)), image=pair[0]), wide=True),
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
