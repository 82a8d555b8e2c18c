"""Folders, globs and files to photographs; left and right to pairs.

Two photographs are a pair when their names agree once the word for the side is taken out: ``left01.jpg`` and
``right01.jpg``, ``L000700.jpg`` and ``R000700.jpg``, ``cam0_5.png`` and ``cam1_5.png``, ``left/5.png`` and
``right/5.png``. Only when no name agrees at all are they paired by order, and then only if there are as many left as
right: pairing the wrong photographs is the one mistake that no calibration survives.

Many UVC stereo cameras deliver one frame with both images side by side; such a photograph is a pair by itself.
"""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from stereocal.base.errors import DataFileError, InputError
from stereocal.base.gray import to_gray
from stereocal.store.images import IMAGE_SUFFIXES, read_image

Side = Literal["whole", "left half", "right half"]

_SIDE_WORDS = re.compile(
    r"left|right|(?<![a-z])[lr](?![a-z])|(?<=cam)[_-]?[01](?!\d)|(?<=camera)[_-]?[01](?!\d)", re.IGNORECASE
)
"""What is taken out of a name before two are compared: the side's word, a lone l or r, the 0 or 1 of cam0 and cam1."""


@dataclass(frozen=True)
class Photograph:
    """One camera's image: a file, or one half of a side-by-side frame."""

    path: Path
    side: Side = "whole"

    def __str__(self) -> str:
        return str(self.path) if self.side == "whole" else f"{self.path} ({self.side})"

    def read(self) -> NDArray[Any]:
        """Return the image, (H, W) or (H, W, 3).

        Raises
        ------
        DataFileError
            If the file is missing, empty, truncated or no image, or cannot be halved.
        """
        image = read_image(self.path)
        if self.side == "whole":
            return image
        if image.shape[1] % 2:
            raise DataFileError(self.path, f"is {image.shape[1]} pixels wide, so it is no two images side by side")
        middle = image.shape[1] // 2
        return np.ascontiguousarray(image[:, :middle] if self.side == "left half" else image[:, middle:])

    def read_gray(self) -> NDArray[Any]:
        """Return the image in grey, 8 or 16 bits as the file has it."""
        return to_gray(self.read(), str(self.path))


@dataclass(frozen=True)
class Pair:
    """Two photographs of one moment."""

    left: Photograph
    right: Photograph


def list_photographs(where: str | os.PathLike[str] | Sequence[str | os.PathLike[str]]) -> list[Path]:
    """Return the photographs that a folder, a glob, a file, or several of them name, in natural order.

    Raises
    ------
    DataFileError
        If a file is missing, a folder holds no photograph, or a glob names nothing.
    """
    found: list[Path] = []
    for item in [where] if isinstance(where, (str, os.PathLike)) else where:
        found += _list_one(Path(item))
    return list(dict.fromkeys(found))


def _list_one(item: Path) -> list[Path]:
    if item.is_dir():
        inside = [
            path for path in item.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".")
        ]
        if not inside:
            raise DataFileError(item, "holds no photographs (jpg, png, tif, bmp, ppm …); name the folder that does")
        return sorted(inside, key=_natural_order)
    if item.exists():
        return [item]
    if glob.has_magic(str(item)):
        matched = [Path(name) for name in glob.glob(str(item), recursive=True)]
        if not matched:
            raise DataFileError(item, "matches no file; check the pattern")
        return sorted((path for path in matched if path.is_file()), key=_natural_order)
    raise DataFileError(item, "does not exist; check the name")


def pair_photographs(
    left: str | os.PathLike[str] | Sequence[str], right: str | os.PathLike[str] | Sequence[str] | None
) -> tuple[list[Pair], list[Photograph]]:
    """Pair photographs by name or, if no name agrees, by order.

    Parameters
    ----------
    left, right : path, glob, or sequence of them
        `right` is None for side-by-side frames: each file is then a pair.

    Returns
    -------
    pairs : list of Pair
        In the natural order of the left names.
    alone : list of Photograph
        Those without a partner.

    Raises
    ------
    InputError
        If no name agrees and there are not as many left as right, or both sides name the same files.
    """
    left_paths = list_photographs(left)
    if right is None:
        return [Pair(Photograph(path, "left half"), Photograph(path, "right half")) for path in left_paths], []
    right_paths = list_photographs(right)
    if {path.resolve() for path in left_paths} & {path.resolve() for path in right_paths}:
        raise InputError(
            f"left and right name the same photographs ({left_paths[0]}, …); name each camera's own, "
            "or give --side-by-side with one folder if every frame holds both images"
        )
    by_name = _pair_by_name(left_paths, right_paths)
    if by_name is not None:
        return by_name
    if len(left_paths) != len(right_paths):
        raise InputError(
            f"{len(left_paths)} photographs left and {len(right_paths)} right, and no names that agree "
            f"({left_paths[0].name}, {right_paths[0].name}): give pairs the same name, or the same number on both sides"
        )
    return [Pair(Photograph(a), Photograph(b)) for a, b in zip(left_paths, right_paths, strict=True)], []


def _pair_by_name(left: list[Path], right: list[Path]) -> tuple[list[Pair], list[Photograph]] | None:
    """Pair the names that agree, as they are or without the word for the side, whichever pairs more; None if none."""
    best: tuple[list[Pair], list[Photograph]] | None = None
    for key in (lambda path: path.stem, lambda path: _SIDE_WORDS.sub("", path.stem)):
        left_of_key = {key(path): path for path in left}
        right_of_key = {key(path): path for path in right}
        unambiguous = len(left_of_key) == len(left) and len(right_of_key) == len(right)
        common = [name for name in left_of_key if name in right_of_key]
        if unambiguous and len(common) > (len(best[0]) if best else 0):
            pairs = [Pair(Photograph(left_of_key[name]), Photograph(right_of_key[name])) for name in common]
            alone = [path for name, path in left_of_key.items() if name not in right_of_key]
            alone += [path for name, path in right_of_key.items() if name not in left_of_key]
            best = pairs, [Photograph(path) for path in alone]
    return best


def _natural_order(path: Path) -> tuple[object, ...]:
    """Sort img2 before img10."""
    parts = re.split(r"(\d+)", path.name)
    return (str(path.parent), *((int(part), "") if part.isdigit() else (-1, part) for part in parts))
