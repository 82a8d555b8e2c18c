"""Point clouds as PLY, which MeshLab, CloudCompare, Open3D and Blender read.

The file is a text header that names the columns, then one packed record a point (binary, little-endian)::

    x y z           3 × float32, in the units of the calibration's square_size
    red green blue  3 × uchar, where colours are given

A point that has no depth (NaN) or lies at infinity is not a point: it is dropped, so that no viewer scales the scene to
it.

Source: G. Turk, *The PLY Polygon File Format* (1994).
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.atomic_files import write_whole
from stereocal.base.errors import DataFileError, InputError

_POSITION = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
_COLOUR = [("red", "u1"), ("green", "u1"), ("blue", "u1")]
POINTS_AT_A_TIME = 2**18
"""How many points are packed at once, so that a large cloud needs no second copy in memory."""

_TYPE_NAMES = {"float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8", "uchar": "u1", "uint8": "u1"}


def write_ply(path: str | os.PathLike[str], points: ArrayLike, colors: ArrayLike | None = None) -> int:
    """Write a point cloud as binary little-endian PLY, whole or not at all.

    Parameters
    ----------
    path : str or os.PathLike
        Where to.
    points : array_like of shape (N, 3) or (H, W, 3)
        Positions; a point with a NaN or infinite coordinate is dropped.
    colors : array_like of shape (N, 3), (N,), (H, W, 3) or (H, W), uint8, optional
        R, G, B or grey of each point.

    Returns
    -------
    int
        The number of points written.

    Raises
    ------
    InputError
        If the shapes do not fit each other, or the colours are not uint8.
    DataFileError
        If the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import stereocal as sc
    >>> points = np.array([[0, 0, 1000.0], [10, 0, 1000], [np.nan, np.nan, np.nan]])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     sc.write_ply(Path(folder) / "cloud.ply", points)
    2
    """
    positions, grid = _as_positions(points)
    shades = None if colors is None else _as_colours(colors, grid)
    slices = [slice(first, first + POINTS_AT_A_TIME) for first in range(0, len(positions), POINTS_AT_A_TIME)]
    count = sum(int(_is_point(positions[some]).sum()) for some in slices)

    def write(stream: BinaryIO) -> None:
        stream.write(_header(count, colored=shades is not None).encode())
        for some in slices:
            stream.write(_records(positions[some], None if shades is None else shades[some]).tobytes())

    write_whole(path, write)
    return count


def read_ply(path: str | os.PathLike[str]) -> tuple[NDArray[np.float32], NDArray[np.uint8] | None]:
    """Read the points of a binary little-endian PLY file.

    Returns
    -------
    points : ndarray of shape (N, 3), float32
    colors : ndarray of shape (N, 3), uint8, or None if the file has none

    Raises
    ------
    DataFileError
        If the file is missing, cut short, of another kind, or holds anything but plain scalar columns.
    """
    source = Path(path)
    try:
        content = source.read_bytes()
    except OSError as error:
        raise DataFileError(source, f"cannot be read ({error.strerror}); check the name") from error
    head, marker, body = content.partition(b"end_header\n")
    lines = head.decode("ascii", "replace").split("\n")
    if not marker or lines[0] != "ply" or "format binary_little_endian 1.0" not in lines:
        raise DataFileError(source, "is not a binary little-endian PLY file")
    count, columns = _parse_header(lines, source)
    layout = np.dtype(columns)
    if len(body) < count * layout.itemsize:
        raise DataFileError(
            source, f"is cut short: {count} points need {count * layout.itemsize} bytes, not {len(body)}"
        )
    records = np.frombuffer(body, dtype=layout, count=count)
    points = np.stack([records[name].astype(np.float32) for name in "xyz"], axis=1)
    if not {"red", "green", "blue"} <= set(layout.names or ()):
        return points, None
    return points, np.stack([records[name].astype(np.uint8) for name in ("red", "green", "blue")], axis=1)


def _as_positions(points: ArrayLike) -> tuple[NDArray[Any], tuple[int, ...]]:
    """Return the points as (N, 3), and the shape that they were given in: (N,) or (H, W)."""
    try:
        positions = np.asarray(points)
    except ValueError as error:  # rows of unequal length
        raise InputError("points must be numbers of shape (N, 3) or (H, W, 3), each row as long as the next") from error
    if positions.dtype.kind not in "fiu" or positions.ndim < 2 or positions.shape[-1] != 3:
        raise InputError(f"points must be numbers of shape (N, 3) or (H, W, 3), but are {positions.shape}")
    return positions.reshape(-1, 3), positions.shape[:-1]


def _as_colours(colors: ArrayLike, grid: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return the colours as (N, 3) or, grey, (N, 1); a map of another shape would colour the wrong points."""
    shades = np.asarray(colors)
    if shades.dtype != np.uint8:
        raise InputError(f"colors must be uint8 (0 to 255), not {shades.dtype}; scale or convert them first")
    count = math.prod(grid)
    for shape in (grid, (count,)):
        for channels in ((3,), (1,), ()):
            if shades.shape == shape + channels:
                return shades.reshape(count, *channels or (1,))
    wanted = " or ".join(str(shape) for shape in ((*grid, 3), grid))
    raise InputError(f"colors must give each point R, G, B or a grey value, shape {wanted}, but are {shades.shape}")


def _is_point(positions: NDArray[Any]) -> NDArray[np.bool_]:
    """Which are finite, in the file's float32 too."""
    with np.errstate(over="ignore"):
        return np.asarray(np.isfinite(positions.astype(np.float32, copy=False)).all(axis=1))


def _records(positions: NDArray[Any], shades: NDArray[np.uint8] | None) -> NDArray[Any]:
    """Return the packed records of the points that are points."""
    keep = _is_point(positions)
    records = np.empty(int(keep.sum()), dtype=_POSITION if shades is None else _POSITION + _COLOUR)
    for (name, _), column in zip(_POSITION, positions[keep].T, strict=True):
        records[name] = column
    if shades is not None:
        for i, (name, _) in enumerate(_COLOUR):
            records[name] = shades[keep, i % shades.shape[1]]
    return records


def _header(count: int, *, colored: bool) -> str:
    lines = ["ply", "format binary_little_endian 1.0", "comment written by stereocal", f"element vertex {count}"]
    lines += [f"property float {name}" for name, _ in _POSITION]
    if colored:
        lines += [f"property uchar {name}" for name, _ in _COLOUR]
    return "\n".join([*lines, "end_header", ""])


def _parse_header(lines: list[str], source: Path) -> tuple[int, list[tuple[str, Any]]]:
    count, columns, in_vertex = -1, [], False
    for words in (line.split() for line in lines):
        if words[:1] == ["element"]:
            in_vertex = words[1:2] == ["vertex"]
            if in_vertex and len(words) == 3 and words[2].isdigit():
                count = int(words[2])
            elif count < 0:
                raise DataFileError(source, "does not begin with its vertices")
        elif words[:1] == ["property"] and in_vertex:
            if len(words) != 3 or words[1] not in _TYPE_NAMES:
                raise DataFileError(source, f"has a column of a kind that is not read: {' '.join(words)}")
            columns.append((words[2], _TYPE_NAMES[words[1]]))
    if count < 0 or not {"x", "y", "z"} <= {name for name, _ in columns}:
        raise DataFileError(source, "has no vertices with x, y and z")
    return count, columns
