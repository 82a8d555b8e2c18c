"""Pictures with photographs in them: corners, the rectified pair, disparity, the point of view.

Each function takes plain arrays and returns a new :class:`matplotlib.figure.Figure`. Images are (H, W) or (H, W, 3) of
any dtype the library reads; pixel (0, 0) is the centre of the first pixel, which is also where matplotlib's ``imshow``
puts it, so that points need no shift.
"""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float, as_image, as_points
from stereocal.report.style import (
    AMBER,
    INK,
    MUTED,
    NO_VALUE,
    PANEL,
    RIGHT,
    SEQUENTIAL,
    SMALL,
    add_colorbar,
    dress_image,
    image_panel_height,
    new_figure,
)


def to_display(image: ArrayLike, *, longest: int | None = None) -> NDArray[np.uint8]:
    """Return an image as uint8 for showing: 16-bit and float images are stretched from their 0.5 to 99.5 percentile.

    Parameters
    ----------
    image : array_like of shape (H, W) or (H, W, 3)
    longest : int, optional
        Take every n-th pixel so that the longer side is at most this. The step is whole, so that points scale by
        1/n exactly.

    Returns
    -------
    ndarray of uint8
    """
    array = as_image(image)
    if longest is not None:
        step = -(-max(array.shape[:2]) // longest)
        array = array[::step, ::step]
    if array.dtype == np.uint8:
        return np.ascontiguousarray(array)
    low, high = np.percentile(array, (0.5, 99.5))
    scaled = (array.astype(np.float64) - low) / max(high - low, 1e-12)
    return np.asarray(np.clip(scaled * 255, 0, 255), dtype=np.uint8)


def show_image(axes: Axes, image: ArrayLike, *, dimmed: float = 0.0, longest: int = 1280) -> tuple[int, int]:
    """Show an image on axes in its own pixel coordinates, and return its (width, height).

    Parameters
    ----------
    axes : Axes
    image : array_like of shape (H, W) or (H, W, 3)
    dimmed : float in [0, 1]
        How far to fade towards white, so that what is drawn on top stands out.
    longest : int
        Larger images are thinned for showing; the axes keep the pixel coordinates of the original.
    """
    height, width = np.asarray(image).shape[:2]
    shown = to_display(image, longest=longest)
    axes.imshow(
        shown,
        cmap="gray",
        vmin=0,
        vmax=255,
        alpha=1 - dimmed,
        extent=(-0.5, width - 0.5, height - 0.5, -0.5),
        interpolation="antialiased",
    )
    return width, height


def add_corners(axes: Axes, corners: Float, columns: int, *, size: float = 14.0) -> None:
    """Draw a board's corners in their order: a line through each row, coloured by row, the first corner ringed."""
    rows = max(1, len(corners) // columns)
    colours = _row_colours(rows)
    row_of = np.minimum(np.arange(len(corners)) // columns, rows - 1)
    path = np.stack([corners[:-1], corners[1:]], axis=1)
    axes.add_collection(LineCollection(list(path), colors=colours[row_of[1:]], linewidths=1.0, alpha=0.9))
    axes.scatter(
        corners[:, 0], corners[:, 1], s=size, facecolors="none", edgecolors=list(colours[row_of]), linewidths=1.1
    )
    first_x, first_y = corners[0]
    axes.scatter([first_x], [first_y], s=6 * size, facecolors="none", edgecolors=AMBER, linewidths=1.8)


def _row_colours(rows: int) -> Float:
    import matplotlib

    return np.asarray(matplotlib.colormaps["plasma"](np.linspace(0.05, 0.85, rows)))


def draw_corners(image: ArrayLike, corners: ArrayLike | None, columns: int, *, title: str = "") -> Figure:
    """Draw the corners found on a photograph, row by row in their order.

    Parameters
    ----------
    image : array_like of shape (H, W) or (H, W, 3)
    corners : array_like of shape (N, 2), or None
        Pixels; None draws the photograph with a note that no board was found.
    columns : int
        Inner corners in a row of the board.
    title : str

    Returns
    -------
    Figure
    """
    size = np.asarray(image).shape[1], np.asarray(image).shape[0]
    figure, grid = new_figure(PANEL, image_panel_height(size))
    axes = grid[0, 0]
    show_image(axes, image)
    if corners is None:
        axes.text(0.5, 0.5, "no board found", transform=axes.transAxes, ha="center", color="white",
                  fontsize=14, bbox={"facecolor": RIGHT, "edgecolor": "none", "pad": 5})  # fmt: skip
    else:
        add_corners(axes, as_points(corners, 2, "corners", minimum=1), columns)
    dress_image(axes, size, title)
    return figure


def draw_rectified_pair(
    left: ArrayLike,
    right: ArrayLike,
    *,
    left_corners: ArrayLike | None = None,
    right_corners: ArrayLike | None = None,
    axis: int = 0,
    lines: int = 12,
    title: str = "rectified: a point lies on the same line in both",
) -> Figure:
    """Draw a rectified pair, with epipolar lines through both images.

    Parameters
    ----------
    left, right : array_like of shape (H, W) or (H, W, 3)
        Rectified images of equal size.
    left_corners, right_corners : array_like of shape (N, 2), optional
        Rectified corners; lines then pass through some of the left ones, so that a fault of a pixel shows.
    axis : int
        0: side by side, lines are rows. 1: one above the other, lines are columns (a vertical rig).
    lines : int
        How many lines.
    title : str

    Returns
    -------
    Figure
    """
    height, width = np.asarray(left).shape[:2]
    if axis == 0:
        figure, grid = new_figure(2 * PANEL, image_panel_height((2 * width, height), 2 * PANEL, 0.5), columns=2)
    else:
        figure, grid = new_figure(PANEL, image_panel_height((width, 2 * height), PANEL, 0.8), rows=2)
    across = 1 - axis  # the coordinate that both pictures of a point share
    extent = (width, height)
    at = np.linspace(0, extent[across] - 1, lines + 2)[1:-1]
    if left_corners is not None:
        shared = as_points(left_corners, 2, "left_corners")[:, across]
        at = np.sort(shared)[np.linspace(0, len(shared) - 1, min(lines, len(shared))).astype(int)]
    colours = list(_row_colours(len(at)))
    names = ("left", "right")
    for axes, image, corners, name in zip(grid.flat, (left, right), (left_corners, right_corners), names, strict=True):
        show_image(axes, image)
        draw_lines = axes.hlines if axis == 0 else axes.vlines
        draw_lines(at, -0.5, extent[axis] - 0.5, colors=colours, linewidth=0.8)
        if corners is not None:
            points = as_points(corners, 2, "corners")
            axes.plot(points[:, 0], points[:, 1], "+", color=AMBER, markersize=5, markeredgewidth=0.9)
        dress_image(axes, (width, height), name)
    figure.suptitle(title, fontsize=10, color=INK, x=0.01, ha="left")
    return figure


def draw_disparity(
    disparity: ArrayLike,
    *,
    image: ArrayLike | None = None,
    limits: tuple[float, float] | None = None,
    title: str = "disparity",
    label: str = "disparity, px",
) -> Figure:
    """Draw a disparity map in colour, grey where there is none.

    Parameters
    ----------
    disparity : array_like of shape (H, W)
        Pixels, NaN where there is none.
    image : array_like, optional
        The rectified left image, shown beside it.
    limits : tuple of (low, high), optional
        Colour limits; by default the 1 and 99 percentile of the valid pixels.
    title, label : str

    Returns
    -------
    Figure
    """
    values = np.asarray(disparity, dtype=np.float64)
    height, width = values.shape
    valid = values[np.isfinite(values)]
    low, high = limits or ((0.0, 1.0) if valid.size == 0 else np.percentile(valid, (1, 99)))
    panels = 1 if image is None else 2
    total = panels * PANEL
    figure, grid = new_figure(total, image_panel_height((panels * width, height), total, 0.35), columns=panels)
    if image is not None:
        show_image(grid[0, 0], image)
        dress_image(grid[0, 0], (width, height), "left, rectified")
    axes = grid[0, -1]
    import matplotlib

    cmap = matplotlib.colormaps[SEQUENTIAL].with_extremes(bad=NO_VALUE)
    shown = axes.imshow(values, cmap=cmap, vmin=low, vmax=max(high, low + 1e-6), interpolation="nearest")
    dress_image(axes, (width, height), title)
    fill = valid.size / values.size
    axes.text(0.99, 0.02, f"{fill:.0%} of the pixels", transform=axes.transAxes, ha="right", fontsize=SMALL,
              color=INK, bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none", "pad": 2})  # fmt: skip
    add_colorbar(figure, shown, axes, label)
    return figure


def draw_image(image: ArrayLike, *, title: str = "", caption: str = "") -> Figure:
    """Draw one image with a title and, below it, a caption."""
    height, width = np.asarray(image).shape[:2]
    figure, grid = new_figure(PANEL, image_panel_height((width, height), extra=0.6 if caption else 0.35))
    show_image(grid[0, 0], image)
    dress_image(grid[0, 0], (width, height), title)
    if caption:
        grid[0, 0].set_xlabel(caption, fontsize=SMALL, color=MUTED)
    return figure
