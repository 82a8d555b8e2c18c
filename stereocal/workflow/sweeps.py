"""``sweep``: the paper's section 3 on one pair of photographs.

The pair is rectified once; then every window size is matched once and filtered with every speckle size. Rows go to
``sweep.csv`` as they finish, so this folder is not written whole or not at all: a sweep that is cut off goes on where
it stopped when the same command is given again. The figures are written at the end, each whole.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stereocal.base.atomic_files import write_whole
from stereocal.base.errors import DataFileError
from stereocal.pair.search_direction import turn_for_matching
from stereocal.report.figures_curves import draw_sweep_speckles, draw_sweep_windows
from stereocal.report.style import to_png
from stereocal.sweep.disparity_sweep import PAPER_BLOCK_SIZES, PAPER_SPECKLE_SIZES, sweep_disparity
from stereocal.sweep.executors import open_executor
from stereocal.sweep.table import SweepTable
from stereocal.workflow.matching import to_eight_bits
from stereocal.workflow.photographs import Pair, Photograph
from stereocal.workflow.progress import Progress, Silent
from stereocal.workflow.quantities import parse_range
from stereocal.workflow.rectified_pairs import load_rig, rectify_for_viewing, require_size_of_rig

MAX_CURVES = 6
"""More curves than this in one figure cannot be told apart."""


@dataclass(frozen=True)
class SweepRun:
    """What ``sweep`` did.

    Attributes
    ----------
    table : SweepTable
        One row a cell.
    resumed : int
        How many window sizes were there already.
    folder : Path
        Where the files stand.
    files : tuple of Path
        Those written.
    seconds : float
        Wall time.
    """

    table: SweepTable
    resumed: int
    folder: Path
    files: tuple[Path, ...]
    seconds: float

    def as_dict(self) -> dict[str, Any]:
        """Return what ``sweep --json`` prints."""
        return {
            "cells": len(self.table),
            "block_sizes": list(self.table.block_sizes),
            "speckle_sizes": list(self.table.speckle_sizes),
            "best_block": self.table.best_block(),
            "resumed": self.resumed,
            "files": [str(path) for path in self.files],
            "seconds": self.seconds,
        }


def run_sweep(
    calibration: str | os.PathLike[str],
    left: str | os.PathLike[str],
    right: str | os.PathLike[str],
    *,
    blocks: str | tuple[int, ...] = PAPER_BLOCK_SIZES,
    speckles: str | tuple[int, ...] = PAPER_SPECKLE_SIZES,
    executor: str = "local",
    out: str | os.PathLike[str] = "out/sweep",
    progress: Progress | None = None,
) -> SweepRun:
    """Count disparities over window and speckle sizes, and redraw the paper's figures 7 and 8 [sec-3].

    Parameters
    ----------
    calibration : path
        Of the rig.
    left, right : path
        The photographs, as the cameras took them.
    blocks, speckles : str or tuple of int
        ``"5:255:2"``, both ends included.
    executor : str
        ``local``, ``local:N``, ``processes:N`` or ``dask:ADDRESS``.
    out : path
        Folder for sweep.csv, figure7.png and figure8.png.
    progress : Progress, optional
        Who watches.

    Raises
    ------
    DataFileError
        If a file cannot be read or written, or the folder holds a sweep of something else.
    InputError
        If a size makes no sense, or the executor is not there.
    """
    start = time.perf_counter()
    block_sizes = parse_range(blocks, "--blocks") if isinstance(blocks, str) else blocks
    speckle_sizes = parse_range(speckles, "--speckles") if isinstance(speckles, str) else speckles
    rig = load_rig(calibration)
    pair = Pair(Photograph(Path(left)), Photograph(Path(right)))
    images = pair.left.read(), pair.right.read()
    require_size_of_rig(pair, images, rig)
    rectification = rectify_for_viewing(rig)
    rectified = (turn_for_matching(view, rectification) for view in to_eight_bits(*rectification.apply(*images)))
    folder = _make_folder(Path(out))
    resumed = -1
    with open_executor(executor) as workers, (progress or Silent()).stage("Sweeping", len(block_sizes)) as step:
        seen = 0

        def count(done: int, total: int) -> None:
            nonlocal seen, resumed
            resumed = done if resumed < 0 else resumed
            for _ in range(done - seen):
                step()
            seen = done

        table = sweep_disparity(
            *rectified,
            block_sizes=block_sizes,
            speckle_sizes=speckle_sizes,
            executor=workers,
            csv=folder / "sweep.csv",
            progress=count,
        )
    files = (folder / "sweep.csv", *_write_figures(table, folder))
    return SweepRun(table, max(resumed, 0), folder, files, time.perf_counter() - start)


def _make_folder(folder: Path) -> Path:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataFileError(
            folder, f"cannot be written ({error.strerror}); choose another folder with --out"
        ) from error
    return folder


def _write_figures(table: SweepTable, folder: Path) -> list[Path]:
    """Redraw figures 7 and 8 from the table."""
    counts = table.column("count")
    speckles, blocks = table.speckle_sizes, table.block_sizes
    by_speckle = {speckles[i]: counts[:, i] for i in _spread(len(speckles))}
    by_block = {blocks[i]: counts[i] for i in _spread(len(blocks))}
    windows = draw_sweep_windows(
        blocks,
        by_speckle,
        computable=table.column("computable")[:, 0],
        consistency=table.column("consistency")[:, 0],
        pixels=table.pixels or None,
    )
    return [
        write_whole(folder / "figure7.png", to_png(windows)),
        write_whole(folder / "figure8.png", to_png(draw_sweep_speckles(speckles, by_block))),
    ]


def _spread(count: int) -> list[int]:
    """Return at most :data:`MAX_CURVES` indices, evenly spread, both ends among them."""
    few = min(count, MAX_CURVES)
    return sorted({round(i * (count - 1) / max(few - 1, 1)) for i in range(few)})
