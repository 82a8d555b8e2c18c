"""remap beside cv2.remap: pytest benchmarks/bench_remap.py

The same cases in turns on one thread, with the ratio: stereocal bench remap
"""

from __future__ import annotations

import cv2
import pytest

from stereocal.verify.bench import run_case
from stereocal.verify.bench_rectification import cases

CASES = [case for case in cases() if case.kernel == "remap"]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.case)
@pytest.mark.parametrize("side", ["ours", "opencv"])
def test_remap(benchmark, case, side) -> None:
    cv2.setNumThreads(1)
    benchmark.group = case.case
    benchmark(getattr(case, side))


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.case)
def test_ratio_and_agreement(case, capsys) -> None:
    result = run_case(case)
    with capsys.disabled():
        print(f"\n{case.case}: {result.ratio:.2f} x OpenCV {cv2.__version__}, {result.agreement}")
    if "bilinear" in case.case and cv2.__version__.startswith("5"):
        assert result.agreement == "identical"
