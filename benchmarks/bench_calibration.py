"""calibrate_camera and calibrate_stereo against OpenCV on the same corners.

    pytest benchmarks/bench_calibration.py --benchmark-only

`extra_info` holds the ratio (ours / OpenCV, processor time of one thread, in turns) and the two RMS.
"""

from __future__ import annotations

import pytest

from stereocal.verify.bench import BenchCase, run_case
from stereocal.verify.bench_camera import mono_case, stereo_case

CASES = [mono_case(20), mono_case(100), mono_case(1000), stereo_case(20), stereo_case(100)]


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.kernel} {case.case}")
def test_calibration(benchmark, case: BenchCase) -> None:
    result = run_case(case)
    benchmark.extra_info.update(ratio=result.ratio, opencv_ms=result.opencv_ms, agreement=result.agreement)
    benchmark(case.ours)
