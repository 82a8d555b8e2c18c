"""How much memory a call takes beyond what was there before, whoever asks for it: NumPy, compiled kernels, OpenCV.

Python's own counter (tracemalloc) sees NumPy's arrays only. Linux counts the pages of the whole process and remembers
the most there ever were (``VmHWM`` in ``/proc/self/status``); writing 5 to ``/proc/self/clear_refs`` makes it forget.
So

    peak = VmHWM after the call − VmRSS before it,

with what the allocator keeps for later given back first (``malloc_trim``), for memory used again would not be seen.
What the allocator gives back varies: repeated, the figure moves by up to 5 MB, so that only large ones mean something.
Elsewhere there is no such counter, and None is said.
"""

from __future__ import annotations

import ctypes
import gc
from collections.abc import Callable
from pathlib import Path
from typing import Any

_STATUS, _FORGET = Path("/proc/self/status"), Path("/proc/self/clear_refs")


def peak_megabytes(call: Callable[[], Any]) -> float | None:
    """Call once and return the largest memory that it held on top of what was there, in MB; None if not to be had."""
    gc.collect()
    try:
        ctypes.CDLL(None).malloc_trim(0)
        _FORGET.write_text("5")
        before = _kilobytes("VmRSS")
    except (OSError, AttributeError, KeyError):
        return None
    result = call()
    peak = _kilobytes("VmHWM")
    del result
    return max(0, peak - before) * 1024 / 1e6


def _kilobytes(name: str) -> int:
    entries = dict(line.split(":", 1) for line in _STATUS.read_text().splitlines())
    return int(entries[name].split()[0])
