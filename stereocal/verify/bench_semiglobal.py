"""Benchmarks of semi-global matching beside cv2.StereoSGBM, at equal paths and with the same checks.

OpenCV has the settings of the project's reference: block 5, P1 = 8 · 25, P2 = 32 · 25, uniqueness 10, speckles 100/2;
its left-right check and its median of 3x3 are always on. Ours has its defaults, the same among them. The two minimise
different costs, so that "agreement" says where they answer alike, not who is right: that is
``benchmarks/study_middlebury.py``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.reconstruction.semiglobal import match_sgm
from stereocal.verify.bench import Arguments, BenchCase
from stereocal.verify.bench_reconstruction import textured_pair


def cases() -> list[BenchCase]:
    """Return the cases of semi-global matching."""
    sizes = ((384, 288), 16), ((640, 480), 64), ((640, 480), 128), ((1280, 960), 128)
    found = [_semiglobal(size, d, 8) for size, d in sizes]
    return [*found, _semiglobal((640, 480), 64, 5), _semiglobal((1280, 960), 128, 5)]


def _semiglobal(size: tuple[int, int], disparities: int, paths: int) -> BenchCase:
    import cv2

    mode = cv2.STEREO_SGBM_MODE_HH if paths == 8 else cv2.STEREO_SGBM_MODE_SGBM
    matcher = cv2.StereoSGBM.create(0, disparities, 5, 8 * 25, 32 * 25, 0, 0, 10, 100, 2, mode)

    def ours() -> NDArray[Any]:
        return match_sgm(*textured_pair(size, disparities), num_disparities=disparities, paths=paths, threads=1)

    def opencv() -> NDArray[Any]:
        return np.asarray(matcher.compute(*textured_pair(size, disparities)))

    def agreement(a: NDArray[Any], b: NDArray[Any]) -> str:
        theirs = np.where(b < 0, np.nan, b / 16)
        both = np.isfinite(a) & np.isfinite(theirs)
        close = np.mean(np.abs(a - theirs)[both] <= 1)
        density = np.isfinite(a).mean(), np.isfinite(theirs).mean()
        return f"{close:.1%} within 1 px where both answer; density {density[0]:.1%} and {density[1]:.1%}"

    def arguments() -> Arguments:
        return textured_pair(size, disparities), {"num_disparities": disparities, "paths": paths}

    name = f"{size[0]}x{size[1]}, D {disparities}, {paths} paths"
    return BenchCase("match_sgm", name, ours, opencv, agreement, arguments, memory=True)
