"""KITTI's ``calib.txt`` and ``calib_cam_to_cam.txt``: projection matrices of rectified cameras.

::

    P0: f 0 cx 0          0 f cy 0     0 0 1 0         # or P_rect_00: in calib_cam_to_cam.txt
    P1: f 0 cx −f·b       0 f cy 0     0 0 1 0
    P2: f 0 cx p_x        0 f cy p_y   0 0 1 p_z
    P3: …

Twelve numbers row by row. Camera 0 is the left grey one, 1 the right grey one, 2 and 3 the colour pair; which pair is
read says ``camera_pair``, "0-1" by default, "2-3" the colour one. All stand in one frame, that of camera 0 rectified,
P_i = K [I | t_i], lengths in METRES, so

    t_i = K⁻¹ p_i with p_i the fourth column,    R = I,    T = t_right − t_left.

P1[0, 3] = −f b. The colour cameras' t have y and z of millimetres, which a rectified pair has not: they are kept, and
T says them. Other lines (Tr:, R0_rect:, and K, D, R, T of the cameras before rectification) are passed over.
``calib_cam_to_cam.txt`` says the image size (S_rect_0i); ``calib.txt`` does not, so that reading takes twice the
principal point and says so. Written is P0 and P1, of a pair that is rectified.

Source: Geiger, Lenz, Stiller, Urtasun, *Vision meets robotics: the KITTI dataset*, IJRR 2013, and its devkits.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from stereocal.base.atomic_files import write_whole
from stereocal.base.checks import Float, require_choice
from stereocal.base.errors import DataFileError, InputError
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig
from stereocal.store.calibration_record import CalibrationRecord, length_in
from stereocal.store.rectified_pairs import as_row, require_rectified
from stereocal.store.structured_text import as_numbers, read_text

TITLE = "KITTI calib.txt"
EXTRA: tuple[str, ...] = ()
CAMERA_PAIRS = ("0-1", "2-3")

_NAME = re.compile(r"\s*(?:P_rect_0|P)([0-3])\s*")
_SIZE = re.compile(r"\s*S_rect_0([0-3])\s*")


def read(path: Path, camera_pair: str | None = None) -> CalibrationRecord:
    """Read two cameras.

    Parameters
    ----------
    path : Path
        The file.
    camera_pair : {"0-1", "2-3"}, optional
        The grey cameras (default) or the colour ones.

    Raises
    ------
    DataFileError
        If their matrices are missing, or are no rectified pair.
    """
    first, second = require_choice(camera_pair or "0-1", CAMERA_PAIRS, "camera_pair").split("-")
    matrices, sizes = _entries(path)
    if not {first, second} <= set(matrices):
        raise DataFileError(path, f"lacks P{first} or P{second}, so it is cut short or of another kind")
    P = [matrices[name] for name in (first, second)]
    if any(np.any(each[[0, 1, 2, 2, 2], [1, 0, 0, 1, 2]] != (0, 0, 0, 0, 1)) for each in P):
        raise DataFileError(path, f"holds a P{first} or P{second} that is no rectified camera")
    if P[0][0, 0] != P[1][0, 0] or P[0][1, 1] != P[1][1, 1] or P[0][1, 2] != P[1][1, 2]:
        raise DataFileError(path, f"holds no rectified pair: P{first} and P{second} differ in f or cy")
    remarks = []
    if first in sizes and sizes[first] == sizes.get(second):
        size = sizes[first]
    else:
        width, height = (round(min(2 * abs(c), 1e5)) + 1 for c in P[0][:2, 2])
        size = width, height
        remarks.append(
            f"The file does not say the image size; {width}x{height} is taken, twice the principal point: check it."
        )
    try:
        cameras = [Camera(each[:, :3], None, size, model="pinhole") for each in P]
        place = [_solve(each[:, :3], each[:, 3]) for each in P]
        rig = StereoRig(cameras[0], cameras[1], np.eye(3), place[1] - place[0])
    except InputError as error:
        raise DataFileError(path, f"is no calibration: {error}") from error
    if rig.T[0] >= 0:
        raise DataFileError(path, f"holds no rectified pair: camera {second} is not to the right of camera {first}")
    if np.abs(rig.T[1:]).max() > 1e-9 * rig.baseline:
        _, y, z = 1000 * rig.T
        remarks.append(f"T has y {y:.2g} mm and z {z:.2g} mm: KITTI's rows of this pair do not meet exactly.")
    return CalibrationRecord(rig, "m", {}, tuple(remarks))


def write(record: CalibrationRecord, path: Path) -> list[Path]:
    """Write P0 and P1 of a rectified pair.

    Raises
    ------
    InputError
        If the rig is not rectified, or the unit of length is unknown.
    """
    rig = require_rectified(record, TITLE)
    factor, _ = length_in("m", record)
    P0 = np.column_stack([rig.left.K, np.zeros(3)])
    P1 = np.column_stack([rig.right.K, [rig.right.fx * rig.T[0] * factor, 0, 0]])
    return [write_whole(path, f"P0: {as_row(P0)}\nP1: {as_row(P1)}\n")]


def remarks_on_writing(record: CalibrationRecord) -> list[str]:
    """Return what changes meaning in this format."""
    return [length_in("m", record)[1], f"{TITLE} has no place for the image size."]


def _entries(path: Path) -> tuple[dict[str, Float], dict[str, tuple[int, int]]]:
    """The projection matrices and image sizes by the camera's number."""
    matrices: dict[str, Float] = {}
    sizes: dict[str, tuple[int, int]] = {}
    for line in read_text(path).splitlines():
        name, colon, words = line.partition(":")
        is_matrix, is_size = _NAME.fullmatch(name), _SIZE.fullmatch(name)
        if not colon or not (is_matrix or is_size):
            continue
        numbers = as_numbers(words.split(), path, name.strip())
        if is_matrix:
            if len(numbers) != 12 or is_matrix[1] in matrices:
                raise DataFileError(path, f"must have P{is_matrix[1]} once, with 12 numbers")
            matrices[is_matrix[1]] = numbers.reshape(3, 4)
        elif is_size:
            if len(numbers) != 2 or (numbers < 1).any() or (numbers > 1e5).any() or (numbers % 1).any():
                raise DataFileError(path, f"has an S_rect_0{is_size[1]} that is no width and height")
            sizes[is_size[1]] = int(numbers[0]), int(numbers[1])
    return matrices, sizes


def _solve(K: Float, p: Float) -> Float:
    """K⁻¹ p of an upper triangular K without skew, exact where p has zeros."""
    return np.array([(p[0] - K[0, 2] * p[2]) / K[0, 0], (p[1] - K[1, 2] * p[2]) / K[1, 1], p[2]])
