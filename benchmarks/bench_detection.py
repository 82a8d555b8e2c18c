"""pytest-benchmark of detect_chessboard, each case beside OpenCV on the same input: `pytest
benchmarks/bench_detection.py`."""

from __future__ import annotations

import cv2
import pytest

from stereocal.verify.bench_board import cases

CASES = [case for case in cases() if case.kernel == "detect_chessboard"]


@pytest.mark.parametrize("side", ["ours", "opencv"])
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.case)
def test_detect_chessboard(benchmark, case, side):
    cv2.setNumThreads(1)
    benchmark.group = case.case
    benchmark.extra_info["agreement"] = case.agreement(case.ours(), case.opencv())
    benchmark.pedantic(getattr(case, side), rounds=5, warmup_rounds=1)
