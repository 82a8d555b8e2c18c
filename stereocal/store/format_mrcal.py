"""mrcal's ``.cameramodel``: the text of a Python dict, one file a camera.

::

    {
        'lensmodel':  'LENSMODEL_OPENCV5',
        'intrinsics': [fx, fy, cx, cy, k1, k2, p1, p2, k3],
        'extrinsics': [r0, r1, r2, t0, t1, t2],       # rt_cam_ref from mrcal 2.5 on: reference → camera
        'imagersize': [w, h],
    }

LENSMODEL_PINHOLE, OPENCV4, OPENCV5, OPENCV8 and OPENCV12 are OpenCV's models; others (splined, CAHVOR) are refused.
The pose takes points from a reference frame to the camera's, X_cam = R(r) X_ref + t, so the pair's is R = R_r R_lᵀ, T
= t_r − R t_l. A stereo pair is a folder with ``left.cameramodel`` and ``right.cameramodel``, the left one at the
reference.

Files of mrcal before 1.0 name the lens ``distortion_model`` (DISTORTION_OPENCV8) or ``lens_model``; they are read too.
Written is the key ``extrinsics``, which every version reads.

The text is parsed as a literal (``ast.literal_eval``), never run. ``valid_intrinsics_region`` and what mrcal keeps
for its own optimisation are not carried over; a remark says so. Lengths are metres by mrcal's habit, but the file
does not say. Pixel (0, 0) is the first pixel's centre, and there is no skew.

Source: mrcal's documentation, *Camera model representation*, and the models of its own tests.
"""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import numpy as np

from stereocal.base.atomic_files import write_whole
from stereocal.base.checks import Float
from stereocal.base.errors import DataFileError, InputError
from stereocal.base.rotations import rotation_matrix, rotation_vector
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig
from stereocal.store.calibration_record import (
    CalibrationRecord,
    camera_from_opencv,
    camera_matrix,
    opencv_distortion,
    require_no_skew,
)
from stereocal.store.structured_text import Fields, read_text

TITLE = "mrcal .cameramodel"
EXTRA: tuple[str, ...] = ()
LENS_PARAMETERS, FISHEYE = 12, False

_LENSES = {"PINHOLE": 0, "OPENCV4": 4, "OPENCV5": 5, "OPENCV8": 8, "OPENCV12": 12}
_LENS_NAMES = ("lensmodel", "lens_model", "distortion_model")
_KNOWN = {*_LENS_NAMES, "intrinsics", "extrinsics", "rt_cam_ref", "imagersize"}


def read(path: Path) -> CalibrationRecord:
    """Read one camera, or the pair in a folder.

    Raises
    ------
    DataFileError
        If a file is cut short, holds anything but literals, or another lens model.
    """
    remarks: list[str] = []
    if not path.is_dir():
        return CalibrationRecord(_read_camera(path, remarks)[0], None, {}, tuple(remarks))
    left, R_l, t_l = _read_camera(path / "left.cameramodel", remarks)
    right, R_r, t_r = _read_camera(path / "right.cameramodel", remarks)
    R = R_r @ R_l.T
    if R_l.tolist() != np.eye(3).tolist() or t_l.any():
        remarks.append(
            "R and T are composed of both cameras' poses in mrcal's reference frame, which is not the left's."
        )
    return CalibrationRecord(StereoRig(left, right, R, t_r - R @ t_l), None, {}, tuple(remarks))


def write(record: CalibrationRecord, path: Path) -> list[Path]:
    """Write one camera, or a folder with a pair.

    Raises
    ------
    InputError
        If a lens is none of mrcal's OpenCV models, or has a skew.
    """
    if isinstance(record.calibration, Camera):
        return [write_whole(path, _describe(record.calibration, np.zeros(6)))]
    rig = record.calibration
    pose = np.concatenate([rotation_vector(rig.R), rig.T])
    texts = {"left": _describe(rig.left, np.zeros(6)), "right": _describe(rig.right, pose)}
    return [write_whole(path / f"{side}.cameramodel", text) for side, text in texts.items()]


def remarks_on_writing(record: CalibrationRecord) -> list[str]:
    """Return what changes meaning in this format."""
    if not record.is_stereo:
        return []
    unit = record.unit or "the board's square_size units"
    return [f"R is written as a rotation vector; lengths stay in {unit}, mrcal's habit is metres."]


def _describe(camera: Camera, pose: Float) -> str:
    require_no_skew(camera, TITLE)
    dist = opencv_distortion(camera, TITLE, (0, 4, 5, 8, 12) if not camera.dist.any() else (4, 5, 8, 12))
    lens = "PINHOLE" if len(dist) == 0 else f"OPENCV{len(dist)}"
    intrinsics = [camera.fx, camera.fy, camera.cx, camera.cy, *dist]
    return (
        "{\n"
        f"    'lensmodel':  'LENSMODEL_{lens}',\n"
        f"    'intrinsics': {[float(value) for value in intrinsics]},\n"
        f"    'extrinsics': {[float(value) for value in pose]},\n"
        f"    'imagersize': {[int(side) for side in camera.image_size]},\n"
        "}\n"
    )


def _read_camera(path: Path, remarks: list[str]) -> tuple[Camera, Float, Float]:
    fields = Fields(_literal(path), path)
    lens = fields.text(*_LENS_NAMES).removeprefix("LENSMODEL_").removeprefix("DISTORTION_").replace("NONE", "PINHOLE")
    if lens not in _LENSES:
        raise fields.error(f"has the lens model {lens}; {', '.join(_LENSES)} are read")
    numbers = fields.array("intrinsics", size=4 + _LENSES[lens])
    pose = fields.array("rt_cam_ref", "extrinsics", size=6)
    left_out = sorted(str(name) for name in set(fields.mapping) - _KNOWN)
    if left_out:
        remarks.append(f"{path.name} also holds {', '.join(left_out)}, which are not carried over.")
    try:
        camera = camera_from_opencv(camera_matrix(*numbers[:4]), numbers[4:], fields.image_size("imagersize"))
    except InputError as error:
        raise fields.error(f"is no calibration: {error}") from error
    return camera, rotation_matrix(pose[:3]), pose[3:]


def _literal(path: Path) -> Any:
    text = read_text(path).strip()
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError, OverflowError) as error:
        raise DataFileError(path, "is no Python literal, or is cut short; nothing in it was run") from error
