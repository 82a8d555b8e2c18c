"""Random scenes seen by two cameras, for the tests of epipolar geometry and triangulation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from stereocal.base.rotations import rotation_matrix

K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])


class TwoViews(NamedTuple):
    """Matching pixels, points in the left camera's frame, and the motion."""

    left: np.ndarray
    right: np.ndarray
    X: np.ndarray
    R: np.ndarray
    T: np.ndarray
    wrong: np.ndarray


def two_views(seed: int, *, count: int = 60, noise: float = 0.0, wrong: float = 0.0, scene: str = "deep") -> TwoViews:
    """Draw a scene, ``deep``, ``plane`` or ``turn`` (cameras that only turned), and its matches."""
    random = np.random.default_rng(seed)
    R = rotation_matrix(random.normal(size=3) * 0.1)
    T = np.array([-1.0, 0, 0]) + random.normal(size=3) * 0.15
    T = np.zeros(3) if scene == "turn" else T / np.linalg.norm(T)
    rays = np.column_stack([random.uniform((-0.5, -0.4), (0.5, 0.4), (20 * count, 2)), np.ones(20 * count)])
    depth = 5 / (1 + rays[:, :2] @ [0.3, 0.2]) if scene == "plane" else random.uniform(3, 12, len(rays))
    X = rays * depth[:, None]
    moved = X @ R.T + T
    X, moved = X[moved[:, 2] > 0.5][:count], moved[moved[:, 2] > 0.5][:count]
    left, right = ((Y / Y[:, 2:]) @ K.T[:, :2] for Y in (X, moved))
    left, right = left + noise * random.normal(size=left.shape), right + noise * random.normal(size=right.shape)
    bad = np.zeros(len(X), dtype=bool)
    bad[random.permutation(len(X))[: int(wrong * len(X))]] = True
    right[bad] = random.uniform((0, 0), (640, 480), (bad.sum(), 2))
    return TwoViews(left, right, X, R, T, bad)
