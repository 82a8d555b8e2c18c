"""How alike are two pixels: the cost of matching, for every pixel at every disparity.

A matcher looks for disparities at which the two images look alike. What "alike" means is the matching cost, a number
for each pixel (x, y) of the left image and each candidate d, the pixel (x − d, y) of the right one:

``"census"``
    The number of bits in which the two census codes differ (:mod:`stereocal.reconstruction.census`): how many of 22
    neighbours, every other one of a 9x5 window, have changed sides, darker than the centre or not. Blind to exposure
    and gain, good at edges; and wider than it is high, because rows that are off by a part of a pixel are the fault of
    all rectified pairs.
``"bt"``
    The difference of the grey values after Birchfield and Tomasi (1998), who ask how far I_L(x) is from the values that
    the right image takes within half a pixel of x − d, and the reverse, and take the smaller:

        max(0, I_L(x) − I⁺_R(x − d), I⁻_R(x − d) − I_L(x)),      I⁻, I⁺ = least, greatest of I(x), I(x ± ½).

    Subpixel shifts of a steep edge then cost nothing.
``"sad"``
    The plain difference |I_L(x) − I_R(x − d)|.
``"census+bt"``
    The first and the second up to 5 grey levels, added (after X. Mei et al., 2011, who blend census with absolute
    differences). Where there is no texture the census bits are noise, while equal grey values are still a sign.

Differences of grey values are cut off at a cap, so that a highlight seen by one camera does not outvote the rest.

The single pixels' costs are averaged over a small block, then scaled to 0 … 64, whatever the cost, so that the
penalties of semi-global matching mean the same for all:

    C(x, y, d) = ⌊64 · mean over the block of c(x + i, y + j, d) / c_max⌋     (in 16-bit fixed point: see `scale`).

**At the left border** the candidates of a pixel x are those d that fit, d ≤ x. (OpenCV matches no pixel with
x < num_disparities.) A candidate outside the right image has a cost too, a third of the greatest: dearer than a good
match and cheaper than a bad one. If such a candidate wins, what the pixel shows is most likely outside the right
image, and there is no answer.

Beyond the image, rows and columns of costs are copies of the outermost.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.base.errors import InputError
from stereocal.reconstruction.census import (
    PIXELS_AT_A_TIME,
    census_planes,
    census_transform,
    neighbours,
    with_margin,
)

Gray = NDArray[np.uint8]

COST_MAX = 64
"""The greatest scaled cost."""

TILE_CELLS = 2**14
"""How many cells of a row, pixels times disparities, are computed before the next row: what stays in the cache."""

COSTS = ("census+bt", "census", "bt", "sad")


@dataclass(frozen=True)
class PixelCost:
    """What the cost of one pixel is made of.

    Attributes
    ----------
    census : bool
        Whether the differing bits of the census codes count.
    cap : int
        The largest difference of grey values that counts; 0 leaves them out.
    half_pixel : bool
        Whether the difference is Birchfield and Tomasi's or the plain one.
    window : (int, int)
        The census window, (width, height).
    sparse : bool
        Whether the code leaves out every other neighbour.
    threshold : int
        A neighbour counts as darker if it is so by more than this many grey levels.
    """

    census: bool
    cap: int
    half_pixel: bool
    window: tuple[int, int] = (9, 5)
    sparse: bool = True
    threshold: int = 0

    @cached_property
    def bits(self) -> int:
        """The length of the census code."""
        return len(neighbours(self.window, self.sparse))

    @property
    def greatest(self) -> int:
        """c_max, the greatest cost of a pixel."""
        return self.census * self.bits + self.cap

    @property
    def outside(self) -> int:
        """The cost of a candidate outside the right image."""
        return (self.greatest + 1) // 3

    def scale(self, block_size: int) -> tuple[int, int]:
        """Return (shift, factor) with which (sum · 2^shift · factor) >> 16 takes the block's sum to 0 … 64."""
        greatest = self.greatest * block_size**2
        shift = 0
        while (greatest << shift) < COST_MAX:
            shift += 1
        return shift, min((COST_MAX << 16) // (greatest << shift), 65535)


RECIPES = {
    "census": PixelCost(True, 0, False),
    "bt": PixelCost(False, 40, True),
    "sad": PixelCost(False, 40, False),
    "census+bt": PixelCost(True, 5, True),
}


def require_block_fits(block_size: int, recipe: PixelCost) -> None:
    """Refuse a block whose sum of costs does not fit into 16 bits."""
    largest = int((65534 / recipe.greatest) ** 0.5)
    if block_size > largest:
        raise InputError(f"block_size is {block_size}, but this cost takes at most {largest}: use a smaller block")


def cost_volume(
    left: Gray,
    right: Gray,
    *,
    num_disparities: int,
    min_disparity: int,
    recipe: PixelCost,
    block_size: int,
    scaled: bool = True,
) -> NDArray[np.int64]:
    """Return C(x, y, d), the readable way.

    Parameters
    ----------
    left, right : ndarray of shape (H, W), uint8
        The rectified pair.
    num_disparities, min_disparity : int
        The candidates: `num_disparities` values from `min_disparity` up.
    recipe : PixelCost
        The cost of a pixel.
    block_size : int
        Side of the block, odd.
    scaled : bool
        Whether the costs are scaled to 0 … 64 or left as sums over the block.

    Returns
    -------
    ndarray of shape (H, W, num_disparities), int64
    """
    height, width = left.shape
    codes = [
        census_transform(image, window=recipe.window, sparse=recipe.sparse, threshold=recipe.threshold, backend="numpy")
        for image in (left, right)
    ]
    l_level, r_level = _levels(left, recipe.half_pixel), _levels(right, recipe.half_pixel)
    volume = np.full((height, width, num_disparities), recipe.outside, np.int64)
    for i in range(num_disparities):
        d = min_disparity + i
        here, there = slice(max(d, 0), max(width + min(d, 0), 0)), slice(max(-d, 0), max(width - max(d, 0), 0))
        if abs(d) >= width:
            continue
        cost = recipe.census * np.bitwise_count(codes[0][:, here] ^ codes[1][:, there]).astype(np.int64)
        if recipe.cap:
            (value, low, high), (r_value, r_low, r_high) = l_level[:, :, here], r_level[:, :, there]
            to_right = np.maximum(np.maximum(value - r_high, r_low - value), 0)
            to_left = np.maximum(np.maximum(r_value - high, low - r_value), 0)
            cost += np.minimum(np.minimum(to_right, to_left), recipe.cap)
        volume[:, here, i] = cost
    radius = block_size // 2
    padded = np.pad(volume, ((radius, radius), (radius, radius), (0, 0)), mode="edge")
    sums = np.lib.stride_tricks.sliding_window_view(padded, (block_size, block_size), axis=(0, 1)).sum(axis=(3, 4))
    if not scaled:
        return sums
    shift, factor = recipe.scale(block_size)
    return ((sums << shift) * factor) >> 16


def _levels(image: Gray, half_pixel: bool) -> NDArray[np.int64]:
    """I, I⁻ and I⁺: grey value, and the least and the greatest within half a pixel; all three I if not asked for."""
    value = image.astype(np.int64)
    if not half_pixel:
        return np.stack([value, value, value])
    padded = np.pad(value, ((0, 0), (1, 1)), mode="edge")
    left, right = value + padded[:, :-2], value + padded[:, 2:]
    low = np.minimum(value, np.minimum(left, right) // 2)
    high = np.maximum(value, (np.maximum(left, right) + 1) // 2)
    return np.stack([value, low, high])


@dataclass(frozen=True)
class PreparedPair:
    """A pair laid out for the kernels: see :mod:`stereocal.reconstruction.matching_costs_kernels`."""

    left_codes: Gray
    right_codes: Gray
    left_levels: Gray
    right_levels: Gray
    inside: Gray
    outside: Gray
    start: int
    lanes: int
    shape: tuple[int, int]


def prepare_pair(
    left: Gray, right: Gray, *, num_disparities: int, min_disparity: int, recipe: PixelCost
) -> PreparedPair:
    """Compute the codes and levels that the kernels compare, the right image flipped and with room for all lanes."""
    height, width = left.shape
    lanes = lanes_for(num_disparities)
    before = max(0, -min_disparity)
    flipped = with_margin(right[:, ::-1], 0, before, max(0, min_disparity + lanes))
    right_planes = _planes(flipped, recipe, flipped=True)
    left_planes = _planes(left, recipe)
    inside = np.zeros(max(plane.shape[2] for plane in right_planes), np.uint8)
    inside[before : before + width] = 255
    return PreparedPair(
        left_codes=left_planes[0],
        right_codes=right_planes[0],
        left_levels=left_planes[1],
        right_levels=right_planes[1],
        inside=inside,
        outside=np.where(inside > 0, 0, recipe.outside).astype(np.uint8),
        start=width - 1 + min_disparity + before,
        lanes=lanes,
        shape=(height, width),
    )


def _planes(image: Gray, recipe: PixelCost, *, flipped: bool = False) -> tuple[Gray, Gray]:
    """Return the census codes and the levels; rows are longer than the image, and a part without weight is empty."""
    none = np.zeros((0, *image.shape), np.uint8)
    codes = none
    if recipe.census:
        codes = census_planes(image, neighbours(recipe.window, recipe.sparse), recipe.threshold, flipped=flipped)
    return codes, _levels_u8(image, recipe.half_pixel) if recipe.cap else none


def _levels_u8(image: Gray, half_pixel: bool) -> Gray:
    """Return :func:`_levels` by the kernel, rows padded to a multiple of what it does at a time."""
    from stereocal.reconstruction import matching_costs_kernels as kernels
    from stereocal.reconstruction.vector_primitives import lanes_of

    height, width = image.shape
    padded = with_margin(image, 0, 1, 1 + -width % PIXELS_AT_A_TIME)
    levels = np.empty((3, height, padded.shape[1] - 2), np.uint8)
    if half_pixel:
        kernels.half_pixel_levels(padded, lanes_of(PIXELS_AT_A_TIME), PIXELS_AT_A_TIME, levels)
    else:
        levels[:] = padded[:, 1:-1]
    return levels


def lanes_for(num_disparities: int) -> int:
    """Return how many lanes the kernels use: a multiple of 16, of 64 above 64, so that few kernels are compiled."""
    step = 16 if num_disparities <= 64 else 64
    return -(-num_disparities // step) * step


def cost_rows(
    pair: PreparedPair,
    rows: tuple[int, int],
    out: NDArray[Any],
    *,
    num_disparities: int,
    recipe: PixelCost,
    block_size: int,
) -> None:
    """Write the costs of `rows` into `out` (rows, W, lanes): scaled if it is uint8, sums if it is uint16."""
    from stereocal.reconstruction import matching_costs_kernels as kernels
    from stereocal.reconstruction.vector_primitives import lanes_of

    width = pair.shape[1]
    beyond = np.zeros(pair.lanes, out.dtype)
    beyond[num_disparities:] = np.iinfo(out.dtype).max
    shift, factor = recipe.scale(block_size)
    tile = min(max(TILE_CELLS // pair.lanes, 2 * block_size), width)  # columns at a time
    cells = (tile + block_size - 1) * pair.lanes
    small = out.dtype == np.uint8 and recipe.greatest * block_size**2 < 256
    kernels.cost_rows(
        pair.left_codes, pair.right_codes, pair.left_levels, pair.right_levels, recipe.cap,
        pair.start, pair.inside, pair.outside, beyond, block_size // 2, shift,
        factor if out.dtype == np.uint8 else 0, rows, width, lanes_of(pair.lanes),
        np.empty((block_size, cells), np.uint8), np.empty(cells, np.uint8 if small else np.uint16),
        np.zeros(pair.lanes, np.uint16), out.reshape(-1),
    )  # fmt: skip
