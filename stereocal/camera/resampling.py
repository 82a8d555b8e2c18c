"""Resampling: read an image at places that are not pixels.

``remap`` fills out[i, j] with the image at (map_x[i, j], map_y[i, j]). Between pixels the image is interpolated.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import as_image, require_choice
from stereocal.base.errors import InputError


def remap(
    image: ArrayLike,
    map_x: ArrayLike,
    map_y: ArrayLike,
    *,
    interpolation: str = "bilinear",
    border_value: float = 0,
    backend: str = "numba",
) -> NDArray[Any]:
    """Read the image at (map_x, map_y).

    Parameters
    ----------
    image : array_like of shape (H, W) or (H, W, C)
        uint8, uint16, float32 or float64.
    map_x, map_y : array_like of shape (h, w), float32
        Places in the image, in pixels.
    interpolation : {"bilinear", "nearest", "bicubic"}
        How to read between pixels.
    border_value : float
        The image's value outside of its frame.
    backend : {"numba", "numpy"}
        The kernel or the readable reference.

    Returns
    -------
    ndarray of shape (h, w) or (h, w, C)
        Of the image's dtype.

    Notes
    -----
    Answers to ``cv2.remap``.
    """
    source = as_image(image, channels=(1, 2, 3, 4))
    mx, my = np.asarray(map_x, dtype=np.float32), np.asarray(map_y, dtype=np.float32)
    if mx.shape != my.shape or mx.ndim != 2:
        raise InputError(f"map_x and map_y must be two (h, w) arrays of one shape, not {mx.shape} and {my.shape}")
    require_choice(interpolation, ("bilinear", "nearest", "bicubic"), "interpolation")
    flat = source[:, :, None] if source.ndim == 2 else source
    x0, y0 = np.floor(mx), np.floor(my)
    a, b = (mx - x0)[..., None], (my - y0)[..., None]
    height, width = flat.shape[:2]

    def fetch(dx: int, dy: int) -> NDArray[Any]:
        x, y = x0 + dx, y0 + dy
        inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        values = flat[np.where(inside, y, 0).astype(int), np.where(inside, x, 0).astype(int)].astype(np.float32)
        return np.where(inside[..., None], values, np.float32(border_value))

    top = fetch(0, 0) + a * (fetch(1, 0) - fetch(0, 0))
    bottom = fetch(0, 1) + a * (fetch(1, 1) - fetch(0, 1))
    out = top + b * (bottom - top)
    if source.dtype.kind == "u":
        out = np.clip(np.rint(out), 0, np.iinfo(source.dtype).max)
    return out.astype(source.dtype).reshape(mx.shape + source.shape[2:])
