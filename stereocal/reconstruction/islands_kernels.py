# mypy: allow-untyped-defs
"""Kernel of the islands without evidence, on the runs that the speckle filter finds.

A run is a maximal row of joined pixels, an island a tree of runs (:mod:`stereocal.reconstruction.speckles_kernels`).
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def erase_unsupported(runs, start, length, root, size, image, threshold, texture, max_size, evidence, out):
    """Write NaN over each island that is too small or has too little texture.

    Parameters
    ----------
    runs : int
        How many runs.
    start, length, root : (≥ runs,) int32
        The first pixel of each run, counted through the map; its pixels; the first run of its island.
    size : (runs,) int32
        The pixels of the island, at its first run.
    image : (H, W) uint8
    threshold : int
        t: a pixel has texture if its two neighbours in the row differ by more.
    texture : (runs,) int32
        Scratch, enters as zeros.
    max_size, evidence : int
        An island is kept if it has more pixels than the one, and at least as many with texture as the other.
    out : (H·W,) float32
    """
    width = image.shape[1]
    gray = image.ravel()
    for run in range(runs):
        island = root[run]
        if size[island] > max_size and texture[island] < evidence:
            first = start[run]
            row = first // width * width
            found = 0
            for p in range(first, first + length[run]):
                before, after = gray[max(p - 1, row)], gray[min(p + 1, row + width - 1)]
                found += abs(np.int32(after) - np.int32(before)) > threshold
            texture[island] += found
    for run in range(runs):
        island = root[run]
        if size[island] <= max_size or texture[island] < evidence:
            out[start[run] : start[run] + length[run]] = np.nan
