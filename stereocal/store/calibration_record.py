"""What stands between two formats: the cameras, the unit of length, and whatever else the file knew.

Every format is read into one :class:`CalibrationRecord` in the library's own conventions (X_right = R X_left + T, pixel
(0, 0) the centre of the first pixel, OpenCV's order of distortion parameters) and written from it; n formats need 2n
functions, not n². What a format cannot hold is refused by :class:`~stereocal.base.errors.InputError`, never dropped:
a distortion model, a skew, a second camera, a length whose unit nobody knows.

**The unit of T.** The library works in units of the board's squares, and OpenCV's files do not say more. ROS, Kalibr
and KITTI demand metres, MATLAB and Middlebury millimetres. So a record carries a unit if it is known; if it is not,
:func:`length_in` takes the baseline for what people type (25 for a 25 mm square gives a baseline of tens to thousands,
0.025 one below 1) and says so, and refuses where that is ambiguous.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import InputError
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig

METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254}
"""Units of length, in metres."""

_ADVICE = "refit=True (convert --refit) fits a lens that it can hold, and says how far off that is"

OPENCV_MODELS = {"pinhole": 0, "brown": 5, "rational": 8, "thin_prism": 12, "tilted": 14}
"""The models of OpenCV's distortion vector and their number of parameters; each begins like the one before."""


@dataclass(frozen=True)
class CalibrationRecord:
    """A calibration on its way between two files.

    Attributes
    ----------
    calibration : Camera or StereoRig
        In the library's conventions.
    unit : {"m", "cm", "mm", "in"} or None
        The unit of T; None if the file does not say.
    extra : dict
        What else the file held (errors, pairs, covariance), as plain data.
    remarks : tuple of str
        What changed meaning while reading, a sentence each.
    """

    calibration: Camera | StereoRig
    unit: str | None = None
    extra: dict[str, Any] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The one or two cameras, left first."""
        if isinstance(self.calibration, StereoRig):
            return self.calibration.left, self.calibration.right
        return (self.calibration,)

    @property
    def is_stereo(self) -> bool:
        """Whether there are two cameras."""
        return isinstance(self.calibration, StereoRig)

    def require_stereo(self, title: str) -> StereoRig:
        """Return the rig, or refuse in the name of a format that holds pairs only."""
        if not isinstance(self.calibration, StereoRig):
            raise InputError(f"{title} holds stereo pairs; this calibration is of one camera")
        return self.calibration

    def with_remarks(self, *sentences: str) -> CalibrationRecord:
        """Return a copy with sentences added."""
        return replace(self, remarks=(*self.remarks, *sentences))


def length_in(unit: str, record: CalibrationRecord) -> tuple[float, str]:
    """Return the factor from the record's lengths to `unit`, and a sentence that says what was taken.

    Raises
    ------
    InputError
        If the record's unit is not known and cannot be told from the baseline.
    """
    rig = record.require_stereo("a length")
    known = record.unit
    baseline = float(np.linalg.norm(rig.T))
    if known is None:
        if 10 <= baseline <= 5000:
            known, reason = "mm", "no unit is stored, and it is of the size of millimetres"
        elif 0.005 <= baseline <= 1:
            known, reason = "m", "no unit is stored, and it is of the size of metres"
        else:
            raise InputError(
                f"the unit of the baseline {baseline:g} is not known, but this format needs {unit}; name it (mm, m)"
            )
    else:
        reason = ""
    factor = METRES[known] / METRES[unit]
    said = f"The baseline {baseline:g} {known}{f' ({reason})' if reason else ''} is written as "
    return factor, said + ("it is." if factor == 1 else f"{baseline * factor:g} {unit}.")


def require_unit(unit: str | None) -> str | None:
    """Return a unit of length that is known, or None."""
    if unit is not None and unit not in METRES:
        raise InputError(f"unit must be one of {', '.join(METRES)}, not {unit!r}")
    return unit


def opencv_distortion(camera: Camera, title: str, sizes: tuple[int, ...] = (5, 8, 12, 14)) -> Float:
    """Return k1 k2 p1 p2 k3 … zero-padded to the shortest of `sizes` that holds the camera's model.

    Raises
    ------
    InputError
        If the camera's model is not one of OpenCV's polynomial family, or needs more parameters than the format has.
    """
    if camera.model not in (*OPENCV_MODELS, "polynomial"):
        raise InputError(f"{title} cannot hold the distortion model {camera.model}; {_ADVICE}")
    dist = camera.dist
    needed = parameters_needed(camera)
    if len(dist) in sizes:
        return dist.copy()
    for size in sizes:
        if size >= needed:
            return np.concatenate([dist[:size], np.zeros(max(0, size - len(dist)))])
    raise InputError(
        f"{title} holds at most {sizes[-1]} distortion parameters; this {camera.model} lens has {needed}; {_ADVICE}"
    )


def parameters_needed(camera: Camera) -> int:
    """Return how many of its distortion parameters count: those up to the last that is not 0."""
    return int(np.flatnonzero(camera.dist)[-1]) + 1 if camera.dist.any() else 0


def camera_from_opencv(K: Float, dist: Float, image_size: tuple[int, int]) -> Camera:
    """Return a camera of the smallest model that holds OpenCV's distortion vector of 0, 4, 5, 8, 12 or 14 numbers."""
    for model, size in OPENCV_MODELS.items():
        if len(dist) <= size:
            padded = np.concatenate([dist, np.zeros(size - len(dist))])
            return Camera(K, padded, image_size, model=model)
    raise InputError(f"OpenCV's distortion has up to 14 parameters, not {len(dist)}")


def require_no_skew(camera: Camera, title: str) -> None:
    """Refuse a camera whose K has a skew, in the name of a format that has no place for it."""
    if camera.K[0, 1] != 0:
        raise InputError(f"{title} has no skew; this camera's is {camera.K[0, 1]:g} px")


def camera_matrix(fx: float, fy: float, cx: float, cy: float, skew: float = 0.0) -> Float:
    """Return K = [[fx, s, cx], [0, fy, cy], [0, 0, 1]]."""
    return np.array([[fx, skew, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
