"""undistortion_maps and rectify beside OpenCV: pytest benchmarks/bench_rectification_maps.py

The same cases in turns on one thread, with the ratio: stereocal bench undistortion_maps rectify
"""

from __future__ import annotations

import cv2
import pytest

from stereocal.verify.bench import run_case
from stereocal.verify.bench_rectification import cases

CASES = [case for case in cases() if case.kernel in ("undistortion_maps", "rectify")]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.case)
@pytest.mark.parametrize("side", ["ours", "opencv"])
def test_maps(benchmark, case, side) -> None:
    cv2.setNumThreads(1)
    benchmark.group = case.case
    benchmark(getattr(case, side))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.case)
def test_ratio_and_agreement(case, capsys) -> None:
    result = run_case(case)
    with capsys.disabled():
        print(f"\n{case.case}: {result.ratio:.2f} x OpenCV {cv2.__version__}, {result.agreement}")
    if case.kernel == "undistortion_maps" and "fisheye" not in case.case:
        assert result.agreement == "identical"
