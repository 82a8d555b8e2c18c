"""The board's shape, drawn: a map of its heights, and profiles, in which a hinge is a kink.

Heights of a good board are a thousandth of its size. In a map colours show where the board stands off its plane, but
not how: a bow and a hinge look alike. So below it every line of corners is drawn as seen from the side, along the axis
on which the board bends more, and the mean of them all. A bow is a curve; a hinge is two straight parts.

The kink of the mean profile z̄ at corner i is its second difference, κ_i = z̄_{i−1} − 2 z̄_i + z̄_{i+1}, in which errors of
σ a corner leave σ √(6 / lines). Where the largest is beyond five times that it is marked: the hinge, if there is one.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from stereocal.base.checks import Float
from stereocal.report.style import (
    DIVERGING,
    INK,
    LEFT,
    MUTED,
    PANEL,
    RIGHT,
    SMALL,
    add_colorbar,
    add_legend,
    dress,
    image_panel_height,
    new_figure,
)

_CERTAIN = 5.0


def heights_over_plane(points: Float) -> Float:
    """Return how far points (N, 3) stand off the plane that fits them best, (N,), along z."""
    plane = np.column_stack([points[:, :2], np.ones(len(points))])
    return np.asarray(points[:, 2] - plane @ np.linalg.lstsq(plane, points[:, 2], rcond=None)[0])


def sharpest_bend(heights: Float, sigma: float) -> tuple[int, int | None]:
    """Return the axis (0: from row to row, 1: from column to column) that bends more, and where its kink is.

    Parameters
    ----------
    heights : ndarray of shape (rows, columns)
        Of the corners.
    sigma : float
        Standard error of each.

    Returns
    -------
    axis : int
    kink : int or None
        Number of the row or column; None where no kink is certain.
    """
    profiles = [heights.mean(axis=1), heights.mean(axis=0)]
    axis = int(np.std(profiles[1]) > np.std(profiles[0]))
    kinks = np.abs(np.diff(profiles[axis], 2))
    if len(kinks) == 0 or kinks.max() <= _CERTAIN * sigma * np.sqrt(6 / heights.shape[1 - axis]):
        return axis, None
    return axis, int(np.argmax(kinks)) + 1


def draw_board_shape(
    heights: ArrayLike, *, unit: str = "", sigma: float = np.inf, title: str = "shape of the board"
) -> Figure:
    """Draw how far each corner stands off the board's plane, as a map of the board and in profile.

    Parameters
    ----------
    heights : array_like of shape (rows, columns)
        Positive away from the camera.
    unit : str
        Theirs.
    sigma : float
        Standard error of a height; the sharpest bend is marked where it is certain.
    title : str
        Over the map.

    Returns
    -------
    Figure
    """
    values = np.asarray(heights, dtype=np.float64)
    rows, columns = values.shape
    axis, kink = sharpest_bend(values, sigma)
    of_map = image_panel_height((columns, rows), 0.8 * PANEL, 0.55)
    figure, grid = new_figure(PANEL, of_map + 2.3, rows=2, height_ratios=(of_map, 2.3))
    upper, lower = grid[:, 0]
    reach = float(np.abs(values).max()) or 1.0
    shown = upper.imshow(values, cmap=DIVERGING, vmin=-reach, vmax=reach, interpolation="bilinear")
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    upper.plot(x.ravel(), y.ravel(), ".", color=INK, markersize=3)
    dress(upper, title, "column", "row", grid="none")
    add_colorbar(figure, shown, upper, f"off the plane{', ' + unit if unit else ''}")

    profiles, lines = (values, "column") if axis == 0 else (values.T, "row")
    along = "row" if axis == 0 else "column"
    at = np.arange(len(profiles))
    lower.plot(at, profiles, color=MUTED, linewidth=0.7, alpha=0.6)
    lower.plot([], [], color=MUTED, linewidth=0.7, label=f"each {lines}")
    lower.plot(at, profiles.mean(axis=1), ".-", color=LEFT, linewidth=1.8, markersize=6, label="mean")
    for axes, ticks in ((lower, len(at)), (upper, columns)):
        axes.set_xticks(np.arange(ticks))
    upper.set_yticks(np.arange(rows))
    if kink is not None:
        (upper.axhline if axis == 0 else upper.axvline)(kink, color=RIGHT, linestyle="--", linewidth=1.2)
        lower.axvline(kink, color=RIGHT, linestyle="--", linewidth=1.2, label=f"sharpest bend, {along} {kink}")
    lower.set_ylim(-1.1 * reach, 1.1 * reach)
    dress(lower, "seen from the side", along, f"off the plane{', ' + unit if unit else ''}")
    lower.yaxis.label.set_fontsize(SMALL)
    add_legend(lower, loc="upper center", bbox_to_anchor=(0.45, -0.24), ncol=3)  # below, where it hides no line
    return figure
