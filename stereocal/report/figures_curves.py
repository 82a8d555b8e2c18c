"""Pictures of curves: σ_Z over distance, and the paper's figures 7 and 8."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from stereocal.report.style import (
    AMBER,
    GREEN,
    INK,
    LEFT,
    MUTED,
    PANEL,
    PURPLE,
    RIGHT,
    SKY,
    SMALL,
    add_legend,
    dress,
    dress_image,
    image_panel_height,
    new_figure,
)

__all__ = ["draw_depth_uncertainty", "draw_sweep_maps", "draw_sweep_speckles", "draw_sweep_windows"]


def draw_depth_uncertainty(
    distance: ArrayLike,
    from_disparity: ArrayLike,
    from_calibration: ArrayLike,
    *,
    board_range: tuple[float, float] | None = None,
    unit: str = "",
    title: str = "depth uncertainty",
) -> Figure:
    """Draw σ_Z over distance: from disparity noise, from the calibration, and both together.

    Parameters
    ----------
    distance : array_like of shape (M,)
        Z, in board units.
    from_disparity : array_like of shape (M,)
        Z²·σ_d/(f·B).
    from_calibration : array_like of shape (M,)
        From the calibration's covariance.
    board_range : tuple of (near, far), optional
        Where the boards stood; outside it the curve is extrapolated.
    unit, title : str

    Returns
    -------
    Figure
    """
    z, a, b = (np.asarray(v, dtype=np.float64) for v in (distance, from_disparity, from_calibration))
    figure, grid = new_figure(PANEL, 3.0)
    axes = grid[0, 0]
    if board_range is not None:
        axes.axvspan(*board_range, color=SKY, alpha=0.18, linewidth=0, label="boards stood here")
    axes.plot(z, 100 * np.hypot(a, b) / z, color=INK, linewidth=2.0, label="both together")
    axes.plot(z, 100 * a / z, color=AMBER, linewidth=1.4, linestyle="--", label="disparity noise")
    axes.plot(z, 100 * b / z, color=LEFT, linewidth=1.4, linestyle=":", label="calibration")
    axes.set_xlim(z.min(), z.max())
    axes.set_ylim(bottom=0)
    dress(axes, title, f"distance Z{', ' + unit if unit else ''}", "σ_Z, % of Z")
    add_legend(axes, loc="upper left")
    return figure


def draw_sweep_windows(
    block_sizes: ArrayLike,
    counts: Mapping[int, ArrayLike],
    *,
    computable: ArrayLike | None = None,
    consistency: ArrayLike | None = None,
    bad_pixels: ArrayLike | None = None,
    pixels: int | None = None,
    title: str = "figure 7: window size",
) -> Figure:
    """Draw the paper's figure 7: number of disparities > 0 over the window size, and what explains it.

    Parameters
    ----------
    block_sizes : array_like of shape (B,)
    counts : mapping of speckle size to array_like of shape (B,)
        Disparities > 0, a curve for each speckle size.
    computable : array_like of shape (B,), optional
        How many pixels have a window that fits in the image: the ceiling of the count.
    consistency, bad_pixels : array_like of shape (B,), optional
        Shares in [0, 1] on the lower axes.
    pixels : int, optional
        Pixels of the image, for the share on the right.
    title : str

    Returns
    -------
    Figure
    """
    x = np.asarray(block_sizes)
    figure, grid = new_figure(PANEL, 4.6, rows=2, sharex=True, height_ratios=(3, 2))
    upper, lower = grid[:, 0]
    colours = (LEFT, RIGHT, GREEN, PURPLE, AMBER, SKY)
    peak = 0.0
    for colour, (speckle, values) in zip(colours, counts.items(), strict=False):
        y = np.asarray(values, dtype=np.float64) / 1000
        label = "no speckle filter" if speckle == 0 else f"speckle size {speckle}"
        upper.plot(x, y, color=colour, linewidth=1.6, label=label)
        peak = max(peak, float(y.max()))
    first = np.asarray(next(iter(counts.values())), dtype=np.float64)
    best = int(x[int(np.argmax(first))])
    upper.axvline(best, color=INK, linewidth=0.8, linestyle=":")
    upper.annotate(f"most at {best}", (best, 0.02), xycoords=("data", "axes fraction"), xytext=(4, 0),
                   textcoords="offset points", fontsize=SMALL, color=INK)  # fmt: skip
    if computable is not None:
        ceiling = np.asarray(computable, dtype=np.float64) / 1000
        upper.plot(x, ceiling, color=MUTED, linewidth=1.2, linestyle="--", label="pixels whose window fits")
        lower.plot(x, first / 1000 / np.maximum(ceiling, 1e-12), color=LEFT, linewidth=1.6, label="fill of those")
    if consistency is not None:
        lower.plot(x, consistency, color=GREEN, linewidth=1.4, linestyle="-.", label="left-right consistent")
    if bad_pixels is not None:
        lower.plot(x, bad_pixels, color=RIGHT, linewidth=1.4, linestyle=":", label="wrong by > 1 px")
    upper.set_ylim(bottom=0)
    lower.set_ylim(0, 1.02)
    dress(upper, title, "", "disparities > 0, thousands")
    dress(lower, "", "window size, px", "share")
    add_legend(upper, loc="upper right")
    add_legend(lower, loc="lower left", ncols=2)
    return figure


def draw_sweep_speckles(
    speckle_sizes: ArrayLike, counts: Mapping[int, ArrayLike], *, title: str = "figure 8: speckle size"
) -> Figure:
    """Draw the paper's figure 8: number of disparities > 0 over the speckle filter's size, for some windows.

    Parameters
    ----------
    speckle_sizes : array_like of shape (S,)
        Largest area of a component that is removed, pixels.
    counts : mapping of block size to array_like of shape (S,)
    title : str

    Returns
    -------
    Figure
    """
    figure, grid = new_figure(PANEL, 3.0)
    axes = grid[0, 0]
    styles = ("-", "--", "-.", ":")
    for index, (block, values) in enumerate(counts.items()):
        colour = (LEFT, RIGHT, GREEN, PURPLE, AMBER, SKY)[index % 6]
        axes.plot(speckle_sizes, np.asarray(values, dtype=np.float64) / 1000, color=colour, marker="o", markersize=3,
                  linewidth=1.4, linestyle=styles[index % 4], label=f"window {block}")  # fmt: skip
    axes.set_ylim(bottom=0)
    dress(axes, title, "speckle size: largest area removed, px", "disparities > 0, thousands")
    add_legend(axes, loc="lower left", ncols=2)
    return figure


def draw_sweep_maps(maps: Mapping[int, ArrayLike], *, limits: tuple[float, float], title: str = "") -> Figure:
    """Draw the disparity maps of some window sizes, as the paper's figure 7 a to f.

    Parameters
    ----------
    maps : mapping of block size to array_like of shape (H, W)
        NaN where there is none.
    limits : tuple of (low, high)
        Colour limits, the same for all.
    title : str

    Returns
    -------
    Figure
    """
    import matplotlib

    from stereocal.report.style import NO_VALUE, SEQUENTIAL

    columns = 2 if len(maps) < 3 else 3
    rows = -(-len(maps) // columns)
    height, width = np.asarray(next(iter(maps.values()))).shape
    panel = 2 * PANEL / columns
    figure, grid = new_figure(
        2 * PANEL, rows * image_panel_height((width, height), panel, 0.3), rows=rows, columns=columns
    )
    cmap = matplotlib.colormaps[SEQUENTIAL].with_extremes(bad=NO_VALUE)
    for axes in grid.flat[len(maps) :]:
        axes.set_visible(False)
    for axes, (block, disparity) in zip(grid.flat, maps.items(), strict=False):
        values = np.asarray(disparity, dtype=np.float64)
        axes.imshow(values, cmap=cmap, vmin=limits[0], vmax=limits[1], interpolation="nearest")
        dress_image(axes, (width, height), f"window {block}: {np.isfinite(values).mean():.0%}")
    if title:
        figure.suptitle(title, fontsize=10, color=INK, x=0.01, ha="left")
    return figure
