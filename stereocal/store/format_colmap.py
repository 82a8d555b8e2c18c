"""COLMAP's ``cameras.txt``: one line a camera, intrinsics only.

::

    # CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]
    1 OPENCV 640 480 fx fy cx cy k1 k2 p1 p2

==================  ==================================================  ==================
model               parameters                                          here
==================  ==================================================  ==================
SIMPLE_PINHOLE      f cx cy                                             pinhole (read)
PINHOLE             fx fy cx cy                                         pinhole
SIMPLE_RADIAL       f cx cy k1                                          polynomial (read)
RADIAL              f cx cy k1 k2                                       polynomial (read)
OPENCV              fx fy cx cy k1 k2 p1 p2                             brown with k3 = 0
FULL_OPENCV         … + k3 k4 k5 k6                                     rational
OPENCV_FISHEYE      fx fy cx cy k1 k2 k3 k4                             fisheye
==================  ==================================================  ==================

**Half a pixel**: in COLMAP the first pixel's centre is (0.5, 0.5), here (0, 0). So 0.5 is added to cx and cy on
writing, and taken off on reading. There is no pose in the file: a stereo rig is refused. Nor is there a skew.

Source: COLMAP's documentation, *Output format* and *Camera models*.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stereocal.base.atomic_files import write_whole
from stereocal.base.errors import DataFileError, InputError
from stereocal.camera.model import Camera
from stereocal.store.calibration_record import (
    CalibrationRecord,
    camera_from_opencv,
    camera_matrix,
    opencv_distortion,
    require_no_skew,
)
from stereocal.store.structured_text import as_numbers, read_text

TITLE = "COLMAP cameras.txt"
EXTRA: tuple[str, ...] = ()
LENS_PARAMETERS, FISHEYE = 8, True

_HALF = 0.5
_COUNTS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "FULL_OPENCV": 12,
    "OPENCV_FISHEYE": 8,
}


def read(path: Path) -> CalibrationRecord:
    """Read the one camera of a cameras.txt.

    Raises
    ------
    DataFileError
        If it holds no camera, several (their poses stand elsewhere), or a model that is not known.
    """
    lines = [
        line.split() for line in read_text(path).splitlines() if line.strip() and not line.lstrip().startswith("#")
    ]
    if len(lines) != 1:
        raise DataFileError(path, f"holds {len(lines)} cameras and no poses between them; keep the line of one")
    words = lines[0]
    if len(words) < 4 or words[1] not in _COUNTS:
        raise DataFileError(path, f"is no camera that is known; known are {', '.join(_COUNTS)}")
    model = words[1]
    width, height = as_numbers(words[2:4], path, "width and height")
    parameters = as_numbers(words[4:], path, "the parameters")
    if len(parameters) != _COUNTS[model]:
        raise DataFileError(path, f"has {len(parameters)} parameters, but {model} has {_COUNTS[model]}")
    try:
        camera = _camera(model, parameters, (int(width), int(height)))
    except InputError as error:
        raise DataFileError(path, f"is no calibration: {error}") from error
    return CalibrationRecord(
        camera, None, {}, ("0.5 px is taken off cx and cy: COLMAP's first pixel is at (0.5, 0.5).",)
    )


def write(record: CalibrationRecord, path: Path) -> list[Path]:
    """Write one camera.

    Raises
    ------
    InputError
        If it is a stereo rig, or its lens is none of COLMAP's.
    """
    if not isinstance(record.calibration, Camera):
        raise InputError(f"{TITLE} holds cameras without poses; save each camera of the rig by itself")
    camera = record.calibration
    require_no_skew(camera, TITLE)
    parameters = [camera.fx, camera.fy, camera.cx + _HALF, camera.cy + _HALF]
    if camera.model == "pinhole":
        model, dist = "PINHOLE", np.zeros(0)
    elif camera.model == "fisheye":
        model, dist = "OPENCV_FISHEYE", camera.dist
    else:
        dist = opencv_distortion(camera, TITLE, (4, 8))
        model = "OPENCV" if len(dist) == 4 else "FULL_OPENCV"
    numbers = " ".join(repr(float(value)) for value in (*parameters, *dist))
    size = f"{camera.image_size[0]} {camera.image_size[1]}"
    return [write_whole(path, f"# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n1 {model} {size} {numbers}\n")]


def remarks_on_writing(record: CalibrationRecord) -> list[str]:
    """Return what changes meaning in this format."""
    return ["0.5 px is added to cx and cy: COLMAP's first pixel has its centre at (0.5, 0.5)."]


def _camera(model: str, p: np.ndarray, size: tuple[int, int]) -> Camera:
    if model.startswith("SIMPLE") or model == "RADIAL":
        K = camera_matrix(p[0], p[0], p[1] - _HALF, p[2] - _HALF)
        return Camera(K, p[3:], size, model="polynomial" if len(p) > 3 else "pinhole")
    K = camera_matrix(p[0], p[1], p[2] - _HALF, p[3] - _HALF)
    if model == "OPENCV_FISHEYE":
        return Camera(K, p[4:], size, model="fisheye")
    return camera_from_opencv(K, p[4:], size)
