"""Timing beside the oracle: the same input, one thread each, in turns.

Two programs that are timed one after the other are compared on two different machines: the clock has changed, another
process has come. So each case runs ours, OpenCV, ours, OpenCV, … and what is reported is the median of each, and the
median and the quartiles of the ratio within a turn. One thread each, and the processor time of that thread rather than
the wall's, so that a machine that is shared does not blur the ratio. All are called once before the clock starts:
compilation and first touch of memory are not the kernel's speed.

A room adds its cases in ``verify/bench_<room>.py``, as a function ``cases() -> list[BenchCase]``; :func:`all_cases`
finds them. A user adds a function by :func:`register`, or by ``extra=`` of :func:`run_benchmarks`: it is called with
the arguments of the public function that it wants to beat, takes its turn as the third, and its result is compared
with ours.
"""

from __future__ import annotations

import importlib
import pkgutil
import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import stereocal.verify
from stereocal.base.errors import InputError
from stereocal.verify.peak_memory import peak_megabytes

Arguments = tuple[tuple[Any, ...], dict[str, Any]]


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
    arguments : callable, optional
        Returns the positional and the keyword arguments that the public function is called with: what a user's own
        function gets. Without it the case has no third column.
    memory : bool
        Whether the memory that a call takes beyond its input is of interest, and measured.
    """

    kernel: str
    case: str
    ours: Callable[[], Any]
    opencv: Callable[[], Any]
    agreement: Callable[[Any, Any], str]
    arguments: Callable[[], Arguments] | None = None
    memory: bool = False


@dataclass(frozen=True)
class BenchResult:
    """What a case measured: milliseconds a call, ratio = ours / OpenCV's (smaller is faster).

    Attributes
    ----------
    kernel, case : str
        Of the case.
    ours_ms, opencv_ms : float
        Medians, milliseconds.
    ratio : float
        The median of ours / OpenCV's within a turn; a drift of the clock leaves it alone.
    agreement : str
        In words.
    ratio_low, ratio_high : float
        Quartiles of the ratio within a turn.
    extra, extra_ms, extra_ratio, extra_agreement : str, float, float, str, or None
        The user's function: its name, milliseconds, ratio to OpenCV's, and agreement with ours.
    ours_mb, opencv_mb : float or None
        Memory taken beyond the input, MB, of cases that ask for it where the system tells.
    """

    kernel: str
    case: str
    ours_ms: float
    opencv_ms: float
    ratio: float
    agreement: str
    ratio_low: float = float("nan")
    ratio_high: float = float("nan")
    extra: str | None = None
    extra_ms: float | None = None
    extra_ratio: float | None = None
    extra_agreement: str | None = None
    ours_mb: float | None = None
    opencv_mb: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """The fields as ``stereocal bench --json`` prints them."""
        return asdict(self)


_REGISTERED: dict[str, Callable[..., Any]] = {}


def register(kernel: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Put a function of your own beside a kernel in every benchmark to come, as a decorator.

    Parameters
    ----------
    kernel : str
        The public function that it is compared with: it is called with the same arguments.

    Returns
    -------
    callable
        The decorator; it returns the function as it is.

    Examples
    --------
    >>> @register("harris_response")
    ... def my_harris(image, *, block_size=3, aperture=3, k=0.04):
    ...     return image
    >>> registered()["harris_response"] is my_harris
    True
    >>> _REGISTERED.clear()
    """

    def remember(function: Callable[..., Any]) -> Callable[..., Any]:
        _REGISTERED[kernel] = function
        return function

    return remember


def registered() -> dict[str, Callable[..., Any]]:
    """Return the functions registered so far, by the kernel that they stand beside."""
    return dict(_REGISTERED)


def run_benchmarks(
    kernels: Iterable[str] = (),
    *,
    extra: Mapping[str, Callable[..., Any]] | None = None,
    left: ArrayLike | None = None,
    right: ArrayLike | None = None,
    seconds: float = 0.7,
) -> list[BenchResult]:
    """Time kernels beside OpenCV's, and beside functions of your own, in turns on one thread.

    Parameters
    ----------
    kernels : iterable of str
        Public names such as ``"match_bm"``; by default all, or those of `extra`.
    extra : mapping of str to callable, optional
        Functions of your own by the kernel that they stand beside; each is called with the arguments of the public
        function. Those put in by :func:`register` are there, too.
    left, right : array_like of shape (H, W) or (H, W, 3), optional
        Photographs to run the kernels of images on, rectified for those that need two; by default synthetic ones.
    seconds : float
        About how long to measure each case.

    Returns
    -------
    list of BenchResult

    Raises
    ------
    InputError
        If a kernel is not known, or OpenCV is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> def my_harris(image, **options):
    ...     Iy, Ix = np.gradient(image.astype(float))
    ...     return (Ix * Iy) ** 2
    >>> image = np.random.default_rng(0).integers(0, 255, (48, 64), dtype=np.uint8)
    >>> results = sc.run_benchmarks(extra={"harris_response": my_harris}, left=image, seconds=0)
    >>> [(result.kernel, result.case, result.extra) for result in results]
    [('harris_response', 'left 64x48, block 3', 'my_harris')]
    """
    functions = _REGISTERED | dict(extra or {})
    wanted = list(kernels) or list(extra or {})
    return [run_case(case, seconds=seconds, extra=functions.get(case.kernel)) for case in chosen(wanted, left, right)]


def chosen(kernels: Iterable[str], left: ArrayLike | None = None, right: ArrayLike | None = None) -> list[BenchCase]:
    """Return the cases of the kernels named, on photographs where there are some.

    Raises
    ------
    InputError
        If a kernel is named that no case is about.
    """
    if left is None and right is None:
        return all_cases(kernels)
    from stereocal.verify.benchmark_photographs import photograph_cases

    return _of_kernels(photograph_cases(left, right), kernels)


def run_case(
    case: BenchCase, *, seconds: float = 0.7, least_rounds: int = 5, extra: Callable[..., Any] | None = None
) -> BenchResult:
    """Time a case: ours and OpenCV in turns, medians of the calling thread's processor time.

    Parameters
    ----------
    case : BenchCase
    seconds : float
        About how long to measure.
    least_rounds : int
        The least number of rounds, however long they take.
    extra : callable, optional
        A user's function that takes its turn, too.

    Returns
    -------
    BenchResult
    """
    import cv2

    calls: dict[str, Callable[[], Any]] = {"ours": case.ours, "opencv": case.opencv}
    if extra is not None:
        if case.arguments is None:
            raise InputError(f"the case {case.kernel}, {case.case} takes no function of another")
        positional, named = case.arguments()
        calls["extra"] = lambda: extra(*positional, **named)
    threads_before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        results = {name: call() for name, call in calls.items()}
        agreement = case.agreement(results["ours"], results["opencv"])
        times: dict[str, list[float]] = {name: [] for name in calls}
        end = time.perf_counter() + seconds
        while len(times["ours"]) < least_rounds or time.perf_counter() < end:
            for name, call in calls.items():
                times[name].append(_milliseconds(call))
        memory = [peak_megabytes(call) if case.memory else None for call in (case.ours, case.opencv)]
    finally:
        cv2.setNumThreads(threads_before)
    medians = {name: statistics.median(values) for name, values in times.items()}
    turns = {name: np.array(values) / np.maximum(times["opencv"], 1e-9) for name, values in times.items()}
    low, ratio, high = np.percentile(turns["ours"], (25, 50, 75))
    added: dict[str, Any] = {}
    if extra is not None:
        added["extra"], added["extra_ms"] = getattr(extra, "__name__", "yours"), medians["extra"]
        added["extra_ratio"] = float(np.median(turns["extra"]))
        added["extra_agreement"] = describe_agreement(results["ours"], results["extra"])
    return BenchResult(
        case.kernel, case.case, medians["ours"], medians["opencv"], float(ratio), agreement,
        float(low), float(high), ours_mb=memory[0], opencv_mb=memory[1], **added,
    )  # fmt: skip


def run_cases(cases: Iterable[BenchCase], *, seconds: float = 0.7) -> Iterator[BenchResult]:
    """Time cases one by one, yielding each result as it is measured."""
    for case in cases:
        yield run_case(case, seconds=seconds)


def describe_agreement(ours: Any, theirs: Any) -> str:
    """Say of any two results how far they agree: arrays (NaN where both have none), numbers, tuples of them."""
    if isinstance(ours, float):
        theirs = getattr(theirs, "rms", theirs)  # calibrations are compared by their RMS
    if isinstance(ours, tuple) and isinstance(theirs, tuple) and len(ours) == len(theirs):
        words = [describe_agreement(a, b) for a, b in zip(ours, theirs, strict=True)]
        return words[0] if len(set(words)) == 1 else "; ".join(words)
    try:
        a, b = np.asarray(ours, dtype=np.float64), np.asarray(theirs, dtype=np.float64)
    except (TypeError, ValueError):
        return f"not compared: {type(ours).__name__} and {type(theirs).__name__}"
    if a.shape != b.shape:
        return f"shapes {a.shape} and {b.shape}"
    both = np.isfinite(a) & np.isfinite(b)
    missing = int(np.count_nonzero(np.isfinite(a) != np.isfinite(b)))
    worst = float(np.abs(a - b)[both].max(initial=0))
    if worst == 0 and missing == 0:
        return "identical"
    text = f"max |Δ| {worst:.2g}"
    return text + f"; {100 * missing / a.size:.2g} % answered by one only" if missing else text


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
    return _of_kernels(cases, kernels)


def _of_kernels(cases: list[BenchCase], kernels: Iterable[str]) -> list[BenchCase]:
    wanted = set(kernels)
    known = sorted({case.kernel for case in cases})
    unknown = sorted(wanted - set(known))
    if unknown:
        raise InputError(f"no benchmark of {', '.join(unknown)}: there are {', '.join(known)}")
    return [case for case in cases if not wanted or case.kernel in wanted]


def markdown_table(results: Iterable[BenchResult]) -> str:
    """Return results as a Markdown table, one row a case; columns that no result fills are left out."""
    rows = list(results)
    columns = [("kernel", "kernel"), ("case", "case"), ("ours ms", "ours_ms"), ("OpenCV ms", "opencv_ms")]
    columns += [("ratio", "ratio"), ("quartiles", "spread")]
    if any(row.extra for row in rows):
        columns += [("yours", "extra"), ("ms", "extra_ms"), ("ratio", "extra_ratio")]
        columns += [("agreement with ours", "extra_agreement")]
    if any(row.ours_mb is not None for row in rows):
        columns += [("ours MB", "ours_mb"), ("OpenCV MB", "opencv_mb")]
    columns += [("agreement", "agreement")]
    lines = [f"| {' | '.join(title for title, _ in columns)} |", "|" + "---|" * len(columns)]
    lines += [f"| {' | '.join(_cell(row, name) for _, name in columns)} |" for row in rows]
    return "\n".join(lines)


def markdown_summary(columns: Mapping[str, Iterable[BenchResult | None]]) -> str:
    """Return one row a kernel and opponent: how many cases, the middle, the least and the largest ratio to each OpenCV.

    Parameters
    ----------
    columns : mapping of str to results
        The results by the version of OpenCV that they are beside, this environment first.
    """
    by_version = {version: [row for row in rows if row is not None] for version, rows in columns.items()}
    kernels = list(dict.fromkeys(_opponents(row) for rows in by_version.values() for row in rows))
    titles = ["kernel", "cases", *(f"time to OpenCV {version}'s: median (least–most)" for version in by_version)]
    lines = [f"| {' | '.join(titles)} |", "|" + "---|" * len(titles)]
    for kernel in kernels:
        cells = []
        for rows in by_version.values():
            ratios = [row.ratio for row in rows if _opponents(row) == kernel]
            spread = f" ({_short(min(ratios))}–{_short(max(ratios))})" if len(ratios) > 1 else ""
            cells.append(f"{_short(statistics.median(ratios))}{spread}" if ratios else "–")
        count = max(sum(_opponents(row) == kernel for row in rows) for rows in by_version.values())
        lines.append(f"| {kernel} | {count} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _opponents(row: BenchResult) -> str:
    """The kernel, and whom it stands against where OpenCV has more than one function for the job."""
    _, against, other = row.case.partition(", against ")
    return f"{row.kernel}, against {other}" if against else row.kernel


def _short(ratio: float) -> str:
    return f"{ratio:.2f}" if ratio >= 0.095 else f"{ratio:.2g}"


def _cell(row: BenchResult, name: str) -> str:
    """One entry as Markdown; a bar must not end the cell."""
    if name == "spread":
        return f"{row.ratio_low:.3f}–{row.ratio_high:.3f}"
    value = getattr(row, name)
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.3f}" if name.endswith("ratio") else f"{value:.3g}"
    return str(value).replace("|", "\\|")


def _milliseconds(call: Callable[[], Any]) -> float:
    start = time.thread_time_ns()
    call()
    return (time.thread_time_ns() - start) / 1e6
