"""pytest-benchmark of match_bm beside OpenCV on the same input: ``pytest benchmarks/bench_block_matching.py``.

Each case states the ratio (ours / OpenCV, one thread each, in turns) and the agreement in its ``extra_info``.
"""

from __future__ import annotations

import pytest

from stereocal.verify.bench import BenchCase, run_case
from stereocal.verify.bench_reconstruction import cases

CASES = [case for case in cases() if case.kernel == "match_bm"]


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.case)
def test_match_bm(benchmark, case: BenchCase) -> None:
    result = run_case(case)
    benchmark.extra_info.update(result.as_dict())
    benchmark(case.ours)
    assert result.agreement == "identical"
