"""The levels a board is looked for at: halves, a double, and levels whose gaps are closed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

SMALLEST_LEVEL = 200
"""The longest side of the coarsest level is at least this, px."""
LARGEST_AGAIN = 1.3e6
"""Levels of up to this many pixels are searched again, as logarithms and with their gaps closed."""


def halved(gray: NDArray[Any], smallest: int, least_side: int) -> list[tuple[NDArray[Any], float]]:
    """The image and its halves while the longest side stays above `smallest` and the shortest above `least_side`."""
    from stereocal.board.pyramid_kernels import halve

    levels = [(gray, 1.0)]
    while max(levels[-1][0].shape) >= 2 * smallest and min(levels[-1][0].shape) >= 2 * least_side:
        fine, scale = levels[-1]
        coarse = np.empty((fine.shape[0] // 2, fine.shape[1] // 2), np.float32)
        halve(fine, coarse)
        levels.append((coarse, 2 * scale))
    return levels


def levels(gray: NDArray[Any], most_corners: int) -> Iterator[tuple[NDArray[Any], float]]:
    """Levels from coarse to fine, each with its scale: image pixel = scale * (level pixel + 0.5) - 0.5."""
    from stereocal.board.pyramid_kernels import double

    yield from reversed(halved(gray, SMALLEST_LEVEL, 6 * most_corners))
    if max(gray.shape) <= 800:
        fine = np.empty((2 * gray.shape[0], 2 * gray.shape[1]), np.float32)
        double(gray, fine)
        yield fine, 0.5


def logarithm(gray: NDArray[Any]) -> NDArray[np.float32]:
    """log(1 + I/2), scaled to 0..255: a shadow becomes a step that is added, and no longer hides the squares' colours.

    The 2 grey levels keep the noise of what is black from being stretched.
    """
    top = np.float32(255 / np.log1p(255 / 2))
    return np.asarray(top * np.log1p(np.float32(0.5) * np.maximum(gray, 0).astype(np.float32)), np.float32)


def logarithmic_levels(
    gray: NDArray[Any], most_corners: int, worth_it: Callable[[], bool]
) -> Iterator[tuple[NDArray[Any], float]]:
    """The logarithms of the levels, coarse to fine, if `worth_it` says so."""
    if worth_it():
        for level, scale in levels(gray, most_corners):
            if level.size <= LARGEST_AGAIN:
                yield logarithm(level), scale


def closed_levels(
    gray: NDArray[Any], most_corners: int, worth_it: Callable[[], bool]
) -> Iterator[tuple[NDArray[Any], float]]:
    """Levels whose dark, then whose light parts have grown by one and by two pixels, coarse to fine.

    The image itself, which costs more than all the others together, comes only if `worth_it` says so then.
    """
    from stereocal.board.pyramid_kernels import spread_darkest

    for level, scale in reversed(halved(gray, SMALLEST_LEVEL // 2, 6 * most_corners)):
        if level.size > LARGEST_AGAIN or (scale == 1 and not worth_it()):
            break
        for tone in (1, -1):
            grown = level
            for _ in range(2):
                former, grown = grown, np.empty(level.shape, np.float32)
                spread_darkest(former, tone, grown)
                yield grown, scale
