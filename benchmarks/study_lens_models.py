"""Every lens model through calibration, from a cold start with default settings.

Two questions for each of the models, pinhole (with and without skew) to rational function:

**Foreign lenses.** The first rigs of ``study_random_rigs``, whose lens is Brown's, calibrated with the model. It need
not fit well, but must end in an optimum. Where OpenCV has the model (``calibrateCamera`` with flags, or
``fisheye.calibrate``), ours may not be above OpenCV's best of default and patient runs (1e-9 relative).

**Its own lens.** Rigs drawn with a random lens of the model itself. The oracle is the truth: the fit must be no worse
than the one that starts from the true camera, and the pixels that the camera found draws must be off by no more than
its covariance says (χ² per pixel coordinate where corners were seen, 1 on average; and |Δ| / σ of fx).

    python benchmarks/study_lens_models.py [--rigs 10] [--only fisheye fov]
"""

from __future__ import annotations

import argparse
import time

import cv2
import numpy as np
from study_random_rigs import random_rig

import stereocal as sc
from stereocal.base.rotations import rotation_matrix, rotation_vector
from stereocal.camera.distortion import MODELS
from stereocal.camera.propagation import pixel_covariance

SIZE = (640, 480)
PATIENT = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 300, 1e-15)
_NONE = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3
FLAGS = {
    "pinhole": _NONE | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2,
    "polynomial": _NONE,
    "brown": 0,
    "rational": cv2.CALIB_RATIONAL_MODEL,
    "thin_prism": cv2.CALIB_RATIONAL_MODEL | cv2.CALIB_THIN_PRISM_MODEL,
    "tilted": cv2.CALIB_RATIONAL_MODEL | cv2.CALIB_THIN_PRISM_MODEL | cv2.CALIB_TILTED_MODEL,
}


def opencv_rms(model: str, X, corners, size) -> float:
    """Return the lower RMS of OpenCV's default and patient run; infinite where it refuses or has no such model."""
    objects = [X.astype(np.float32).reshape(-1, 1, 3)] * len(corners)
    images = [y.astype(np.float32).reshape(-1, 1, 2) for y in corners]
    best = np.inf
    for criteria in (None, PATIENT):
        more = {} if criteria is None else {"criteria": criteria}
        try:
            if model == "fisheye":
                names = cv2.fisheye if hasattr(cv2.fisheye, "CALIB_FIX_SKEW") else cv2  # OpenCV 4, OpenCV 5
                flags = names.CALIB_RECOMPUTE_EXTRINSIC | names.CALIB_FIX_SKEW
                # OpenCV 5.0 takes points in a row only
                f64 = (
                    [x.reshape(1, -1, 3).astype(float) for x in objects],
                    [y.reshape(1, -1, 2).astype(float) for y in images],
                )
                found = cv2.fisheye.calibrate(*f64, size, None, None, flags=flags, **more)
                # its RMS is of another definition in some versions: measured anew
                rms = _fisheye_rms(*f64, found)
            elif model in FLAGS:
                rms = cv2.calibrateCamera(objects, images, size, None, None, flags=FLAGS[model], **more)[0]
            else:
                return np.inf
            best = min(best, rms) if np.isfinite(rms) else best
        except cv2.error:
            continue  # OpenCV refuses: nothing to compare with
    return best


def _fisheye_rms(objects, images, found) -> float:
    _, K, D, rvecs, tvecs = found
    d = [
        cv2.fisheye.projectPoints(X, r, t, K, D)[0] - y
        for X, y, r, t in zip(objects, images, rvecs, tvecs, strict=True)
    ]
    return float(np.sqrt(np.mean(np.sum(np.concatenate(d) ** 2, axis=2))))


def random_lens(model: str, rng: np.random.Generator) -> np.ndarray:
    """Return coefficients of a plausible lens of a model."""
    k1 = rng.uniform(-0.35, 0.1)
    k2 = rng.uniform(0, 0.3) * abs(k1)
    p = rng.normal(0, 1e-3, 2)
    rational = np.array([k1, k2, *p, 0.01, rng.uniform(0, 0.1), rng.uniform(0, 0.03), 0.002])
    prism = rng.normal(0, 2e-3, 4)
    lenses = {
        "pinhole": [],
        "polynomial": [k1, k2],
        "polynomial_printed": [rng.uniform(-0.05, 0.3), rng.uniform(0, 0.05)],
        "brown": [k1, k2, *p, rng.normal(0, 0.02)],
        "rational": rational,
        "thin_prism": [*rational, *prism],
        "tilted": [*rational, *prism, *rng.normal(0, 0.03, 2)],
        "fisheye": rng.uniform(-1, 1, 4) * [0.1, 0.05, 0.02, 0.005],
        "fov": [rng.uniform(0.3, 1.0)],
        "division": [rng.uniform(-0.35, 0.1)],
        "rational_function": (
            np.array([0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 1.0])
            + rng.normal(0, 0.02, 18) * [1, 1, 1, 0, 0, 0, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0]
            + rng.uniform(-0.25, 0) * np.array([0] * 12 + [1, 0, 1, 0, 0, 0])
        ),
    }
    return np.asarray(lenses[model], dtype=np.float64)


def own_rig(model: str, rng: np.random.Generator, skew: float):
    """Return (camera, board, clean corners) of a rig with a lens of the model."""
    width, height = SIZE
    columns, rows = int(rng.integers(6, 13)), int(rng.integers(5, 10))
    X = np.array([[x, y, 0.0] for y in range(rows) for x in range(columns)])
    f = width * rng.uniform(0.5, 1.6)
    K = [[f, skew, width / 2 + rng.normal(0, 12)], [0, f * rng.uniform(0.98, 1.02), height / 2 + rng.normal(0, 12)]]
    camera = sc.Camera([*K, [0, 0, 1]], random_lens(model, rng), SIZE, model)
    corners, wanted = [], int(rng.integers(10, 31))
    for _ in range(20000):
        tilt, around = np.radians(rng.uniform(0, 50)), rng.uniform(0, 2 * np.pi)
        R = rotation_matrix(tilt * np.array([np.cos(around), np.sin(around), 0])) @ rotation_matrix(
            [0, 0, rng.uniform(0, 2 * np.pi)]
        )
        Z = f * np.hypot(columns, rows) / (rng.uniform(0.3, 1.0) * width)
        ray = camera.undistort_points([rng.uniform(0.1, 0.9, 2) * SIZE], P=np.eye(3))[0]
        if not np.isfinite(ray).all():
            continue
        t = Z * np.array([*ray, 1.0]) - R @ X.mean(axis=0)
        y = camera.project(X, rotation_vector(R), t)
        if not (np.isfinite(y).all() and np.all((y >= 0) & (y <= np.array(SIZE) - 1))):
            continue
        # only where the lens can be undone: no fold of the model inside of the board
        back = camera.undistort_points(y, P=np.eye(3))
        X_c = X @ R.T + t
        if np.isfinite(back).all() and np.abs(back - X_c[:, :2] / X_c[:, 2:]).max() < 1e-8:
            corners.append(y)
        if len(corners) == wanted:
            return camera, X, corners
    return None


def chi2_of_pixels(found, truth: sc.Camera, corners: list[np.ndarray]) -> float:
    """Return the mean of Δᵀ C⁻¹ Δ / 2 over every 20th corner, Δ between found and true camera at the same ray."""
    rays = truth.undistort_points(np.concatenate(corners)[::20], P=np.eye(3))
    rays = rays[np.isfinite(rays).all(1)]
    directions = np.column_stack([rays, np.ones(len(rays))])
    delta = found.camera.project(directions) - truth.project(directions)
    C = pixel_covariance(directions, found.camera, found.covariance)
    half = np.linalg.inv(np.linalg.cholesky(C + 1e-12 * np.trace(C, axis1=1, axis2=2)[:, None, None] * np.eye(2)))
    return float(np.mean(np.sum(np.einsum("nij,nj->ni", half, delta) ** 2, axis=1)) / 2)


def foreign(model: str, count: int, skew: bool) -> tuple[str, list[str]]:
    """Calibrate the first random rigs with a model; return a line of the table and what is to be explained."""
    above, faults, lower, compared, spent = 0, [], 0, 0, 0.0
    for index in range(count):
        rng = np.random.default_rng([0, index])
        camera, X, clean, noise = random_rig(rng)
        corners = [(y + rng.normal(0, noise, y.shape)).astype(np.float32).astype(np.float64) for y in clean]
        started = time.perf_counter()
        try:
            found = sc.calibrate_camera(X, corners, camera.image_size, model=model, skew=skew)
        except sc.StereocalError as error:
            faults.append(f"foreign {index}: {type(error).__name__}: {error}")
            continue
        finally:
            spent += time.perf_counter() - started
        if not found.converged:
            faults.append(f"foreign {index}: not converged ({found.reason}, {found.iterations}), RMS {found.rms:.6g}")
        theirs = np.inf if skew else opencv_rms(model, X, corners, camera.image_size)
        compared += np.isfinite(theirs)
        lower += np.isfinite(theirs) and found.rms < theirs * (1 - 1e-6)
        if found.rms > theirs * (1 + 1e-9):
            above += 1
            faults.append(f"foreign {index}: ours {found.rms:.9g} above OpenCV {theirs:.9g} ({found.reason})")
    return f"above OpenCV {above} of {compared}, lower {lower}, {spent:6.1f} s", faults


def own(model: str, count: int, skew: bool) -> tuple[str, list[str]]:
    """Calibrate rigs with the model's own lens; return a line of the table and what is to be explained."""
    faults, chi2, off, worse, spent, done = [], [], [], 0, 0.0, 0
    for index in range(count):
        rng = np.random.default_rng([1, index, len(model)])
        drawn = own_rig(model, rng, rng.normal(0, 2) if skew else 0.0)
        if drawn is None:
            faults.append(f"own {index}: no views of this lens drawn")
            continue
        truth, X, clean = drawn
        noise = rng.uniform(0.02, 0.5)
        corners = [y + rng.normal(0, noise, y.shape) for y in clean]
        started = time.perf_counter()
        try:
            found = sc.calibrate_camera(X, corners, SIZE, model=model, skew=skew)
        except sc.StereocalError as error:
            faults.append(f"own {index}: {type(error).__name__}: {error}")
            continue
        finally:
            spent += time.perf_counter() - started
        done += 1
        warm = sc.calibrate_camera(X, corners, SIZE, model=model, skew=skew, initial=truth)
        if not found.converged:
            faults.append(f"own {index}: not converged ({found.reason}, {found.iterations}), RMS {found.rms:.6g}")
        if found.rms > warm.rms * (1 + 1e-9):
            worse += 1
            faults.append(
                f"own {index}: cold {found.rms:.9g}, from the truth {warm.rms:.9g}, dist {truth.dist.round(3)}"
            )
        chi2.append(chi2_of_pixels(found, truth, clean))
        off.append(abs(found.camera.fx - truth.fx) / found.std[0])
    if not done:
        return "none done", faults
    return (
        f"above the fit from the truth {worse} of {done}, χ² of pixels {np.mean(chi2):.2f} (highest {max(chi2):.1f}), "
        f"|Δfx|/σ {np.mean(off):.2f} (highest {max(off):.1f}), {spent:6.1f} s"
    ), faults


def main() -> None:
    """Run the study and print a line a model."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rigs", type=int, default=10)
    parser.add_argument("--only", nargs="+", choices=list(MODELS), default=list(MODELS))
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    for model in arguments.only:
        for skew in (False, True) if model == "pinhole" else (False,):
            print(model + (" with skew" if skew else ""))
            for name, study in (("foreign", foreign), ("own", own)):
                line, faults = study(model, arguments.rigs, skew)
                print(f"  {name:8s}{line}")
                print("".join(f"      {fault}\n" for fault in faults), end="", flush=True)


if __name__ == "__main__":
    main()
