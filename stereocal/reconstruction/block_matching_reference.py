"""StereoBM's recipe in NumPy: each step of :mod:`stereocal.reconstruction.block_matching` as it reads, slow and plain.

The fast kernels are held equal to these functions, and these to OpenCV. All D sums of each pixel are kept at once, as
(D, rows, columns), so that this is for small images and for reading.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereocal.reconstruction.sliding_window import Disparity

Image = NDArray[np.uint8]
Sums = NDArray[np.int64]


def window_sums(values: NDArray[np.int64], block_size: int) -> Sums:
    """Sum over each window of block_size² pixels that lies inside: (…, H, W) → (…, H − b + 1, W − b + 1)."""
    windows = np.lib.stride_tricks.sliding_window_view(values, (block_size, block_size), axis=(-2, -1))
    return np.asarray(windows.sum(axis=(-2, -1)))


def xsobel(image: Image, cap: int) -> Image:
    """clip(∂I/∂x by Sobel, ±c) + c; the first and last column are c, and the last row of an odd height."""
    padded = np.pad(image.astype(np.int64), ((1, 1), (0, 0)), mode="reflect")
    across = padded[:, 2:] - padded[:, :-2]
    slope = across[:-2] + 2 * across[1:-1] + across[2:]
    filtered = np.full(image.shape, cap, np.uint8)
    filtered[:, 1:-1] = np.clip(slope, -cap, cap) + cap
    if len(image) % 2:
        filtered[-1] = cap
    return filtered


def normalized_response(image: Image, size: int, cap: int) -> Image:
    """clip((g (4I + the four neighbours) − s Σ_window I) >> 10, ±c) + c, the border replicated."""
    eighth = size * size // 8
    s = (1024 + eighth) // (2 * eighth)
    g = s * eighth
    near = np.pad(image.astype(np.int64), 1, mode="edge")
    centre = 4 * near[1:-1, 1:-1] + near[1:-1, :-2] + near[1:-1, 2:] + near[:-2, 1:-1] + near[2:, 1:-1]
    total = window_sums(np.pad(image.astype(np.int64), size // 2, mode="edge"), size)
    return (np.clip((g * centre - s * total) >> 10, -cap, cap) + cap).astype(np.uint8)


def match_filtered(
    left: Image,
    right: Image,
    columns: range,
    rows: range,
    *,
    num_disparities: int,
    min_disparity: int,
    block_size: int,
    cap: int,
    texture_threshold: int,
    uniqueness_ratio: int,
) -> tuple[Disparity, Sums]:
    """Steps 2 to 5 on prefiltered images: the disparity and the smallest SAD of the pixels in `rows` and `columns`."""
    radius = block_size // 2
    largest = min_disparity + num_disparities - 1
    beside = np.arange(columns.start - radius, columns.stop + radius)
    down = slice(rows.start - radius, rows.stop + radius)
    seen = left[down, np.clip(beside, 0, left.shape[1] - 1)].astype(np.int64)
    start = np.clip(beside - largest, 0, left.shape[1] - num_disparities)
    sad = np.stack(
        [
            window_sums(np.abs(seen - right[down, start + k].astype(np.int64)), block_size)
            for k in range(num_disparities)
        ]
    )
    k = np.argmin(sad, axis=0)  # k counts disparities down, so that a tie goes to the larger

    def at(lane: NDArray[np.int64]) -> Sums:
        inside = np.clip(lane, 0, num_disparities - 1)
        return np.asarray(np.take_along_axis(sad, inside[None], axis=0)[0])

    least = at(k)
    rejected = window_sums(np.abs(seen - cap), block_size) < texture_threshold
    if uniqueness_ratio > 0:
        elsewhere = np.abs(np.arange(num_disparities)[:, None, None] - k) > 1
        rejected |= np.any(elsewhere & (sad <= least + least * uniqueness_ratio // 100), axis=0)
    p, n = at(k + 1), at(k - 1)
    q = p + n - 2 * least + np.abs(p - n)
    fraction = np.trunc(256 * (p - n) / np.maximum(q, 1)).astype(np.int64)
    fraction[(k == 0) | (k == num_disparities - 1)] = 0
    disparity = ((256 * (largest - k) + fraction + 15) >> 4) / 16
    return np.where(rejected, np.nan, disparity).astype(np.float32), least


def cross_check(disparity: Disparity, cost: Sums, first_column: int, width: int, max_difference: int) -> None:
    """Step 6, in place: the right image's disparity is that of the cheapest left pixel matched to it.

    `first_column` is where the first column of `disparity` stands in the image of `width` columns.
    """
    for row, costs in zip(disparity, cost, strict=True):
        cheapest: dict[int, tuple[int, float]] = {}
        for x, (d, c) in enumerate(zip(row, costs, strict=True), first_column):
            there = x - int(np.floor(d + 0.5)) if d == d else -1
            if d == d and (there not in cheapest or cheapest[there][0] > c):
                cheapest[there] = (int(c), float(d))
        for x, d in enumerate(row, first_column):
            if d == d:
                met = [cheapest.get(x - int(side)) for side in (np.floor(d), np.ceil(d))]
                inside = all(0 <= x - int(side) < width for side in (np.floor(d), np.ceil(d)))
                if inside and all(m is not None and abs(m[1] - d) > max_difference for m in met):
                    row[x - first_column] = np.nan
