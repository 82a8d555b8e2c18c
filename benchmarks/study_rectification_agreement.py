"""Rectification, maps and remap beside OpenCV: do they agree, and what do they cost? One command, three tables.

1. ``rectify`` against ``cv2.stereoRectify``: random rigs (seeded), horizontal and vertical, cameras in order and
   swapped, six lens models, for every alpha, zero disparity on and off, three sizes of the new picture. Given are the
   largest difference of R1, R2, P1, P2, Q (|Δ| / max(1, |value|)), and how many regions of interest differ. Rigs whose
   lens cannot be undone over the whole image are counted and left out: there OpenCV's five steps diverge.
2. ``undistortion_maps`` against ``cv2.initUndistortRectifyMap`` (``cv2.fisheye`` for the fisheye lens): values that
   differ over random cameras, and the time at three sizes.
3. ``remap`` against ``cv2.remap``: values that differ, and the time, for every dtype, number of channels and method.

Times are medians of the thread's processor time, one thread each, in turns. OpenCV 5.0 and 4.14 differ in remap (4.14
rounds places to 1/32 px): run this under both.

Run: python benchmarks/study_rectification_agreement.py [rectify | maps | remap …]
"""

from __future__ import annotations

import sys
from collections.abc import Callable

import cv2
import numpy as np

from stereocal.base.rotations import rotation_matrix
from stereocal.camera.model import Camera
from stereocal.camera.resampling import remap
from stereocal.camera.undistortion import undistortion_maps
from stereocal.pair.rectification import rectify
from stereocal.pair.rig import StereoRig
from stereocal.verify.bench import BenchCase, run_case

LENSES = {"pinhole": 0, "polynomial": 2, "brown": 5, "rational": 8, "thin_prism": 12, "tilted": 14}
SPREAD = np.array([0.1, 0.02, 0.002, 0.002, 0.002] + 3 * [0.004] + 4 * [0.002] + 2 * [0.01])
SIZES = ((640, 480), (1280, 960), (1920, 1080))
METHODS = {"bilinear": cv2.INTER_LINEAR, "nearest": cv2.INTER_NEAREST, "bicubic": cv2.INTER_CUBIC}
RIGS, CAMERAS = 50, 10


def draw_camera(random: np.random.Generator, lens: str, size: tuple[int, int]) -> Camera:
    width, height = size
    f = width * random.uniform(0.55, 1.4)
    K = np.array([[f, 0, width / 2], [0, f * random.uniform(0.97, 1.03), height / 2], [0, 0, 1.0]])
    K[:2, 2] += 0.02 * width * random.normal(size=2)
    if lens == "fisheye":
        return Camera(K, random.normal(size=4) * [0.05, 0.02, 0.01, 0.005], size, lens)
    return Camera(K, (random.normal(size=14) * SPREAD)[: LENSES[lens]], size, lens)


def padded(camera: Camera) -> np.ndarray:
    """OpenCV takes no list of fewer than four coefficients."""
    return np.pad(camera.dist, (0, max(0, 4 - len(camera.dist))))


def time_of(ours: Callable, theirs: Callable) -> str:
    result = run_case(BenchCase("", "", ours, theirs, lambda a, b: ""), seconds=0.5)
    return f"{result.ours_ms:8.3f} {result.opencv_ms:8.3f} {result.ratio:6.2f}"


# ---- rectify ---------------------------------------------------------------------------------------------------------


def draw_rig(random: np.random.Generator, vertical: bool, swapped: bool) -> StereoRig:
    lens = str(random.choice(list(LENSES)))
    T = np.array([3.0 if swapped else -3.0, 0, 0]) + 0.2 * random.normal(size=3)
    T = T[[1, 0, 2]] if vertical else T
    cameras = [draw_camera(random, lens, (640, 480)) for _ in "lr"]
    return StereoRig(*cameras, rotation_matrix(random.normal(size=3) * 0.05), T)


def can_be_undone(rig: StereoRig) -> bool:
    x, y = np.meshgrid(np.linspace(0, 639, 9), np.linspace(0, 479, 9))
    pixels = np.column_stack([x.ravel(), y.ravel()])
    return all(np.isfinite(camera.undistort_points(pixels)).all() for camera in (rig.left, rig.right))


def opencv_rectify(rig: StereoRig, alpha: float | None, zero_disparity: bool, size: tuple[int, int] | None):
    K1, K2, R = (np.array(matrix) for matrix in (rig.left.K, rig.right.K, rig.R))
    flags = cv2.CALIB_ZERO_DISPARITY if zero_disparity else 0
    return cv2.stereoRectify(
        K1, padded(rig.left), K2, padded(rig.right), rig.left.image_size, R, np.array(rig.T).reshape(3, 1),
        flags=flags, alpha=-1 if alpha is None else alpha, newImageSize=size or (0, 0),
    )  # fmt: skip


def study_rectify() -> None:
    print(f"\nrectify beside stereoRectify, OpenCV {cv2.__version__}, {RIGS} random rigs a line and size")
    print("rig                  alpha zero disparity  rigs left out  worst |Δ| ROIs off")
    for vertical in (False, True):
        for swapped in (False, True):
            rig_name = ("vertical" if vertical else "horizontal") + (", swapped" if swapped else "")
            for alpha in (None, 0, 0.5, 1):
                for zero_disparity in (True, False):
                    compare_rigs(rig_name, vertical, swapped, alpha, zero_disparity)
    rig = draw_rig(np.random.default_rng(0), False, False)
    print(
        "ms ours, OpenCV, ratio:",
        time_of(lambda: rectify(rig, alpha=0.5), lambda: opencv_rectify(rig, 0.5, True, None)),
    )


def compare_rigs(rig_name: str, vertical: bool, swapped: bool, alpha: float | None, zero_disparity: bool) -> None:
    random = np.random.default_rng(1)
    worst, off, kept, left_out = 0.0, 0, 0, 0
    for n in range(3 * RIGS):
        rig = draw_rig(random, vertical, swapped)
        if not can_be_undone(rig):
            left_out += 1
            continue
        kept += 1
        size = (None, (800, 500), (320, 241))[n % 3]
        ours = rectify(rig, alpha=alpha, zero_disparity=zero_disparity, image_size=size)
        theirs = opencv_rectify(rig, alpha, zero_disparity, size)
        for mine, matrix in zip((ours.R1, ours.R2, ours.P1, ours.P2, ours.Q), theirs[:5], strict=True):
            worst = max(worst, float((np.abs(mine - matrix) / np.maximum(1, np.abs(matrix))).max()))
        off += (ours.roi1 != tuple(theirs[5])) + (ours.roi2 != tuple(theirs[6]))
    spelt = "None" if alpha is None else f"{alpha:g}"
    zero = "yes" if zero_disparity else "no"
    print(f"{rig_name:20} {spelt:>5} {zero:>14} {kept:5d} {left_out:8d} {worst:10.1e} {off:8d}", flush=True)


# ---- maps ------------------------------------------------------------------------------------------------------------


def opencv_maps(camera: Camera, R: np.ndarray, P: np.ndarray, out: np.ndarray | None = None):
    K, size = np.array(camera.K), camera.image_size
    kept = () if out is None else (out[0], out[1])
    if camera.model == "fisheye":
        return cv2.fisheye.initUndistortRectifyMap(K, np.array(camera.dist), R, P, size, cv2.CV_32FC1, *kept)
    return cv2.initUndistortRectifyMap(K, padded(camera), R, P, size, cv2.CV_32FC1, *kept)


def study_maps() -> None:
    print(
        f"\nundistortion_maps beside initUndistortRectifyMap, OpenCV {cv2.__version__}, {CAMERAS} random cameras a line"
    )
    print("lens              size     values differ  worst px  ours ms   OpenCV  ratio")
    for lens in (*LENSES, "fisheye"):
        for size in SIZES:
            random = np.random.default_rng(2)
            values, differ, worst = 0, 0, 0.0
            for _ in range(CAMERAS):
                camera = draw_camera(random, lens, size)
                R, P = rotation_matrix(random.normal(size=3) * 0.03), np.array(camera.K)
                P[:2, :2] *= random.uniform(0.8, 1.1)
                ours = np.array(undistortion_maps(camera.K, camera.dist, size, R=R, P=P, model=lens))
                theirs = np.array(opencv_maps(camera, R, P))
                values, differ = values + ours.size, differ + int(np.count_nonzero(ours != theirs))
                worst = max(worst, float(np.abs(ours.astype(float) - theirs).max()))
            out, other = np.zeros_like(ours), np.zeros_like(ours)
            K, dist = np.array(camera.K), np.array(camera.dist)
            times = time_of(
                lambda: undistortion_maps(K, dist, size, R=R, P=P, model=lens, out=(out[0], out[1])),  # noqa: B023
                lambda: opencv_maps(camera, R, P, other),  # noqa: B023
            )
            print(f"{lens:11} {size[0]:5d}x{size[1]:4d} {values:10d} {differ:6d} {worst:9.1e} {times}", flush=True)


# ---- remap -----------------------------------------------------------------------------------------------------------


def study_remap() -> None:
    print(f"\nremap beside cv2.remap, OpenCV {cv2.__version__}, noise through the map of a lens")
    print("image              method          size differ %    worst  ours ms   OpenCV  ratio")
    random = np.random.default_rng(3)
    for size in (SIZES[0], SIZES[2]):
        camera = draw_camera(random, "brown", size)
        maps = undistortion_maps(camera.K, camera.dist, size, R=rotation_matrix([0.01, 0.03, -0.02]))
        for method, flag in METHODS.items():
            for kind, top in (("uint8", 256), ("uint16", 65536), ("float32", 1)):
                for channels in (1, 3):
                    image = (random.random((size[1], size[0], channels)[: 2 + (channels > 1)]) * top).astype(kind)
                    ours, theirs = np.zeros_like(image), np.zeros_like(image)
                    times = time_of(
                        lambda: remap(image, *maps, interpolation=method, out=ours),  # noqa: B023
                        lambda: cv2.remap(image, *maps, flag, theirs),  # noqa: B023
                    )
                    off = np.abs(ours.astype(float) - theirs)
                    name = f"{kind}, {'colour' if channels == 3 else 'grey'}"
                    share, shape = 100 * np.mean(off > 0), f"{size[0]}x{size[1]}"
                    print(f"{name:18} {method:9} {shape:>10} {share:8.2g} {off.max():8.2g} {times}", flush=True)


def main() -> None:
    tables = {"rectify": study_rectify, "maps": study_maps, "remap": study_remap}
    for name in sys.argv[1:] or tables:
        tables[name]()


if __name__ == "__main__":
    main()
