"""pytest-benchmark of filter_speckles beside OpenCV on the same input: ``pytest benchmarks/bench_speckles.py``.

Each case states the ratio (ours / OpenCV, one thread each, in turns) and the agreement in its ``extra_info``.
"""

from __future__ import annotations

import pytest

from stereocal.verify.bench import BenchCase, run_case
from stereocal.verify.bench_reconstruction import cases

CASES = [case for case in cases() if case.kernel == "filter_speckles"]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.case)
def test_filter_speckles(benchmark, case: BenchCase) -> None:
    result = run_case(case)
    benchmark.extra_info.update(result.as_dict())
    benchmark(case.ours)
    assert result.agreement == "identical"
