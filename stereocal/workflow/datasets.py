"""``fetch``: a public data set on this disk, every file checked against its SHA-256."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stereocal.store.datasets import Dataset, fetch_dataset, load_dataset
from stereocal.workflow.progress import Progress, Silent


@dataclass(frozen=True)
class FetchRun:
    """What ``fetch`` did.

    Attributes
    ----------
    dataset : Dataset
        What is there now.
    downloaded : bool
        Whether it had to be downloaded; otherwise ``STEREOCAL_DATA`` holds it.
    """

    dataset: Dataset
    downloaded: bool

    def as_dict(self) -> dict[str, Any]:
        """Return what ``fetch --json`` prints."""
        data = self.dataset
        return {
            "name": data.name,
            "title": data.title,
            "terms": data.terms,
            "folder": str(data.folder),
            "left": [str(path) for path in data.left],
            "right": [str(path) for path in data.right],
            "inner_corners": None if data.inner_corners is None else list(data.inner_corners),
            "square_size": data.square_size,
            "unit": data.unit,
            "downloaded": self.downloaded,
        }


def run_fetch(name: str, *, out: str | os.PathLike[str] | None = None, progress: Progress | None = None) -> FetchRun:
    """Download a data set, unless the folder that ``STEREOCAL_DATA`` names holds it.

    Parameters
    ----------
    name : str
        ``uvc_paper``, ``opencv_sample``, …
    out : path, optional
        Folder for the data sets; by default the user's cache.
    progress : Progress, optional
        Who watches.

    Raises
    ------
    InputError
        If there is no data set of this name, or it cannot be fetched.
    DataFileError
        If a file cannot be downloaded or written, or is not what it should be.
    """
    held = os.environ.get("STEREOCAL_DATA")
    if out is None and held and (Path(held) / name).is_dir():
        return FetchRun(load_dataset(name, held), False)
    with (progress or Silent()).stage(f"Fetching {name}") as step:
        dataset = fetch_dataset(name, out, progress=lambda done, total: step())
    return FetchRun(dataset, True)
