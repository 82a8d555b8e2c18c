"""MATLAB's .mat files of version 5, as far as plain structs of numbers and text go.

SciPy reads all of .mat, but its reader trusts the file: under fuzzing it ended in errors of kinds that nobody expects
(UnboundLocalError among them). A calibration from a stranger needs less: elements of (type, size, bytes), and among
these ``miMATRIX``, which holds flags, dimensions, a name and its contents:

    header 124 bytes of text, 2 of version, "IM" or "MI" for the byte order
    element = type uint32, size uint32, bytes, padded to 8      (or, if small: size and type in 4 bytes, then 4 bytes)
    miMATRIX = flags (class), dimensions, name, then: the numbers | the text | field names and one miMATRIX a field

A compressed element (type 15) is an element in zlib. Every count is checked against the bytes that are there, what is
unpacked and how deep structs nest is bounded. Objects, cells, sparse and complex arrays are refused: no calibration
struct has them.

Source: MathWorks, *MAT-File Format* (version 5).
"""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np

MAX_UNPACKED = 32 * 2**20
MAX_DEPTH = 8

_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_TEXT = {1: "utf-8", 2: "utf-8", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_MATRIX, _COMPRESSED = 14, 15
_STRUCT, _CHAR = 2, 4
_NUMERIC_CLASSES = range(6, 16)
_COMPLEX = 0x0800


class MatError(ValueError):
    """The bytes are no .mat of version 5 with plain structs."""


def parse_mat(content: bytes) -> dict[str, Any]:
    """Return the variables of a .mat: structs as dicts, numbers as arrays (float64), text as str.

    Raises
    ------
    MatError
        If the file is cut short, damaged, too large when unpacked, or holds anything else.
    """
    if len(content) < 128 or content[126:128] not in (b"IM", b"MI"):
        raise MatError("it has no header of version 5")
    order = "<" if content[126:128] == b"IM" else ">"
    variables: dict[str, Any] = {}
    position, unpacked = 128, 0
    while position < len(content):
        kind, data, position = _element(content, position, order)
        if kind == _COMPRESSED:
            data = _unpack(data, MAX_UNPACKED - unpacked)
            unpacked += len(data)
            kind, data, _ = _element(data, 0, order)
        if kind == _MATRIX:
            name, value = _matrix(data, order, 0)
            variables[name] = value
    return variables


def _element(content: bytes, position: int, order: str) -> tuple[int, bytes, int]:
    """Return type, bytes and the position behind."""
    if position + 8 > len(content):
        raise MatError("it is cut short")
    first, second = struct.unpack_from(order + "II", content, position)
    if first >> 16:  # a small element
        kind, size, start, end = first & 0xFFFF, first >> 16, position + 4, position + 8
        if size > 4:
            raise MatError("a small element is too large")
    else:
        kind, size, start = first, second, position + 8
        # compressed elements are not padded
        end = start + size + (0 if kind == _COMPRESSED else -size % 8)
    if start + size > len(content):
        raise MatError("it is cut short")
    return kind, content[start : start + size], end


def _unpack(data: bytes, limit: int) -> bytes:
    unpacker = zlib.decompressobj()
    try:
        unpacked = unpacker.decompress(data, max(limit, 1))
    except zlib.error as error:
        raise MatError("its compressed part is damaged") from error
    if unpacker.unconsumed_tail:
        raise MatError(f"it unpacks to more than {MAX_UNPACKED >> 20} MB, too large for a calibration")
    if not unpacker.eof:
        raise MatError("its compressed part is cut short")
    return unpacked


def _matrix(data: bytes, order: str, depth: int) -> tuple[str, Any]:
    """Return the name and the value of a miMATRIX."""
    if depth > MAX_DEPTH:
        raise MatError("its structs are nested too deeply")
    if not data:
        return "", np.zeros((0, 0))
    _, flags, position = _element(data, 0, order)
    _, dimensions, position = _element(data, position, order)
    _, name, position = _element(data, position, order)
    if len(flags) < 4 or len(dimensions) % 4 or len(dimensions) > 32:
        raise MatError("an array's head is damaged")
    word = struct.unpack_from(order + "I", flags)[0]
    shape = struct.unpack(order + f"{len(dimensions) // 4}i", dimensions)
    label = name.decode("ascii", "replace")
    if word & _COMPLEX:
        raise MatError(f"{label or 'an array'} is complex")
    if word & 0xFF == _STRUCT:
        return label, _struct(data, position, order, depth)
    kind, values, _ = _element(data, position, order)
    if word & 0xFF == _CHAR:
        return label, _text(kind, values, order)
    if word & 0xFF not in _NUMERIC_CLASSES or kind not in _NUMBERS:
        raise MatError(f"{label or 'an array'} is neither numbers, text nor a struct")
    return label, _numbers(values, order + _NUMBERS[kind], shape)


def _numbers(values: bytes, kind: str, shape: tuple[int, ...]) -> Any:
    step = np.dtype(kind).itemsize
    if len(values) % step or min(shape, default=-1) < 0:
        raise MatError("an array is damaged")
    count = 1
    for side in shape:
        count *= side
    if count * step != len(values):
        raise MatError("an array's size does not fit its contents")
    return np.frombuffer(values, dtype=kind).astype(np.float64).reshape(shape, order="F")


def _text(kind: int, values: bytes, order: str) -> str:
    if kind not in _TEXT:
        raise MatError("a text is damaged")
    encoding = _TEXT[kind]
    if encoding != "utf-8":
        encoding += "-le" if order == "<" else "-be"
    return values.decode(encoding, "replace")


def _struct(data: bytes, position: int, order: str, depth: int) -> dict[str, Any]:
    _, length, position = _element(data, position, order)
    _, names, position = _element(data, position, order)
    size = struct.unpack_from(order + "i", length)[0] if len(length) >= 4 else 0
    if size <= 0 or len(names) % size:
        raise MatError("a struct's field names are damaged")
    fields: dict[str, Any] = {}
    for start in range(0, len(names), size):
        field = names[start : start + size].split(b"\0")[0].decode("ascii", "replace")
        kind, content, position = _element(data, position, order)
        if kind != _MATRIX:
            raise MatError(f"the field {field} is damaged")
        fields[field] = _matrix(content, order, depth + 1)[1]
    if position < len(data):
        raise MatError("a struct is an array of structs, or damaged")
    return fields
