"""One look for every picture: sizes, colours, and figures that touch no global state.

A figure is a :class:`matplotlib.figure.Figure` on an Agg canvas, never made through pyplot: pyplot keeps every figure
it makes alive and changes its behaviour with the machine's display, so a library must not use it. For the same reason
nothing here writes to ``rcParams``: the look is set on the artists, by :func:`dress`.

**Colours** are those of Okabe and Ito (2008), chosen so that readers with any of the common colour deficiencies tell
them apart; maps are ``viridis`` (uniform in lightness, so it survives a grey printer) and ``PuOr`` for signed values.
Left is always blue and right always vermilion. A verdict is never told by colour alone: its word stands beside it.

**Size**: a panel is 4.6 inches wide with 9-point text, so that it is legible both as half of a desktop page and as the
whole width of a phone, where a picture drawn for a desk would shrink its labels to five pixels.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

LEFT, RIGHT = "#0072B2", "#D55E00"
"""The two cameras, everywhere."""

GREEN, SKY, AMBER, PURPLE = "#009E73", "#56B4E9", "#E69F00", "#CC79A7"
INK, MUTED, RULE, NO_VALUE = "#1F2933", "#5F6B7A", "#D5DAE0", "#C9CED6"

VERDICT_COLOURS = {"good": "#00724F", "usable": "#9A6200", "bad": "#B3261E"}
"""Dark enough for white text (contrast above 4.5), distinct without red-green vision."""

SEQUENTIAL, DIVERGING = "viridis", "PuOr"

PANEL = 4.6
"""Width of one panel, inches."""

TEXT, SMALL = 9.0, 8.0


def new_figure(
    width: float = PANEL, height: float = 3.3, *, rows: int = 1, columns: int = 1, **options: Any
) -> tuple[Figure, NDArray[Any]]:
    """Make a figure with a grid of axes.

    Parameters
    ----------
    width, height : float
        Size in inches.
    rows, columns : int
        The grid.
    **options
        Passed to ``Figure.subplots`` (``width_ratios``, ``sharey``, ``subplot_kw``, …).

    Returns
    -------
    tuple of (Figure, ndarray of Axes of shape (rows, columns))
    """
    figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, squeeze=False, **options)
    return figure, np.asarray(axes)


def dress(axes: Axes, title: str = "", xlabel: str = "", ylabel: str = "", *, grid: str = "both") -> None:
    """Give axes the common look: a title on the left, thin rules, no box.

    Parameters
    ----------
    axes : Axes
    title, xlabel, ylabel : str
    grid : {"both", "x", "y", "none"}
        Which rules are drawn.
    """
    axes.set_title(title, fontsize=TEXT + 0.5, color=INK, loc="left", fontweight="bold")
    axes.set_xlabel(xlabel, fontsize=TEXT, color=INK)
    axes.set_ylabel(ylabel, fontsize=TEXT, color=INK)
    axes.tick_params(labelsize=SMALL, color=RULE, labelcolor=MUTED, length=3)
    for side, spine in axes.spines.items():
        spine.set_visible(side in ("left", "bottom"))
        spine.set_color(RULE)
    if grid != "none":
        axes.grid(True, axis=grid, color=RULE, linewidth=0.6, alpha=0.7)  # type: ignore[arg-type]
        axes.set_axisbelow(True)


def dress_image(axes: Axes, image_size: tuple[int, int] | None = None, title: str = "") -> None:
    """Give axes that show an image, or stand for one, their look: pixels square, y down, no ticks.

    Parameters
    ----------
    axes : Axes
    image_size : tuple of (width, height), optional
        Sets the limits to the image's outer edges; pixel (0, 0) is the centre of the first pixel, so they are at −½.
    title : str
    """
    axes.set_title(title, fontsize=TEXT + 0.5, color=INK, loc="left", fontweight="bold")
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_aspect("equal")
    for spine in axes.spines.values():
        spine.set_color(RULE)
    if image_size is not None:
        width, height = image_size
        axes.set_xlim(-0.5, width - 0.5)
        axes.set_ylim(height - 0.5, -0.5)


def add_legend(axes: Axes, **options: Any) -> None:
    """A legend in the common look."""
    legend = axes.legend(fontsize=SMALL, frameon=True, framealpha=0.85, edgecolor="none", **options)
    for text in legend.get_texts():
        text.set_color(INK)


def add_colorbar(figure: Figure, mappable: Any, axes: Any, label: str, **options: Any) -> None:
    """A colour bar in the common look."""
    bar = figure.colorbar(mappable, ax=axes, **{"shrink": 0.85, "pad": 0.02, **options})
    bar.set_label(label, fontsize=SMALL, color=INK)
    bar.ax.tick_params(labelsize=SMALL, color=RULE, labelcolor=MUTED, length=3)
    bar.outline.set_visible(False)


def image_panel_height(image_size: tuple[int, int], width: float = PANEL, extra: float = 0.35) -> float:
    """Height in inches of a panel that holds one image at full width, with `extra` for its title."""
    return width * image_size[1] / image_size[0] + extra


def to_png(figure: Figure, dpi: float = 130.0) -> bytes:
    """Render a figure as PNG.

    Parameters
    ----------
    figure : Figure
    dpi : float
        Dots per inch: a panel of 4.6 inches is 598 pixels wide at 130.
    """
    # ``savefig`` lays the figure out in a first drawing and renders it in a second; one drawing does both
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    stream = io.BytesIO()
    Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB").save(stream, "PNG")
    return stream.getvalue()
