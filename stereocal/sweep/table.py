"""The table of a sweep, and the CSV file that outlives a kill.

Rows are appended as they come, one window size at a time, and flushed to the disk. A process that is killed in
between leaves a file whose last window size may be incomplete or its last line torn; reading it back keeps the window
sizes that have all their rows and forgets the rest, so that no row is lost that was finished and none is computed
twice. When the sweep ends, the file is written once more, sorted: the order in which workers happened to finish is
gone, and the file is the same whatever ran it.

Beside ``sweep.csv`` stands ``sweep.settings.json``: what was swept, and a fingerprint (SHA-256) of the images. A table
is only continued on the same images with the same settings; a larger grid may continue a smaller one.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.base.atomic_files import write_whole
from stereocal.base.checks import Float
from stereocal.base.errors import DataFileError
from stereocal.sweep.blocks import SweepRow

COLUMNS = ("block_size", "speckle_size", "count", "computable", "fill", "consistency", "bad")
"""The columns of the CSV."""


@dataclass(frozen=True)
class SweepTable:
    """What a sweep found: one row a cell, sorted by window size, then speckle size.

    Attributes
    ----------
    rows : tuple of SweepRow
    pixels : int
        Of an image.
    """

    rows: tuple[SweepRow, ...]
    pixels: int = 0
    block_sizes: tuple[int, ...] = field(init=False)
    speckle_sizes: tuple[int, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "rows", tuple(sorted(self.rows, key=lambda r: (r.block_size, r.speckle_size))))
        object.__setattr__(self, "block_sizes", tuple(sorted({r.block_size for r in self.rows})))
        object.__setattr__(self, "speckle_sizes", tuple(sorted({r.speckle_size for r in self.rows})))

    def __len__(self) -> int:
        return len(self.rows)

    def column(self, name: str) -> Float:
        """A column as a grid of shape (window sizes, speckle sizes); ``count``, ``fill``, ``consistency``, …"""
        values = np.array([getattr(row, name) for row in self.rows], dtype=np.float64)
        return values.reshape(len(self.block_sizes), len(self.speckle_sizes))

    def best_block(self, speckle_size: int | None = None) -> int:
        """The window size with the most disparities above 0, at one speckle size (by default the smallest)."""
        column = 0 if speckle_size is None else self.speckle_sizes.index(speckle_size)
        return self.block_sizes[int(np.argmax(self.column("count")[:, column]))]

    def to_csv(self) -> str:
        """The table as CSV text."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows(_cells(row) for row in self.rows)
        return stream.getvalue()


def _cells(row: SweepRow) -> list[str]:
    def spelt(value: float) -> str:
        if isinstance(value, int):
            return str(value)
        return "" if math.isnan(value) else f"{value:.6f}"

    return [spelt(getattr(row, name)) for name in COLUMNS]


def _parse(cells: Sequence[str]) -> SweepRow:
    integers = [int(c) for c in cells[:4]]
    shares = [float(c) if c else float("nan") for c in cells[5:7]]
    return SweepRow(*integers, *shares)


def fingerprint(arrays: Iterable[NDArray[Any] | None], settings: dict[str, Any]) -> str:
    """SHA-256 over images and settings."""
    digest = hashlib.sha256(json.dumps(settings, sort_keys=True).encode())
    for array in arrays:
        if array is not None:
            digest.update(repr((array.shape, array.dtype.str)).encode())
            digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


class SweepFile:
    """The CSV of a sweep that is under way.

    Parameters
    ----------
    path : path
        The CSV; its settings stand beside it.
    settings : dict
        What is swept, besides the grid.
    key : str
        Fingerprint of images and settings.

    Raises
    ------
    DataFileError
        If a table is there that was made from other images or settings, or it cannot be read or written.
    """

    def __init__(self, path: str | os.PathLike[str], settings: dict[str, Any], key: str) -> None:
        self.path = Path(path)
        self._settings_path = self.path.with_suffix(".settings.json")
        if self.path.exists():
            self._require_same(key)
        else:
            write_whole(self.path, ",".join(COLUMNS) + "\n")
        write_whole(self._settings_path, json.dumps({"fingerprint": key, **settings}, indent=1) + "\n")

    def _require_same(self, key: str) -> None:
        try:
            found = json.loads(self._settings_path.read_text(encoding="utf-8")).get("fingerprint")
        except (OSError, ValueError, AttributeError) as error:
            raise DataFileError(
                self.path, "is there, but what it was made from is not known; delete it or choose another folder"
            ) from error
        if found != key:
            raise DataFileError(
                self.path, "was made from other images or settings; delete it or choose another folder to sweep anew"
            )

    def finished(self, speckle_sizes: Sequence[int]) -> list[SweepRow]:
        """Rows of the window sizes that are complete for `speckle_sizes`; the file is cut back to whole lines.

        Parameters
        ----------
        speckle_sizes : sequence of int

        Returns
        -------
        list of SweepRow
        """
        try:
            lines = self.path.read_text(encoding="utf-8").splitlines(keepends=True)
        except (OSError, UnicodeDecodeError) as error:
            raise DataFileError(self.path, "cannot be read; delete it to sweep anew") from error
        rows: dict[tuple[int, int], SweepRow] = {}
        for line in lines[1:]:
            cells = line.rstrip("\n").split(",")
            if not line.endswith("\n") or len(cells) != len(COLUMNS):
                continue  # torn by a kill
            try:
                row = _parse(cells)
            except ValueError:
                continue
            rows[row.block_size, row.speckle_size] = row
        wanted = set(speckle_sizes)
        blocks = {block for block, _ in rows}
        whole = {b for b in blocks if wanted <= {s for block, s in rows if block == b}}
        kept = [row for (block, _), row in sorted(rows.items()) if block in whole]
        write_whole(self.path, SweepTable(tuple(kept)).to_csv())
        return [row for row in kept if row.speckle_size in wanted]

    def append(self, rows: Sequence[SweepRow]) -> None:
        """Append the rows of one window size, and see them onto the disk."""
        text = "".join(",".join(_cells(row)) + "\n" for row in rows)
        try:
            with self.path.open("a", encoding="utf-8") as stream:
                stream.write(text)
                stream.flush()
                os.fsync(stream.fileno())
        except OSError as error:
            raise DataFileError(self.path, f"cannot be written ({error.strerror or error})") from error

    def finish(self, table: SweepTable) -> None:
        """Write the whole table, sorted."""
        write_whole(self.path, table.to_csv())
