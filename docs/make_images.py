"""Make the pictures of the README and of the book's gallery, from the rendered rig of ``stereocal demo`` alone.

Run ``python docs/make_images.py`` after a change that alters them; they are committed, small, beside this file in
``images/``. ``python docs/make_images.py FOLDER`` takes them from a demo that ran already.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from PIL import Image

from stereocal.workflow.demonstration import run_demo

IMAGES = Path(__file__).parent / "images"
WIDTH = 1000
GALLERY = (
    "corners_left",
    "rig",
    "rectified_pair",
    "reprojection_scatter",
    "residual_vectors_left",
    "coverage_left",
    "depth_uncertainty",
    "halves_difference",
)


def main() -> None:
    """Render, calibrate, match, and keep the pictures."""
    if len(sys.argv) > 1:
        keep_pictures(Path(sys.argv[1]))
        return
    with tempfile.TemporaryDirectory() as folder:
        if not run_demo(folder).holds:
            raise SystemExit("the demo's bounds are broken; no picture is made of that")
        keep_pictures(Path(folder))


def keep_pictures(demo: Path) -> None:
    """Copy the demo's picture and some figures of its report, no wider than a page."""
    keep(demo / "demo.png", IMAGES / "demo.png", colours=None)
    for name in GALLERY:
        keep(demo / "figures" / f"{name}.png", IMAGES / "gallery" / f"{name}.png", colours=128)


def keep(source: Path, target: Path, *, colours: int | None) -> None:
    """Save a picture at the page's width; figures with a palette, which is a third of the bytes."""
    picture = Image.open(source).convert("RGB")
    if picture.width > WIDTH:
        size = (WIDTH, round(picture.height * WIDTH / picture.width))
        picture = picture.resize(size, Image.Resampling.LANCZOS)
    target.parent.mkdir(parents=True, exist_ok=True)
    (picture if colours is None else picture.quantize(colours)).save(target, optimize=True)
    print(f"{target}: {target.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
