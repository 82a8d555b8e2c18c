"""Pictures of the geometry: the rig and its boards in space, coverage of the image, maps over the image.

The rig is drawn in the left camera's frame, turned so that the page's up is the camera's −y: x to the right, z into the
page's depth. Lengths are in the unit of the board's squares.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from stereocal.base.checks import Float
from stereocal.base.rotations import rotation_matrix
from stereocal.report.style import (
    AMBER,
    DIVERGING,
    GREEN,
    INK,
    LEFT,
    MUTED,
    NO_VALUE,
    PANEL,
    RIGHT,
    RULE,
    SEQUENTIAL,
    SMALL,
    TEXT,
    add_colorbar,
    dress_image,
    image_panel_height,
    new_figure,
)


def draw_rig(
    rig: Any,
    rvecs: Sequence[ArrayLike],
    tvecs: Sequence[ArrayLike],
    object_points: ArrayLike,
    columns: int,
    *,
    unit: str = "",
    title: str = "the rig and its boards",
) -> Figure:
    """Draw both cameras as pyramids and every board where the fit puts it.

    Parameters
    ----------
    rig : StereoRig
        With left, right (K, image_size), R, T; X_right = R X_left + T.
    rvecs, tvecs : sequence of array_like of shape (3,)
        Board to left camera.
    object_points : array_like of shape (N, 3)
        The board's corners.
    columns : int
        Corners in a row.
    unit : str
        Of length.
    title : str

    Returns
    -------
    Figure
    """
    importlib.import_module("mpl_toolkits.mplot3d")  # registers the projection

    board = np.asarray(object_points, dtype=np.float64)
    outline = board[[0, columns - 1, len(board) - 1, len(board) - columns, 0]]
    figure, grid = new_figure(PANEL, 4.0, subplot_kw={"projection": "3d"})
    axes = grid[0, 0]
    reach = [np.zeros((1, 3))]
    shades = np.linspace(0.35, 0.9, max(1, len(rvecs)))
    for shade, rvec, tvec in zip(shades, rvecs, tvecs, strict=True):
        corners = outline @ rotation_matrix(np.ravel(rvec)).T + np.ravel(tvec)
        axes.plot(*_page(corners).T, color=GREEN, linewidth=0.9, alpha=float(shade))
        axes.plot(*_page(corners[:1]).T, ".", color=AMBER, markersize=4)
        reach.append(corners)
    distance = float(np.median([np.linalg.norm(np.ravel(t)) for t in tvecs])) if len(tvecs) else 1.0
    R, T = np.asarray(rig.R), np.ravel(rig.T)
    centre = -R.T @ T
    for camera, rotation, origin, colour, name in (
        (rig.left, np.eye(3), np.zeros(3), LEFT, "left"),
        (rig.right, R, centre, RIGHT, "right"),
    ):
        pyramid = _pyramid(camera.K, camera.image_size, 0.22 * distance) @ rotation + origin
        for a, b in ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1)):
            axes.plot(*_page(pyramid[[a, b]]).T, color=colour, linewidth=1.2)
        axes.text(*_page(origin[None])[0], f" {name}", color=colour, fontsize=SMALL)
        reach.append(pyramid)
    _equal_limits(axes, _page(np.vstack(reach)))
    suffix = f", {unit}" if unit else ""
    axes.set_xlabel(f"x{suffix}", fontsize=SMALL, color=MUTED, labelpad=-4)
    axes.set_ylabel(f"z{suffix}", fontsize=SMALL, color=MUTED, labelpad=-4)
    axes.set_zlabel(f"−y{suffix}", fontsize=SMALL, color=MUTED, labelpad=-4)
    axes.tick_params(labelsize=7, colors=MUTED, pad=-2)
    axes.view_init(elev=22, azim=-62)
    axes.set_title(title, fontsize=TEXT + 0.5, color=INK, loc="left", fontweight="bold")
    return figure


def _page(points: Float) -> Float:
    """Camera coordinates (x, y down, z forward) to the plot's (x, depth, up)."""
    return np.asarray(points)[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0])


def _pyramid(K: ArrayLike, image_size: tuple[int, int], depth: float) -> Float:
    """The camera's centre and the corners of its image at `depth`, in its own frame, (5, 3)."""
    width, height = image_size
    pixels = np.array([[0, 0, 1], [width, 0, 1], [width, height, 1], [0, height, 1]], dtype=np.float64)
    rays = pixels @ np.linalg.inv(np.asarray(K, dtype=np.float64)).T
    return np.vstack([np.zeros(3), rays * depth])


def _equal_limits(axes: Any, points: Float) -> None:
    low, high = points.min(axis=0), points.max(axis=0)
    span = np.maximum(high - low, 1e-9)
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_zlim(low[2], high[2])
    axes.set_box_aspect(span, zoom=0.95)


def draw_coverage(
    points: ArrayLike,
    image_size: tuple[int, int],
    *,
    cells: int = 10,
    border: Sequence[bool] | None = None,
    colour: str = LEFT,
    title: str = "coverage",
) -> Figure:
    """Draw how many corners fell into each cell of the image, and the corners themselves.

    Parameters
    ----------
    points : array_like of shape (N, 2)
        Every corner of every used view, pixels.
    image_size : tuple of (width, height)
    cells : int
        Cells a side, as BoofCV's inner grid.
    border : sequence of bool, optional
        Of the cells of the border strip, clockwise from the top left, which are seen; the others are marked.
    colour : str
        Of the corners.
    title : str

    Returns
    -------
    Figure
    """
    import matplotlib

    at = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    width, height = image_size
    figure, grid = new_figure(PANEL, image_panel_height(image_size))
    axes = grid[0, 0]
    edges_x, edges_y = np.linspace(-0.5, width - 0.5, cells + 1), np.linspace(-0.5, height - 0.5, cells + 1)
    counts, _, _ = np.histogram2d(at[:, 1], at[:, 0], bins=(edges_y, edges_x))
    cmap = matplotlib.colormaps[SEQUENTIAL].with_extremes(bad="#F1E7D8")
    shown = axes.imshow(
        np.where(counts > 0, counts, np.nan),
        cmap=cmap,
        vmin=0,
        extent=(-0.5, width - 0.5, height - 0.5, -0.5),
        alpha=0.85,
    )
    thin = at[:: max(1, len(at) // 4000)]
    axes.plot(thin[:, 0], thin[:, 1], ".", color="white", markersize=1.5, alpha=0.7, rasterized=True)
    dress_image(axes, image_size, title)
    for row, column in np.argwhere(counts == 0):
        x, y = (edges_x[column] + edges_x[column + 1]) / 2, (edges_y[row] + edges_y[row + 1]) / 2
        axes.text(x, y, "×", color=colour, ha="center", va="center", fontsize=SMALL, fontweight="bold")
    if border is not None:
        _mark_border(axes, image_size, border)
    add_colorbar(figure, shown, axes, "corners in a cell (× none)")
    return figure


def _mark_border(axes: Any, image_size: tuple[int, int], seen: Sequence[bool]) -> None:
    """Mark the seen and unseen cells of the border strip by short bars along the image's edge."""
    width, height = image_size
    side = len(seen) // 4
    for index, covered in enumerate(seen):
        edge, k = divmod(index, side)
        a, b = k / side, (k + 1) / side
        line = {
            0: ((a * width, b * width), (0, 0)),
            1: ((width, width), (a * height, b * height)),
            2: (((1 - a) * width, (1 - b) * width), (height, height)),
            3: ((0, 0), ((1 - a) * height, (1 - b) * height)),
        }[edge]
        axes.plot(*line, color=GREEN if covered else RIGHT, linewidth=5 if covered else 3,
                  linestyle="-" if covered else (0, (0.4, 0.8)), solid_capstyle="butt", clip_on=False)  # fmt: skip


def draw_signed_map(
    points: ArrayLike,
    values: ArrayLike,
    image_size: tuple[int, int],
    *,
    title: str,
    label: str,
    limit: float | None = None,
) -> Figure:
    """Draw signed values at points of the image, one colour either side of zero.

    Parameters
    ----------
    points : array_like of shape (N, 2)
        Pixels.
    values : array_like of shape (N,)
    image_size : tuple of (width, height)
    title, label : str
    limit : float, optional
        Colour limit; by default the 98 percentile of |value|.

    Returns
    -------
    Figure
    """
    at, value = np.asarray(points, dtype=np.float64), np.asarray(values, dtype=np.float64)
    figure, grid = new_figure(PANEL, image_panel_height(image_size))
    axes = grid[0, 0]
    reach = limit or (float(np.percentile(np.abs(value), 98)) if value.size else 1.0) or 1.0
    shown = axes.scatter(
        at[:, 0], at[:, 1], c=value, s=9, cmap=DIVERGING, vmin=-reach, vmax=reach, linewidths=0.2, edgecolors=RULE,
        rasterized=True,
    )  # fmt: skip
    dress_image(axes, image_size, title)
    add_colorbar(figure, shown, axes, label)
    return figure


def draw_field(
    values: ArrayLike,
    image_size: tuple[int, int],
    *,
    title: str,
    label: str,
    limit: float | None = None,
    contours: Sequence[float] = (),
) -> Figure:
    """Draw a field of values ≥ 0 over the image, from a coarse grid, with contour lines.

    Parameters
    ----------
    values : array_like of shape (rows, columns)
        On a regular grid whose outer samples lie on the image's edges; NaN where unknown.
    image_size : tuple of (width, height)
    title, label : str
    limit : float, optional
        Top of the colours; by default the 98 percentile.
    contours : sequence of float
        Values to draw as lines.

    Returns
    -------
    Figure
    """
    import matplotlib

    field = np.asarray(values, dtype=np.float64)
    width, height = image_size
    figure, grid = new_figure(PANEL, image_panel_height(image_size))
    axes = grid[0, 0]
    finite = field[np.isfinite(field)]
    top = limit or (float(np.percentile(finite, 98)) if finite.size else 1.0)
    shown = axes.imshow(
        field, cmap=matplotlib.colormaps[SEQUENTIAL].with_extremes(bad=NO_VALUE), vmin=0, vmax=top or 1.0,
        extent=(-0.5, width - 0.5, height - 0.5, -0.5), interpolation="bilinear",
    )  # fmt: skip
    levels = [level for level in contours if finite.size and finite.min() < level < finite.max()]
    if levels:
        x, y = np.linspace(0, width - 1, field.shape[1]), np.linspace(0, height - 1, field.shape[0])
        lines = axes.contour(x, y, field, levels=levels, colors="white", linewidths=1.0)
        axes.clabel(lines, fontsize=SMALL, fmt="%g")
    dress_image(axes, image_size, title)
    add_colorbar(figure, shown, axes, label)
    return figure
