"""Benchmarks of maps, remap and rectification beside OpenCV.

Both sides write into arrays that they are given: fresh memory costs a page fault every 4 KB, on some machines more than
the maps themselves, and blurs the comparison.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from stereocal.base.rotations import rotation_matrix
from stereocal.camera.model import Camera
from stereocal.camera.resampling import remap
from stereocal.camera.undistortion import undistortion_maps
from stereocal.pair.rectification import rectify
from stereocal.pair.rig import StereoRig
from stereocal.verify.bench import BenchCase

_LENSES: dict[str, list[float]] = {
    "brown": [-0.3, 0.1, 0.001, 0.002, -0.01],
    "rational": [-0.2, 0.05, 0.001, 0.002, 0, 0.05, 0.01, 0.002],
    "thin_prism": [-0.2, 0.05, 0.001, 0.002, 0, 0.05, 0.01, 0.002, 0.001, 0.002, 0.001, 0.002],
    "tilted": [-0.2, 0.05, 0.001, 0.002, 0, 0.05, 0.01, 0.002, 0.001, 0.002, 0.001, 0.002, 0.01, 0.02],
    "fisheye": [0.02, -0.01, 0.003, -0.001],
}
_FLAGS = {"bilinear": cv2.INTER_LINEAR, "nearest": cv2.INTER_NEAREST, "bicubic": cv2.INTER_CUBIC}


def cases() -> list[BenchCase]:
    """Return the cases of maps, remap and rectify."""
    found = [_maps("brown", size) for size in ((640, 480), (1280, 960), (1920, 1080))]
    found += [_maps(lens, (640, 480)) for lens in ("rational", "thin_prism", "tilted", "fisheye")]
    for kind in ("uint8", "uint16", "float32"):
        found += [_remap((640, 480), kind, channels, "bilinear") for channels in (1, 3)]
    found += [_remap((1920, 1080), "uint8", channels, "bilinear") for channels in (1, 3)]
    found += [_remap((640, 480), "uint8", 1, method) for method in ("nearest", "bicubic")]
    return [*found, _rectify()]


def _camera(lens: str, size: tuple[int, int]) -> Camera:
    width, height = size
    f = 0.8 * width
    K = np.array([[f, 0, width / 2 + 3], [0, 1.01 * f, height / 2 - 4], [0, 0, 1]])
    return Camera(K, _LENSES[lens], size, lens)


def _maps(lens: str, size: tuple[int, int]) -> BenchCase:
    camera = _camera(lens, size)
    R = rotation_matrix([0.01, 0.03, -0.02])
    K, dist = np.array(camera.K), np.array(camera.dist)
    ours, theirs = (tuple(np.zeros(size[::-1], np.float32) for _ in "xy") for _ in range(2))
    opencv = cv2.fisheye.initUndistortRectifyMap if lens == "fisheye" else cv2.initUndistortRectifyMap
    return BenchCase(
        "undistortion_maps",
        f"{size[0]}x{size[1]}, {lens}",
        lambda: undistortion_maps(K, dist, size, R=R, P=K, model=lens, out=(ours[0], ours[1])),
        lambda: opencv(K, dist, R, K, size, cv2.CV_32FC1, *theirs),
        _pixels_that_differ,
        lambda: ((K, dist, size), {"R": R, "P": K, "model": lens}),
    )


def _remap(size: tuple[int, int], kind: str, channels: int, method: str) -> BenchCase:
    camera = _camera("brown", size)
    maps = undistortion_maps(camera.K, camera.dist, size, R=rotation_matrix([0.01, 0.03, -0.02]))
    shape = (size[1], size[0]) if channels == 1 else (size[1], size[0], channels)
    top = {"uint8": 255, "uint16": 65535, "float32": 1}[kind]
    image = (np.random.default_rng(0).random(shape) * top).astype(kind)
    ours, theirs = np.zeros_like(image), np.zeros_like(image)
    return BenchCase(
        "remap",
        f"{size[0]}x{size[1]}, {kind}, {'grey' if channels == 1 else 'colour'}, {method}",
        lambda: remap(image, *maps, interpolation=method, out=ours),
        lambda: cv2.remap(image, maps[0], maps[1], _FLAGS[method], theirs),
        _pixels_that_differ,
        lambda: ((image, *maps), {"interpolation": method}),
    )


def _rectify() -> BenchCase:
    camera = _camera("brown", (640, 480))
    R, T = rotation_matrix([0.01, 0.03, -0.02]), np.array([-3.0, 0.05, 0.1])
    rig = StereoRig(camera, camera, R, T)
    K, dist = np.array(camera.K), np.array(camera.dist)

    def opencv() -> Any:
        return cv2.stereoRectify(
            K, dist, K, dist, camera.image_size, R, T.reshape(3, 1), flags=cv2.CALIB_ZERO_DISPARITY, alpha=0.5
        )

    def agreement(ours: Any, theirs: Any) -> str:
        mine = (ours.R1, ours.R2, ours.P1, ours.P2, ours.Q)
        worst = max(float(np.abs(a - b).max()) for a, b in zip(mine, theirs[:5], strict=True))
        same = (ours.roi1, ours.roi2) == (tuple(theirs[5]), tuple(theirs[6]))
        return f"max |Δ| {worst:.0e}, ROIs {'equal' if same else 'differ'}"

    name, ours = "640x480, brown, alpha 0.5", lambda: rectify(rig, alpha=0.5)
    return BenchCase("rectify", name, ours, opencv, agreement, lambda: ((rig,), {"alpha": 0.5}))


def _pixels_that_differ(ours: Any, theirs: Any) -> str:
    """Say how many values differ, and by how much."""
    pairs = list(zip(ours, theirs, strict=True)) if isinstance(ours, tuple) else [(ours, theirs)]
    differing = sum(int(np.count_nonzero(a != b)) for a, b in pairs)
    if differing == 0:
        return "identical"
    worst = max(float(np.abs(a.astype(float) - b.astype(float)).max()) for a, b in pairs)
    share = differing / sum(a.size for a, _ in pairs)
    return f"{100 * share:.2g} % differ, max |Δ| {worst:.2g} (OpenCV {cv2.__version__})"
