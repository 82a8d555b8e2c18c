"""Semi-global matching beside cv2.StereoSGBM: `pytest benchmarks/bench_semiglobal.py`; one thread, then two.

The ratio to OpenCV and the agreement, measured in turns, are in `extra_info` of each benchmark and printed.
"""

from __future__ import annotations

import time
import tracemalloc

import pytest

from stereocal.reconstruction.semiglobal import match_sgm
from stereocal.verify.bench import markdown_table, run_case
from stereocal.verify.bench_reconstruction import textured_pair
from stereocal.verify.bench_semiglobal import cases


@pytest.mark.parametrize("case", cases(), ids=lambda case: case.case)
def test_beside_opencv(benchmark, case) -> None:
    result = run_case(case, seconds=2)
    print(f"\n{markdown_table([result])}")
    benchmark.extra_info.update(result.as_dict())
    benchmark.pedantic(case.ours, rounds=3, warmup_rounds=1)


@pytest.mark.parametrize(("size", "disparities"), [((640, 480), 64), ((1280, 960), 128)])
def test_two_threads_beside_one(benchmark, size, disparities) -> None:
    """Wall time, least of several in turns: this one needs a machine with two idle cores."""
    pair = textured_pair(size, disparities)
    least = {1: float("inf"), 2: float("inf")}
    for _ in range(9):
        for threads in least:
            start = time.perf_counter()
            match_sgm(*pair, num_disparities=disparities, threads=threads, speckle_size=0)
            least[threads] = min(least[threads], time.perf_counter() - start)
    print(f"\n{size[0]}x{size[1]}, D {disparities}: two threads {least[1] / least[2]:.2f} times as fast as one")
    benchmark.extra_info["speedup"] = least[1] / least[2]
    benchmark.pedantic(match_sgm, pair, {"num_disparities": disparities, "threads": 2}, rounds=3)


@pytest.mark.parametrize(("size", "disparities"), [((640, 480), 64), ((1280, 960), 128), ((1920, 1080), 256)])
def test_memory(benchmark, size, disparities) -> None:
    """Most memory held at once above the images; NumPy tells tracemalloc of its arrays."""
    pair = textured_pair(size, disparities)
    match_sgm(*pair, num_disparities=disparities, threads=1)
    tracemalloc.start()
    match_sgm(*pair, num_disparities=disparities, threads=1)
    peak = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    volume = 3 * size[0] * size[1] * disparities / 1e6
    print(f"\n{size[0]}x{size[1]}, D {disparities}: {peak:.0f} MB; the volumes C and S would be {volume:.0f} MB")
    benchmark.extra_info["peak_mb"] = peak
    benchmark.pedantic(match_sgm, pair, {"num_disparities": disparities, "threads": 1}, rounds=1)
