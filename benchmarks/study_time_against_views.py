"""Time against the number of views: ours is a straight line, a solver of the full equations is not.

One camera and joint stereo on synthetic views of a 9x6 board with 0.1 px of noise, 10 to 2,000 of them, from points to
result: ours with covariance, OpenCV's (the version installed) without. Stereo includes both cameras by themselves, in
both libraries. One thread each, processor time, in turns, the least of the repetitions. OpenCV is left out from the
first number of views on that would take it longer than `--patience` seconds, judged by its last two times.

    python benchmarks/study_time_against_views.py [--figure time_against_views.png]

The slope of log time against log views is 1 for work that is linear, 3 for a full system of six unknowns a view. It is
fitted to the upper half of the views, where fixed costs no longer count.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable

import cv2
import numpy as np

from stereocal.verify.bench import BenchCase
from stereocal.verify.bench_camera import mono_case, stereo_case

VIEWS = (10, 20, 50, 100, 200, 400, 1000, 2000)


def seconds(call: Callable[[], object]) -> float:
    """Return the processor time of one call, of this thread."""
    start = time.thread_time()
    call()
    return time.thread_time() - start


def measure(case: BenchCase, with_opencv: bool, budget: float) -> tuple[float, float]:
    """Return the least time of ours and of OpenCV's (NaN without), in turns, within about `budget` seconds."""
    case.ours()  # compiled and in memory
    ours, theirs = [seconds(case.ours)], [seconds(case.opencv) if with_opencv else math.nan]
    rounds = int(min(200, budget / (ours[0] + np.nan_to_num(theirs[0]))))
    for _ in range(rounds):
        ours.append(seconds(case.ours))
        if with_opencv:
            theirs.append(seconds(case.opencv))
    return min(ours), min(theirs)


def foreseen(views: list[int], times: list[float], count: int) -> float:
    """Return OpenCV's time for `count` views, going on from the last two as a power of the number of views."""
    if len(times) < 2:
        return 0.0
    slope = math.log(times[-1] / times[-2]) / math.log(views[-1] / views[-2])
    return times[-1] * (count / views[-1]) ** slope


def slope_of(views: list[int], times: list[float]) -> float:
    """Return the slope of log time against log views over the upper half."""
    n, t = (np.log(np.array(a)[np.isfinite(times)]) for a in (views, times))
    half = len(n) // 2
    return float(np.polyfit(n[half:], t[half:], 1)[0]) if len(n) - half > 1 else math.nan


def run(make: Callable[[int], BenchCase], patience: float, budget: float) -> tuple[list[float], list[float]]:
    """Print a table and return both lists of times."""
    ours: list[float] = []
    theirs: list[float] = []
    print(f"{'views':>6s} {'ours ms':>10s} {'us a view':>10s} {'OpenCV ms':>11s} {'ratio':>8s}")
    for count in VIEWS:
        known = [t for t in theirs if math.isfinite(t)]
        with_opencv = len(known) == len(theirs) and foreseen(list(VIEWS[: len(known)]), known, count) < patience
        a, b = measure(make(count), with_opencv, budget)
        ours.append(a)
        theirs.append(b)
        print(f"{count:6d} {1e3 * a:10.2f} {1e6 * a / count:10.1f} {1e3 * b:11.1f} {a / b:8.4f}", flush=True)
    print(f"slope of log time: ours {slope_of(list(VIEWS), ours):.2f}, OpenCV {slope_of(list(VIEWS), theirs):.2f}\n")
    return ours, theirs


def draw(results: dict[str, tuple[list[float], list[float]]], path: str) -> None:
    """Draw both curves on logarithmic axes."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), sharey=True, layout="constrained")
    for axis, (name, (ours, theirs)) in zip(axes, results.items(), strict=True):
        axis.loglog(VIEWS, theirs, "o-", color="tab:red", label=f"OpenCV {cv2.__version__}")
        axis.loglog(VIEWS, ours, "o-", color="tab:blue", label="stereocal, with covariance")
        line = ours[-1] * np.array(VIEWS) / VIEWS[-1]
        axis.loglog(VIEWS, line, "--", color="0.6", label="proportional to views")
        axis.set(title=name, xlabel="views", xticks=VIEWS, xticklabels=[str(v) for v in VIEWS])
        axis.minorticks_off()
        axis.grid(True, alpha=0.3)
    axes[0].set_ylabel("seconds, one thread")
    axes[0].legend()
    figure.savefig(path, dpi=130)


def main() -> None:
    """Run the study."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--patience", type=float, default=60.0, help="seconds that one call of OpenCV may take")
    parser.add_argument("--budget", type=float, default=3.0, help="seconds of repetitions for each number of views")
    parser.add_argument("--figure", help="where to draw the curves")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    print(f"OpenCV {cv2.__version__}")
    results = {}
    for name, make in (("one camera", mono_case), ("joint stereo", stereo_case)):
        print(name)
        results[name] = run(make, arguments.patience, arguments.budget)
    if arguments.figure:
        draw(results, arguments.figure)


if __name__ == "__main__":
    main()
