"""The engine of both block matchers: which kernel runs, on what scratch memory, over which bands of rows.

The algorithm is told in :mod:`stereocal.reconstruction.sliding_window_kernels`. Here is what surrounds it: where each
column of the window's sums stands in the two images, how wide its numbers must be, and the memory it works in, 64-byte
aligned so that no vector straddles two cache lines.

What it costs, in cycles of one core of a Zen 4, found by leaving steps out: of 32 disparities of a pixel the sums take
5 and the search for the winner and its rivals 2.5 where 16 bits do, 9 and 5 where 32 are needed, for each sum then
fills two registers and each comparison makes two masks. Some ten cycles a pixel come on top, whatever D. So a window of
101, whose sums pass 2¹⁶ in the benchmark's pair, costs 1.7 times as much a pixel as one of 21.

A column beside the region that is matched may lie outside the image. :func:`slide_window` then takes the nearest column
inside; in the right image, the nearest place at which all D candidates are inside, as OpenCV does. In the regions of
:func:`~stereocal.reconstruction.sad.match_sad` that never happens.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from stereocal.reconstruction.row_bands import run_bands

Disparity = NDArray[np.float32]
"""A disparity map: pixels, NaN where there is none."""

SUBPIXEL = ("none", "opencv", "parabola")
"""How a disparity is refined to a fraction of a pixel; the kernels get the index."""

MOST_LANES = 512
"""Up to here the D sums are held as one value: beyond, the registers of no machine would do, and the loops run."""

TILE = 128
"""Pixels of which the vector kernel takes a step together,"""

TILE_BYTES = 2**14
"""or fewer, so that their sums stay in the first cache."""

NARROW = 2**16 - 1
"""The greatest number of 16 bits."""

CACHE_LINE = 64


def slide_window(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    disparity: Disparity,
    columns: range,
    rows: range,
    *,
    num_disparities: int,
    min_disparity: int,
    block_size: int,
    peak: int = 255,
    uniqueness_ratio: int = 0,
    subpixel: str = "none",
    left_right: int = -1,
    cost: NDArray[np.int32] | None = None,
    prepare: Callable[[range], None] | None = None,
    threads: int | None = None,
    vectors: bool = True,
) -> None:
    """Match `rows` and `columns` of `disparity` by the smallest SAD, wherever it is not NaN on entry.

    Parameters
    ----------
    left, right : ndarray of shape (H, W), uint8
        Grey or prefiltered images.
    disparity : ndarray of shape (H, W), float32
        Enters as NaN where no answer is wanted; leaves as the disparity map.
    columns, rows : range
        The pixels to match. The rows of every window lie in the images.
    num_disparities, min_disparity, block_size, uniqueness_ratio : int
        As in the matchers.
    peak : int
        No value of the images is above this; the smaller, the narrower the numbers that do.
    subpixel : {"none", "opencv", "parabola"}
        How the disparity is refined.
    left_right : int
        The left-right check's tolerance, or −1.
    cost : ndarray of shape (H, W), int32, optional
        Receives the smallest sum.
    prepare : callable, optional
        What is to be done for a band of rows before it is matched, on the band's thread.
    threads : int, optional
        How many threads share the rows; None is one a core.
    vectors : bool
        Whether explicit vectors may be used; the result is the same.
    """
    from numba import config

    from stereocal.reconstruction import sliding_window_kernels as kernels
    from stereocal.reconstruction.vector_primitives import lanes_of

    radius = block_size // 2
    width = left.shape[1]
    largest = min_disparity + num_disparities - 1
    beside = np.arange(columns.start - radius, columns.stop + radius)
    left_column = np.clip(beside, 0, width - 1).astype(np.intp)
    right_start = np.clip(beside - largest, 0, width - num_disparities).astype(np.intp)
    search = (columns.start, largest, num_disparities, uniqueness_ratio, SUBPIXEL.index(subpixel), left_right)
    cost = np.empty((0, 0), np.int32) if cost is None else cost
    vectors = vectors and num_disparities <= MOST_LANES and not config.DISABLE_JIT
    lanes = -(-num_disparities // 16) * 16
    largest_step = peak * block_size
    certain = largest_step * block_size < NARROW
    highest = None if certain else NARROW - 1 - largest_step
    sums_may_fit = certain or (2 * largest_step < NARROW and _sums_may_fit(left, peak, block_size))
    small = True if 2 * peak < 128 else None
    if vectors and lanes > num_disparities:
        right = np.pad(right, ((0, 0), (0, lanes - num_disparities)))

    def match_band(band: range) -> None:
        if prepare is not None:
            prepare(band)
        n = len(columns)
        if vectors:
            first = band.start
            for kind in (np.uint16, np.uint32) if sums_may_fit else (np.uint32,):
                narrow = kind is np.uint16
                gains = np.uint16 if narrow or 2 * largest_step < NARROW else np.uint32
                first = kernels.match_rows_vector(
                    left, right, left_column, right_start, radius, (first, band.stop), search,
                    lanes_of(lanes), aligned_empty(32 + n * lanes + 32, kind), aligned_empty(block_size * lanes, gains),
                    aligned_empty(block_size * lanes, np.uint8 if small else np.uint16),
                    _lanes_beyond(lanes, num_disparities, kind), small,
                    True if subpixel == "opencv" else None, highest if narrow else None,
                    _tile_scratch(lanes, kind), np.empty(n, np.int32),
                    *_right_scratch(width + lanes, kind, left_right), disparity, cost,
                )  # fmt: skip
                if first == band.stop:
                    break
        else:
            kernels.match_rows(
                left, right, left_column, right_start, radius, (band.start, band.stop), search,
                np.empty((n, num_disparities), np.int32), np.empty(num_disparities, np.int32),
                np.empty((block_size, num_disparities), np.int32), np.empty(n, np.int32),
                np.empty(width, np.int32), np.empty(width, np.int32), disparity, cost,
            )  # fmt: skip

    run_bands(match_band, rows, threads, least_rows=block_size)


def _sums_may_fit(image: NDArray[np.uint8], peak: int, block_size: int) -> bool:
    """Whether to try 16 bits: a guess from how far the values are from the middle, of every eighth row.

    On photographs as StereoBM filters them the greatest sum is about twice the mean Σ |I − peak/2| of a window. A wrong
    guess costs time, not the result.
    """
    typical = np.abs(image[::8].astype(np.int16) - peak // 2).mean()
    return bool(2.0 * typical * block_size**2 < np.iinfo(np.uint16).max)


def _lanes_beyond(lanes: int, num_disparities: int, kind: DTypeLike) -> NDArray[Any] | None:
    """Return all ones in the lanes that stand for no disparity, zeros in the others; None if there are none."""
    if lanes == num_disparities:
        return None
    beyond = np.zeros(lanes, kind)
    beyond[num_disparities:] = np.iinfo(kind).max
    return beyond


def _tile_scratch(lanes: int, kind: DTypeLike) -> tuple[NDArray[Any], ...]:
    """Return (least, limit, first, found, around) of the pixels of a tile, see ``find_winners``."""
    size = min(TILE, TILE_BYTES // (lanes * np.dtype(kind).itemsize))
    least, first, found = np.empty((3, size), np.int32)
    return least, np.empty(size, kind), first, found, np.empty(4 * size, kind)


def _right_scratch(size: int, kind: DTypeLike, left_right: int) -> tuple[NDArray[Any] | None, NDArray[Any] | None]:
    """Return the two rows that the left-right check keeps of the right image, or None twice."""
    if left_right < 0:
        return None, None
    return np.empty(size, kind), np.empty(size, np.uint32)


def aligned_empty(count: int, dtype: DTypeLike) -> NDArray[Any]:
    """Return an array whose first element stands at the start of a cache line."""
    size = count * np.dtype(dtype).itemsize
    raw = np.empty(size + CACHE_LINE, np.uint8)
    start = -raw.ctypes.data % CACHE_LINE
    return raw[start : start + size].view(dtype)
