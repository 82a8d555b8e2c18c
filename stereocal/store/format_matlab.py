"""MATLAB's ``stereoParameters`` and ``cameraParameters``, as a .mat (version 5) or .json of a plain struct.

MATLAB saves its objects in a form that only MATLAB reads; a struct is open to all::

    s = toStruct(stereoParams);  save('stereo.mat', '-struct', 's', '-v7')      % or: jsonencode(s)

What differs from the library:

- **transposes**: ``IntrinsicMatrix`` is [fx 0 0; s fy 0; cx cy 1] and ``RotationOfCamera2`` acts on row vectors: both
  are transposed. The newer ``K`` and ``PoseCamera2`` (4x4) are not.
- **1-based pixels**: the first pixel's centre is (1, 1); 1 is taken off cx and cy, as MathWorks' own
  ``stereoParametersToOpenCV`` does.
- ``ImageSize`` is [rows columns]; ``RadialDistortion`` has 2 or 3 numbers, ``TangentialDistortion`` 2.
- ``WorldUnits`` names the unit, 'millimeters' by habit.

A point goes from camera 1 to camera 2 by ``[x y z] * RotationOfCamera2 + TranslationOfCamera2``: the direction is the
library's. More than three radial terms, and fisheye lenses, have no place.

Source: MathWorks' pages on ``stereoParameters``, ``toStruct`` and ``stereoParametersToOpenCV``, and its answer 502227.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from stereocal.base.atomic_files import write_whole
from stereocal.base.errors import DataFileError, InputError
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig
from stereocal.store.calibration_record import CalibrationRecord, opencv_distortion
from stereocal.store.matlab_structs import MatError, parse_mat
from stereocal.store.structured_text import Fields, parse_json, read_bytes, read_text

TITLE = "MATLAB struct"
EXTRA: tuple[str, ...] = ()
LENS_PARAMETERS, FISHEYE = 5, False

_UNITS = {"m": "m", "meters": "m", "cm": "cm", "centimeters": "cm", "mm": "mm", "millimeters": "mm", "in": "in"}
_UNIT_NAMES = {"m": "meters", "cm": "centimeters", "mm": "millimeters", "in": "inches"}


def read(path: Path) -> CalibrationRecord:
    """Read a stereo or single-camera struct.

    Raises
    ------
    DataFileError
        If it is cut short, hostile, or no such struct.
    """
    fields = Fields(_read_mat(path) if read_bytes(path)[:6] == b"MATLAB" else parse_json(read_text(path), path), path)
    remarks = ["1 px is taken off cx and cy: MATLAB's first pixel is (1, 1)."]
    try:
        if "IntrinsicMatrix" in (fields.fields("CameraParameters1") if "CameraParameters1" in fields else fields):
            remarks.append("IntrinsicMatrix is transposed into K.")
        if "CameraParameters1" not in fields:
            return CalibrationRecord(_read_camera(fields), _unit(fields), {}, tuple(remarks))
        first = fields.fields("CameraParameters1")
        left, right = _read_camera(first), _read_camera(fields.fields("CameraParameters2"))
        if "RotationOfCamera2" in fields:
            R, T = fields.matrix(3, 3, "RotationOfCamera2").T, fields.array("TranslationOfCamera2", size=3)
            remarks.append("RotationOfCamera2 is transposed: MATLAB's acts on row vectors.")
        else:
            pose = fields.matrix(4, 4, "PoseCamera2")
            R, T = pose[:3, :3], pose[:3, 3]
        return CalibrationRecord(StereoRig(left, right, R, T), _unit(first), {}, tuple(remarks))
    except InputError as error:
        raise fields.error(f"is no calibration: {error}") from error


def write(record: CalibrationRecord, path: Path) -> list[Path]:
    """Write a struct as .mat, or .json by that ending.

    Raises
    ------
    InputError
        If a lens needs more than three radial and two tangential parameters.
    """
    unit = _UNIT_NAMES.get(record.unit or "", "unspecified")
    if isinstance(record.calibration, StereoRig):
        rig = record.calibration
        content: dict[str, Any] = {
            "CameraParameters1": _describe(rig.left, unit),
            "CameraParameters2": _describe(rig.right, unit),
            "RotationOfCamera2": np.ascontiguousarray(rig.R.T),
            "TranslationOfCamera2": rig.T[None],
        }
    else:
        content = _describe(record.calibration, unit)
    if path.suffix.lower() == ".json":
        return [write_whole(path, json.dumps(content, indent=1, default=_as_json) + "\n")]

    def save(stream: BinaryIO) -> None:
        from scipy.io import savemat

        savemat(stream, content, format="5")

    return [write_whole(path, save)]


def remarks_on_writing(record: CalibrationRecord) -> list[str]:
    """Return what changes meaning in this format."""
    sentences = ["1 px is added to cx and cy: MATLAB's first pixel is (1, 1).", "IntrinsicMatrix is K transposed."]
    if record.is_stereo:
        unit = record.unit or "the board's square_size units"
        sentences.append(f"RotationOfCamera2 is R transposed: it acts on row vectors; lengths stay in {unit}.")
    return sentences


def _describe(camera: Camera, unit: str) -> dict[str, Any]:
    k1, k2, p1, p2, k3 = opencv_distortion(camera, TITLE, (5,))
    K = camera.K.copy()
    K[:2, 2] += 1
    return {
        "IntrinsicMatrix": np.ascontiguousarray(K.T),
        "RadialDistortion": np.array([[k1, k2, k3]]),
        "TangentialDistortion": np.array([[p1, p2]]),
        "ImageSize": np.array([[camera.image_size[1], camera.image_size[0]]], dtype=np.float64),
        "WorldUnits": unit,
    }


def _as_json(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value[0].tolist() if value.shape[0] == 1 else value.tolist()
    raise TypeError(type(value).__name__)


def _read_camera(fields: Fields) -> Camera:
    K = fields.matrix(3, 3, "K") if "K" in fields else fields.matrix(3, 3, "IntrinsicMatrix").T.copy()
    K[:2, 2] -= 1
    radial = fields.array("RadialDistortion", size=(2, 3))
    p1, p2 = fields.array("TangentialDistortion", size=2)
    height, width = fields.image_size("ImageSize")
    k3 = radial[2] if len(radial) == 3 else 0.0
    return Camera(K, [radial[0], radial[1], p1, p2, k3], (width, height), model="brown")


def _unit(fields: Fields) -> str | None:
    word = fields.mapping.get("WorldUnits")
    return _UNITS.get(word.lower()) if isinstance(word, str) else None


def _read_mat(path: Path) -> dict[str, Any]:
    try:
        return parse_mat(read_bytes(path))
    except MatError as error:
        raise DataFileError(path, f"is no MATLAB file of a plain struct saved with -v7: {error}") from error
