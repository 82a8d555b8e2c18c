"""The public photographs that the library is tested on: where they lie, and what is known of them.

A data set is a folder. It is looked for, in this order, in the folder that the caller names, in ``$STEREOCAL_DATA``,
and in the user's cache, where :func:`fetch_dataset` puts it. Nothing is downloaded unless asked for; what is
downloaded comes from the set's own origin, at a fixed commit, and every file is checked against its SHA-256
(``dataset_files.json``) before it is used, so that a result quoted from a data set is about these bytes.

==================  ==========================================================================================  =======
name                what                                                                                        fetched
==================  ==========================================================================================  =======
uvc_paper           the paper's rig: 21 pairs of a folding 8x7 board, and a room                                yes
opencv_sample       OpenCV's left01…14, right01…14: Bouguet's stereo example, 13 pairs                          yes
bumblebee2_chess    BoofCV's Point Grey Bumblebee2, 11 pairs                                                    yes
zhang               Zhang's five views and his points                                                           no
motorcycle          Middlebury 2014, quarter size, true disparity                                               no
teddy               Middlebury 2003, true disparity                                                             no
tsukuba             Middlebury 2001, true disparity                                                             no
==================  ==========================================================================================  =======
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import require_choice
from stereocal.base.errors import DataFileError, InputError
from stereocal.store.disparity_files import read_disparity


@dataclass(frozen=True)
class _Description:
    """What is known of a data set beforehand; patterns are relative to its folder."""

    title: str
    left: str
    right: str = ""
    inner_corners: tuple[int, int] | None = None
    square_size: float | None = None
    unit: str | None = None
    scene: tuple[str, str] | None = None
    disparity: str = ""
    disparity_scale: float = 1.0
    terms: str = ""


DESCRIPTIONS: dict[str, _Description] = {
    "uvc_paper": _Description(
        "The paper's UVC rig (browarsoftware/stereovision)",
        "left/*.jpg",
        "right/*.jpg",
        (7, 6),
        1.0,
        scene=("scene/L000700.jpg", "scene/R000700.jpg"),
        terms="no licence stated: for tests only, not to be passed on",
    ),
    "opencv_sample": _Description(
        "OpenCV's stereo sample, Bouguet's fifth example",
        "left/*.jpg",
        "right/*.jpg",
        (9, 6),
        30.0,
        "mm",
        terms="Apache-2.0",
    ),
    "bumblebee2_chess": _Description(
        "BoofCV's Bumblebee2, (c) Peter Abeles",
        "left/*.jpg",
        "right/*.jpg",
        (6, 4),
        30.0,
        "mm",
        terms="CC BY 4.0",
    ),
    "zhang": _Description("Zhang's five views", "images/*.jpg", unit="in", terms="no licence stated"),
    "motorcycle": _Description(
        "Middlebury 2014 Motorcycle, a quarter of the size",
        "motorcycle_left.png",
        "motorcycle_right.png",
        disparity="motorcycle_disp.npz",
        terms="to be cited: Scharstein et al., GCPR 2014",
    ),
    "teddy": _Description(
        "Middlebury 2003 Teddy",
        "im2.png",
        "im6.png",
        disparity="disp2.pgm",
        disparity_scale=4,
        terms="to be cited: Scharstein and Szeliski, CVPR 2003",
    ),
    "tsukuba": _Description(
        "Middlebury 2001 Tsukuba",
        "scene1.row3.col3.ppm",
        "scene1.row3.col4.ppm",
        disparity="truedisp.row3.col3.pgm",
        disparity_scale=16,
        terms="to be cited: Scharstein and Szeliski, IJCV 2002",
    ),
}
"""Every data set by its name."""


@dataclass(frozen=True)
class Dataset:
    """A data set on the disk.

    Attributes
    ----------
    name, title, terms : str
        What it is, and under which terms it may be used.
    folder : Path
        Where it lies.
    left, right : tuple of Path
        The photographs, in pairs; `right` is empty for a single camera.
    inner_corners : (int, int) or None
        Of its chessboard.
    square_size : float or None
        Of its chessboard, in `unit`; 1 where nobody knows.
    unit : str or None
        Of lengths.
    scene : (Path, Path) or None
        A pair of photographs of the rig's surroundings.
    """

    name: str
    title: str
    terms: str
    folder: Path
    left: tuple[Path, ...]
    right: tuple[Path, ...]
    inner_corners: tuple[int, int] | None
    square_size: float | None
    unit: str | None
    scene: tuple[Path, Path] | None

    def true_disparity(self) -> NDArray[np.float32]:
        """Return the true disparity of the left image, (H, W) float32, NaN = unknown.

        Raises
        ------
        InputError
            If the set has none.
        """
        description = DESCRIPTIONS[self.name]
        if not description.disparity:
            raise InputError(f"{self.name} has no true disparity; teddy, tsukuba and motorcycle have")
        path = self.folder / description.disparity
        if path.suffix != ".npz":
            return read_disparity(path, encoding="middlebury", scale=description.disparity_scale)
        try:
            with np.load(path, allow_pickle=False) as archive:
                values = archive["arr_0"].astype(np.float32)
        except (OSError, ValueError, KeyError) as error:
            raise DataFileError(path, "cannot be read; fetch it again") from error
        return np.where(np.isfinite(values), values, np.float32(np.nan))


def load_dataset(name: str, folder: str | os.PathLike[str] | None = None) -> Dataset:
    """Find a data set on the disk.

    Parameters
    ----------
    name : str
        A key of :data:`DESCRIPTIONS`.
    folder : str or os.PathLike, optional
        The folder that holds the data sets; by default ``$STEREOCAL_DATA``, then the user's cache.

    Returns
    -------
    Dataset

    Raises
    ------
    DataFileError
        If it is not there, or files are missing.

    Examples
    --------
    >>> import tempfile
    >>> import stereocal as sc
    >>> with tempfile.TemporaryDirectory() as empty:
    ...     try:
    ...         sc.load_dataset("teddy", empty)
    ...     except sc.DataFileError as error:
    ...         print("not there")
    not there
    """
    require_choice(name, tuple(DESCRIPTIONS), "name")
    places = [Path(folder)] if folder is not None else _places()
    for place in places:
        if (place / name).is_dir():
            return _open(name, place / name)
    where = " or ".join(str(place) for place in places)
    fetch = f"stereocal fetch {name}, or " if name in _file_lists() else ""
    raise DataFileError(places[0] / name, f"is not in {where}; {fetch}set STEREOCAL_DATA to the folder that holds it")


def fetch_dataset(
    name: str,
    folder: str | os.PathLike[str] | None = None,
    *,
    progress: Callable[[int, int], object] | None = None,
    files: dict[str, dict[str, str]] | None = None,
) -> Dataset:
    """Download a data set, checking every file against its SHA-256; files that are there and right are kept.

    Parameters
    ----------
    name : str
        A data set that can be fetched.
    folder : str or os.PathLike, optional
        Where to; by default the user's cache.
    progress : callable, optional
        Called with (files done, files in all).
    files : dict, optional
        Another list of files than the library's own: relative path to {"url", "sha256"}.

    Returns
    -------
    Dataset

    Raises
    ------
    InputError
        If the set cannot be fetched, or pooch is not installed.
    DataFileError
        If a download fails or is not what it should be.
    """
    wanted = files if files is not None else _file_lists().get(name)
    if name not in DESCRIPTIONS or wanted is None:
        raise InputError(f"name must be one of {', '.join(_file_lists())}, not {name!r}")
    try:
        import pooch
    except ImportError as error:
        raise InputError("fetching needs pooch: pip install 'stereocal[fetch]'") from error
    root = (Path(folder) if folder is not None else _cache()) / name
    logger = pooch.get_logger()
    level, quiet = logger.level, 40
    logger.setLevel(quiet)
    try:
        for done, (relative, source) in enumerate(sorted(wanted.items()), start=1):
            target = _inside(root, relative)
            try:
                pooch.retrieve(source["url"], f"sha256:{source['sha256']}", fname=target.name, path=target.parent)
            except Exception as error:  # pooch and its backends raise many kinds; each means: this file did not come
                reason = " ".join(str(error).split())[:160]
                raise DataFileError(target, f"could not be fetched from {source['url']} ({reason})") from error
            if progress is not None:
                progress(done, len(wanted))
    finally:
        logger.setLevel(level)
    return _open(name, root)


def _inside(root: Path, relative: str) -> Path:
    """Return root/relative, or refuse a name that leads out of root."""
    target = (root / relative).resolve()
    if not target.is_relative_to(root.resolve()):
        raise InputError(f"{relative!r} leads out of the data set's folder")
    return target


def _open(name: str, folder: Path) -> Dataset:
    known = DESCRIPTIONS[name]
    left, right = (tuple(sorted(folder.glob(each))) if each else () for each in (known.left, known.right))
    if not left or (known.right and len(left) != len(right)):
        raise DataFileError(folder, f"is incomplete: {len(left)} left and {len(right)} right images; fetch it again")
    scene = None if known.scene is None else (folder / known.scene[0], folder / known.scene[1])
    return Dataset(
        name, known.title, known.terms, folder, left, right, known.inner_corners, known.square_size, known.unit, scene
    )


def _places() -> list[Path]:
    named = os.environ.get("STEREOCAL_DATA")
    return [*([Path(named)] if named else []), _cache()]


def _cache() -> Path:
    root = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA")
    return (Path(root) if root else Path.home() / ".cache") / "stereocal"


def _file_lists() -> dict[str, Any]:
    lists: dict[str, Any] = json.loads(resources.files("stereocal.store").joinpath("dataset_files.json").read_text())
    return lists
