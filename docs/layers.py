"""The picture of the layers: which room may import which, drawn from the contract that CI keeps."""

from __future__ import annotations

import tomllib
from pathlib import Path

from matplotlib.figure import Figure

IDEAS = {
    "base": "checks, errors, rotations,\nleast squares, equations",
    "board": "chessboard, Harris corners,\ngrid, subpixel",
    "camera": "models, homography, Zhang,\nbundle refinement",
    "pair": "stereo calibration, F, E,\nrectification",
    "reconstruction": "SAD, census, semi-global,\nspeckles, depth",
    "report": "verdicts, figures,\nthe HTML page",
    "store": "images, formats, clouds,\ncapture",
    "sweep": "the paper's section 3",
    "synthetic": "rendered rigs\nwith known truth",
    "verify": "the oracle: OpenCV,\ncrosscheck, bench",
    "workflow": "one function a command",
    "cli": "a thin face",
}


def draw_layers(pyproject: Path, target: Path) -> None:
    """Draw the import contract's layers, lowest at the bottom, as an SVG."""
    contracts = tomllib.loads(pyproject.read_text())["tool"]["importlinter"]["contracts"]
    layers = [layer.removeprefix("stereocal.") for layer in contracts[0]["layers"]]
    figure = Figure(figsize=(6.4, 0.56 * len(layers)), layout="constrained")
    axes = figure.add_subplot()
    axes.set_axis_off()
    axes.set_xlim(0, 10)
    axes.set_ylim(-len(layers), 0)
    for row, layer in enumerate(layers):
        y = -row - 0.5
        shade = "#e8eef7" if row % 2 else "#d5e1f2"
        axes.axhspan(y - 0.44, y + 0.44, color=shade)
        axes.text(0.3, y, layer, va="center", family="monospace", fontsize=11, weight="bold", color="#16324f")
        axes.text(4.2, y, IDEAS.get(layer, ""), va="center", fontsize=8.5, color="#333333")
    axes.annotate(
        "may import", (9.4, -len(layers) + 0.4), (9.4, -0.6), rotation=90, ha="center", va="top", fontsize=8.5,
        color="#555555", arrowprops={"arrowstyle": "->", "color": "#555555"},
    )  # fmt: skip
    figure.savefig(target, metadata={"Date": None} if target.suffix == ".svg" else None)
