"""OpenCV's FileStorage, without OpenCV: the YAML, XML and JSON that ``cv2.FileStorage`` writes and reads.

All three hold named numbers, strings and matrices. A matrix is its rows, cols, element type and numbers, row by row::

    K: !!opencv-matrix            <K type_id="opencv-matrix">        "K": {"type_id": "opencv-matrix",
       rows: 3                      <rows>3</rows>                          "rows": 3,
       cols: 3                      <cols>3</cols>                          "cols": 3,
       dt: d                        <dt>d</dt>                              "dt": "d",
       data: [ 5.3e+02, … ]         <data>5.3e+02 …</data></K>              "data": [ 530.0, … ]}

The type is a letter (u c w s i f d h: uint8, int8, uint16, int16, int32, float32, float64, float16) after the number of
channels if there are several ("3d"). OpenCV's YAML begins with ``%YAML:1.0``, which is no YAML directive; it is taken
off before a YAML parser sees the text.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from stereocal.base.atomic_files import write_whole
from stereocal.base.checks import Float
from stereocal.base.errors import DataFileError
from stereocal.store.structured_text import matrix_from_entries, parse_json, parse_xml, parse_yaml, read_text, spell

_HEADER = re.compile(r"\A\s*%YAML[: ]1\.[0-9]\s*?\n(---[^\n]*\n)?")


def read_storage(path: Path) -> dict[str, Any]:
    """Return the top level of a FileStorage file: numbers, strings, lists, dicts, and matrices as float64 arrays.

    Raises
    ------
    DataFileError
        If the file is missing, cut short, hostile or of another kind.
    """
    text = read_text(path)
    start = text.lstrip()[:200]
    if start.startswith(("<?xml", "<opencv_storage")):
        root = parse_xml(text, path)
        if root.tag != "opencv_storage":
            raise DataFileError(path, "is XML, but not OpenCV's")
        try:
            return {child.tag: _from_xml(child) for child in root}
        except (ValueError, RecursionError) as error:
            raise DataFileError(path, f"is damaged: {error}") from error
    if start.startswith("{"):
        document = parse_json(text, path)
        try:
            return {name: _from_json(value) for name, value in document.items()}
        except (ValueError, RecursionError) as error:
            raise DataFileError(path, f"is damaged: {error}") from error
    return parse_yaml(_HEADER.sub("", text, count=1), path)


def write_storage(path: Path, content: dict[str, Any]) -> Path:
    """Write numbers, strings and matrices as FileStorage; the ending says the kind: .xml, .json, else YAML.

    Parameters
    ----------
    path : Path
        Where to.
    content : dict of str to int, float, str or ndarray (rows, cols)
        In the order in which they are written. Floats keep all their digits.
    """
    suffix = path.suffix.lower()
    if suffix == ".xml":
        return write_whole(path, _to_xml(content))
    if suffix == ".json":
        return write_whole(path, json.dumps({k: _to_json(v) for k, v in content.items()}, indent=4) + "\n")
    lines = ["%YAML:1.0", "---"]
    for name, value in content.items():
        if isinstance(value, np.ndarray):
            rows, columns = value.shape
            numbers = ", ".join(spell(number) for number in value.ravel())
            lines += [f"{name}: !!opencv-matrix", f"   rows: {rows}", f"   cols: {columns}", "   dt: d"]
            lines += [f"   data: [ {numbers} ]"]
        else:
            lines.append(f"{name}: {json.dumps(value) if isinstance(value, str) else _spell_scalar(value)}")
    return write_whole(path, "\n".join(lines) + "\n")


def _spell_scalar(value: int | float) -> str:
    return str(value) if isinstance(value, int) else spell(value)


def _to_xml(content: dict[str, Any]) -> str:
    root = ElementTree.Element("opencv_storage")
    for name, value in content.items():
        node = ElementTree.SubElement(root, name)
        if isinstance(value, np.ndarray):
            node.set("type_id", "opencv-matrix")
            for key, text in zip(("rows", "cols", "dt"), (*map(str, value.shape), "d"), strict=True):
                ElementTree.SubElement(node, key).text = text
            ElementTree.SubElement(node, "data").text = " ".join(spell(number) for number in value.ravel())
        else:
            node.text = f'"{value}"' if isinstance(value, str) else _spell_scalar(value)
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _to_json(value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        return value
    rows, columns = value.shape
    data = [float(number) for number in value.ravel()]
    return {"type_id": "opencv-matrix", "rows": rows, "cols": columns, "dt": "d", "data": data}


def _from_json(value: Any) -> Any:
    if isinstance(value, dict) and value.get("type_id") == "opencv-matrix":
        return matrix_from_entries(value.get("rows"), value.get("cols"), value.get("dt"), value.get("data"))
    if isinstance(value, dict):
        return {name: _from_json(item) for name, item in value.items()}
    return value


def _from_xml(node: ElementTree.Element) -> Any:
    if node.get("type_id") == "opencv-matrix":
        text = {child.tag: (child.text or "").strip().strip('"') for child in node}
        try:
            rows, columns = int(text.get("rows", "")), int(text.get("cols", ""))
        except ValueError:
            raise ValueError(f"the matrix {node.tag} has no proper rows and cols") from None
        return matrix_from_entries(rows, columns, text.get("dt"), text.get("data", "").split())
    if len(node):
        return {child.tag: _from_xml(child) for child in node}
    words = (node.text or "").strip()
    if words.startswith('"') and words.endswith('"') and len(words) > 1:
        return words[1:-1]
    try:
        numbers = [float(word) for word in words.split()]
    except ValueError:
        return words
    return numbers[0] if len(numbers) == 1 else numbers


def as_column(values: Float) -> Float:
    """Return n numbers as an (n, 1) matrix, as OpenCV stores vectors."""
    return np.asarray(values, dtype=np.float64).reshape(-1, 1)
