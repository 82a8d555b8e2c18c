"""Middlebury 2014's ``calib.txt``: a rectified pair.

::

    cam0=[f 0 cx0; 0 f cy; 0 0 1]
    cam1=[f 0 cx1; 0 f cy; 0 0 1]
    doffs=cx1 − cx0
    baseline=B            (millimetres)
    width=…
    height=…
    ndisp=…               (a bound on the disparities)

Z = B f/(d + doffs). Other lines (isint, vmin, vmax, dyavg, dymax) are passed over; of ndisp, which a calibration does
not know, the image's width is written.

Source: Scharstein et al., *High-resolution stereo datasets with subpixel-accurate ground truth*, GCPR 2014.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from stereocal.base.atomic_files import write_whole
from stereocal.base.checks import Float
from stereocal.base.errors import DataFileError, InputError
from stereocal.store.calibration_record import CalibrationRecord, length_in
from stereocal.store.rectified_pairs import rectified_rig, require_rectified
from stereocal.store.structured_text import Fields, read_text

TITLE = "Middlebury calib.txt"
EXTRA: tuple[str, ...] = ("ndisp",)

_LINE = re.compile(r"^\s*(\w+)\s*=\s*(.*?)\s*$")


def read(path: Path) -> CalibrationRecord:
    """Read a rectified pair.

    Raises
    ------
    DataFileError
        If an entry is missing or the cameras are no rectified pair.
    """
    found = [match.groups() for match in map(_LINE.match, read_text(path).splitlines()) if match]
    entries = {name: re.split(r"[\s;]+", value.strip("[]").strip()) for name, value in found}
    if len(entries) != len(found):
        raise DataFileError(path, "holds an entry twice")
    fields = Fields(entries, path)
    K0, K1 = fields.matrix(3, 3, "cam0"), fields.matrix(3, 3, "cam1")
    same = np.abs(K0 - K1)
    same[0, 2] = 0
    if same.any() or K0[0, 1] or K0[1, 0] or np.any(K0[2] != (0, 0, 1)):
        raise fields.error("holds no rectified pair: cam0 and cam1 may differ in cx only")
    if abs(fields.number("doffs") - (K1[0, 2] - K0[0, 2])) > 0.01:
        raise fields.error("contradicts itself: doffs is not cx1 − cx0")
    size = Fields({"size": [fields.integer("width"), fields.integer("height")]}, path).image_size("size")
    baseline = fields.number("baseline")
    if baseline <= 0:
        raise fields.error(f"has a baseline of {baseline:g}")
    try:
        rig = rectified_rig((K0[0, 0], K0[1, 1]), (K0[0, 2], K1[0, 2]), K0[1, 2], baseline, size)
    except InputError as error:
        raise fields.error(f"is no calibration: {error}") from error
    return CalibrationRecord(rig, "mm", {"ndisp": fields.integer("ndisp")} if "ndisp" in fields else {})


def write(record: CalibrationRecord, path: Path) -> list[Path]:
    """Write a rectified pair.

    Raises
    ------
    InputError
        If the rig is not rectified, or the unit of length is unknown.
    """
    rig = require_rectified(record, TITLE)
    factor, _ = length_in("mm", record)
    width, height = rig.left.image_size
    text = (
        f"cam0={_matrix(rig.left.K)}\ncam1={_matrix(rig.right.K)}\n"
        f"doffs={float(rig.right.cx - rig.left.cx)!r}\nbaseline={float(-rig.T[0] * factor)!r}\n"
        f"width={width}\nheight={height}\nndisp={int(record.extra.get('ndisp', width))}\n"
    )
    return [write_whole(path, text)]


def remarks_on_writing(record: CalibrationRecord) -> list[str]:
    """Return what changes meaning in this format."""
    return [length_in("mm", record)[1], "Depth is baseline · f/(d + doffs): doffs must be added to the disparity."]


def _matrix(K: Float) -> str:
    return "[" + "; ".join(" ".join(repr(float(value)) for value in row) for row in K) + "]"
