"""The kernels of images on a user's own photographs, beside OpenCV's.

A photograph has texture, blank walls and noise in its own mixture, and some kernels care: speckles and left-right
checks take the time that there is to do. Of one photograph Harris, undistortion and remap are timed; of two, taken for
a rectified pair, the matchers and the speckle filter, too. The disparities searched are a tenth of the width.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.errors import InputError
from stereocal.base.gray import to_gray
from stereocal.board.harris import harris_response
from stereocal.camera.resampling import remap
from stereocal.camera.undistortion import undistortion_maps
from stereocal.reconstruction.block_matching import match_bm
from stereocal.reconstruction.sad import match_sad
from stereocal.reconstruction.semiglobal import match_sgm
from stereocal.reconstruction.speckles import filter_speckles
from stereocal.verify.bench import BenchCase, describe_agreement
from stereocal.verify.bench_reconstruction import sad_by_opencv

BLOCK = 21
LENS = (-0.3, 0.1, 0.001, 0.002, -0.01)


def photograph_cases(left: ArrayLike | None, right: ArrayLike | None = None) -> list[BenchCase]:
    """Return the cases of one photograph, or of a rectified pair.

    Raises
    ------
    InputError
        If only the right one is given, or the two differ in size.
    """
    if left is None:
        raise InputError("the left photograph is missing: give it, too")
    first = _bytes(left)
    cases = _of_one(first)
    if right is not None:
        second = _bytes(right)
        if first.shape != second.shape:
            sizes = " and ".join(f"{image.shape[1]}x{image.shape[0]}" for image in (first, second))
            raise InputError(f"left and right photograph are {sizes}; a rectified pair is of one size")
        cases += _of_two(first, second)
    return cases


def _bytes(image: ArrayLike) -> NDArray[np.uint8]:
    gray = to_gray(image)
    return np.ascontiguousarray(gray >> 8 if gray.dtype == np.uint16 else gray).astype(np.uint8)


def _of_one(image: NDArray[np.uint8]) -> list[BenchCase]:
    height, width = image.shape
    f, label = 0.8 * width, f"left {width}x{height}"
    K, dist = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]]), np.array(LENS)
    maps = undistortion_maps(K, dist, (width, height))
    return [
        BenchCase(
            "harris_response", f"{label}, block 3",
            lambda: harris_response(image), lambda: cv2.cornerHarris(image, 3, 3, 0.04),
            lambda a, b: f"max |Δ| {np.abs(a - b).max() / max(float(np.abs(b).max()), 1e-30):.1e} of the largest",
            lambda: ((image,), {}),
        ),
        BenchCase(
            "undistortion_maps", f"{label}, brown",
            lambda: undistortion_maps(K, dist, (width, height)),
            lambda: cv2.initUndistortRectifyMap(K, dist, None, K, (width, height), cv2.CV_32FC1),
            lambda a, b: describe_agreement(tuple(a), tuple(b)),
            lambda: ((K, dist, (width, height)), {}),
        ),
        BenchCase(
            "remap", f"{label}, uint8, grey, bilinear",
            lambda: remap(image, *maps), lambda: cv2.remap(image, *maps, cv2.INTER_LINEAR), describe_agreement,
            lambda: ((image, *maps), {}),
        ),
    ]  # fmt: skip


def _of_two(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> list[BenchCase]:
    height, width = left.shape
    D = max(16, 16 * round(width / 160))
    if width < D + BLOCK or height < BLOCK:
        raise InputError(f"photographs of {width}x{height} are too small for {D} disparities and a window of {BLOCK}")
    label = f"pair {width}x{height}, D {D}"
    matcher = cv2.StereoBM.create(D, BLOCK)
    semiglobal = cv2.StereoSGBM.create(0, D, 5, 8 * 25, 32 * 25, 0, 0, 10, 100, 2, cv2.STEREO_SGBM_MODE_HH)
    found = match_bm(left, right, num_disparities=D, block_size=BLOCK)
    sixteenths = np.where(np.isnan(found), -16, found * 16).astype(np.int16)
    options: dict[str, Any] = {"num_disparities": D, "block_size": BLOCK}
    speckles: dict[str, Any] = {"max_size": 100, "max_difference": 32, "no_disparity": -16}

    def filter_by_opencv() -> NDArray[Any]:
        filtered = sixteenths.copy()
        cv2.filterSpeckles(filtered, -16, 100, 32)
        return filtered

    def near(a: NDArray[Any], b: NDArray[Any]) -> str:
        theirs = np.where(b < 0, np.nan, b / 16)
        both = np.isfinite(a) & np.isfinite(theirs)
        return f"{np.mean(np.abs(a - theirs)[both] <= 1) if both.any() else 0:.1%} within 1 px where both answer"

    return [
        BenchCase(
            "match_bm", f"{label}, block {BLOCK}",
            lambda: match_bm(left, right, **options, threads=1), lambda: np.asarray(matcher.compute(left, right)),
            lambda a, b: describe_agreement(a, np.where(b == -16, np.nan, b / 16)),
            lambda: ((left, right), options), True,
        ),
        BenchCase(
            "match_sad", f"{label}, block {BLOCK}",
            lambda: match_sad(left, right, **options, threads=1), lambda: sad_by_opencv(left, right, D, BLOCK),
            describe_agreement, lambda: ((left, right), options), True,
        ),
        BenchCase(
            "match_sgm", f"{label}, 8 paths",
            lambda: match_sgm(left, right, num_disparities=D, paths=8, threads=1),
            lambda: np.asarray(semiglobal.compute(left, right)), near,
            lambda: ((left, right), {"num_disparities": D, "paths": 8}), True,
        ),
        BenchCase(
            "filter_speckles", f"map of the pair, {width}x{height}",
            lambda: filter_speckles(sixteenths, **speckles), filter_by_opencv, describe_agreement,
            lambda: ((sixteenths,), speckles),
        ),
    ]  # fmt: skip
