"""JSON, YAML and XML from strangers: parsed as data, never as a program.

Calibration files travel by mail and by forum, so a reader must survive a file made to harm it:

- **size**: a file over 32 MB is no calibration and is not read;
- **tags**: YAML can name Python objects to be built (``!!python/object/apply:os.system``); only plain data, and the
  matrix tag that OpenCV writes, are known;
- **bombs**: YAML aliases and XML entities let a kilobyte grow to gigabytes ("billion laughs"); both are refused, for no
  calibration needs them;
- **depth**: ten thousand nested brackets overflow the parser's stack; that is caught and said;
- **numbers**: NaN and infinity, which JSON does not have and Python accepts, are refused where a number is asked for,
  and so are numbers whose square overflows;
- **duplicates**: a key that stands twice makes the file mean two things; refused.

What comes out are dicts, lists, strings and numbers; :class:`Fields` then asks for each by name, shape and type, and
names the file and the entry when it is not there.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml

from stereocal.base.checks import Float
from stereocal.base.errors import DataFileError

MAX_BYTES = 32 * 2**20
"""The largest calibration file that is read."""

LARGEST = 1e100
"""The largest number: the square of a larger one may overflow."""


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Return a small file's content.

    Raises
    ------
    DataFileError
        If it is missing, a folder, empty, or larger than 32 MB.
    """
    source = Path(path)
    try:
        folder, size = source.is_dir(), source.stat().st_size
        content = b"" if folder or size > MAX_BYTES else source.read_bytes()
    except OSError as error:
        raise DataFileError(source, f"cannot be read ({error.strerror}); check the name") from error
    except ValueError as error:  # a NUL byte in the name
        raise DataFileError(source, "is not a file name") from error
    if folder:
        raise DataFileError(source, "is a folder; name a file in it")
    if size > MAX_BYTES:
        raise DataFileError(source, f"is too large for a calibration ({size >> 20} MB)")
    if not content:
        raise DataFileError(source, "is empty (0 bytes)")
    return content


def read_text(path: str | os.PathLike[str]) -> str:
    """Return a small UTF-8 file's text; see :func:`read_bytes`."""
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise DataFileError(path, "is not a text file (UTF-8)") from error


def parse_json(text: str, path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the object that a JSON text holds."""
    try:
        value = json.loads(text, parse_constant=_refuse_constant, object_pairs_hook=_unique)
    except RecursionError as error:
        raise DataFileError(path, "is nested too deeply to be a calibration") from error
    except ValueError as error:
        raise DataFileError(path, f"is not valid JSON, or is cut short ({_one_line(error)})") from error
    return _require_mapping(value, path)


def parse_yaml(text: str, path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the mapping that a YAML text holds: plain data only, OpenCV's matrices as arrays."""
    try:
        value = yaml.load(text, Loader=_PlainLoader)
    except RecursionError as error:
        raise DataFileError(path, "is nested too deeply to be a calibration") from error
    except (yaml.YAMLError, ValueError, TypeError, OverflowError) as error:
        raise DataFileError(path, f"is not valid YAML, or is cut short ({_one_line(error)})") from error
    return _require_mapping(value, path)


def parse_xml(text: str, path: str | os.PathLike[str]) -> ElementTree.Element:
    """Return the root of an XML text that defines no entities."""
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise DataFileError(path, "defines XML entities, which no calibration needs; it is not read")
    try:
        # bytes in UTF-8: a declaration of another encoding must not make the parser see another text than we checked
        return ElementTree.fromstring(_without_declaration(text).encode())
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise DataFileError(path, f"is not valid XML, or is cut short ({_one_line(error)})") from error


def spell(number: float) -> str:
    """Return the shortest text that reads back as the same float64, with a point: YAML 1.1 takes 1e-05 for a word."""
    if not math.isfinite(number):
        raise ValueError("a calibration holds finite numbers only")
    mantissa, e, exponent = repr(float(number)).partition("e")
    return (mantissa if "." in mantissa else mantissa + ".0") + e + exponent


class Fields:
    """Named entries of a mapping, each checked as it is taken.

    Parameters
    ----------
    mapping : dict
        What a parser returned.
    path : str or os.PathLike
        The file, for the messages.
    where : str
        The mapping's own name within the file, for the messages.
    """

    def __init__(self, mapping: Any, path: str | os.PathLike[str], where: str = "") -> None:
        if not isinstance(mapping, dict):
            raise DataFileError(path, f"{where or 'its content'} is not a set of named entries")
        self.mapping, self.path, self.where = mapping, path, where

    def __contains__(self, name: str) -> bool:
        return name in self.mapping

    def error(self, problem: str) -> DataFileError:
        """Return an error about this mapping."""
        return DataFileError(self.path, problem)

    def value(self, *names: str) -> Any:
        """Return the entry under the first of `names` that is there."""
        for name in names:
            if name in self.mapping:
                return self.mapping[name]
        raise self.error(f"lacks the entry {self._spelt(names[0])}, so it is cut short or of another kind")

    def fields(self, *names: str) -> Fields:
        """Return an entry that is a mapping itself."""
        return Fields(self.value(*names), self.path, self._spelt(names[0]))

    def text(self, *names: str) -> str:
        """Return an entry that is a string."""
        value = self.value(*names)
        if not isinstance(value, str):
            raise self.error(f"{self._spelt(names[0])} is not a word")
        return value

    def number(self, *names: str) -> float:
        """Return an entry that is one finite number."""
        return float(self.array(*names, size=1)[0])

    def integer(self, *names: str) -> int:
        """Return an entry that is a whole number."""
        number = self.number(*names)
        if not number.is_integer():
            raise self.error(f"{self._spelt(names[0])} must be a whole number, but is {number:g}")
        return int(number)

    def image_size(self, *names: str) -> tuple[int, int]:
        """Return an entry that is (width, height)."""
        width, height = self.array(*names, size=2)
        if not (width.is_integer() and height.is_integer() and 0 < width < 1e6 and 0 < height < 1e6):
            raise self.error(f"{self._spelt(names[0])} must be a width and a height, but is {width:g}, {height:g}")
        return int(width), int(height)

    def matrix(self, rows: int, columns: int, *names: str) -> Float:
        """Return an entry of rows · columns numbers, row by row, nested or flat."""
        return self.array(*names, size=rows * columns).reshape(rows, columns)

    def array(self, *names: str, size: int | Iterable[int] | None = None) -> Float:
        """Return an entry of finite numbers as a flat array, its size one of `size` if given."""
        array = as_numbers(self.value(*names), self.path, self._spelt(names[0]))
        sizes = None if size is None else (size,) if isinstance(size, int) else tuple(size)
        if sizes is not None and array.size not in sizes:
            wanted = " or ".join(map(str, sizes))
            raise self.error(f"{self._spelt(names[0])} must be {wanted} numbers, but is {array.size}")
        return array

    def _spelt(self, name: str) -> str:
        return f"{self.where}.{name}" if self.where else name


def as_numbers(value: Any, path: str | os.PathLike[str], name: str) -> Float:
    """Return nested lists of finite numbers, or an array, as a flat float64 array."""
    try:
        if isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
            array = value.astype(np.float64).ravel()
        else:
            # one by one: YAML 1.1 takes 1e-5, which lacks a point, for a word, and True must not pass for 1
            items = np.asarray(value, dtype=object).ravel()
            array = np.array([_as_float(item) for item in items], dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise DataFileError(path, f"{name} must be numbers") from error
    if not np.isfinite(array).all():
        raise DataFileError(path, f"{name} holds NaN or infinity")
    if np.abs(array).max(initial=0) > LARGEST:
        raise DataFileError(path, f"{name} holds {np.abs(array).max():g}, which no calibration does")
    return array


def _as_float(item: Any) -> float:
    if isinstance(item, (bool, np.bool_)) or not isinstance(item, (str, int, float, np.number)):
        raise TypeError(f"{type(item).__name__} is not a number")
    return float(item)


class _PlainLoader(yaml.SafeLoader):
    """Plain data only: no aliases, no repeated keys, no tag but OpenCV's matrix."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("it uses aliases, which no calibration needs")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        mapping = super().construct_mapping(node, deep=deep)
        if isinstance(node, yaml.MappingNode) and len(mapping) != len(node.value):
            raise yaml.YAMLError("an entry stands in it twice")
        return mapping


def _construct_matrix(loader: _PlainLoader, node: Any) -> Float:
    entries = loader.construct_mapping(node, deep=True)
    return matrix_from_entries(entries.get("rows"), entries.get("cols"), entries.get("dt"), entries.get("data"))


def matrix_from_entries(rows: Any, columns: Any, kind: Any, data: Any) -> Float:
    """Return OpenCV's stored matrix (rows, cols, dt, data) as (rows, cols) or, with channels, (rows, cols, n) numbers.

    Raises
    ------
    ValueError
        If the counts do not fit.
    """
    if not isinstance(kind, str) or not kind or kind[-1] not in "ucwsifdh" or not (kind[:-1] or "1").isdigit():
        raise ValueError(f"a matrix is of an unknown type {kind!r}")
    if not (type(rows) is int and type(columns) is int and rows >= 0 and columns >= 0):  # True is an int, too
        raise ValueError("a matrix has no proper rows and cols")
    channels = int(kind[:-1] or "1")
    try:
        numbers = np.array([_as_float(item) for item in (data if isinstance(data, list) else [])], dtype=np.float64)
    except TypeError as error:
        raise ValueError(f"a matrix holds what is no number: {error}") from error
    if numbers.size != rows * columns * channels:
        raise ValueError(f"a matrix of {rows}x{columns} holds {numbers.size} numbers")
    return numbers.reshape((rows, columns) if channels == 1 else (rows, columns, channels))


_PlainLoader.add_constructor("tag:yaml.org,2002:opencv-matrix", _construct_matrix)


def _require_mapping(value: Any, path: str | os.PathLike[str]) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise DataFileError(path, "holds no named entries, so it is no calibration")
    return value


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    mapping = dict(pairs)
    if len(mapping) != len(pairs):
        raise ValueError("an entry stands in it twice")
    return mapping


def _refuse_constant(word: str) -> Any:
    raise ValueError(f"{word} is not a number")


def _without_declaration(text: str) -> str:
    stripped = text.lstrip()
    if stripped.startswith("<?xml"):
        _, _, stripped = stripped.partition("?>")
    return stripped


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:160]
