"""How a board was found, or how far the search got: four panels, one a stage of :mod:`stereocal.board.detection`.

1. **Response**: the saddle measure on the level of the pyramid that decided, white where a corner may be.
2. **Candidates**: its maxima (dots), those that pass the ring test (crosses), those that a grid took up (squares). A
   board that fades between dots and crosses is blurred or covered; one between crosses and squares is interrupted.
3. **Grid**: the largest one, its links drawn, so that a line that slipped by a square is seen at once.
4. **Corners**, enlarged: the rows in the board's order, from the ring of the first corner along the arrow; ellipses are
   one sigma of each corner, enlarged by a round factor that the title tells, so that the usual one fills a quarter of a
   square. Corners eight times less certain than the usual one are crossed out instead: their ellipse would hide the
   others. Where no board was found, the panel says why and shows what stands in its place.

The title says in words what the panels show, and the first stage that fell short is named.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float
from stereocal.report.figures_images import show_image
from stereocal.report.style import (
    AMBER,
    GREEN,
    INK,
    PANEL,
    RIGHT,
    SKY,
    SMALL,
    VERDICT_COLOURS,
    dress_image,
    image_panel_height,
    new_figure,
)

UNCERTAIN = 8.0
"""A corner is crossed out if its sigma is this many times the median."""

_FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
_WIDEST_RESPONSE = 600  # pixels of the panel


def draw_detection_stages(
    image: ArrayLike, detection: Any, inner_corners: tuple[int, int], *, title: str = ""
) -> Figure:
    """Draw how a board was found, or how far the search got: response, candidates, grid, refined corners.

    Parameters
    ----------
    image : array_like of shape (H, W) or (H, W, 3)
    detection : Detection
        With ``stages``: a dict that may hold ``response`` (h, w), ``maxima`` (m, 2) and ``candidates`` (n, 2 or more)
        in the pixels of a level, ``scale`` from these to the image's, ``grid`` (k, 2) and ``lattice`` (I, J, 2) in
        the image's, and ``fit``; ``corners``, ``covariances`` and ``message``.
    inner_corners : (columns, rows)
        Of the board asked for.
    title : str

    Returns
    -------
    Figure
        Two by two panels.
    """
    size = np.asarray(image).shape[1], np.asarray(image).shape[0]
    figure, panels = new_figure(2 * PANEL, 2 * image_panel_height(size) + 0.4, rows=2, columns=2)
    stages: Mapping[str, Any] = detection.stages or {}
    scale = float(stages.get("scale", 1.0))
    _show_response(panels[0, 0], stages.get("response"), scale, image, size)
    _show_candidates(panels[0, 1], stages, scale, image, size)
    _show_grid(panels[1, 0], stages, image, size)
    corners = detection.corners
    if corners is not None:
        _show_corners(panels[1, 1], image, np.asarray(corners), detection.covariances, inner_corners)
    else:
        _show_failure(panels[1, 1], image, stages, getattr(detection, "message", ""), size)
    figure.suptitle(_headline(detection, stages, inner_corners, title), fontsize=10, x=0.01, ha="left",
                    color=INK if corners is not None else VERDICT_COLOURS["bad"])  # fmt: skip
    return figure


def _headline(detection: Any, stages: Mapping[str, Any], inner_corners: tuple[int, int], title: str) -> str:
    """What the picture shows, in one line."""
    columns, rows = inner_corners
    if detection.corners is not None:
        width = getattr(detection, "edge_width", float("nan"))
        sharp = f", edges {width:.1f} px wide" if np.isfinite(width) else ""
        said = f"{columns}x{rows} board found{sharp}"
        said += f" · {detection.message}" if getattr(detection, "message", "") else ""
    else:
        reached = "1 response" if _count(stages.get("candidates")) == 0 else "2 candidates"
        reached = "3 grid" if _count(stages.get("grid")) else reached
        reached = "4 fit of the corners" if "fit" in stages else reached
        said = f"no {columns}x{rows} board; the search ended at stage {reached}"
    return " · ".join(part for part in (title, said) if part)


def _count(points: Any) -> int:
    return 0 if points is None else len(points)


def _to_image(points: Any, scale: float) -> Float:
    """Points of a level as (n, 2) pixels of the image."""
    if points is None or np.size(points) == 0:
        return np.empty((0, 2))
    return np.asarray(scale * (np.asarray(points, dtype=np.float64)[:, :2] + 0.5) - 0.5)


def _show_response(axes: Axes, response: Any, scale: float, image: ArrayLike, size: tuple[int, int]) -> None:
    if response is None:
        show_image(axes, image, dimmed=0.5)
        dress_image(axes, size, "1  response: not computed")
        return
    values = np.asarray(response, dtype=np.float64)
    top = float(np.nanpercentile(np.abs(values), 99.8)) or 1.0
    height, width = values.shape
    # thinned by the maximum of each block: a corner is a few pixels wide and must not fall between the samples
    step = max(1, max(width, height) // _WIDEST_RESPONSE)
    blocks = values[: height - height % step, : width - width % step]
    blocks = blocks.reshape(height // step, step, width // step, step).max(axis=(1, 3))
    # a level may be a few pixels short of the image, whose sides need not be even
    extent = (-0.5, scale * blocks.shape[1] * step - 0.5, scale * blocks.shape[0] * step - 0.5, -0.5)
    axes.imshow(np.sqrt(np.clip(blocks / top, 0, 1)), cmap="magma", vmin=0, vmax=1, extent=extent)
    level = "" if scale == 1 else f", image at {1 / scale:g} of its size"
    dress_image(axes, size, f"1  corner response{level}")


def _show_candidates(
    axes: Axes, stages: Mapping[str, Any], scale: float, image: ArrayLike, size: tuple[int, int]
) -> None:
    show_image(axes, image, dimmed=0.45)
    maxima, candidates = _to_image(stages.get("maxima"), scale), _to_image(stages.get("candidates"), scale)
    grid = _to_image(stages.get("grid"), 1.0)
    axes.plot(maxima[:, 0], maxima[:, 1], ".", color=SKY, markersize=2.5, markeredgewidth=0)
    axes.plot(candidates[:, 0], candidates[:, 1], "+", color=RIGHT, markersize=6, markeredgewidth=1.2)
    axes.plot(grid[:, 0], grid[:, 1], "s", color=GREEN, fillstyle="none", markersize=5, markeredgewidth=1.0)
    words = f"2  {len(candidates)} candidates (+)" if len(candidates) else "2  no candidate"
    words += f" of {len(maxima)} maxima (·)" if len(maxima) else ""
    dress_image(axes, size, words + (f", {len(grid)} in the grid (□)" if len(grid) else ""))


def _lattice(stages: Mapping[str, Any]) -> Float | None:
    lattice = stages.get("lattice")
    return None if lattice is None else np.asarray(lattice, dtype=np.float64)


def _add_links(axes: Axes, lattice: Float, colour: str) -> None:
    """Lines between neighbours that are both known."""
    links = []
    for grid in (lattice, lattice.transpose(1, 0, 2)):
        ends = np.stack([grid[:-1], grid[1:]], axis=2).reshape(-1, 2, 2)
        links.append(ends[np.isfinite(ends).all(axis=(1, 2))])
    axes.add_collection(LineCollection(list(np.concatenate(links)), colors=colour, linewidths=1.2))


def _show_grid(axes: Axes, stages: Mapping[str, Any], image: ArrayLike, size: tuple[int, int]) -> None:
    show_image(axes, image, dimmed=0.45)
    grid, lattice = _to_image(stages.get("grid"), 1.0), _lattice(stages)
    words = "3  no grid" if not len(grid) else f"3  grid of {len(grid)} corners"
    if lattice is not None:
        _add_links(axes, lattice, AMBER)
        sides = sorted(lattice.shape[:2], reverse=True)
        words = f"3  grid of {sides[0]}x{sides[1]}, {len(grid)} corners"
    axes.plot(grid[:, 0], grid[:, 1], "o", color=RIGHT, markersize=2.5, markeredgewidth=0)
    dress_image(axes, size, words)


def _zoom(axes: Axes, points: Float, size: tuple[int, int]) -> float:
    """Limit the axes to the points and a margin, in the picture's own shape; returns inches a pixel."""
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    middle = (low + high) / 2
    reach = float(np.max((high - low) / size)) * 1.25
    half = np.array(size) * min(max(reach, 0.05), 1.0) / 2
    middle = np.clip(middle, half - 0.5, np.array(size) - 0.5 - half)
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] + half[1], middle[1] - half[1])
    return float(PANEL / (2 * half[0]))


def _show_corners(
    axes: Axes, image: ArrayLike, corners: Float, covariances: Any, inner_corners: tuple[int, int]
) -> None:
    size = np.asarray(image).shape[1], np.asarray(image).shape[0]
    show_image(axes, image, dimmed=0.25, longest=4000)
    rows = corners.reshape(inner_corners[1], inner_corners[0], 2)
    axes.add_collection(LineCollection(list(rows), colors=SKY, linewidths=0.9))
    axes.plot(corners[:, 0], corners[:, 1], ".", color=RIGHT, markersize=3, markeredgewidth=0)
    arrow = {"arrowstyle": "-|>", "color": GREEN, "linewidth": 1.6, "shrinkA": 4, "mutation_scale": 7}
    axes.annotate("", xy=tuple(rows[0, 1]), xytext=tuple(rows[0, 0]), arrowprops=arrow)
    axes.plot(*rows[0, 0], "o", color=GREEN, fillstyle="none", markersize=11, markeredgewidth=1.8)
    words = "4  refined corners"
    if covariances is not None:
        words += _add_ellipses(axes, corners, np.asarray(covariances), rows)
    dress_image(axes, None, words)
    _zoom(axes, corners, size)


def _add_ellipses(axes: Axes, corners: Float, covariances: Float, rows: Float) -> str:
    """Draw one sigma of each corner, enlarged; returns the words for the title."""
    values, vectors = np.linalg.eigh(covariances)
    sigma = np.sqrt(np.maximum(values, 0))
    largest = sigma[:, 1]
    usual = float(np.median(largest))
    step = float(np.median(np.linalg.norm(np.diff(rows, axis=1), axis=-1)))
    wanted = 0.25 * step / max(usual, 1e-9)
    enlarged = min(_FACTORS, key=lambda factor: abs(np.log(factor / wanted)))
    certain: NDArray[np.bool_] = largest <= UNCERTAIN * usual
    angles = np.linspace(0, 2 * np.pi, 37)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    outline = corners[:, None, :] + enlarged * np.einsum("nij,nj,jk->nki", vectors, sigma, circle)
    axes.add_collection(LineCollection(list(outline[certain]), colors=AMBER, linewidths=1.2))
    axes.plot(*corners[~certain].T, "x", color=VERDICT_COLOURS["bad"], markersize=9, markeredgewidth=1.8)
    doubtful = f", {np.count_nonzero(~certain)} uncertain (x)" if not certain.all() else ""
    return f", ellipses {enlarged} σ; median σ {usual:.3f} px{doubtful}"


def _show_failure(axes: Axes, image: ArrayLike, stages: Mapping[str, Any], message: str, size: tuple[int, int]) -> None:
    """Why there is no board, and what stands in its place."""
    show_image(axes, image, dimmed=0.45)
    lattice, fit = _lattice(stages), stages.get("fit")
    if fit is not None:
        good = np.asarray(fit.converged)
        axes.plot(*fit.corners[good].T, ".", color=GREEN, markersize=5, markeredgewidth=0)
        axes.plot(*fit.corners[~good].T, "x", color=VERDICT_COLOURS["bad"], markersize=8, markeredgewidth=1.8)
    elif lattice is not None:
        _add_links(axes, lattice, AMBER)
    place = _to_image(stages.get("grid"), 1.0)
    dress_image(axes, size, "4  no board" + (": corners that could not be measured (x)" if fit is not None else ""))
    if len(place) >= 2:
        _zoom(axes, place, size)
    why = textwrap.fill(message or "nothing was seen", 52)
    axes.text(0.5, 0.03, why, transform=axes.transAxes, ha="center", va="bottom", color="white", fontsize=SMALL + 1.5,
              bbox={"facecolor": VERDICT_COLOURS["bad"], "edgecolor": "none", "pad": 5})  # fmt: skip
