"""Winner takes all: from costs to disparities, and which of them to believe.

Given a cost S(x, y, d), whoever made it, the disparity of a pixel is the one of least cost,

    d*(x, y) = argmin_d S(x, y, d)                                        (of two neighbours that tie, the smaller),

refined to a fraction of a pixel by the two costs beside it. Costs that are sums of absolute values or of differing bits
rise on both sides like a V, not like a parabola; the vertex of the V with two slopes of equal steepness through
S₋ = S(d* − 1), S₀, S₊ = S(d* + 1) is at

    d* + (S₋ − S₊) / (2 (max(S₋, S₊) − S₀)).

(A parabola through the same points pulls fractions towards whole pixels: M. Shimizu and M. Okutomi, 2001.)

Which disparities to believe:

* **Outside.** The winner lies outside the right image: no answer.
* **Uniqueness.** Another disparity, not a neighbour, costs as little, or less than S(d*) · 100 / (100 − u): no answer.
  With u = 0 that leaves the ties: a blank wall, or the black margin of a rectified image, looks the same at every
  disparity.
* **Left-right check.** The same costs seen from the right, d_R(x') = argmin_d S(x' + d, y, d), must agree. With f the
  disparity's floor or its ceiling: |d_R(x − f) − f| ≤ t for one of the two (and for one d_R, if several tie). What
  only the left camera sees has no partner that agrees, so this is what finds occlusions (P. Fua, 1993). OpenCV's
  StereoSGBM checks in the same way.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import require_integer
from stereocal.reconstruction.matching_costs import Gray, PixelCost, PreparedPair, cost_rows, prepare_pair
from stereocal.reconstruction.row_bands import kept_pool

Disparity = NDArray[np.float32]

CHUNK_ROWS = 64
"""Rows that are matched at a time where no cost volume of the whole image is needed."""


@dataclass(frozen=True)
class Search:
    """What is searched, and how the winner is refined and checked.

    Attributes
    ----------
    num_disparities, min_disparity : int
        The candidates: `num_disparities` values from `min_disparity` up.
    subpixel : bool
        Whether the V is fitted.
    tolerance : int
        t of the left-right check; -1 does not check.
    uniqueness_ratio : int
        u, percent.
    """

    num_disparities: int
    min_disparity: int
    subpixel: bool
    tolerance: int
    uniqueness_ratio: int

    @classmethod
    def checked(
        cls,
        num_disparities: int,
        min_disparity: int,
        subpixel: bool,
        left_right_check: int | None,
        uniqueness_ratio: int,
    ) -> Search:
        """Validate what a matcher was given."""
        tolerance = -1
        if left_right_check is not None:
            tolerance = require_integer(left_right_check, "left_right_check", minimum=0)
        return cls(
            num_disparities=require_integer(num_disparities, "num_disparities", minimum=1, maximum=2**12),
            min_disparity=require_integer(min_disparity, "min_disparity", minimum=-(2**14), maximum=2**14),
            subpixel=bool(subpixel),
            tolerance=tolerance,
            uniqueness_ratio=require_integer(uniqueness_ratio, "uniqueness_ratio", minimum=0, maximum=99),
        )


def select(volume: NDArray[np.int64], search: Search) -> Disparity:
    """Take the winner of each pixel, the readable way.

    Parameters
    ----------
    volume : ndarray of shape (H, W, D), int64
        S(x, y, min_disparity + i).
    search : Search

    Returns
    -------
    ndarray of shape (H, W), float32
        NaN where there is no answer.
    """
    _, width, count = volume.shape
    winner = np.argmin(volume, axis=2)
    least, below, above = (
        np.take_along_axis(volume, np.clip(winner + step, 0, count - 1)[..., None], axis=2)[..., 0]
        for step in (0, -1, 1)
    )
    whole = search.min_disparity + winner
    disparity = whole.astype(np.float64)
    if search.subpixel:
        rise = np.maximum(below, above) - least
        fitted = (winner > 0) & (winner < count - 1) & (rise > 0)
        disparity[fitted] += (below - above)[fitted] / (2.0 * rise[fitted])
    there = np.arange(width) - whole
    believed = (there >= 0) & (there < width)
    rivals = np.abs(np.arange(count) - winner[..., None]) > 1
    close = volume * (100 - search.uniqueness_ratio) < 100 * least[..., None]
    tied = volume == least[..., None]
    believed &= ~np.any(rivals & (close | tied), axis=2)
    if search.tolerance >= 0:
        believed &= _right_image_agrees(volume, search, disparity.astype(np.float32))
    return np.where(believed, disparity, np.nan).astype(np.float32)


def _right_image_agrees(volume: NDArray[np.int64], search: Search, disparity: Disparity) -> NDArray[np.bool_]:
    """Whether d_R(x − f) is within t of f, for f the floor or the ceiling of the disparity."""
    height, width, count = volume.shape
    never = np.iinfo(np.int64).max
    seen = np.full((height, width, count), never)  # S(x' + d, y, d) at [y, x', i]
    for i in range(count):
        d = search.min_disparity + i
        if abs(d) < width:
            from_x, to_x = slice(max(d, 0), width + min(d, 0)), slice(max(-d, 0), width - max(d, 0))
            seen[:, to_x, i] = volume[:, from_x, i]
    best_of_right = (seen == seen.min(axis=2, keepdims=True)) & (seen < never)
    candidates = search.min_disparity + np.arange(count)
    agrees = np.zeros((height, width), bool)
    for f in (np.floor(disparity).astype(np.int64), np.ceil(disparity).astype(np.int64)):
        there = np.arange(width) - f
        real = (there >= 0) & (there < width)
        best = np.take_along_axis(best_of_right, np.clip(there, 0, width - 1)[..., None], axis=1)
        near = np.abs(candidates - f[..., None]) <= search.tolerance
        agrees |= real & np.any(best & near, axis=2)
    return agrees


class RowSelector:
    """The scratch memory and the fixed arguments of the kernel that takes the winners of a row."""

    def __init__(self, pair: PreparedPair, search: Search) -> None:
        lanes = pair.lanes
        beyond = np.zeros(lanes, np.uint16)
        beyond[search.num_disparities :] = 65535
        self.arguments = (
            search.num_disparities, search.min_disparity, search.uniqueness_ratio, search.subpixel, search.tolerance,
            pair.start, pair.inside, beyond, np.empty(len(pair.inside), np.uint16),
            np.empty((4, pair.shape[1]), np.int32),
        )  # fmt: skip


def match_by_rows(
    left: Gray, right: Gray, recipe: PixelCost, block_size: int, search: Search, threads: int
) -> Disparity:
    """Match by the least block cost, some rows at a time: memory O(W · D), not O(H · W · D)."""
    from stereocal.reconstruction import semiglobal_kernels as kernels
    from stereocal.reconstruction.vector_primitives import lanes_of

    pair = prepare_pair(
        left, right, num_disparities=search.num_disparities, min_disparity=search.min_disparity, recipe=recipe
    )
    height, width = left.shape
    disparity = np.empty((height, width), np.float32)

    def match_band(first: int, last: int) -> None:
        selector = RowSelector(pair, search)
        sums = np.empty((CHUNK_ROWS, width, pair.lanes), np.uint16)
        for start in range(first, last, CHUNK_ROWS):
            rows = (start, min(start + CHUNK_ROWS, last))
            some = sums[: rows[1] - rows[0]]
            cost_rows(pair, rows, some, num_disparities=search.num_disparities, recipe=recipe, block_size=block_size)
            kernels.select_rows(some.reshape(-1), *selector.arguments, lanes_of(pair.lanes), disparity[slice(*rows)])

    run_together([partial(match_band, *band) for band in bands(height, threads)], threads)
    return disparity


def thread_count(threads: int | None) -> int:
    """Return the number of threads to use; all cores for None."""
    if threads is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return require_integer(threads, "threads", minimum=1)


def bands(height: int, threads: int) -> list[tuple[int, int]]:
    """Split the rows into one band a thread."""
    edges = [height * i // threads for i in range(threads + 1)]
    return [band for band in pairwise(edges) if band[0] < band[1]]


def run_together(jobs: Sequence[Callable[[], Any]], threads: int) -> None:
    """Run callables, one after the other or each on a thread of its own, and wait for all of them."""
    if threads == 1 or len(jobs) == 1:
        for job in jobs:
            job()
        return
    pool = kept_pool(len(jobs) - 1)
    others = [pool.submit(job) for job in jobs[1:]]
    try:
        jobs[0]()
    finally:
        for other in others:
            other.exception()  # none may still write when this returns
    for other in others:
        other.result()
