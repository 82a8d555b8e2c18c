"""What the rectified formats (KITTI, Middlebury) can hold: two pinholes side by side.

Both describe a pair that is rectified already: no distortion, no rotation, the right camera displaced along x, the same
focal length and the same row of the principal point. A rig that is not like that is refused: its photographs would have
to be rectified first, and then it is these that the file describes.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import InputError
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig
from stereocal.store.calibration_record import CalibrationRecord, camera_matrix

_TINY = 1e-9


def require_rectified(record: CalibrationRecord, title: str) -> StereoRig:
    """Return the rig if it is rectified, or refuse in the name of a format."""
    rig = record.require_stereo(title)
    same = np.abs(rig.left.K - rig.right.K)
    same[0, 2] = 0
    if (
        any(camera.dist.any() or camera.skew for camera in record.cameras)
        or np.abs(rig.R - np.eye(3)).max() > _TINY
        or np.abs(rig.T[1:]).max() > _TINY * rig.baseline
        or rig.T[0] >= 0
        or same.max() > _TINY * rig.left.fx
        or rig.left.image_size != rig.right.image_size
    ):
        raise InputError(
            f"{title} describes rectified images; rectify this rig's photographs first (stereocal rectify)"
        )
    return rig


def rectified_rig(
    f: tuple[float, float], cx: tuple[float, float], cy: float, baseline: float, size: tuple[int, int]
) -> StereoRig:
    """Return two pinholes of focal lengths f = (fx, fy), principal points (cx[0], cy) and (cx[1], cy), side by side."""
    cameras = [Camera(camera_matrix(f[0], f[1], c, cy), None, size, model="pinhole") for c in cx]
    return StereoRig(cameras[0], cameras[1], np.eye(3), [-baseline, 0.0, 0.0])


def as_row(values: Float) -> str:
    """Return numbers with all their digits, a space between."""
    return " ".join(repr(float(value)) for value in np.ravel(values))
