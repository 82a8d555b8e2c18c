"""After matching: smoother, without holes, and with a measure of trust. All of it optional, for any matcher's map.

**Weighted median.** Inside a surface a median removes outliers; across an edge it must not mix the two sides. So each
pixel q of the window around p votes for its disparity with the weight

    w(p, q) = exp(−|I(q) − I(p)| / σ_c) · exp(−|q − p| / σ_s),

and the result is the disparity at which half of the votes are reached (Z. Ma et al., 2013). It is one of the
disparities of the window, never a blend of foreground and background. Votes are counted in whole numbers, so that the
order of counting does not matter. Pixels without a disparity neither vote nor are given one.

**Median of nine.** The plain median of 3x3 pixels takes single wrong pixels and ragged edges away, for next to no
time. A neighbour without a disparity counts as the pixel itself. A pixel without one counts as infinitely far away, so
that it gets one if five or more of its neighbours have, and leans towards the farther of them, for what has no match is
mostly background. Semi-global matching ends with it.

**Holes.** What the right camera does not see is BACKGROUND, next to the left edge of something nearer. A hole in a row
is filled with the smaller of the two disparities at its ends (H. Hirschmüller, 2008, section 2.5.3): a guess that is
right for occlusions behind a straight edge, and not a measurement. Fill for pictures; leave the holes for measuring.

**Confidence.** A match is the more to be trusted the dearer its best rival. With c₁ the matching cost at the disparity
found and c₂ the least cost at one that is not its neighbour,

    confidence = max(0, 1 − c₁ / c₂),

0 for a tie, near 1 for a match without rival (X. Hu and P. Mordohai, 2012: "peak ratio, naive"). It looks at the images
alone, so it tells whether they support a disparity, whatever smoothness led to it.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import as_array, as_image, require_choice, require_integer, require_positive
from stereocal.base.errors import InputError
from stereocal.base.gray import to_gray
from stereocal.reconstruction.census import runs_compiled
from stereocal.reconstruction.matching_costs import (
    COSTS,
    RECIPES,
    cost_rows,
    cost_volume,
    prepare_pair,
    require_block_fits,
)
from stereocal.reconstruction.sad import as_gray_pair
from stereocal.reconstruction.winner import CHUNK_ROWS, Disparity, bands, run_together, thread_count

VOTES = 1024
"""The weight of the centre pixel in each of the two factors."""


def weighted_median(
    disparity: ArrayLike,
    image: ArrayLike,
    *,
    radius: int = 3,
    sigma_color: float = 10.0,
    sigma_space: float = 5.0,
    threads: int | None = None,
    backend: str = "numba",
) -> Disparity:
    """Median of each window, weighted by w(p, q) = exp(−|I(q) − I(p)| / σ_c) · exp(−|q − p| / σ_s).

    Parameters
    ----------
    disparity : array_like of shape (H, W)
        Pixels; NaN where there is none.
    image : array_like of shape (H, W) or (H, W, 3), uint8
        The rectified left image.
    radius : int
        The window has (2 radius + 1)² pixels.
    sigma_color : float
        σ_c, grey levels.
    sigma_space : float
        σ_s, pixels.
    threads : int, optional
        How many threads share the rows; the result does not depend on it. None takes all cores.
    backend : {"numba", "numpy"}
        The kernel, or the readable reference. They are equal to the bit.

    Returns
    -------
    ndarray of shape (H, W), float32
        NaN where `disparity` is.

    Raises
    ------
    InputError
        If the image is not uint8 or its size is not that of the map, or a parameter is out of its range.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> disparity = np.full((9, 9), 5, np.float32)
    >>> disparity[4, 4] = 50  # a false match
    >>> float(sc.weighted_median(disparity, np.full((9, 9), 100, np.uint8))[4, 4])
    5.0
    """
    require_choice(backend, ("numba", "numpy"), "backend")
    d = _as_disparity(disparity)
    guide = to_gray(as_image(image, channels=(1, 3, 4)))
    if guide.dtype != np.uint8 or guide.shape != d.shape:
        raise InputError(f"image must be uint8 of shape {d.shape}, as the map, but is {guide.dtype} {guide.shape}")
    radius = require_integer(radius, "radius", minimum=1, maximum=15)
    sigma_color = require_positive(sigma_color, "sigma_color")
    sigma_space = require_positive(sigma_space, "sigma_space")
    color_weight = np.rint(VOTES * np.exp(-np.arange(256) / sigma_color)).astype(np.int64)
    v, u = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    space_weight = np.rint(VOTES * np.exp(-np.hypot(u, v) / sigma_space)).astype(np.int64)
    if backend == "numpy":
        return _weighted_median_reference(d, guide, color_weight, space_weight)
    from stereocal.reconstruction import postprocessing_kernels as kernels

    out = np.empty_like(d)
    count = thread_count(threads)
    jobs = [
        partial(kernels.weighted_median, d, guide, color_weight, space_weight, band, out)
        for band in bands(len(d), count)
    ]
    run_together(jobs, count)
    return out


def _weighted_median_reference(
    disparity: Disparity, guide: NDArray[np.uint8], color_weight: NDArray[np.int64], space_weight: NDArray[np.int64]
) -> Disparity:
    """All windows at once: sort their disparities, add up the votes in that order, take the first to reach half."""
    side = len(space_weight)
    radius = side // 2

    def windows(array: NDArray[np.float64], beyond: float) -> NDArray[np.float64]:
        padded = np.pad(array, radius, constant_values=beyond)
        return np.lib.stride_tricks.sliding_window_view(padded, (side, side)).reshape(*array.shape, -1)

    values = windows(disparity.astype(np.float64), np.nan)
    difference = np.abs(windows(guide.astype(np.float64), 0) - guide[..., None].astype(np.float64)).astype(np.int64)
    votes = np.where(np.isnan(values), 0, color_weight[difference] * space_weight.ravel())
    order = np.argsort(values, axis=2, kind="stable")  # NaN comes last, with no votes
    values, votes = (np.take_along_axis(a, order, axis=2) for a in (values, votes))
    reached = np.cumsum(votes, axis=2)
    first = np.argmax(2 * reached >= reached[..., -1:], axis=2)
    median = np.take_along_axis(values, first[..., None], axis=2)[..., 0]
    return np.where(np.isnan(disparity), np.nan, median).astype(np.float32)


def median_of_nine(disparity: Disparity, *, backend: str = "numba") -> Disparity:
    """Median of 3x3 pixels, those without a disparity as said above.

    Parameters
    ----------
    disparity : ndarray of shape (H, W), float32
        NaN where there is none.
    backend : {"numba", "numpy"}
        The kernel, or the readable reference. They are equal to the bit.

    Returns
    -------
    ndarray of shape (H, W), float32
        NaN where `disparity` is, but for holes that five neighbours close.
    """
    if runs_compiled(backend):
        from stereocal.reconstruction import postprocessing_kernels as kernels

        height, width = disparity.shape
        padded = np.full((height + 2, width + 2), np.nan, np.float32)
        padded[1:-1, 1:-1] = disparity
        out = np.empty_like(disparity)
        kernels.median_of_nine(padded, out)
        return out
    padded = np.pad(disparity, 1, constant_values=np.nan)
    nine = np.lib.stride_tricks.sliding_window_view(padded, (3, 3)).reshape(*disparity.shape, 9)
    itself = np.where(np.isnan(disparity), np.float32(-np.inf), disparity)
    nine = np.where(np.isnan(nine), itself[..., None], nine)
    middle = np.sort(nine, axis=2)[..., 4]
    return np.where(np.isinf(middle), np.float32(np.nan), middle)


def fill_holes(disparity: ArrayLike, *, max_width: int | None = None) -> Disparity:
    """Fill each hole of a row from the background: with the smaller of the disparities at its two ends.

    Parameters
    ----------
    disparity : array_like of shape (H, W)
        Pixels; NaN where there is none.
    max_width : int, optional
        Wider holes are left as they are; None fills all.

    Returns
    -------
    ndarray of shape (H, W), float32
        A hole at the image's border is filled from its one end. A row without any disparity stays empty.

    Raises
    ------
    InputError
        If `disparity` is not (H, W) or `max_width` is below 1.

    Notes
    -----
    What is filled in is a guess. Smoothness of the result says nothing about its truth.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> sc.fill_holes(np.array([[5, np.nan, np.nan, 3]], np.float32))  # the farther side goes on
    array([[5., 3., 3., 3.]], dtype=float32)
    """
    d = _as_disparity(disparity)
    limit = d.shape[1] if max_width is None else require_integer(max_width, "max_width", minimum=1)
    if d.size == 0:
        return d
    _, width = d.shape
    valid = ~np.isnan(d)
    column = np.arange(width)
    before = np.maximum.accumulate(np.where(valid, column, -1), axis=1)  # the last valid column so far, or -1
    after = np.minimum.accumulate(np.where(valid, column, width)[:, ::-1], axis=1)[:, ::-1]
    guarded = np.pad(d, ((0, 0), (0, 1)), constant_values=np.nan)  # columns -1 and `width` both read NaN
    rows = np.arange(len(d))[:, None]
    background = np.fmin(guarded[rows, before], guarded[rows, after])
    return np.where(~valid & (after - before - 1 <= limit), background, d)


def confidence_map(
    disparity: ArrayLike,
    left: ArrayLike,
    right: ArrayLike,
    *,
    num_disparities: int = 64,
    min_disparity: int = 0,
    cost: str = "census+bt",
    block_size: int = 5,
    backend: str = "numba",
) -> NDArray[np.float32]:
    """How much the images support each disparity, max(0, 1 − c₁ / c₂).

    Parameters
    ----------
    disparity : array_like of shape (H, W)
        Pixels; NaN where there is none.
    left, right : array_like of shape (H, W) or (H, W, 3), uint8
        The rectified pair.
    num_disparities, min_disparity : int
        The candidates among which the rival is sought.
    cost : {"census+bt", "census", "bt", "sad"}
        The matching cost, see :mod:`stereocal.reconstruction.matching_costs`.
    block_size : int
        Side of the block over which the cost is summed, odd.
    backend : {"numba", "numpy"}
        The kernel for the costs, or the readable reference.

    Returns
    -------
    ndarray of shape (H, W), float32
        0 … 1; NaN where there is no disparity, or one that is not among the candidates.

    Raises
    ------
    InputError
        If the images are not a pair of equal uint8 images of the map's size, or a parameter is out of its range.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> scene = np.random.default_rng(0).integers(0, 256, (40, 120), dtype=np.uint8)
    >>> left, right = scene[:, :-4], scene[:, 4:]  # all of it 4 px away
    >>> disparity = np.full(left.shape, 4, np.float32)
    >>> disparity[:, :60] = 9  # false on the left half
    >>> confidence = sc.confidence_map(disparity, left, right, num_disparities=16)
    >>> bool(np.nanmedian(confidence[:, 20:60]) < np.nanmedian(confidence[:, 60:]))
    True
    """
    require_choice(cost, COSTS, "cost")
    require_choice(backend, ("numba", "numpy"), "backend")
    d = _as_disparity(disparity)
    left_gray, right_gray = as_gray_pair(left, right)
    if left_gray.shape != d.shape:
        raise InputError(f"left and right must be of the map's shape {d.shape}, but are {left_gray.shape}")
    count = require_integer(num_disparities, "num_disparities", minimum=4, maximum=2**12)
    lowest = require_integer(min_disparity, "min_disparity", minimum=-(2**14), maximum=2**14)
    block_size = require_integer(block_size, "block_size", minimum=1, odd=True)
    recipe = RECIPES[cost]
    require_block_fits(block_size, recipe)
    if not runs_compiled(backend):
        volume = cost_volume(
            left_gray, right_gray, num_disparities=count, min_disparity=lowest, recipe=recipe, block_size=block_size,
            scaled=False,
        )  # fmt: skip
        return _peak_ratio(volume, d, lowest)
    pair = prepare_pair(left_gray, right_gray, num_disparities=count, min_disparity=lowest, recipe=recipe)
    confidence = np.empty_like(d)
    sums = np.empty((CHUNK_ROWS, d.shape[1], pair.lanes), np.uint16)
    for first in range(0, len(d), CHUNK_ROWS):
        rows = (first, min(first + CHUNK_ROWS, len(d)))
        some = sums[: rows[1] - rows[0]]
        cost_rows(pair, rows, some, num_disparities=count, recipe=recipe, block_size=block_size)
        confidence[slice(*rows)] = _peak_ratio(some[..., :count], d[slice(*rows)], lowest)
    return confidence


def _peak_ratio(volume: NDArray[np.integer], disparity: Disparity, lowest: int) -> NDArray[np.float32]:
    """1 − c₁ / c₂ from the costs of all candidates, lowest disparity first."""
    count = volume.shape[2]
    with np.errstate(invalid="ignore"):
        index = np.rint(disparity - lowest)
    among = (index >= 0) & (index < count)
    best = np.where(among, index, 0).astype(np.int64)
    c1 = np.take_along_axis(volume, best[..., None], axis=2)[..., 0].astype(np.float64)
    rivals = volume.copy()
    for step in (-1, 0, 1):
        np.put_along_axis(rivals, np.clip(best + step, 0, count - 1)[..., None], np.iinfo(volume.dtype).max, axis=2)
    c2 = rivals.min(axis=2).astype(np.float64)
    ratio = np.divide(c1, c2, out=np.ones_like(c1), where=c2 > 0)
    return np.where(among, np.maximum(0.0, 1.0 - ratio), np.nan).astype(np.float32)


def _as_disparity(disparity: ArrayLike) -> Disparity:
    d = as_array(disparity, (None, None), "disparity", finite=False).astype(np.float32)
    d[~np.isfinite(d)] = np.nan
    return d
