"""Kalibr's ``camchain.yaml``: cameras in a chain, each with the pose from the one before.

::

    cam0:
      camera_model: pinhole
      intrinsics: [fu, fv, pu, pv]
      distortion_model: radtan                 # or equidistant
      distortion_coeffs: [k1, k2, p1, p2]      # radtan; [k1, k2, k3, k4] equidistant
      resolution: [w, h]
      cam_overlaps: [1]
      rostopic: /cam0/image_raw
    cam1:
      T_cn_cnm1: 4x4, cam0 → cam1, METRES
      …

T_cn_cnm1 = [R T; 0 1] is the library's own convention X_right = R X_left + T, in metres. ``radtan`` is OpenCV's model
without k3: a lens with a k3 is refused, because dropping it would move pixels (by 100 at the corners of a wide
webcam's image). Asked to (``refit=True``, ``convert --refit``), the best lens of four parameters is fitted over the
image, and its misfit is said (:mod:`~stereocal.store.lens_refit`). ``equidistant`` is the fisheye model
(Kannala–Brandt, four parameters). Kalibr's pinhole has no skew; its ``omni``, ``ds`` and ``eucm`` cameras are not read.
The pixel (0, 0) is the first pixel's centre, as here. Entries of the IMU (T_cam_imu, timeshift_cam_imu) are passed
over.

Source: Kalibr's wiki, *YAML formats*; conventions as in ``aslam_cv``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stereocal.base.atomic_files import write_whole
from stereocal.base.checks import Float
from stereocal.base.errors import InputError
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig
from stereocal.store.calibration_record import (
    CalibrationRecord,
    camera_from_opencv,
    camera_matrix,
    length_in,
    opencv_distortion,
    require_no_skew,
)
from stereocal.store.structured_text import Fields, parse_yaml, read_text, spell

TITLE = "Kalibr camchain"
EXTRA: tuple[str, ...] = ()
LENS_PARAMETERS, FISHEYE = 4, True


def read(path: Path) -> CalibrationRecord:
    """Read a camchain of one or two cameras.

    Raises
    ------
    DataFileError
        If it is cut short, hostile, of more cameras, or of models that are not known.
    """
    fields = Fields(parse_yaml(read_text(path), path), path)
    if "cam2" in fields:
        raise fields.error("is a chain of more than two cameras; cut it to the pair that you need")
    try:
        left = _read_camera(fields.fields("cam0"))
        if "cam1" not in fields:
            if fields.mapping["cam0"].get("cam_overlaps"):
                raise fields.error("lacks cam1, which cam0 overlaps, so it is cut short")
            return CalibrationRecord(left)
        right = fields.fields("cam1")
        pose = right.matrix(4, 4, "T_cn_cnm1")
        if not np.array_equal(pose[3], (0, 0, 0, 1)):
            raise fields.error("has a T_cn_cnm1 that is no pose: its last row is not 0 0 0 1")
        return CalibrationRecord(StereoRig(left, _read_camera(right), pose[:3, :3], pose[:3, 3]), "m")
    except InputError as error:
        raise fields.error(f"is no calibration: {error}") from error


def write(record: CalibrationRecord, path: Path) -> list[Path]:
    """Write a camchain.

    Raises
    ------
    InputError
        If a lens needs more than radtan's four parameters, has a skew, or the unit of length is unknown.
    """
    cameras = record.cameras
    lines: list[str] = []
    for number, camera in enumerate(cameras):
        lines.append(f"cam{number}:")
        lines += [f"  cam_overlaps: [{1 - number}]"] if len(cameras) == 2 else ["  cam_overlaps: []"]
        lines += _describe(camera)
        lines += [f"  rostopic: /cam{number}/image_raw"]
        if number == 1:
            rig = record.require_stereo(TITLE)
            factor, _ = length_in("m", record)
            lines.append("  T_cn_cnm1:")
            for row in np.vstack([np.column_stack([rig.R, rig.T * factor]), [0, 0, 0, 1]]):
                lines.append(f"  - {_list(row)}")
    return [write_whole(path, "\n".join(lines) + "\n")]


def remarks_on_writing(record: CalibrationRecord) -> list[str]:
    """Return what changes meaning in this format."""
    return [length_in("m", record)[1]] if record.is_stereo else []


def _describe(camera: Camera) -> list[str]:
    require_no_skew(camera, TITLE)
    if camera.model == "fisheye":
        model, dist = "equidistant", camera.dist
    else:
        model, dist = "radtan", opencv_distortion(camera, f"{TITLE} (radtan, without k3)", (4,))
    return [
        "  camera_model: pinhole",
        f"  intrinsics: {_list(np.array([camera.fx, camera.fy, camera.cx, camera.cy]))}",
        f"  distortion_model: {model}",
        f"  distortion_coeffs: {_list(dist)}",
        f"  resolution: [{camera.image_size[0]}, {camera.image_size[1]}]",
    ]


def _list(values: Float) -> str:
    return "[" + ", ".join(map(spell, values)) + "]"


def _read_camera(fields: Fields) -> Camera:
    if fields.text("camera_model") != "pinhole":
        raise fields.error(f"{fields.where} is {fields.text('camera_model')}; only Kalibr's pinhole is read")
    K = camera_matrix(*fields.array("intrinsics", size=4))
    size = fields.image_size("resolution")
    model = fields.text("distortion_model")
    if model == "none":
        return Camera(K, None, size, model="pinhole")
    if model not in ("radtan", "equidistant"):
        raise fields.error(f"{fields.where} has the distortion model {model!r}; radtan and equidistant are read")
    dist = fields.array("distortion_coeffs", size=4)
    return Camera(K, dist, size, model="fisheye") if model == "equidistant" else camera_from_opencv(K, dist, size)
