"""Timing beside the oracle: the same input, one thread each, in turns.

Two programs that are timed one after the other are compared on two different machines: the clock has changed, another
process has come. So each case runs ours, OpenCV, ours, OpenCV, … and what is reported is the median of each. One
thread each, and the processor time of that thread rather than the wall's, so that a machine that is shared does not
blur the ratio. Both are called once before the clock starts: compilation and first touch of memory are not the
kernel's speed.

A room adds its cases in ``verify/bench_<room>.py``, as a function ``cases() -> list[BenchCase]``; :func:`all_cases`
finds them.
"""

from __future__ import annotations

import importlib
import pkgutil
import statistics
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import stereocal.verify
from stereocal.base.errors import InputError


@dataclass(frozen=True)
class BenchCase:
    """One comparison on one input.

    Attributes
    ----------
    kernel : str
        The public name that is timed, ``"match_bm"``.
    case : str
        The input and the options, ``"640x480, D 64, block 21"``.
    ours : callable
        Runs ours, on ONE thread, and returns its result.
    opencv : callable
        Runs OpenCV's on the same input.
    agreement : callable
        Says of the two results how far they agree, in a few words: ``"identical"``, ``"max |Δ| 3e-7"``.
    """

    kernel: str
    case: str
    ours: Callable[[], Any]
    opencv: Callable[[], Any]
    agreement: Callable[[Any, Any], str]


@dataclass(frozen=True)
class BenchResult:
    """What a case measured: milliseconds a call, ratio = ours / OpenCV (smaller is faster)."""

    kernel: str
    case: str
    ours_ms: float
    opencv_ms: float
    ratio: float
    agreement: str

    def as_dict(self) -> dict[str, Any]:
        """The fields as ``stereocal bench --json`` prints them."""
        return asdict(self)


def run_case(case: BenchCase, *, seconds: float = 0.7, least_rounds: int = 5) -> BenchResult:
    """Time a case: ours and OpenCV in turns, medians of the calling thread's processor time.

    Parameters
    ----------
    case : BenchCase
    seconds : float
        About how long to measure.
    least_rounds : int
        The least number of rounds, however long they take.

    Returns
    -------
    BenchResult
    """
    import cv2

    threads_before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        agreement = case.agreement(case.ours(), case.opencv())
        ours: list[float] = []
        opencv: list[float] = []
        end = time.perf_counter() + seconds
        while len(ours) < least_rounds or time.perf_counter() < end:
            ours.append(_milliseconds(case.ours))
            opencv.append(_milliseconds(case.opencv))
    finally:
        cv2.setNumThreads(threads_before)
    ours_ms, opencv_ms = statistics.median(ours), statistics.median(opencv)
    return BenchResult(case.kernel, case.case, ours_ms, opencv_ms, ours_ms / opencv_ms, agreement)


def run_cases(cases: Iterable[BenchCase], *, seconds: float = 0.7) -> Iterator[BenchResult]:
    """Time cases one by one, yielding each result as it is measured."""
    for case in cases:
        yield run_case(case, seconds=seconds)


def all_cases(kernels: Iterable[str] = ()) -> list[BenchCase]:
    """Return the cases of every ``verify/bench_<room>.py``, or those of the kernels named.

    Raises
    ------
    InputError
        If a kernel is named that no case is about.
    """
    cases: list[BenchCase] = []
    for module in sorted(module.name for module in pkgutil.iter_modules(stereocal.verify.__path__)):
        if module.startswith("bench_"):
            cases += importlib.import_module(f"stereocal.verify.{module}").cases()
    wanted = set(kernels)
    known = sorted({case.kernel for case in cases})
    unknown = sorted(wanted - set(known))
    if unknown:
        raise InputError(f"no benchmark of {', '.join(unknown)}: there are {', '.join(known)}")
    return [case for case in cases if not wanted or case.kernel in wanted]


def markdown_table(results: Iterable[BenchResult]) -> str:
    """Return results as a Markdown table, one row a case."""
    lines = ["| kernel | case | ours ms | OpenCV ms | ratio | agreement |", "|---|---|---|---|---|---|"]
    lines += [
        f"| {r.kernel} | {r.case} | {r.ours_ms:.3g} | {r.opencv_ms:.3g} | {r.ratio:.3f} | {_escaped(r.agreement)} |"
        for r in results
    ]
    return "\n".join(lines)


def _escaped(text: str) -> str:
    """Text that does not end a table's cell."""
    return text.replace("|", "\\|")


def _milliseconds(call: Callable[[], Any]) -> float:
    start = time.thread_time_ns()
    call()
    return (time.thread_time_ns() - start) / 1e6
