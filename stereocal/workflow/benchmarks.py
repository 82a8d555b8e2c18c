"""``bench``: kernels beside OpenCV on this machine."""

from __future__ import annotations

import importlib.util
import os
import platform
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stereocal.base.atomic_files import write_whole
from stereocal.base.errors import InputError
from stereocal.verify.bench import BenchResult, all_cases, markdown_table, run_case
from stereocal.workflow.progress import Progress, Silent


@dataclass(frozen=True)
class BenchRun:
    """What ``bench`` measured.

    Attributes
    ----------
    results : tuple of BenchResult
        One a case.
    machine : str
        Processor, Python and the versions of what was compared.
    files : tuple of Path
        Those written.
    """

    results: tuple[BenchResult, ...]
    machine: str
    files: tuple[Path, ...]

    def as_list(self) -> list[dict[str, Any]]:
        """Return what ``bench --json`` prints: one entry a case."""
        return [result.as_dict() for result in self.results]


def run_bench(
    kernels: Sequence[str] = (), *, markdown: str | os.PathLike[str] | None = None, progress: Progress | None = None
) -> BenchRun:
    """Time kernels and OpenCV's, in turns, on one thread.

    Parameters
    ----------
    kernels : sequence of str
        Public names such as ``match_bm``; by default all.
    markdown : path, optional
        Write the table there.
    progress : Progress, optional
        Who watches.

    Raises
    ------
    InputError
        If a kernel is not known, or OpenCV is not installed.
    """
    if importlib.util.find_spec("cv2") is None:
        raise InputError('bench compares with OpenCV, which is not installed: pip install "stereocal[opencv]"')
    cases = all_cases(kernels)
    results = []
    with (progress or Silent()).stage("Measuring", len(cases)) as step:
        for case in cases:
            results.append(run_case(case))
            step()
    machine = _machine()
    files = () if markdown is None else (write_whole(markdown, f"{markdown_table(results)}\n\n{machine}\n"),)
    return BenchRun(tuple(results), machine, files)


def _machine() -> str:
    import cv2
    import numba
    import numpy as np

    return (
        f"{_processor()}, one thread; Python {platform.python_version()}, NumPy {np.__version__}, "
        f"Numba {numba.__version__}, OpenCV {cv2.__version__}"
    )


def _processor() -> str:
    """Return the processor's name where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
