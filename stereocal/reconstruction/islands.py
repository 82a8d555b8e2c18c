"""Islands without evidence: what to do with a disparity that no texture supports.

A blank wall looks the same at every disparity. Smoothness lets it take over what its textured border says, and that is
mostly right. But where the border is hidden, or the wall is larger than the smoothness reaches, the camera's noise
decides, for a patch of hundreds of pixels at once: neighbours agree with each other, the right image agrees, and a
speckle filter finds the patch too large to be a speckle.

What tells such a patch is that nothing in it could have been matched. So an **island** (a 4-connected set of pixels
that differ by at most `max_difference` from neighbour to neighbour, see :mod:`stereocal.reconstruction.speckles`) is
believed if it

* has more than `max_size` pixels, and
* holds at least :data:`EVIDENCE` pixels with texture,

        |I(x + 1, y) − I(x − 1, y)| > t,

for it is along the row that matching looks. A correct blank wall is joined to the textured things around it, and is
kept with them; one that hangs in the air is not.

The threshold t is in grey levels, and is lowered where the whole image has little contrast: to 1/16 of the range in
which nine tenths of its grey values lie.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereocal.reconstruction.census import runs_compiled
from stereocal.reconstruction.speckles import _label_runs, components

Disparity = NDArray[np.float32]

EVIDENCE = 10
"""The least number of pixels with texture in an island that is believed."""


def filter_islands(
    disparity: Disparity,
    image: NDArray[np.uint8],
    *,
    max_size: int,
    max_difference: float,
    texture_threshold: int,
    backend: str = "numba",
) -> Disparity:
    """Remove the islands of at most `max_size` pixels, and those without texture.

    Parameters
    ----------
    disparity : ndarray of shape (H, W), float32
        Pixels; NaN where there is none.
    image : ndarray of shape (H, W), uint8
        The rectified left image.
    max_size : int
        At least 1.
    max_difference : float
        Neighbours that differ by at most this much belong to one island.
    texture_threshold : int
        t, grey levels; 0 does not ask for texture.
    backend : {"numba", "numpy"}
        The kernel, or the readable reference.

    Returns
    -------
    ndarray of shape (H, W), float32
    """
    threshold = min(texture_threshold, contrast(image) // 16)
    evidence = EVIDENCE if texture_threshold > 0 else 0
    if not runs_compiled(backend):
        island = components(disparity, np.isfinite(disparity), max_difference)
        size = np.bincount(island.ravel())
        texture = np.bincount(island.ravel(), weights=textured(image, threshold).ravel())
        believed = (size > max_size) & (texture >= evidence)
        return np.where(believed[island], disparity, np.nan).astype(np.float32)
    from stereocal.reconstruction import islands_kernels as kernels

    none = np.float32(np.nan)
    out = disparity.copy()
    runs = _label_runs(np.ascontiguousarray(disparity), none, max_difference, out.reshape(-1), alone=none)
    texture = np.zeros(runs[0], np.int32)
    kernels.erase_unsupported(*runs, image, threshold, texture, max_size, evidence, out.reshape(-1))
    return out


def contrast(image: NDArray[np.uint8]) -> int:
    """Return the range in which nine tenths of the grey values lie, from every eighth row and column."""
    low, high = np.percentile(image[::8, ::8], (5, 95))
    return int(high - low)


def textured(image: NDArray[np.uint8], threshold: int) -> NDArray[np.bool_]:
    """Return |I(x + 1) − I(x − 1)| > t; beyond its border the image goes on as it ends."""
    padded = np.pad(image.astype(np.int64), ((0, 0), (1, 1)), mode="edge")
    return np.asarray(np.abs(padded[:, 2:] - padded[:, :-2]) > threshold)
