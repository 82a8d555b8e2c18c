"""Our own ``calibration.json``: lossless, and readable without this library.

One JSON object::

    {"format": "stereocal calibration", "version": 1,
     "left":  {"image_size": [w, h], "model": "brown", "K": [[…], […], […]], "dist": […]},
     "right": {…}, "R": [[…], […], […]], "T": […], "baseline": …, "unit": "mm" or null,
     …whatever else is known: rms, pairs, square_size, inner_corners, covariance…}

A single camera stands under ``"camera"`` instead. Numbers are written with the fewest digits that give the same float64
back (17 at most), so that nothing is lost; what is NaN or infinite becomes null, for JSON has neither. ``baseline`` is
there for the reader's eye: |T| is what counts.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from stereocal.base.atomic_files import write_whole
from stereocal.base.errors import InputError
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig
from stereocal.store.calibration_record import METRES, CalibrationRecord
from stereocal.store.structured_text import Fields, parse_json, read_text

TITLE = "stereocal JSON"
EXTRA: tuple[str, ...] = ()
FORMAT = "stereocal calibration"
VERSION = 1

_GEOMETRY = frozenset(("format", "version", "R", "T", "baseline"))
_CAMERA_GEOMETRY = frozenset(("image_size", "model", "K", "dist"))


def read(path: Path) -> CalibrationRecord:
    """Read calibration.json.

    Raises
    ------
    DataFileError
        If it is cut short, hostile, of a later version, or its numbers make no calibration.
    """
    fields = Fields(parse_json(read_text(path), path), path)
    if fields.text("format") != FORMAT:
        raise fields.error("is JSON, but not a stereocal calibration")
    if fields.integer("version") > VERSION:
        raise fields.error("is written by a later version of stereocal; update")
    extra = {name: value for name, value in fields.mapping.items() if name not in _GEOMETRY}
    unit = extra.pop("unit", None)
    if unit is not None and unit not in METRES:
        raise fields.error(f"names a unit that is not known: {unit!r}")
    try:
        if "camera" in fields:
            calibration: Camera | StereoRig = _read_camera(fields.fields("camera"))
        else:
            left, right = _read_camera(fields.fields("left")), _read_camera(fields.fields("right"))
            calibration = StereoRig(left, right, fields.matrix(3, 3, "R"), fields.array("T", size=3))
    except InputError as error:
        raise fields.error(f"is no calibration: {error}") from error
    for side in ("camera", "left", "right"):
        further = {name: value for name, value in extra.pop(side, {}).items() if name not in _CAMERA_GEOMETRY}
        if further:
            extra[side] = further
    return CalibrationRecord(calibration, unit, extra)


def write(record: CalibrationRecord, path: Path) -> list[Path]:
    """Write calibration.json; `record.extra` is merged in.

    Raises
    ------
    InputError
        If `extra` holds what JSON cannot, or would replace the calibration itself.
    """
    document: dict[str, Any] = {"format": FORMAT, "version": VERSION}
    if isinstance(record.calibration, StereoRig):
        rig = record.calibration
        document |= {"left": _describe(rig.left), "right": _describe(rig.right)}
        document |= {"R": rig.R.tolist(), "T": rig.T.tolist(), "baseline": float(np.linalg.norm(rig.T))}
    else:
        document |= {"camera": _describe(record.calibration)}
    document["unit"] = record.unit
    _merge(document, record.extra)
    return [write_whole(path, json.dumps(document, indent=1, allow_nan=False) + "\n")]


def remarks_on_writing(record: CalibrationRecord) -> list[str]:
    """Return nothing: this format is lossless."""
    return []


def plain(value: Any) -> Any:
    """Return arrays, tuples, NumPy numbers and paths as what JSON knows; NaN and infinity become None."""
    if isinstance(value, dict):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    if value is None or isinstance(value, (str, int, bool)):
        return value
    raise InputError(f"extra holds a {type(value).__name__}, which JSON cannot hold")


def _describe(camera: Camera) -> dict[str, Any]:
    return {
        "image_size": [int(side) for side in camera.image_size],
        "model": camera.model,
        "K": camera.K.tolist(),
        "dist": np.asarray(camera.dist, dtype=np.float64).ravel().tolist(),
    }


def _read_camera(fields: Fields) -> Camera:
    size = fields.image_size("image_size")
    return Camera(fields.matrix(3, 3, "K"), fields.array("dist"), size, model=fields.text("model"))


def _merge(document: dict[str, Any], extra: dict[str, Any]) -> None:
    """Add extra fields; mappings under left, right and camera are joined, the calibration itself is never replaced."""
    for name, value in extra.items():
        addition = plain(value)
        if name in ("left", "right", "camera") and name in document and isinstance(addition, dict):
            for inner, item in addition.items():
                if inner in _CAMERA_GEOMETRY and item != document[name][inner]:
                    raise InputError(f"extra would replace {name}.{inner} of the calibration")
                document[name][inner] = item
        elif name in document and name != "unit" and addition != document[name]:
            raise InputError(f"extra would replace {name} of the calibration")
        else:
            document[name] = addition
