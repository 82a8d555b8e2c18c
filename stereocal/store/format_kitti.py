"""KITTI's ``calib.txt``: projection matrices of rectified cameras.

::

    P0: f 0 cx 0       0 f cy 0  0 0 1 0
    P1: f 0 cx −f·b    0 f cy 0  0 0 1 0

Twelve numbers row by row; camera 0 is the left grey one, 1 the right grey one (2 and 3, the colour pair, are not read).
P1[0, 3] = −f b, lengths in METRES. Other lines (Tr:, R0_rect:) are passed over. The file does not say the image size:
reading takes twice the principal point and says so.

Source: Geiger, Lenz, Urtasun, *Are we ready for autonomous driving?*, CVPR 2012; the odometry devkit.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from stereocal.base.atomic_files import write_whole
from stereocal.base.errors import DataFileError, InputError
from stereocal.store.calibration_record import CalibrationRecord, length_in
from stereocal.store.rectified_pairs import as_row, rectified_rig, require_rectified
from stereocal.store.structured_text import as_numbers, read_text

TITLE = "KITTI calib.txt"
EXTRA: tuple[str, ...] = ()


def read(path: Path) -> CalibrationRecord:
    """Read cameras 0 and 1.

    Raises
    ------
    DataFileError
        If P0 or P1 is missing, or they are no rectified pair.
    """
    matrices = {}
    for line in read_text(path).splitlines():
        name, colon, words = line.partition(":")
        if colon and name.strip() in ("P0", "P1"):
            numbers = as_numbers(words.split(), path, name.strip())
            if len(numbers) != 12 or name.strip() in matrices:
                raise DataFileError(path, f"must have {name.strip()} once, with 12 numbers")
            matrices[name.strip()] = numbers.reshape(3, 4)
    if set(matrices) != {"P0", "P1"}:
        raise DataFileError(path, "lacks P0 or P1, so it is cut short or no KITTI calibration")
    P0, P1 = matrices["P0"], matrices["P1"]
    if P0[0, 0] != P1[0, 0] or P0[1, 1] != P1[1, 1] or P0[1, 2] != P1[1, 2] or P0[0, 3] != 0 or P1[0, 3] >= 0:
        raise DataFileError(path, "holds no rectified pair: P0 and P1 differ in more than cx and −f·b")
    if any(np.any(P[[0, 1, 1, 2, 2, 2, 2], [1, 0, 3, 0, 1, 2, 3]] != (0, 0, 0, 0, 0, 1, 0)) for P in (P0, P1)):
        raise DataFileError(path, "holds a P0 or P1 that is no rectified camera")
    size = max(1, round(2 * P0[0, 2]) + 1), max(1, round(2 * P0[1, 2]) + 1)
    try:
        rig = rectified_rig((P0[0, 0], P0[1, 1]), (P0[0, 2], P1[0, 2]), P0[1, 2], -P1[0, 3] / P0[0, 0], size)
    except InputError as error:
        raise DataFileError(path, f"is no calibration: {error}") from error
    return CalibrationRecord(
        rig,
        "m",
        {},
        (f"The file does not say the image size; {size[0]}x{size[1]} is taken, twice the principal point: check it.",),
    )


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
