"""Benchmarks of dense matching beside cv2.StereoBM, cv2.filterSpeckles, and absdiff with a box filter."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from stereocal.reconstruction.block_matching import match_bm
from stereocal.reconstruction.sad import match_sad, matched_region
from stereocal.reconstruction.speckles import filter_speckles
from stereocal.verify.bench import Arguments, BenchCase

Pair = tuple[NDArray[np.uint8], NDArray[np.uint8]]

SIZES = (((640, 480), 64), ((1280, 960), 128), ((1920, 1080), 256))
"""Image size and disparities searched, of the project's speed targets."""


def cases() -> list[BenchCase]:
    """Return the cases of this room."""
    found = [_block_matching(size, d, block) for size, d in SIZES for block in (5, 9, 15, 21, 41, 101)]
    found += [_block_matching(size, 64, 21) for size, d in SIZES if d != 64]  # time against size alone,
    found += [_block_matching((640, 480), d, 21) for d in (32, 128, 256)]  # and against disparities alone
    found += [_sad((640, 480), 64, block) for block in (5, 21)]
    found += [_speckles(kind, size) for kind in ("map", "noise", "flat") for size in ((640, 480), (1920, 1080))]
    return found


@cache
def textured_pair(size: tuple[int, int], disparities: int) -> Pair:
    """A pair with texture of several scales, blank patches, noise, and a disparity that varies over the image.

    Parameters
    ----------
    size : (width, height)
    disparities : int
        The disparity runs from a fifth to four fifths of this.
    """
    width, height = size
    rng = np.random.default_rng(width)
    texture = np.zeros((height, width + disparities))
    for sigma in (0.8, 2.0, 6.0, 20.0):
        layer = gaussian_filter(rng.standard_normal(texture.shape), sigma)
        texture += layer / layer.std() * np.sqrt(sigma)
    patches = gaussian_filter(rng.standard_normal(texture.shape), 25)
    blank = patches > 1.3 * patches.std()
    texture[blank] = texture.mean()
    texture = 128 + 25 * texture / texture.std()
    depth = gaussian_filter(rng.standard_normal((height, width)), 0.6 * disparities)
    depth = 0.2 + 0.6 * (depth - depth.min()) / np.ptp(depth)
    shifted = np.arange(width) + disparities * (1 - depth)  # left(x) = texture(x + D − d), right(x) = texture(x + D)
    left = np.stack([np.interp(x, np.arange(texture.shape[1]), row) for x, row in zip(shifted, texture, strict=True)])
    pair = [image + rng.normal(0, 2, image.shape) for image in (left, texture[:, disparities:])]
    first, second = (np.clip(np.round(image), 0, 255).astype(np.uint8) for image in pair)
    return first, second


def differing_pixels(ours: NDArray[Any], theirs: NDArray[Any]) -> str:
    """Say how many pixels of two maps differ."""
    count = int(np.count_nonzero(~((ours == theirs) | (np.isnan(ours) & np.isnan(theirs)))))
    return "identical" if count == 0 else f"{count} of {ours.size} pixels differ"


def _block_matching(size: tuple[int, int], disparities: int, block: int) -> BenchCase:
    import cv2

    matcher = cv2.StereoBM.create(disparities, block)

    def ours() -> NDArray[Any]:
        return match_bm(*textured_pair(size, disparities), num_disparities=disparities, block_size=block, threads=1)

    def opencv() -> NDArray[Any]:
        return np.asarray(matcher.compute(*textured_pair(size, disparities)))

    def agreement(a: NDArray[Any], b: NDArray[Any]) -> str:
        return differing_pixels(a, np.where(b == -16, np.nan, b / 16))

    def arguments() -> Arguments:
        return textured_pair(size, disparities), {"num_disparities": disparities, "block_size": block}

    name = f"{size[0]}x{size[1]}, D {disparities}, block {block}"
    return BenchCase("match_bm", name, ours, opencv, agreement, arguments, memory=True)


def _sad(size: tuple[int, int], disparities: int, block: int) -> BenchCase:
    def ours() -> NDArray[Any]:
        return match_sad(*textured_pair(size, disparities), num_disparities=disparities, block_size=block, threads=1)

    def opencv() -> NDArray[Any]:
        return sad_by_opencv(*textured_pair(size, disparities), disparities, block)

    def arguments() -> Arguments:
        return textured_pair(size, disparities), {"num_disparities": disparities, "block_size": block}

    name = f"{size[0]}x{size[1]}, D {disparities}, block {block}"
    return BenchCase("match_sad", name, ours, opencv, differing_pixels, arguments, memory=True)


def sad_by_opencv(
    left: NDArray[np.uint8], right: NDArray[np.uint8], disparities: int, block: int, first: int = 0
) -> NDArray[np.float32]:
    """The paper's SAD made of cv2.absdiff and cv2.boxFilter, the smallest kept as it goes, d from the largest down."""
    import cv2

    columns, rows = matched_region(left.shape, disparities, first, block // 2)
    least = np.full(left.shape, np.iinfo(np.int32).max, np.int32)
    best = np.full(left.shape, np.nan, np.float32)
    radius = block // 2
    x0, x1 = columns.start - radius, columns.stop + radius
    inner = np.s_[rows.start : rows.stop, columns.start : columns.stop]
    for d in range(first + disparities - 1, first - 1, -1):
        difference = cv2.absdiff(left[:, x0:x1], right[:, x0 - d : x1 - d])
        box = cv2.boxFilter(difference, cv2.CV_32S, (block, block), normalize=False)
        sums = box[rows.start : rows.stop, radius : radius + len(columns)]
        better = sums < least[inner]
        np.copyto(least[inner], sums, where=better)
        np.copyto(best[inner], np.float32(d), where=better)
    return best


def _speckles(kind: str, size: tuple[int, int]) -> BenchCase:
    import cv2

    @cache
    def sixteenths() -> NDArray[np.int16]:
        if kind == "map":
            found = match_bm(*textured_pair(size, 64), num_disparities=64, block_size=9)
            return np.where(np.isnan(found), -16, found * 16).astype(np.int16)
        height, width = size[1], size[0]
        if kind == "noise":
            return np.random.default_rng(0).integers(-16, 1024, (height, width)).astype(np.int16)
        return np.full((height, width), 160, np.int16)

    def ours() -> NDArray[Any]:
        return filter_speckles(sixteenths(), max_size=100, max_difference=32, no_disparity=-16)

    def opencv() -> NDArray[Any]:
        filtered = sixteenths().copy()
        cv2.filterSpeckles(filtered, -16, 100, 32)
        return filtered

    def arguments() -> Arguments:
        return (sixteenths(),), {"max_size": 100, "max_difference": 32, "no_disparity": -16}

    name = f"{kind} {size[0]}x{size[1]}"
    return BenchCase("filter_speckles", name, ours, opencv, differing_pixels, arguments)


def main(run: Callable[[str], object] = print) -> None:
    """Print the table of this room."""
    from stereocal.verify.bench import markdown_table, run_cases

    run(markdown_table(run_cases(cases())))


if __name__ == "__main__":
    main()
