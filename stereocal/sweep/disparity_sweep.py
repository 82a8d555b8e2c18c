"""The paper's section 3: how the size of the window and of the speckle filter change the disparity map [sec-3].

The paper matches one rectified pair with windows of 5 to 255 pixels (step 2), filters each map with speckle sizes of 50
to 200 (step 10), and counts the disparities above 0. Its figure 7 shows the count rising to windows of 27 to 31 and
falling to nothing at 255; its figure 8 the count falling with the speckle size, steeply for small windows.

**What the count does and does not say.** A window of n pixels fits around (W − n + 1)(H − n + 1) pixels only, less
the columns that the search needs; on a *perfect* pair the count falls with n for that reason alone, whatever is in
the image. So each row holds that ceiling, and the fill under it. And a count rewards wrong matches: the largest
windows that still fit answer almost everywhere because they smear one surface over the next. So each row also holds
the share of answers that the right image confirms, and with a true disparity the share that is wrong. None of them
alone ranks windows; together they show what the paper's best window is best at.

**How it runs.** One job is one window size with all speckle sizes (:mod:`stereocal.sweep.blocks`), on any
:class:`concurrent.futures.Executor`. A few more jobs than workers are under way at a time, so that memory stays small
however large the grid; finished rows go to the CSV at once (:mod:`stereocal.sweep.table`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import require_choice, require_integer
from stereocal.base.errors import InputError
from stereocal.reconstruction.sad import as_gray_pair
from stereocal.sweep.blocks import Image, SweepRow, SweepSettings, sweep_block
from stereocal.sweep.table import SweepFile, SweepTable, fingerprint

PAPER_BLOCK_SIZES = tuple(range(5, 256, 2))
"""The paper's windows, 5 to 255 in steps of 2."""

PAPER_SPECKLE_SIZES = tuple(range(50, 201, 10))
"""The paper's speckle sizes, 50 to 200 in steps of 10; areas in pixels."""


def sweep_disparity(
    left: ArrayLike,
    right: ArrayLike,
    *,
    block_sizes: Sequence[int] = PAPER_BLOCK_SIZES,
    speckle_sizes: Sequence[int] = PAPER_SPECKLE_SIZES,
    executor: Executor | None = None,
    method: str = "bm",
    num_disparities: int = 32,
    min_disparity: int = 1,
    speckle_range: int = 1,
    texture_threshold: int = 10,
    uniqueness_ratio: int = 15,
    truth: ArrayLike | None = None,
    csv: str | os.PathLike[str] | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> SweepTable:
    """Count disparities over window and speckle sizes, [sec-3], and what qualifies the count.

    Parameters
    ----------
    left, right : array_like of shape (H, W) or (H, W, 3), uint8
        A rectified pair.
    block_sizes : sequence of int
        Windows, odd, pixels.
    speckle_sizes : sequence of int
        Largest areas that the speckle filter removes, pixels; 0 does not filter.
    executor : concurrent.futures.Executor, optional
        Where the jobs run: threads, processes, a dask cluster. By default a thread a core.
    method : {"bm", "sad"}
        StereoBM's recipe, as in the paper's code, or plain SAD [eq 22].
    num_disparities, min_disparity : int
        The search; the defaults are the paper's code's.
    speckle_range : int
        How much neighbours in an island may differ, sixteenths of a pixel (StereoBM's speckleRange).
    texture_threshold, uniqueness_ratio : int
        Of ``bm``.
    truth : array_like of shape (H, W), optional
        True disparity of the left image, NaN where unknown; adds the share of wrong pixels.
    csv : path, optional
        Where rows go as they finish. A table of the same images and settings that is there is continued.
    progress : callable, optional
        Called with (window sizes done, window sizes in all), first with those that were there already.

    Returns
    -------
    SweepTable
        The same whatever the executor.

    Raises
    ------
    InputError
        If the images are not a pair of uint8 images, or a size is out of range.
    DataFileError
        If `csv` holds a table of other images or settings, or cannot be written.

    Notes
    -----
    Paper: [sec-3]. The counts equal those of ``cv2.StereoBM`` with ``setSpeckleWindowSize``.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> scene = np.random.default_rng(0).integers(0, 256, (40, 120), dtype=np.uint8)
    >>> left, right = scene[:, :-4], scene[:, 4:]  # all of it 4 px away
    >>> table = sc.sweep_disparity(left, right, block_sizes=(5, 9), speckle_sizes=(0, 20), num_disparities=16)
    >>> len(table.rows)
    4
    """
    pair = as_gray_pair(left, right)
    require_choice(method, ("bm", "sad"), "method")
    blocks = _sizes(block_sizes, "block_sizes", least=5 if method == "bm" else 1, most=255, odd=True)
    if blocks[-1] >= min(pair[0].shape):
        width, height = pair[0].shape[::-1]
        raise InputError(
            f"block_sizes go up to {blocks[-1]}, but the images are {width}x{height}; end the sweep sooner"
        )
    speckles = _sizes(speckle_sizes, "speckle_sizes", least=0, most=2**31 - 1, odd=False)
    settings = SweepSettings(method, num_disparities, min_disparity, speckle_range, texture_threshold, uniqueness_ratio)
    known = None if truth is None else _as_truth(truth, pair[0].shape)
    file: SweepFile | None = None
    rows: list[SweepRow] = []
    if csv is not None:
        key = fingerprint((*pair, known), asdict(settings))
        file = SweepFile(Path(csv), asdict(settings) | {"image_size": pair[0].shape[::-1]}, key)
        rows = [row for row in file.finished(speckles) if row.block_size in set(blocks)]
    done = {row.block_size for row in rows}
    jobs = [block for block in blocks if block not in done]
    report = progress or (lambda done, total: None)
    report(len(done), len(blocks))
    for finished in _run(pair, known, jobs, speckles, settings, executor):
        rows += finished
        if file is not None:
            file.append(finished)
        done.add(finished[0].block_size)
        report(len(done), len(blocks))
    table = SweepTable(tuple(rows), pair[0].size)
    if file is not None:
        file.finish(table)
    return table


def _run(
    pair: tuple[Image, Image],
    truth: NDArray[np.float32] | None,
    jobs: Sequence[int],
    speckles: Sequence[int],
    settings: SweepSettings,
    executor: Executor | None,
) -> Iterator[list[SweepRow]]:
    """Yield the rows of each window size as it finishes."""
    if executor is None:
        with ThreadPoolExecutor(os.cpu_count()) as threads:
            yield from _run(pair, truth, jobs, speckles, settings, threads)
        return
    waiting = list(reversed(jobs))
    under_way: set[Future[list[SweepRow]]] = set()
    ahead = 2 * _worker_count(executor)
    try:
        while waiting or under_way:
            while waiting and len(under_way) < ahead:
                under_way.add(executor.submit(sweep_block, *pair, waiting.pop(), speckles, settings, truth))
            finished, under_way = wait(under_way, return_when=FIRST_COMPLETED)
            for future in sorted(finished, key=lambda f: f.result()[0].block_size):
                yield future.result()
    finally:
        for future in under_way:
            future.cancel()


def _worker_count(executor: Executor) -> int:
    """How many workers an executor has; pools of the standard library know, of others a fair number is assumed."""
    return int(getattr(executor, "_max_workers", 0) or 16)


def _sizes(values: Sequence[int], name: str, *, least: int, most: int, odd: bool) -> list[int]:
    """Whole numbers within limits, each once, ascending."""
    sizes = sorted({require_integer(v, name, minimum=least, maximum=most, odd=odd) for v in values})
    if not sizes:
        raise InputError(f"{name} is empty; name at least one size")
    return sizes


def _as_truth(truth: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float32]:
    array = np.asarray(truth, dtype=np.float32)
    if array.shape != shape:
        raise InputError(f"truth must have the images' shape {shape}, but has {array.shape}")
    return array
