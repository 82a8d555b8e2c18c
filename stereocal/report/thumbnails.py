"""Small photographs with the corners found drawn on them, as JPEG: one look tells a wrong pair from a right one.

They are drawn with Pillow, which takes two milliseconds where matplotlib takes a hundred.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from stereocal.base.checks import Float
from stereocal.report.evidence import Evidence
from stereocal.report.figures_images import to_display
from stereocal.report.style import AMBER, VERDICT_COLOURS

_WIDTH = 260
_AT_MOST = 60


@dataclass(frozen=True)
class Thumbnail:
    """A pair in small.

    Attributes
    ----------
    name : str
    left, right : bytes
        JPEG.
    used : bool
    note : str
        RMS of the pair, or the reason why it was left out.
    """

    name: str
    left: bytes
    right: bytes
    used: bool
    note: str


def make_thumbnails(
    evidence: Evidence, pairs: Sequence[Mapping[str, Any]], images: Sequence[Any]
) -> tuple[Thumbnail, ...]:
    """Make a thumbnail for each pair, those left out first, at most sixty.

    Parameters
    ----------
    evidence : Evidence
    pairs : sequence of mapping
        One a pair, used or not; the used ones in the order of `evidence`.
    images : sequence of (left, right)
        Photographs of `pairs`; each may be an image or None.
    """
    view_of_pair: dict[int, int] = {}
    for index, pair in enumerate(pairs):
        if pair["used"]:
            view_of_pair[index] = len(view_of_pair)
    order = sorted(range(len(pairs)), key=lambda i: (bool(pairs[i]["used"]), i))
    return tuple(_thumbnail(evidence, pairs[i], images[i], view_of_pair.get(i)) for i in order[:_AT_MOST])


def _thumbnail(evidence: Evidence, pair: Mapping[str, Any], images: Any, view: int | None) -> Thumbnail:
    left, right = images
    if view is None:
        corners: tuple[Float | None, Float | None] = (None, None)
        note = str(pair.get("reason") or "left out")
    else:
        corners = (evidence.left[view], evidence.right[view])
        error = np.sqrt(np.mean(np.sum(evidence.residuals[:, view] ** 2, axis=-1)))
        note = f"{error:.3f} px"
    name = str(pair.get("left") or pair.get("right") or "")
    return Thumbnail(
        name,
        _draw(left, corners[0], evidence.columns),
        _draw(right, corners[1], evidence.columns),
        view is not None,
        note,
    )


def _draw(image: Any, corners: Float | None, columns: int) -> bytes:
    if image is None:
        return b""
    array = np.asarray(image)
    scale = _WIDTH / array.shape[1]
    small = Image.fromarray(to_display(array)).convert("RGB")
    small = small.resize((_WIDTH, max(1, round(scale * array.shape[0]))), Image.Resampling.BILINEAR)
    pen = ImageDraw.Draw(small)
    if corners is not None:
        dots = [tuple((p + 0.5) * scale) for p in corners]
        for start in range(0, len(dots), columns):
            pen.line(dots[start : start + columns], fill="#35E0A1", width=1)
        x, y = dots[0]
        pen.ellipse((x - 4, y - 4, x + 4, y + 4), outline=AMBER, width=2)
    else:
        width, height = small.size
        pen.rectangle((0, 0, width - 1, height - 1), outline=VERDICT_COLOURS["bad"], width=4)
    stream = io.BytesIO()
    small.save(stream, "JPEG", quality=72)
    return stream.getvalue()
