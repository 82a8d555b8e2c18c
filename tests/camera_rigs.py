"""Synthetic views with known truth, for the tests of this room and of the next."""

from __future__ import annotations

import numpy as np

import stereocal as sc
from stereocal.base.rotations import rotation_matrix

SIZE = (640, 480)


def board(columns: int = 9, rows: int = 6) -> np.ndarray:
    """Corners of a flat board, unit squares, x fastest."""
    return np.array([[x, y, 0.0] for y in range(rows) for x in range(columns)])


def camera(model: str = "brown", dist=(-0.28, 0.09, 0.001, -0.0005, 0.0), f: float = 530.0) -> sc.Camera:
    """A camera like that of a webcam."""
    return sc.Camera([[f, 0, 325], [0, f * 1.004, 236], [0, 0, 1]], dist, SIZE, model)


def poses(count: int, rng: np.random.Generator, X: np.ndarray, *cameras_and_rig, tilt: float = 0.6):
    """Random poses at which every camera sees the whole board; a rig is given as (camera, R, T) items."""
    found = []
    middle = X.mean(axis=0)
    while len(found) < count:
        rvec = rng.uniform(-tilt, tilt, 3)
        centre = np.array([rng.uniform(-2.5, 2.5), rng.uniform(-1.8, 1.8), rng.uniform(9, 18)])
        t = centre - rotation_matrix(rvec) @ middle
        X_0 = X @ rotation_matrix(rvec).T + t
        seen = True
        for cam, R, T in cameras_and_rig:
            y = cam.project(X_0 @ R.T + T)
            seen &= bool(np.isfinite(y).all() and (y >= 0).all() and (y < np.array(SIZE)).all())
        if seen:
            found.append((rvec, t))
    return found


def mono_views(cam: sc.Camera, X: np.ndarray, count: int, *, seed: int = 0, noise: float = 0.0, tilt: float = 0.6):
    """Corners of `count` views, and the poses."""
    rng = np.random.default_rng(seed)
    where = poses(count, rng, X, (cam, np.eye(3), np.zeros(3)), tilt=tilt)
    corners = [cam.project(X, r, t) + rng.normal(0, 1, (len(X), 2)) * noise for r, t in where]
    return corners, where


def stereo_views(rig: sc.StereoRig, X: np.ndarray, count: int, *, seed: int = 0, noise: float = 0.0):
    """Corners of `count` pairs, left and right, and the poses."""
    rng = np.random.default_rng(seed)
    where = poses(count, rng, X, (rig.left, np.eye(3), np.zeros(3)), (rig.right, rig.R, rig.T))
    left, right = [], []
    for r, t in where:
        X_0 = X @ rotation_matrix(r).T + t
        left.append(rig.left.project(X_0) + rng.normal(0, 1, (len(X), 2)) * noise)
        right.append(rig.right.project(X_0 @ rig.R.T + rig.T) + rng.normal(0, 1, (len(X), 2)) * noise)
    return left, right, where


def rig() -> sc.StereoRig:
    """A rig like that of two webcams."""
    right = sc.Camera([[535, 0, 318], [0, 533, 243], [0, 0, 1]], [-0.29, 0.1, 0.0005, -0.001, 0], SIZE)
    return sc.StereoRig(camera(), right, rotation_matrix([0.006, 0.012, -0.004]), [-3.3, 0.03, 0.02])
