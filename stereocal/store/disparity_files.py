"""Disparity maps on the disk, and what each format means by a number.

Inside the library a disparity map is (H, W) float32 in pixels, NaN where there is none. Outside:

==============  ===================  ================  ===========================================================
encoding        file                 value             no answer
==============  ===================  ================  ===========================================================
``pfm``         ``.pfm``             d, float32        +inf (Middlebury 2014); NaN is read as none too
``kitti``       16-bit ``.png``      round(256 d)      0, so d = 0 is written as 1/256, as KITTI's own writer does
``middlebury``  8-bit ``.png/.pgm``  round(scale · d)  0; scale 4 (Middlebury 2003), 16 (Tsukuba), 8, 3, …
``opencv``      int16 ``.npy``       round(16 d)       16 (min_disparity − 1)
``npy``         float32 ``.npy``     d                 NaN
==============  ===================  ================  ===========================================================

A PFM file is ``Pf``, ``width height``, a scale whose sign says the byte order (negative: little-endian), and the rows
of float32 from the BOTTOM of the image up. A value that an encoding cannot hold (negative, too large) is refused, never
clipped.

Sources: Menze and Geiger, KITTI devkit 2015; Scharstein and Szeliski, Middlebury stereo SDK; Debevec, PFM;
OpenCV's ``StereoMatcher`` (``DISP_SHIFT`` = 4).
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.atomic_files import write_whole
from stereocal.base.checks import require_choice, require_positive
from stereocal.base.errors import DataFileError, InputError
from stereocal.store.images import MAX_PIXELS, read_image, write_image

Disparity = NDArray[np.float32]

ENCODINGS = ("pfm", "kitti", "middlebury", "opencv", "npy")


def write_disparity(
    path: str | os.PathLike[str],
    disparity: ArrayLike,
    *,
    encoding: str | None = None,
    scale: float = 4.0,
    min_disparity: int = 0,
) -> Path:
    """Write a disparity map.

    Parameters
    ----------
    path : str or os.PathLike
        Where to.
    disparity : array_like of shape (H, W)
        In pixels; NaN or infinite = none.
    encoding : {"pfm", "kitti", "middlebury", "opencv", "npy"}, optional
        What the numbers mean; by default from the ending: .pfm, .png (KITTI) or .npy (float32).
    scale : float
        Of ``middlebury``: grey levels a pixel of disparity.
    min_disparity : int
        Of ``opencv``: what "none" is counted from.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    InputError
        If the encoding cannot hold a value of the map.
    DataFileError
        If the file cannot be written.
    """
    values = _as_disparity(disparity)
    kind = _encoding_of(Path(path), encoding)
    if kind == "pfm":
        return write_pfm(path, np.where(np.isfinite(values), values, np.float32(np.inf)))
    if kind == "kitti":
        return write_image(path, _to_levels(values, 256.0, 65535, "kitti").astype(np.uint16))
    if kind == "middlebury":
        levels = _to_levels(values, require_positive(scale, "scale"), 255, "middlebury")
        return write_image(path, levels.astype(np.uint8))
    if kind == "opencv":
        return _write_npy(path, to_opencv_disparity(values, min_disparity=min_disparity))
    return _write_npy(path, values)


def read_disparity(
    path: str | os.PathLike[str], *, encoding: str | None = None, scale: float = 4.0, min_disparity: int = 0
) -> Disparity:
    """Read a disparity map into pixels, NaN where there is none.

    Parameters
    ----------
    path : str or os.PathLike
        The file.
    encoding : {"pfm", "kitti", "middlebury", "opencv", "npy"}, optional
        What the numbers mean; by default from the file: .pfm; a 16-bit .png is KITTI's, an 8-bit one Middlebury's; an
        int16 .npy is OpenCV's.
    scale : float
        Of ``middlebury``: grey levels a pixel of disparity.
    min_disparity : int
        Of ``opencv``: what "none" is counted from.

    Returns
    -------
    ndarray of shape (H, W), float32

    Raises
    ------
    DataFileError
        If the file is missing, cut short, or not a disparity map.
    """
    source = Path(path)
    if encoding is not None:
        require_choice(encoding, ENCODINGS, "encoding")
    suffix = source.suffix.lower()
    if encoding == "pfm" or (encoding is None and suffix == ".pfm"):
        values = read_pfm(source)
        if values.ndim != 2:
            raise DataFileError(source, "is a colour PFM; a disparity map has one channel")
        return np.where(np.isfinite(values), values, np.float32(np.nan))
    if encoding in ("opencv", "npy") or (encoding is None and suffix == ".npy"):
        return _from_npy(_read_npy(source), source, encoding, min_disparity)
    levels = read_image(source)
    if levels.ndim != 2 or levels.dtype.kind != "u":
        raise DataFileError(source, "is a colour image; a disparity map is grey")
    kind = encoding or ("kitti" if levels.dtype == np.uint16 else "middlebury")
    step = 256.0 if kind == "kitti" else require_positive(scale, "scale")
    return np.where(levels == 0, np.float32(np.nan), (levels / step).astype(np.float32))


def to_opencv_disparity(disparity: ArrayLike, *, min_disparity: int = 0) -> NDArray[np.int16]:
    """Return round(16 d) as int16, (min_disparity − 1)·16 where there is none: what ``StereoBM.compute`` returns.

    Raises
    ------
    InputError
        If a value does not fit (|d| ≥ 2048), or is at most min_disparity − 1, which OpenCV reads as none.
    """
    values = _as_disparity(disparity)
    valid = np.isfinite(values)
    fixed = np.rint(16 * np.where(valid, values, 0).astype(np.float64))
    none = (min_disparity - 1) * 16
    if np.abs(fixed).max(initial=0) > 32767 or (fixed[valid] <= none).any():
        raise InputError(f"disparity must lie above {min_disparity - 1} and below 2048 to fit OpenCV's int16")
    return np.where(valid, fixed, none).astype(np.int16)


def from_opencv_disparity(fixed: ArrayLike, *, min_disparity: int = 0) -> Disparity:
    """Return d = fixed / 16 in float32, NaN where OpenCV has none (at most (min_disparity − 1)·16)."""
    levels = np.asarray(fixed)
    if levels.dtype != np.int16 or levels.ndim != 2:
        raise InputError(f"OpenCV's disparity is (H, W) int16, not {levels.dtype} {levels.shape}")
    return np.where(levels <= (min_disparity - 1) * 16, np.float32(np.nan), (levels / 16).astype(np.float32))


def write_pfm(path: str | os.PathLike[str], values: ArrayLike) -> Path:
    """Write float32 values as PFM, little-endian, bottom row first, as they are.

    Parameters
    ----------
    path : str or os.PathLike
        Where to.
    values : array_like of shape (H, W) or (H, W, 3)
        One channel (``Pf``) or three (``PF``); inf and NaN included.
    """
    array = np.asarray(values, dtype="<f4")
    if array.size == 0 or not (array.ndim == 2 or (array.ndim == 3 and array.shape[2] == 3)):
        raise InputError(f"a PFM file holds (H, W) or (H, W, 3) values, not {array.shape}")
    magic = "Pf" if array.ndim == 2 else "PF"
    header = f"{magic}\n{array.shape[1]} {array.shape[0]}\n-1.0\n"
    return write_whole(path, header.encode() + np.ascontiguousarray(array[::-1]).tobytes())


def read_pfm(path: str | os.PathLike[str]) -> NDArray[np.float32]:
    """Read a PFM file's values as they are, top row first.

    Returns
    -------
    ndarray of shape (H, W) or (H, W, 3), float32

    Raises
    ------
    DataFileError
        If the file is missing, cut short or not PFM.
    """
    source = Path(path)
    content = _read_bytes(source)
    parts = content.split(maxsplit=4) if content[:2] in (b"Pf", b"PF") else []
    try:
        magic, (width, height) = parts[0], (int(parts[1]), int(parts[2]))
        scale = float(parts[3])
        # the pixels begin after ONE white-space character behind the scale; split() would eat pixels that look white
        start = _end_of_words(content, 4) + 1
    except (IndexError, ValueError) as error:
        raise DataFileError(source, "is not a PFM file") from error
    channels = 3 if magic == b"PF" else 1
    if magic not in (b"Pf", b"PF") or width <= 0 or height <= 0 or not np.isfinite(scale) or scale == 0:
        raise DataFileError(source, "is not a PFM file: its header makes no sense")
    if width * height > MAX_PIXELS:
        raise DataFileError(source, f"claims {width}x{height} pixels, more than the {MAX_PIXELS} allowed")
    needed = 4 * width * height * channels
    if len(content) - start < needed:
        raise DataFileError(
            source, f"is cut short: {width}x{height} needs {needed} bytes, {len(content) - start} there"
        )
    order = "<f4" if scale < 0 else ">f4"
    rows = np.frombuffer(content, dtype=order, count=needed // 4, offset=start)
    shape = (height, width) if channels == 1 else (height, width, 3)
    return np.ascontiguousarray(rows.reshape(shape)[::-1]).astype(np.float32)


def _end_of_words(content: bytes, count: int) -> int:
    """Return the index just behind the count-th white-space separated word."""
    index = 0
    for _ in range(count):
        while content[index : index + 1].isspace():
            index += 1
        while index < len(content) and not content[index : index + 1].isspace():
            index += 1
    return index


def _as_disparity(disparity: ArrayLike) -> Disparity:
    values = np.asarray(disparity)
    if values.ndim != 2 or values.size == 0 or values.dtype.kind not in "fiu":
        raise InputError(f"disparity must be (H, W) numbers, but is {values.dtype} {values.shape}")
    return values.astype(np.float32)


def _to_levels(values: Disparity, scale: float, largest: int, encoding: str) -> NDArray[np.float64]:
    """Return round(scale · d), at least 1 where there is a disparity, 0 where there is none."""
    valid = np.isfinite(values)
    levels = np.rint(scale * np.where(valid, values, 0).astype(np.float64))
    if (levels[valid] < 0).any() or (levels[valid] > largest).any():
        raise InputError(f"{encoding} files hold disparities from 0 to {largest / scale:g} only; write PFM instead")
    return np.where(valid, np.maximum(levels, 1), 0)


def _encoding_of(path: Path, encoding: str | None) -> str:
    if encoding is not None:
        return require_choice(encoding, ENCODINGS, "encoding")
    by_suffix = {".pfm": "pfm", ".png": "kitti", ".npy": "npy"}
    if path.suffix.lower() not in by_suffix:
        raise InputError(f"{path}: write disparity as .pfm, .png (KITTI) or .npy, or name the encoding")
    return by_suffix[path.suffix.lower()]


def _read_bytes(source: Path) -> bytes:
    try:
        content = source.read_bytes()
    except OSError as error:
        raise DataFileError(source, f"cannot be read ({error.strerror}); check the name") from error
    if not content:
        raise DataFileError(source, "is empty (0 bytes)")
    return content


def _write_npy(path: str | os.PathLike[str], array: NDArray[Any]) -> Path:
    return write_whole(path, lambda stream: np.save(stream, array, allow_pickle=False))


def _read_npy(source: Path) -> NDArray[Any]:
    try:
        with source.open("rb") as stream:
            return np.asarray(np.lib.format.read_array(stream, allow_pickle=False))
    except OSError as error:
        raise DataFileError(source, f"cannot be read ({error.strerror}); check the name") from error
    except (ValueError, EOFError, SyntaxError, MemoryError, OverflowError) as error:
        raise DataFileError(source, "is not a NumPy file, is cut short, or holds Python objects") from error


def _from_npy(array: NDArray[Any], source: Path, encoding: str | None, min_disparity: int) -> Disparity:
    if array.ndim != 2 or array.size == 0 or array.dtype.kind not in "fiu":
        raise DataFileError(source, f"is not a disparity map: it holds {array.dtype} {array.shape}")
    if encoding == "opencv" or (encoding is None and array.dtype == np.int16):
        if array.dtype != np.int16:
            raise DataFileError(source, f"is not OpenCV's int16 disparity: it holds {array.dtype}")
        return from_opencv_disparity(array, min_disparity=min_disparity)
    values = array.astype(np.float32)
    return np.where(np.isfinite(values), values, np.float32(np.nan))
