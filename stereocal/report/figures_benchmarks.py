"""Pictures of benchmarks: ratio a kernel, and time against image size, disparities and views.

The upper panel has one row a kernel and one dot a case, at ours / OpenCV on a logarithmic axis, so that twice as fast
and twice as slow stand equally far from 1; the thin line through a dot spans the quartiles over the turns, the pale bar
all cases of the kernel. Further OpenCVs and a user's own function have colours of their own. Below, kernels that were
run on several sizes (or disparities, or numbers of views) with all else equal are drawn as lines, ours solid, OpenCV's
dashed: what counts there is the slope.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from stereocal.base.atomic_files import write_whole
from stereocal.report.style import (
    AMBER,
    GREEN,
    INK,
    LEFT,
    MUTED,
    PANEL,
    PURPLE,
    RIGHT,
    RULE,
    SKY,
    SMALL,
    dress,
    new_figure,
    to_png,
)

__all__ = ["BenchColumn", "draw_benchmarks", "write_figure"]

_COLUMN_COLOURS = (LEFT, RIGHT, GREEN, PURPLE)
_KERNEL_COLOURS = (LEFT, RIGHT, GREEN, AMBER, PURPLE, SKY, INK, MUTED)

_RATIO_TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1, 2, 5, 10, 20, 50, 100)

_SIZE = re.compile(r"(\d+)x(\d+)")
_DISPARITIES = re.compile(r"\bD (\d+)")
_VIEWS = re.compile(r"(\d+) (?:views|pairs) of")


@dataclass(frozen=True)
class BenchColumn:
    """The results of one environment.

    Attributes
    ----------
    title : str
        ``"OpenCV 5.0.0"``.
    rows : tuple of dict
        One a case, as ``stereocal bench --json`` prints it; empty where the environment lacks the case.
    """

    title: str
    rows: tuple[Mapping[str, Any], ...]


def draw_benchmarks(columns: Sequence[BenchColumn], machine: str = "") -> Figure:
    """Draw ratios by kernel, and below them the curves that the cases allow.

    Parameters
    ----------
    columns : sequence of BenchColumn
        This environment first.
    machine : str
        Said at the foot.

    Returns
    -------
    Figure
    """
    rows = columns[0].rows
    curves = [
        (name, _series(rows, value, without))
        for name, value, without in (
            ("image, megapixels", _megapixels, (_SIZE,)),
            ("disparities searched", _number(_DISPARITIES), (_DISPARITIES,)),
            ("views", _number(_VIEWS), (_VIEWS,)),
        )
    ]
    curves = [(name, series) for name, series in curves if series]
    kernels = list(dict.fromkeys(row["kernel"] for row in rows))
    top = 0.34 * len(kernels) + 1.0
    wide = PANEL * 2.3
    figure, grid = new_figure(wide, top + (3.4 if curves else 0.2), rows=2 if curves else 1)
    if curves:
        specification = grid[0, 0].get_gridspec()
        specification.set_height_ratios([top, 3.2])
        grid[1, 0].remove()
        below = specification[1, 0].subgridspec(1, len(curves)).subplots()
        axes = np.atleast_1d(below)
        for place, (name, series) in zip(axes, curves, strict=True):
            _draw_curves(place, name, series, kernels)
    _draw_ratios(grid[0, 0], columns, kernels)
    figure.supxlabel(machine, fontsize=SMALL - 1, color=MUTED)
    return figure


def write_figure(path: str | os.PathLike[str], figure: Figure) -> Path:
    """Write a figure as .png, .svg or .pdf, whole or not at all."""
    kind = Path(path).suffix.lower().lstrip(".")
    if kind == "png":
        return write_whole(path, to_png(figure))
    return write_whole(path, lambda stream: figure.savefig(stream, format=kind))


def _draw_ratios(axes: Axes, columns: Sequence[BenchColumn], kernels: list[str]) -> None:
    """One row a kernel; within it one lane a column, within that the cases from top to bottom."""
    with_extra = any(row.get("extra") for row in columns[0].rows)
    lanes = len(columns) + with_extra
    handles = []
    for lane in range(lanes):
        own = with_extra and lane == lanes - 1
        column = columns[0] if own else columns[lane]
        colour = _COLUMN_COLOURS[lane % len(_COLUMN_COLOURS)]
        for height, kernel in enumerate(kernels):
            cases = [row for row in column.rows if row.get("kernel") == kernel]
            ratios = [row["extra_ratio"] if own else row["ratio"] for row in cases]
            drawn = [(ratio, row) for ratio, row in zip(ratios, cases, strict=True) if ratio]
            if not drawn:
                continue
            middle = height + 0.8 * ((lane + 0.5) / lanes - 0.5)
            values = [ratio for ratio, _ in drawn]
            axes.hlines(middle, min(values), max(values), color=colour, alpha=0.15, linewidth=14 / lanes)
            offsets = np.linspace(-0.22, 0.22, len(drawn)) / lanes if len(drawn) > 1 else [0.0]
            for offset, (ratio, row) in zip(offsets, drawn, strict=True):
                y = middle + float(offset)
                low, high = row.get("ratio_low"), row.get("ratio_high")
                if not own and low and high and np.isfinite([low, high]).all():
                    axes.hlines(y, low, high, color=colour, linewidth=1.0, alpha=0.8)
                axes.plot(ratio, y, "o", markersize=3.2, color=colour, markeredgewidth=0)
        title = "yours beside " + columns[0].title if own else column.title
        handles.append(Line2D([], [], marker="o", linestyle="-", linewidth=1, color=colour, markersize=4, label=title))
    axes.axvline(1, color=INK, linewidth=1)
    axes.set_xscale("log")
    low, high = axes.get_xlim()
    axes.set_xlim(min(low, 0.5), max(high, 2.0))
    axes.set_ylim(len(kernels) - 0.4, -0.6)
    axes.set_yticks(range(len(kernels)), kernels)
    dress(axes, "time, ours / OpenCV's: left of 1 stereocal is faster", "", "", grid="x")
    left, right = axes.get_xlim()
    ticks = [tick for tick in _RATIO_TICKS if left <= tick <= right]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.hlines(np.arange(len(kernels) - 1) + 0.5, *axes.get_xlim(), color=RULE, linewidth=0.5, alpha=0.6)
    axes.legend(
        handles=handles, fontsize=SMALL, frameon=False, loc="lower right", ncols=len(handles), bbox_to_anchor=(1, 1)
    )


def _draw_curves(
    axes: Axes, name: str, series: Mapping[str, list[tuple[float, float, float]]], kernels: list[str]
) -> None:
    """Milliseconds over one quantity, both axes logarithmic."""
    ends: list[tuple[float, float, str]] = []
    for label, points in series.items():
        colour = _colour_of(label, kernels)
        x, ours, opencv = np.array(sorted(points)).T
        axes.plot(x, ours, "o-", color=colour, markersize=3.5, linewidth=1.4)
        axes.plot(x, opencv, "o--", color=colour, markersize=3.5, linewidth=1.1, markerfacecolor="white")
        ends.append((float(ours[-1]), float(x[-1]), label))
    axes.set_xscale("log")
    axes.set_yscale("log")
    ticks = sorted({point[0] for points in series.values() for point in points})
    axes.set_xticks(ticks, [f"{tick:.2g}" if tick < 10 else f"{tick:g}" for tick in ticks])
    axes.set_xticks([], minor=True)
    axes.set_xlim(ticks[0] * 0.85, ticks[-1] * (ticks[-1] / ticks[0]) ** 0.5)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    axes.yaxis.set_minor_formatter(lambda value, _: "")
    dress(axes, "", name, "ms: ours solid, OpenCV dashed")
    low, high = np.log10(axes.get_ylim())
    points_a_decade = 150 / max(high - low, 1e-9)  # the panel is about 150 points high
    last = -np.inf
    for y, x_end, label in sorted(ends):
        wanted = float(np.log10(y) * points_a_decade)
        last = max(wanted, last + 10)
        beside: dict[str, Any] = {"xytext": (5, last - wanted), "textcoords": "offset points", "va": "center"}
        axes.annotate(label, (x_end, y), fontsize=SMALL - 1, color=_colour_of(label, kernels), **beside)


def _colour_of(kernel: str, kernels: list[str]) -> str:
    return _KERNEL_COLOURS[kernels.index(kernel) % len(_KERNEL_COLOURS)]


def _series(
    rows: Sequence[Mapping[str, Any]], value: Callable[[str], float | None], without: tuple[re.Pattern[str], ...]
) -> dict[str, list[tuple[float, float, float]]]:
    """For each kernel the longest run of cases that differ in this value only: (value, ours ms, OpenCV ms)."""
    groups: dict[tuple[str, str], list[tuple[float, float, float]]] = {}
    for row in rows:
        x = value(row["case"])
        if x is not None:
            rest = row["case"]
            for pattern in without:
                rest = pattern.sub("", rest)
            groups.setdefault((row["kernel"], rest), []).append((x, row["ours_ms"], row["opencv_ms"]))
    longest: dict[str, list[tuple[float, float, float]]] = {}
    for (kernel, _), points in groups.items():
        if len({x for x, _, _ in points}) == len(points) > max(1, len(longest.get(kernel, ()))):
            longest[kernel] = points
    return longest


def _megapixels(case: str) -> float | None:
    found = _SIZE.search(case)
    return None if found is None else int(found[1]) * int(found[2]) / 1e6


def _number(pattern: re.Pattern[str]) -> Callable[[str], float | None]:
    def value(case: str) -> float | None:
        found = pattern.search(case)
        return None if found is None else float(found[1])

    return value
