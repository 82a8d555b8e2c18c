"""BoofCV's ``stereo.yaml`` and single-camera YAML.

::

    left, right: {model: pinhole_radial_tangential,
                  pinhole: {fx, fy, cx, cy, width, height, skew},
                  radial_tangential: {radial: [k1, k2, …], t1, t2}}
    model: stereo_camera
    rightToLeft: {rotation: 9 numbers row by row, x, y, z}

**rightToLeft is the inverse direction**: X_left = R' X_right + T'. So R = R'ᵀ, T = −R'ᵀ T', and x is positive for a
left-first rig. The unit is that of the squares.

BoofCV's radial k1, k2, k3 are OpenCV's; its (t1, t2) are OpenCV's (p1, p2): both write x_t = 2 t1 x y + t2 (r² + 2 x²).
BoofCV's pixel (0, 0), as OpenCV's, is taken as the first pixel's centre. Here, unlike in ROS or Kalibr, the skew has a
place. More than three radial terms are refused, for they are terms r⁸ and up, which no model here has.

Source: a file that BoofCV wrote of its Bumblebee2 photographs.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stereocal.base.atomic_files import write_whole
from stereocal.base.errors import InputError
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig
from stereocal.store.calibration_record import CalibrationRecord, camera_matrix, opencv_distortion
from stereocal.store.structured_text import Fields, parse_yaml, read_text, spell

TITLE = "BoofCV YAML"
EXTRA: tuple[str, ...] = ()
LENS_PARAMETERS, FISHEYE = 5, False


def read(path: Path) -> CalibrationRecord:
    """Read a BoofCV stereo or single-camera calibration.

    Raises
    ------
    DataFileError
        If it is cut short, hostile, or of another model.
    """
    fields = Fields(parse_yaml(read_text(path), path), path)
    try:
        if fields.text("model") != "stereo_camera":
            return CalibrationRecord(_read_camera(fields))
        left, right = _read_camera(fields.fields("left")), _read_camera(fields.fields("right"))
        pose = fields.fields("rightToLeft")
        R = pose.matrix(3, 3, "rotation").T
        T = -R @ np.array([pose.number(axis) for axis in "xyz"])
        remark = "BoofCV stores the pose right to left; R and T are its inverse, left to right."
        return CalibrationRecord(StereoRig(left, right, R, T), None, {}, (remark,))
    except InputError as error:
        raise fields.error(f"is no calibration: {error}") from error


def write(record: CalibrationRecord, path: Path) -> list[Path]:
    """Write a BoofCV calibration.

    Raises
    ------
    InputError
        If a lens needs more than three radial and two tangential parameters.
    """
    if isinstance(record.calibration, Camera):
        return [write_whole(path, "\n".join(_describe(record.calibration, "")) + "\n")]
    rig = record.calibration
    back = rig.R.T
    place = -back @ rig.T
    lines = ["left:", *_describe(rig.left, "  "), "model: stereo_camera", "rightToLeft:", "  rotation:"]
    lines += [f"  - {spell(value)}" for value in back.ravel()]
    lines += [f"  {axis}: {spell(value)}" for axis, value in zip("xyz", place, strict=True)]
    lines += ["right:", *_describe(rig.right, "  ")]
    return [write_whole(path, "\n".join(lines) + "\n")]


def remarks_on_writing(record: CalibrationRecord) -> list[str]:
    """Return what changes meaning in this format."""
    if not record.is_stereo:
        return []
    unit = record.unit or "the board's square_size units"
    return [f"The pose is written right to left, the inverse of R and T; lengths stay in {unit}."]


def _describe(camera: Camera, indent: str) -> list[str]:
    k1, k2, p1, p2, k3 = opencv_distortion(camera, TITLE, (5,))
    numbers = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy, "skew": camera.skew}
    lines = ["model: pinhole_radial_tangential", "pinhole:"]
    lines += [f"  {name}: {spell(value)}" for name, value in numbers.items()]
    lines += [
        f"  width: {camera.image_size[0]}",
        f"  height: {camera.image_size[1]}",
        "radial_tangential:",
        "  radial:",
    ]
    lines += [f"  - {spell(k)}" for k in (k1, k2, k3)]
    lines += [f"  t1: {spell(p1)}", f"  t2: {spell(p2)}"]
    return [indent + line for line in lines]


def _read_camera(fields: Fields) -> Camera:
    model = fields.text("model")
    pinhole = fields.fields("pinhole")
    size = Fields({"size": [pinhole.integer("width"), pinhole.integer("height")]}, fields.path).image_size("size")
    K = camera_matrix(*(pinhole.number(name) for name in ("fx", "fy", "cx", "cy", "skew")))
    if model == "pinhole":
        return Camera(K, None, size, model="pinhole")
    if model != "pinhole_radial_tangential":
        raise fields.error(f"has the camera model {model!r}; pinhole_radial_tangential is read")
    lens = fields.fields("radial_tangential")
    radial = lens.array("radial") if lens.value("radial") else np.zeros(0)
    if len(radial) > 3 and np.any(radial[3:]):
        raise fields.error(f"has {len(radial)} radial terms; up to three are read")
    k1, k2, k3 = np.concatenate([radial[:3], np.zeros(max(0, 3 - len(radial)))])
    return Camera(K, [k1, k2, lens.number("t1"), lens.number("t2"), k3], size, model="brown")
