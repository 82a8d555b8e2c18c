"""Cameras as users bring them: is our optimum ever above OpenCV's, mono or stereo?

``study_random_rigs`` draws tidy experiments. Here everything is less so: images from 270x180 to 4000x3000 and square
ones, boards of 3x3 to 16x12 points with squares of 1, 25 or 0.025 (board units, millimetres, metres), their origin in a
corner or in the middle and their points row by row or column by column, views mostly frontal or well tilted, near or
far, some with only a part of the board (as with ChArUco), pixels that are not square, principal points far from the
middle, k3 or none. Every rig starts cold, with default settings; OpenCV gets the same float32 corners, its default
criteria and 300 iterations to 1e-15, for pairs from its own mono calibrations, then jointly.

    python benchmarks/study_odd_rigs.py [--rigs 300] [--first 0] [--stereo] [--seed 0]

A refusal is printed with its reason, what OpenCV makes of the same corners, and the truth, so that it can be judged.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import cv2
import numpy as np

import stereocal as sc
from stereocal.base.rotations import rotation_matrix
from stereocal.camera.distortion_brown import radial_limit

SIZES = ((270, 180), (640, 480), (480, 480), (752, 480), (1280, 1024), (1920, 1080), (4000, 3000))
PATIENT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 300, 1e-15)


@dataclass
class OddRig:
    """A rig of one or two cameras and what they saw."""

    cameras: list[sc.Camera]
    R: np.ndarray
    T: np.ndarray
    objects: list[np.ndarray]
    images: list[list[np.ndarray]]
    noise: float
    frontal: float

    def describe(self) -> str:
        """Return the rig in a line."""
        c = self.cameras[0]
        points = [len(X) for X in self.objects]
        return (
            f"{c.image_size} f/w {c.fx / c.image_size[0]:.2f} k1 {c.dist[0]:.2f} k2 {c.dist[1]:.2f} views "
            f"{len(self.objects)} points {min(points)}-{max(points)} noise {self.noise:.2f} frontal {self.frontal:.2f}"
        )


def random_camera(rng: np.random.Generator, size: tuple[int, int]) -> sc.Camera:
    """Return a camera with oblong pixels and a principal point that may be far off."""
    width, height = size
    f = width * rng.choice([rng.uniform(0.45, 0.9), rng.uniform(0.9, 2.0), rng.uniform(2.0, 5.0)])
    centre = np.array([width / 2, height / 2]) + rng.normal(0, rng.choice([0.01, 0.06]) * width, 2)
    k1 = float(np.clip(rng.normal(-0.12, 0.18), -0.5, 0.35))
    k2 = rng.uniform(-0.2, 0.5) * abs(k1)
    k = [k1, k2, *rng.normal(0, 1e-3, 2), rng.choice([0.0, rng.normal(0, 0.05)])]
    oblong = rng.choice([1.0, rng.uniform(0.9, 1.1)])
    return sc.Camera([[f, 0, centre[0]], [0, f * oblong, centre[1]], [0, 0, 1]], k, size)


def random_board(rng: np.random.Generator) -> np.ndarray:
    """Return the points of a board in some unit, order and place."""
    columns, rows = int(rng.integers(3, 17)), int(rng.integers(3, 13))
    X = np.array([[x, y, 0.0] for y in range(rows) for x in range(columns)])
    if rng.random() < 0.3:
        X = X[np.lexsort((X[:, 1], X[:, 0]))]
    if rng.random() < 0.3:
        X -= X.mean(axis=0)
    if rng.random() < 0.2:
        X[:, 1] *= -1
    return X * rng.choice([1.0, 25.0, 0.025])


def sees(camera: sc.Camera, X_c: np.ndarray, limit: float) -> np.ndarray | None:
    """Return the pixels of a board, NaN where it leaves the image; None if it is near the lens model's end."""
    if np.any(X_c[:, 2] <= 0) or np.any(np.hypot(X_c[:, 0], X_c[:, 1]) > limit * X_c[:, 2]):
        return None
    y = camera.project(X_c)
    inside = np.isfinite(y).all(1) & np.all((y >= 0) & (y <= np.array(camera.image_size) - 1), axis=1)
    return np.where(inside[:, None], y, np.nan)


def random_rig(rng: np.random.Generator, *, stereo: bool) -> OddRig:
    """Return a rig and its views."""
    size = SIZES[rng.integers(len(SIZES))]
    while True:
        first = random_camera(rng, size)
        cameras, R, T = [first], np.eye(3), np.zeros(3)
        X = random_board(rng)
        extent = float(np.linalg.norm(np.ptp(X, axis=0)))
        reach = extent * first.fx / (0.6 * size[0])  # at this distance the board spans 60 % of the width
        if stereo:
            second = random_camera(rng, size)
            zoom = first.fx / second.fx * rng.uniform(0.85, 1.15)
            K = second.K.copy()
            K[0, 0], K[1, 1] = K[0, 0] * zoom, K[1, 1] * zoom
            cameras.append(sc.Camera(K, second.dist, size))
            converge = rng.uniform(0, 0.25)
            R = rotation_matrix(rng.normal([0, converge, 0], 0.03))
            T = R @ -np.array(
                [np.tan(converge) * reach + rng.uniform(0.05, 0.2) * reach, *rng.normal(0, 0.02, 2) * reach]
            )
        rig = _views(rng, cameras, R, T, X, reach)
        if rig is not None:
            return rig


def _views(rng, cameras, R, T, X, reach) -> OddRig | None:
    first, size = cameras[0], cameras[0].image_size
    limits = [0.95 * radial_limit(c.dist) for c in cameras]
    frames = list(zip(cameras, (np.eye(3), R)[: len(cameras)], (np.zeros(3), T)[: len(cameras)], limits, strict=True))
    wanted, frontal, partial = int(rng.integers(4, 31)), rng.choice([0.0, 0.5, 0.8]), rng.random() < 0.3
    objects, images = [], [[] for _ in cameras]
    for _ in range(400):
        tilt = np.radians(rng.uniform(0, 8) if rng.random() < frontal else rng.uniform(15, 55))
        around = rng.uniform(0, 2 * np.pi)
        R_v = rotation_matrix(tilt * np.array([np.cos(around), np.sin(around), 0])) @ rotation_matrix(
            [0, 0, rng.normal(0, 0.3) if rng.random() < 0.7 else rng.uniform(-np.pi, np.pi)]
        )
        ray = first.undistort_points([rng.uniform(0.2, 0.8, 2) * size], P=np.eye(3))[0]
        if not np.isfinite(ray).all():
            continue
        t = reach * rng.lognormal(0.15, 0.35) * np.array([*ray, 1.0]) - R_v @ X.mean(axis=0)
        X_0 = X @ R_v.T + t
        seen = [sees(c, X_0 @ r.T + s, limit) for c, r, s, limit in frames]
        if any(y is None for y in seen):
            continue
        keep = np.all([np.isfinite(y[:, 0]) for y in seen], axis=0)
        if keep.all() or (partial and keep.sum() >= max(9, 0.4 * len(X))):
            objects.append(X[keep])
            for into, y in zip(images, seen, strict=True):
                into.append(y[keep])
        if len(objects) == wanted:
            break
    if len(objects) < 4:
        return None
    noise = float(rng.choice([0.0, rng.uniform(0, 0.3), rng.uniform(0, 1.0)]))
    # both libraries get the same float32 points and corners: OpenCV accepts no others
    single = lambda a: np.asarray(a, dtype=np.float32).astype(np.float64)  # noqa: E731
    images = [[single(y + rng.normal(0, noise, y.shape)) for y in side] for side in images]
    return OddRig(cameras, R, T, [single(o) for o in objects], images, noise, float(frontal))


def opencv_rms(rig: OddRig) -> float:
    """Return the lower RMS of OpenCV's default and its most patient run; infinite where it refuses."""
    size = rig.cameras[0].image_size
    objects = [X.astype(np.float32) for X in rig.objects]
    images = [[y.astype(np.float32).reshape(-1, 1, 2) for y in side] for side in rig.images]
    best = np.inf
    for criteria in ({}, {"criteria": PATIENT}):
        try:
            alone = [cv2.calibrateCamera(objects, side, size, None, None, **criteria) for side in images]
            if len(alone) == 1:
                rms = alone[0][0]
            else:
                cameras = [part for result in alone for part in result[1:3]]
                rms = cv2.stereoCalibrate(
                    objects, *images, *cameras, size, flags=cv2.CALIB_USE_INTRINSIC_GUESS, **criteria
                )[0]
            best = min(best, rms)
        except cv2.error:
            continue  # OpenCV refuses this rig: it has no optimum to compare with
    return best


def ours(rig: OddRig):
    """Return our calibration."""
    size = rig.cameras[0].image_size
    calibrate = sc.calibrate_camera if len(rig.images) == 1 else sc.calibrate_stereo
    return calibrate(rig.objects, *rig.images, size)


def main() -> None:
    """Run the study and print where the two part."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rigs", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--stereo", action="store_true")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    lines, counts = [], dict.fromkeys(("above", "refused", "failed", "not converged", "lower by more than 1e-6"), 0)
    spent = [0.0, 0.0]
    for index in range(arguments.first, arguments.first + arguments.rigs):
        rig = random_rig(np.random.default_rng([arguments.seed, index, 77]), stereo=arguments.stereo)
        started = time.perf_counter()
        found, verdict = None, ""
        try:
            found = ours(rig)
        except sc.DegenerateGeometryError as error:
            verdict = "refused"
            message = str(error)
        except sc.StereocalError as error:
            verdict = "failed"
            message = f"{type(error).__name__}: {error}"
        spent[0] += time.perf_counter() - started
        started = time.perf_counter()
        theirs = opencv_rms(rig)
        spent[1] += time.perf_counter() - started
        if found is not None:
            message = f"ours {found.rms:.9g} OpenCV {theirs:.9g} {found.reason} {found.iterations}"
            if not found.converged:
                verdict = "not converged"
            if found.rms > theirs * (1 + 1e-9):
                verdict = "above"
            counts["lower by more than 1e-6"] += found.rms < theirs * (1 - 1e-6)
        if verdict:
            counts[verdict] += 1
            lines.append(f"  {index} {verdict}: {message}; OpenCV {theirs:.6g}; {rig.describe()}")
        if index % 50 == 49:
            print(index + 1, counts, flush=True)
    print(f"{arguments.rigs} rigs {'stereo' if arguments.stereo else 'mono'}:", counts)
    print("\n".join(lines))
    print(f"seconds: ours {spent[0]:.1f}, OpenCV (two runs a rig) {spent[1]:.1f}")


if __name__ == "__main__":
    main()
