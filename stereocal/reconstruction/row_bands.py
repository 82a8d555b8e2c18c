"""Threads over bands of rows: each thread takes some rows of the image, and none waits for another.

The kernels let go of Python's lock (``nogil=True``), so that threads of Python run them side by side. The calling
thread takes the first band, and a pool the others. The pool is kept: a new thread has to ask the system for every page
of its scratch, which costs more than the match of a small image. (Numba's own thread layers cost less when the machine
is idle, and stall for milliseconds when another process holds a core.)

A band's rows are computed from the images alone, never from another band, so the result does not depend on how many
bands there are.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import pairwise

from stereocal.base.checks import require_integer


def thread_count(threads: int | None) -> int:
    """Return how many threads to use: those asked for, or one a core (``NUMBA_NUM_THREADS``, if set, instead)."""
    if threads is not None:
        return require_integer(threads, "threads", minimum=1)
    from numba import config

    return int(config.NUMBA_NUM_THREADS)


def run_bands(work: Callable[[range], object], rows: range, threads: int | None, *, least_rows: int = 1) -> None:
    """Call `work` on bands of consecutive rows that together make up `rows`, each on its own thread.

    Parameters
    ----------
    work : callable
        Takes the band, a range of rows; lets go of the lock while it computes.
    rows : range
        All rows.
    threads : int, optional
        How many bands at most; None is one a core.
    least_rows : int
        Bands are not cut smaller than this: a band has fixed costs, such as the rows of its first window.
    """
    bands = max(1, min(thread_count(threads), len(rows) // max(least_rows, 1)))
    if bands == 1:
        work(rows)
        return
    cuts = [rows.start + len(rows) * i // bands for i in range(bands + 1)]
    first, *others = (range(a, b) for a, b in pairwise(cuts))
    pool = kept_pool(bands - 1)
    running = [pool.submit(work, band) for band in others]
    try:
        work(first)
    finally:
        for band in running:
            band.exception()  # none may still write when this returns
    for band in running:
        band.result()


def kept_pool(workers: int) -> ThreadPoolExecutor:
    """Return a pool of threads that is kept from call to call."""
    return _pool(workers, os.getpid())


@lru_cache(maxsize=2)
def _pool(workers: int, process: int) -> ThreadPoolExecutor:
    """The pool of this process: a forked one has its parent's memory, but not its threads."""
    return ThreadPoolExecutor(workers, thread_name_prefix="stereocal-rows")
