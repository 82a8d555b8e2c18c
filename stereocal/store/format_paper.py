"""The npz of the paper's own code: rectification maps and Q, from which the rig is found again.

The file holds ``imageSize``, ``leftMapX``, ``leftMapY``, ``rightMapX``, ``rightMapY``, ``leftCameraMatrix``,
``rightCameraMatrix``, ``dispartityToDepthMap`` (Q, so spelt), ``leftROI`` and ``rightROI``: what a disparity map needs,
but neither lens nor pose. Both are in the maps. A map says from which pixel of the photograph each pixel (u, v) of the
rectified picture comes,

    m(u, v) = K distort(Rᵢᵀ ((u − cx)/f, (v − cy)/f, 1)ᵀ; k),

and f, cx, cy stand in Q. So k (five numbers) and the rotation Rᵢ (three) are fitted to the map by least squares, on a
grid of its pixels; the maps are float32, hence exact to 3e-5 px, and the fit recovers the lens to 1e-6. With R₁ and
R₂,

    R = R₂ᵀ R₁,   T = R₂ᵀ (T_x, 0, 0)ᵀ,   −1/T_x = Q[3, 2].

A map that OpenCV's five-parameter lens does not explain to 0.01 px is refused: it is of another lens, or damaged.

The file is read with ``allow_pickle=False``: an npz may hold pickles, which are programs. A zip that unpacks to more
than half a gigabyte is refused.
"""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from stereocal.base.atomic_files import write_whole
from stereocal.base.checks import Float
from stereocal.base.errors import DataFileError, InputError
from stereocal.base.least_squares import minimize_least_squares
from stereocal.base.rotations import rotation_matrix
from stereocal.camera.distortion import distort_normalized
from stereocal.camera.model import Camera
from stereocal.pair.rectification import rectify
from stereocal.pair.rig import StereoRig
from stereocal.store.calibration_record import CalibrationRecord, opencv_distortion, require_no_skew

TITLE = "the paper's npz"
EXTRA: tuple[str, ...] = ()
LENS_PARAMETERS, FISHEYE = 5, False

MAX_UNPACKED = 512 * 2**20
"""The largest content that is unpacked, bytes."""

# of damaged archives; RuntimeError is zipfile's word for encrypted ones and those of a later version
_WHAT_NUMPY_RAISES = (
    ValueError,
    KeyError,
    EOFError,
    SyntaxError,
    MemoryError,
    RuntimeError,
    TypeError,
    OverflowError,
    struct.error,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)
_LARGEST_MISFIT = 0.01
_ALPHA = 0.25
"""How much of the photographs' border the paper's code keeps (stereoRectify's alpha)."""


def read(path: Path) -> CalibrationRecord:
    """Read the npz and find the rig that made its maps.

    Raises
    ------
    DataFileError
        If it is cut short, holds pickles, unpacks to too much, or its maps are of no five-parameter lens.
    """
    arrays = _load(path)
    size, reprojection = (_take(arrays, name, path) for name in ("imageSize", "dispartityToDepthMap"))
    try:
        width, height = (int(side) for side in np.ravel(size))
        Q = np.asarray(reprojection, dtype=np.float64).reshape(4, 4)
    except (TypeError, ValueError) as error:
        raise DataFileError(path, "holds an imageSize or dispartityToDepthMap of the wrong shape") from error
    if not np.isfinite(Q).all() or Q[2, 3] <= 0 or Q[3, 2] == 0:
        raise DataFileError(path, "holds a dispartityToDepthMap that is none")
    f, baseline = Q[2, 3], -1 / Q[3, 2]
    centres = -Q[0, 3], -Q[0, 3] - Q[3, 3] * baseline
    try:
        found = [
            _fit_map(arrays, side, (width, height), f, cx, -Q[1, 3], path)
            for side, cx in zip(("left", "right"), centres, strict=True)
        ]
        (left, R1, misfit_left), (right, R2, misfit_right) = found
        rig = StereoRig(left, right, R2.T @ R1, R2.T @ [baseline, 0, 0])
    except InputError as error:
        raise DataFileError(path, f"is no calibration: {error}") from error
    misfit = max(misfit_left, misfit_right)
    remark = f"Lens, R and T are fitted to the rectification maps; they explain the maps to {misfit:.1e} px."
    return CalibrationRecord(rig, None, {}, (remark,))


def write(record: CalibrationRecord, path: Path) -> list[Path]:
    """Write maps, camera matrices and Q, rectified as the paper's code does (alpha 0.25).

    Raises
    ------
    InputError
        If a lens has more than OpenCV's five parameters, or the image sizes differ: reading could not find it again.
    """
    rig = record.require_stereo(TITLE)
    for camera in record.cameras:
        opencv_distortion(camera, TITLE, (5,))
        require_no_skew(camera, TITLE)
    if rig.left.image_size != rig.right.image_size:
        raise InputError(f"{TITLE} holds one image size for both cameras; these differ")
    view = rectify(rig, alpha=_ALPHA)
    if view.axis != 0:
        raise InputError(f"{TITLE} holds pairs side by side; this rig is one above the other")
    (left_x, left_y), (right_x, right_y) = view.maps()
    arrays = {
        "imageSize": np.array(rig.left.image_size),
        "leftMapX": left_x,
        "leftMapY": left_y,
        "leftROI": np.array(view.roi1),
        "rightMapX": right_x,
        "rightMapY": right_y,
        "rightROI": np.array(view.roi2),
        "leftCameraMatrix": rig.left.K,
        "rightCameraMatrix": rig.right.K,
        "dispartityToDepthMap": view.Q,
    }

    def save(stream: BinaryIO) -> None:
        np.savez_compressed(stream, allow_pickle=False, **arrays)

    return [write_whole(path, save)]


def remarks_on_writing(record: CalibrationRecord) -> list[str]:
    """Return what changes meaning in this format."""
    return [
        "Distortion, R and T are not stored as such: they are in the rectification maps (alpha 0.25), in float32.",
        f"Lengths stay in {record.unit or 'the square_size units of the board'}; the file does not say the unit.",
    ]


def _load(path: Path) -> dict[str, Any]:
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(item.file_size for item in archive.infolist()) > MAX_UNPACKED:
                raise DataFileError(path, f"unpacks to more than {MAX_UNPACKED >> 20} MB; it is not read")
            if any(item.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for item in archive.infolist()):
                raise DataFileError(path, "is packed in a way that NumPy does not write; it is not read")
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except DataFileError:
        raise
    except OSError as error:
        raise DataFileError(path, f"cannot be read ({error.strerror or 'cut short'})") from error
    except _WHAT_NUMPY_RAISES as error:
        raise DataFileError(path, "is no npz of plain arrays, or is cut short; nothing in it was run") from error


def _take(arrays: dict[str, Any], name: str, path: Path) -> Any:
    if name not in arrays:
        raise DataFileError(path, f"lacks the entry {name}, so it is cut short or of another kind")
    return arrays[name]


def _fit_map(
    arrays: dict[str, Any], side: str, size: tuple[int, int], f: float, cx: float, cy: float, path: Path
) -> tuple[Camera, Float, float]:
    """Fit k and R to the map m(u, v); return the camera, R and the largest misfit in pixels."""
    maps = [np.asarray(_take(arrays, f"{side}Map{axis}", path)) for axis in "XY"]
    K = np.asarray(_take(arrays, f"{side}CameraMatrix", path), dtype=np.float64)
    if any(each.dtype != np.float32 or each.ndim != 2 or each.size == 0 for each in maps) or K.shape != (3, 3):
        raise DataFileError(path, f"holds {side} maps or a camera matrix of the wrong kind (float32 maps are read)")
    if maps[0].shape != maps[1].shape:
        raise DataFileError(path, f"holds {side} maps of different shapes")
    rows, columns = np.meshgrid(*(_grid(length) for length in maps[0].shape), indexing="ij")
    seen = np.stack([each[rows, columns].ravel() for each in maps], axis=1).astype(np.float64)
    # where the map points into the photograph; beyond, a lens model may bend back
    inside = np.isfinite(seen).all(axis=1) & (seen >= 0).all(axis=1) & (seen <= np.array(size) - 1).all(axis=1)
    rays = np.stack([(columns.ravel() - cx) / f, (rows.ravel() - cy) / f, np.ones(rows.size)], axis=1)[inside]
    if len(rays) < 50:
        raise DataFileError(path, f"holds a {side} map that shows next to nothing of the photograph")
    target = seen[inside]

    def residuals(x: Float) -> Float:
        local = rays @ rotation_matrix(x[:3])
        if local[:, 2].min() <= 0:
            return np.full(target.size, np.nan)
        drawn = distort_normalized(local[:, :2] / local[:, 2:], x[3:], "brown")
        return np.asarray((drawn @ K[:2, :2].T + K[:2, 2] - target).ravel())

    fit = minimize_least_squares(residuals, np.zeros(8))
    misfit = float(np.abs(residuals(fit.x)).max())
    if not misfit <= _LARGEST_MISFIT:
        raise DataFileError(path, f"holds a {side} map that no five-parameter lens explains ({misfit:.2g} px off)")
    return Camera(K, fit.x[3:], size, model="brown"), rotation_matrix(fit.x[:3]), misfit


def _grid(length: int) -> Any:
    return np.unique(np.linspace(0, length - 1, 40).round().astype(int))
