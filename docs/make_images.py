"""Make the picture of the README and of the docs' first page, from the rendered rig of ``stereocal demo`` alone.

Run ``python docs/make_images.py`` after a change that alters it; the picture is committed, small, beside this file in
``images/``.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from PIL import Image

from stereocal.workflow.demonstration import run_demo

IMAGES = Path(__file__).parent / "images"
WIDTH = 1000


def main() -> None:
    """Render, calibrate, match, and keep one picture."""
    with tempfile.TemporaryDirectory() as folder:
        run = run_demo(folder)
        if not run.holds:
            raise SystemExit("the demo's bounds are broken; no picture is made of that")
        picture = Image.open(Path(folder) / "demo.png").convert("RGB")
    IMAGES.mkdir(exist_ok=True)
    smaller = picture.resize((WIDTH, round(picture.height * WIDTH / picture.width)), Image.Resampling.LANCZOS)
    smaller.save(IMAGES / "demo.png", optimize=True)
    print(f"{IMAGES / 'demo.png'}: {(IMAGES / 'demo.png').stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
