"""OpenCV's calibration files, in the layouts of its two samples, as YAML, XML or JSON.

- **Stereo** (``stereo_calib``): M1 D1 M2 D2 R T R1 R2 P1 P2 Q. The sample writes two files, ``intrinsics.yml`` and
  ``extrinsics.yml``; we write one with all of it, its image size and E and F besides, and read either kind. K1, K2,
  cameraMatrix1 and the like, which others write, are read too.
- **One camera** (``calibration``): image_width, image_height, camera_matrix, distortion_coefficients.

The distortion vector is k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [τx τy]]]], of length 4, 5, 8, 12 or 14; a fisheye
camera (four numbers of another meaning) says ``fisheye_model: 1``, as the sample does. X_right = R X_left + T is the
library's own convention, and T is in the units of the board's squares, which the file does not name.
P2[0, 3] = f T_x < 0.

The sample's files do not hold the image size. Read without one, the size is taken as twice the principal point, and
said so. K may hold a skew, which OpenCV's functions ignore. Lenses of other families than OpenCV's are refused.

Source: ``cv2.FileStorage`` itself, and OpenCV's samples ``stereo_calib.cpp`` and ``calibration.cpp``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import DataFileError, InputError
from stereocal.camera.model import Camera
from stereocal.pair.rectification import rectify
from stereocal.pair.rig import StereoRig
from stereocal.store.calibration_record import CalibrationRecord, camera_from_opencv, opencv_distortion
from stereocal.store.opencv_filestorage import as_column, read_storage, write_storage
from stereocal.store.structured_text import Fields

TITLE = "OpenCV FileStorage"
EXTRA = ("rms",)
LENS_PARAMETERS, FISHEYE = 14, True

_LEFT_K, _RIGHT_K = ("M1", "K1", "cameraMatrix1", "camera_matrix_1"), ("M2", "K2", "cameraMatrix2", "camera_matrix_2")
_LEFT_D, _RIGHT_D = ("D1", "distCoeffs1", "dist_coeffs_1"), ("D2", "distCoeffs2", "dist_coeffs_2")
_SINGLE_K = ("camera_matrix", "Camera_Matrix", "K", "M", "cameraMatrix")
_SINGLE_D = ("distortion_coefficients", "Distortion_Coefficients", "D", "distCoeffs")
_SIBLINGS = {"intrinsics": "extrinsics", "extrinsics": "intrinsics"}


def read(path: Path) -> CalibrationRecord:
    """Read a FileStorage calibration, or the sample's pair intrinsics/extrinsics by either name or by their folder.

    Raises
    ------
    DataFileError
        If the file is cut short, hostile, or holds no calibration.
    """
    if path.is_dir():
        path = _intrinsics_in(path)
    fields = Fields(read_storage(path), path)
    if path.stem in _SIBLINGS:
        fields = _join_sibling(fields, path)
    remarks: list[str] = []
    try:
        if any(name in fields for name in _LEFT_K):
            left = _read_camera(fields, _LEFT_K, _LEFT_D, remarks, "left")
            right = _read_camera(fields, _RIGHT_K, _RIGHT_D, remarks, "right")
            if "T" not in fields:
                raise fields.error("holds the cameras, but not R and T; put extrinsics.yml beside it")
            calibration: Camera | StereoRig = StereoRig(
                left, right, fields.matrix(3, 3, "R"), fields.array("T", "t", size=3)
            )
        else:
            calibration = _read_camera(fields, _SINGLE_K, _SINGLE_D, remarks, "camera")
    except InputError as error:
        raise fields.error(f"is no calibration: {error}") from error
    return CalibrationRecord(calibration, None, _scalars(fields), tuple(remarks))


def write(record: CalibrationRecord, path: Path) -> list[Path]:
    """Write the calibration as one FileStorage file, its kind by the ending (.xml, .json, else YAML).

    Raises
    ------
    InputError
        If a camera's model is not one of OpenCV's, or the two cameras differ in image size or family.
    """
    content: dict[str, Any] = {}
    if isinstance(record.calibration, StereoRig):
        rig = record.calibration
        if rig.left.image_size != rig.right.image_size:
            raise InputError(f"{TITLE} holds one image size for both cameras; these differ")
        if (rig.left.model == "fisheye") != (rig.right.model == "fisheye"):
            raise InputError(f"{TITLE} holds two cameras of one family; these are {rig.left.model}, {rig.right.model}")
        content |= _image_size(rig.left)
        for number, camera in (("1", rig.left), ("2", rig.right)):
            content |= {f"M{number}": camera.K, f"D{number}": _distortion(camera)}
        content |= {"R": rig.R, "T": as_column(rig.T), "E": rig.E, "F": rig.F}
        if rig.left.model != "fisheye":  # OpenCV rectifies fisheye pairs by another function
            view = rectify(rig)
            content |= {name: np.asarray(getattr(view, name)) for name in ("R1", "R2", "P1", "P2", "Q")}
    else:
        camera = record.calibration
        content |= _image_size(camera)
        content |= {"camera_matrix": camera.K, "distortion_coefficients": _distortion(camera)}
    rms = record.extra.get("rms")
    if isinstance(rms, (int, float)):
        content["avg_reprojection_error"] = float(rms)
    return [write_storage(path, content)]


def remarks_on_writing(record: CalibrationRecord) -> list[str]:
    """Return what changes meaning in this format."""
    sentences = [
        f"The {side} camera's skew of {camera.K[0, 1]:g} px stands in its matrix, but OpenCV's functions ignore it."
        for side, camera in zip(("left", "right"), record.cameras, strict=False)
        if camera.K[0, 1] != 0
    ]
    if record.is_stereo:
        unit = record.unit or "the board's square_size units"
        sentences.append(f"T stays in {unit}; OpenCV's files do not say the unit.")
    return sentences


def _read_camera(
    fields: Fields, names_K: tuple[str, ...], names_D: tuple[str, ...], remarks: list[str], side: str
) -> Camera:
    K = fields.matrix(3, 3, *names_K)
    dist = fields.array(*names_D, size=(0, 4, 5, 8, 12, 14))
    size = _read_size(fields, K, remarks, side)
    if "fisheye_model" in fields and fields.number("fisheye_model") != 0:
        if len(dist) != 4:
            raise fields.error(f"says fisheye, which has 4 distortion parameters, but has {len(dist)}")
        return Camera(K, dist, size, model="fisheye")
    return camera_from_opencv(K, dist, size)


def _read_size(fields: Fields, K: Float, remarks: list[str], side: str) -> tuple[int, int]:
    if "image_width" in fields and "image_height" in fields:
        return _checked_size(fields, fields.integer("image_width"), fields.integer("image_height"))
    for name in ("image_size", "imageSize", "size"):
        if name in fields:
            return fields.image_size(name)
    width, height = (max(1, round(2 * float(c)) + 1) for c in K[:2, 2])
    remarks.append(
        f"The file does not say the {side} image size; {width}x{height} is taken, twice the principal point: check it."
    )
    return width, height


def _checked_size(fields: Fields, width: int, height: int) -> tuple[int, int]:
    if not (0 < width < 10**6 and 0 < height < 10**6):
        raise fields.error(f"says an image size of {width}x{height}")
    return width, height


def _image_size(camera: Camera) -> dict[str, Any]:
    size: dict[str, Any] = {"image_width": int(camera.image_size[0]), "image_height": int(camera.image_size[1])}
    return size | {"fisheye_model": 1} if camera.model == "fisheye" else size


def _distortion(camera: Camera) -> Float:
    if camera.model == "fisheye":
        return as_column(camera.dist)
    return as_column(opencv_distortion(camera, TITLE)).T


def _intrinsics_in(folder: Path) -> Path:
    for name in ("intrinsics.yml", "intrinsics.yaml", "intrinsics.xml", "calibration.yml"):
        if (folder / name).is_file():
            return folder / name
    raise DataFileError(folder, "holds no intrinsics.yml or calibration.yml")


def _join_sibling(fields: Fields, path: Path) -> Fields:
    other = path.with_name(_SIBLINGS[path.stem] + path.suffix)
    if not other.is_file():
        return fields
    return Fields(read_storage(other) | fields.mapping, path)


def _scalars(fields: Fields) -> dict[str, Any]:
    """Keep the sample's fit error; the derived matrices (R1, P1, Q, E, F) follow from the rig."""
    for name in ("avg_reprojection_error", "Avg_Reprojection_Error"):
        if name in fields:
            return {"rms": fields.number(name)}
    return {}
