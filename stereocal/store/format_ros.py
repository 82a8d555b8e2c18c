"""ROS ``camera_info`` YAML: one file a camera, ``left.yaml`` and ``right.yaml`` in a folder.

As ``camera_calibration_parsers`` and the calibration tool of ``image_pipeline`` write it::

    image_width: 640
    image_height: 480
    camera_name: left
    camera_matrix:           {rows: 3, cols: 3, data: [fx, 0, cx, 0, fy, cy, 0, 0, 1]}
    distortion_model: plumb_bob                      # or rational_polynomial, equidistant
    distortion_coefficients: {rows: 1, cols: 5, data: [k1, k2, p1, p2, k3]}
    rectification_matrix:    {rows: 3, cols: 3, data: […]}        # R1 or R2
    projection_matrix:       {rows: 3, cols: 4, data: […]}        # P1 or P2, lengths in METRES

``plumb_bob`` has 5 numbers, ``rational_polynomial`` 8, ``equidistant`` (fisheye) 4. One writer in the field says
``cols: 5`` whatever follows: the true count is written, and counted when reading. A file without ``distortion_model``
(the first ones had none) is of plumb_bob, as ``camera_calibration_parsers`` takes it.

**The pose is not in the file**, but follows from the rectification: P2[0, 3] = −f B with B in metres, and

    R = R2ᵀ R1,    T = R2ᵀ (P2[0, 3]/f, P2[1, 3]/f, 0)ᵀ,

because both cameras, turned by R1 and R2, share one orientation and differ by the baseline along x (Bouguet). Written
with all digits, R and T come back to 1e-11 of the baseline.

Of a fisheye pair R1 and R2 are those of ``cv2.fisheye.stereoRectify`` too; focal length and centre of P1 and P2 are
ours, the frame that both cameras fill (OpenCV's fisheye frame depends on a ``balance`` and an ``fov_scale`` that ROS
does not know). Any frame gives back the same R and T.

Source: ``camera_calibration_parsers`` and ``image_pipeline`` of ROS; REP 104, *CameraInfo updates*.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from stereocal.base.atomic_files import write_whole
from stereocal.base.checks import Float
from stereocal.base.errors import DataFileError, InputError
from stereocal.camera.model import Camera
from stereocal.pair.rectification import rectify
from stereocal.pair.rig import StereoRig
from stereocal.store.calibration_record import (
    CalibrationRecord,
    camera_from_opencv,
    length_in,
    opencv_distortion,
    require_no_skew,
)
from stereocal.store.structured_text import Fields, parse_yaml, read_text, spell

TITLE = "ROS camera_info"
EXTRA: tuple[str, ...] = ()
LENS_PARAMETERS, FISHEYE = 8, True

_MODELS = {"plumb_bob": (4, 5), "rational_polynomial": (8,), "equidistant": (4,)}


def read(path: Path) -> CalibrationRecord:
    """Read left.yaml and right.yaml of a folder, the pair that one of them belongs to, or one camera's file.

    Raises
    ------
    DataFileError
        If a file is cut short, hostile, or holds no calibration.
    """
    left, right = _pair_of(path)
    if right is None:
        camera, _, _ = _read_camera(left)
        return CalibrationRecord(camera)
    first, R1, _ = _read_camera(left)
    second, R2, P2 = _read_camera(right)
    try:
        step = np.array([P2[0, 3] / P2[0, 0], P2[1, 3] / P2[1, 1], 0.0])
        rig = StereoRig(first, second, R2.T @ R1, R2.T @ step)
    except InputError as error:
        raise DataFileError(right, f"does not fit {left.name}: {error}") from error
    if rig.baseline == 0:
        raise DataFileError(right, "has no baseline: projection_matrix[0, 3] is 0, so it is a single camera's")
    return CalibrationRecord(rig, "m", {}, ("R and T are recovered from the rectification; lengths are in metres.",))


def write(record: CalibrationRecord, path: Path) -> list[Path]:
    """Write a folder with left.yaml and right.yaml, or one camera's file.

    Raises
    ------
    InputError
        If a camera has a skew or a model that ROS lacks, or the unit of length is unknown.
    """
    if isinstance(record.calibration, Camera):
        camera = record.calibration
        P = np.column_stack([camera.K, np.zeros(3)])
        return [write_whole(path, _describe(camera, "camera", np.eye(3), P))]
    rig = record.calibration
    factor, _ = length_in("m", record)
    # cv2.stereoRectify's frame, that of ROS' own calibration tool, is not made for a fisheye's image
    frame = "common" if "fisheye" in (rig.left.model, rig.right.model) else "opencv"
    view = rectify(StereoRig(rig.left, rig.right, rig.R, rig.T * factor), view=frame)
    texts = {
        "left.yaml": _describe(rig.left, "left", view.R1, view.P1),
        "right.yaml": _describe(rig.right, "right", view.R2, view.P2),
    }
    return [write_whole(path / name, text) for name, text in texts.items()]


def remarks_on_writing(record: CalibrationRecord) -> list[str]:
    """Return what changes meaning in this format."""
    if not record.is_stereo:
        return []
    _, sentence = length_in("m", record)
    return [
        sentence,
        "R and T are not stored as such: they stand in both rectification matrices and in projection_matrix[0, 3] of "
        "right.yaml, which is minus focal length times baseline, in metres.",
    ]


def _describe(camera: Camera, name: str, R: Float, P: Float) -> str:
    require_no_skew(camera, TITLE)
    if camera.model == "fisheye":
        model, dist = "equidistant", camera.dist
    else:
        dist = opencv_distortion(camera, TITLE, (5, 8))
        model = "plumb_bob" if len(dist) == 5 else "rational_polynomial"
    lines = [
        f"image_width: {camera.image_size[0]}",
        f"image_height: {camera.image_size[1]}",
        f"camera_name: {name}",
        *_matrix("camera_matrix", camera.K),
        f"distortion_model: {model}",
        *_matrix("distortion_coefficients", dist[None]),
        *_matrix("rectification_matrix", R),
        *_matrix("projection_matrix", P),
    ]
    return "\n".join(lines) + "\n"


def _matrix(name: str, values: Float) -> list[str]:
    numbers = ", ".join(map(spell, values.ravel()))
    return [f"{name}:", f"  rows: {values.shape[0]}", f"  cols: {values.shape[1]}", f"  data: [{numbers}]"]


def _pair_of(path: Path) -> tuple[Path, Path | None]:
    if path.is_dir():
        left, right = path / "left.yaml", path / "right.yaml"
        if not (left.is_file() and right.is_file()):
            raise DataFileError(path, "holds no left.yaml and right.yaml")
        return left, right
    for word, other in (("left", "right"), ("right", "left")):
        if word in path.name:
            partner = path.with_name(path.name.replace(word, other))
            if partner.is_file():
                return (path, partner) if word == "left" else (partner, path)
    return path, None


def _read_camera(path: Path) -> tuple[Camera, Float, Float]:
    fields = Fields(parse_yaml(read_text(path), path), path)
    size = fields.image_size("image_size") if "image_size" in fields else _size(fields)
    # without one, ROS' own parser takes plumb_bob: its first files had no such entry
    model = fields.text("distortion_model") if "distortion_model" in fields else "plumb_bob"
    if model not in _MODELS:
        raise fields.error(f"has the distortion model {model!r}; known are {', '.join(_MODELS)}")
    K = _data(fields, "camera_matrix", (9,)).reshape(3, 3)
    dist = _data(fields, "distortion_coefficients", _MODELS[model])
    R = _data(fields, "rectification_matrix", (9,)).reshape(3, 3)
    P = _data(fields, "projection_matrix", (12,)).reshape(3, 4)
    if P[0, 0] <= 0 or P[1, 1] <= 0:
        raise fields.error("has a projection_matrix without focal length")
    try:
        camera: Any = Camera(K, dist, size, model="fisheye") if model == "equidistant" else None
        return camera or camera_from_opencv(K, dist, size), R, P
    except InputError as error:
        raise fields.error(f"is no calibration: {error}") from error


def _size(fields: Fields) -> tuple[int, int]:
    sizes = Fields({"size": [fields.integer("image_width"), fields.integer("image_height")]}, fields.path)
    return sizes.image_size("size")


def _data(fields: Fields, name: str, sizes: tuple[int, ...]) -> Float:
    """The numbers under ``name.data``, however many ``cols`` claims."""
    return fields.fields(name).array("data", size=sizes)
