"""Pictures of what the fit leaves over: per view, as a scatter, over the image, against the radius.

A residual is observed minus projected, in pixels. If the model is right, residuals are the corner noise and nothing
else: the same spread in every view, a round cloud, no pattern over the image, no trend with the radius. Each picture
here shows one way in which that fails: a view that stands out (blur, a bent or misread board, a flip), an oval or
off-centre cloud (a directional blur, an outlier), arrows that flow together over a region or a curve against the radius
(a lens model that is too stiff).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from stereocal.base.checks import Float
from stereocal.report.style import (
    INK,
    LEFT,
    MUTED,
    PANEL,
    RIGHT,
    SMALL,
    add_legend,
    dress,
    dress_image,
    image_panel_height,
    new_figure,
)


def draw_view_errors(
    left_rms: ArrayLike,
    right_rms: ArrayLike,
    *,
    names: Sequence[str] | None = None,
    joint_rms: float | None = None,
    outliers: Sequence[int] = (),
    title: str = "reprojection error of each pair",
) -> Figure:
    """Draw the RMS of each view as bars, left and right beside each other, outliers named.

    Parameters
    ----------
    left_rms, right_rms : array_like of shape (V,)
        √(Σ‖d‖²/N) of each view, pixels.
    names : sequence of str, optional
        The views' names, for the axis (only as many as can be read) and for the outliers.
    joint_rms : float, optional
        RMS over everything, drawn as a line.
    outliers : sequence of int
        Views to name.
    title : str

    Returns
    -------
    Figure
    """
    left, right = np.asarray(left_rms, dtype=np.float64), np.asarray(right_rms, dtype=np.float64)
    count = len(left)
    labels = list(names) if names is not None else [str(i + 1) for i in range(count)]
    figure, grid = new_figure(PANEL, 2.9)
    axes = grid[0, 0]
    at = np.arange(count)
    axes.bar(at - 0.21, left, 0.4, color=LEFT, label="left")
    axes.bar(at + 0.21, right, 0.4, color=RIGHT, label="right")
    if joint_rms is not None:
        axes.axhline(joint_rms, color=INK, linewidth=1.0, linestyle="--", label=f"all: {joint_rms:.3f} px")
    for view in outliers:
        top = max(left[view], right[view])
        axes.annotate(labels[view], (view, top), fontsize=SMALL, color=INK, ha="center", va="bottom", rotation=90,
                      xytext=(0, 2), textcoords="offset points")  # fmt: skip
    step = max(1, -(-count // 24))
    axes.set_xticks(at[::step], labels[::step], rotation=90)
    axes.set_xlim(-0.7, count - 0.3)
    axes.margins(y=0.18)
    dress(axes, title, "", "RMS, px", grid="y")
    add_legend(axes, loc="upper right", ncols=3)
    return figure


def draw_residual_scatter(left: ArrayLike, right: ArrayLike, *, title: str = "residuals, all corners") -> Figure:
    """Draw the residuals of both cameras as clouds, with the circle that holds 95 % of a round Gaussian one.

    Parameters
    ----------
    left, right : array_like of shape (N, 2)
        Observed minus projected, pixels.
    title : str

    Returns
    -------
    Figure
    """
    figure, grid = new_figure(PANEL, 2.7, columns=2, sharex=True, sharey=True)
    clouds = [np.asarray(d, dtype=np.float64).reshape(-1, 2) for d in (left, right)]
    reach = 1.05 * max((float(np.abs(cloud).max()) for cloud in clouds if cloud.size), default=1.0)
    angles = np.linspace(0, 2 * np.pi, 90)
    for axes, cloud, colour, name in zip(grid[0], clouds, (LEFT, RIGHT), ("left", "right"), strict=True):
        thin = cloud[:: max(1, len(cloud) // 6000)]
        axes.plot(thin[:, 0], thin[:, 1], ".", color=colour, markersize=2.5, alpha=0.45, rasterized=True)
        sigma = float(np.sqrt(np.mean(cloud**2))) if cloud.size else 0.0
        radius = sigma * np.sqrt(-2 * np.log(0.05))  # Rayleigh: 95 % of a round Gaussian cloud
        axes.plot(radius * np.cos(angles), radius * np.sin(angles), color=INK, linewidth=1.0)
        axes.set_xlim(-reach, reach)
        axes.set_ylim(reach, -reach)
        axes.set_aspect("equal")
        dress(axes, f"{name}: σ {sigma:.3f} px an axis", "x, px", "y, px" if name == "left" else "")
    figure.suptitle(title, fontsize=SMALL, color=MUTED, x=0.01, ha="left")
    return figure


def draw_residual_vectors(
    points: ArrayLike, residuals: ArrayLike, image_size: tuple[int, int], *, title: str = "", colour: str = LEFT
) -> Figure:
    """Draw residuals as arrows over the image, enlarged, with their mean over cells in ink.

    Parameters
    ----------
    points : array_like of shape (N, 2)
        Where, pixels.
    residuals : array_like of shape (N, 2)
        Observed minus projected, pixels.
    image_size : tuple of (width, height)
    title, colour : str

    Returns
    -------
    Figure
    """
    at, d = np.asarray(points, dtype=np.float64), np.asarray(residuals, dtype=np.float64)
    figure, grid = new_figure(PANEL, image_panel_height(image_size))
    axes = grid[0, 0]
    rms = float(np.sqrt(np.mean(np.sum(d**2, axis=1)))) if d.size else 1.0
    enlarged = 0.03 * image_size[0] / max(rms, 1e-9)
    thin = slice(None, None, max(1, len(at) // 3000))
    axes.quiver(
        at[thin, 0], at[thin, 1], *(enlarged * d[thin].T), angles="xy", scale_units="xy", scale=1,
        color=colour, width=0.002, alpha=0.45, rasterized=True,
    )  # fmt: skip
    centres, means = cell_means(at, d, image_size)
    axes.quiver(
        centres[:, 0],
        centres[:, 1],
        *(enlarged * means.T),
        angles="xy",
        scale_units="xy",
        scale=1,
        color=INK,
        width=0.005,
    )
    dress_image(axes, image_size, f"{title} residuals, {enlarged:.0f}x; dark: mean of a cell".strip())
    return figure


def cell_means(
    points: Float, values: Float, image_size: tuple[int, int], cells: int = 8, least: int = 5
) -> tuple[Float, Float]:
    """Mean of `values` over the cells of a grid on the image.

    Parameters
    ----------
    points : ndarray of shape (N, 2)
    values : ndarray of shape (N, d)
    image_size : tuple of (width, height)
    cells : int
        Cells along the width; as many along the height as keep them square.
    least : int
        A cell with fewer points is left out.

    Returns
    -------
    centres : ndarray of shape (C, 2)
    means : ndarray of shape (C, d)
    """
    width, height = image_size
    side = width / cells
    column = np.clip((points[:, 0] // side).astype(int), 0, cells - 1)
    row = np.clip((points[:, 1] // side).astype(int), 0, int(np.ceil(height / side)) - 1)
    index = row * cells + column
    used, inverse, counts = np.unique(index, return_inverse=True, return_counts=True)
    sums = np.zeros((len(used), values.shape[1]))
    np.add.at(sums, inverse, values)
    keep = counts >= least
    centres = np.stack([(used % cells + 0.5) * side, (used // cells + 0.5) * side], axis=1)
    return centres[keep], sums[keep] / counts[keep, None]


def draw_residual_radius(
    radius: Sequence[ArrayLike], radial: Sequence[ArrayLike], *, title: str = "radial residual against radius"
) -> Figure:
    """Draw the part of each residual that points away from the principal point against the distance from it.

    Parameters
    ----------
    radius : sequence of two array_like of shape (N,)
        Distance from the principal point, pixels; left, right.
    radial : sequence of two array_like of shape (N,)
        Radial part of the residual, pixels.
    title : str

    Returns
    -------
    Figure
    """
    figure, grid = new_figure(PANEL, 2.9)
    axes = grid[0, 0]
    for r, d, colour, name in zip(radius, radial, (LEFT, RIGHT), ("left", "right"), strict=True):
        distance, part = np.asarray(r, dtype=np.float64), np.asarray(d, dtype=np.float64)
        thin = slice(None, None, max(1, len(distance) // 4000))
        axes.plot(distance[thin], part[thin], ".", color=colour, markersize=2, alpha=0.25, rasterized=True)
        at, mean, error = running_mean(distance, part)
        axes.errorbar(at, mean, 2 * error, color=colour, linewidth=1.6, capsize=2, label=f"{name}: mean ± 2 SE")
    axes.axhline(0, color=INK, linewidth=0.8)
    spread = np.concatenate([np.abs(np.asarray(d, dtype=np.float64)) for d in radial])
    if spread.size:
        reach = max(float(np.percentile(spread, 99)), 1e-6) * 1.2
        axes.set_ylim(-reach, reach)
    dress(axes, title, "distance from the principal point, px", "outward, px")
    add_legend(axes, loc="upper left", ncols=2)
    return figure


def running_mean(x: Float, y: Float, bins: int = 10) -> tuple[Float, Float, Float]:
    """Mean of y and its standard error in bins of equal count along x: (x̄, ȳ, s/√n)."""
    order = np.argsort(x)
    parts = [part for part in np.array_split(order, min(bins, max(1, len(x) // 8))) if len(part) > 1]
    at = np.array([x[part].mean() for part in parts])
    mean = np.array([y[part].mean() for part in parts])
    error = np.array([y[part].std(ddof=1) / np.sqrt(len(part)) for part in parts])
    return at, mean, error
