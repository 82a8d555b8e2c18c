"""Two views with 40 % wrong matches: the pose from our consensus beside OpenCV's USAC_MAGSAC.

Each scene: a camera of 640 x 480 pixels moves by about one unit before 150 points 3 to 12 units away; matches carry
noise of 0.5 px per axis, and 40 % of them are replaced by a random place in the right picture. From each fitted F (or
E) the motion is recovered and compared with the truth: the angle of the rotation that is left over, and the angle
between the directions of translation; the pose error is the larger of the two. OpenCV gets the same points, threshold
(1 px), confidence (0.999) and limit on iterations. A failure counts as 180°.

Run: python benchmarks/study_two_views.py [scenes] [first seed]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import cv2
import numpy as np

from stereocal.base.errors import StereocalError
from stereocal.base.rotations import rotation_matrix
from stereocal.pair.essential import fit_essential, project_to_essential, recover_pose
from stereocal.pair.fundamental import fit_fundamental

K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
SIZE = np.array([640, 480])
THRESHOLD, CONFIDENCE, LIMIT = 1.0, 0.999, 10_000


def scene(random: np.random.Generator, count: int = 150, wrong: float = 0.4, noise: float = 0.5):
    """Return matching pixels, of which `wrong` are outliers, and the true motion."""
    R = rotation_matrix(random.normal(size=3) * 0.15)
    T = np.array([-1.0, 0, 0]) + random.normal(size=3) * 0.3
    T /= np.linalg.norm(T)
    left = random.uniform((0, 0), SIZE, (20 * count, 2))
    X = np.column_stack([left, np.ones(len(left))]) @ np.linalg.inv(K).T * random.uniform(3, 12, (len(left), 1))
    seen = (X @ R.T + T) @ K.T
    right = seen[:, :2] / seen[:, 2:]
    good = (seen[:, 2] > 0.5) & np.all((right > 0) & (right < SIZE), axis=1)
    left, right = left[good][:count], right[good][:count]
    left, right = left + random.normal(size=left.shape) * noise, right + random.normal(size=right.shape) * noise
    bad = random.permutation(len(left))[: int(wrong * len(left))]
    right[bad] = random.uniform((0, 0), SIZE, (len(bad), 2))
    return left, right, R, T


def pose_error(E: np.ndarray | None, left: np.ndarray, right: np.ndarray, R: np.ndarray, T: np.ndarray) -> float:
    """Return the larger of the angles by which rotation and direction of translation are off, degrees."""
    if E is None or E.shape != (3, 3):
        return 180.0
    pose = recover_pose(E, left, right, K)
    off = np.arccos(np.clip((np.trace(pose.R @ R.T) - 1) / 2, -1, 1))
    return float(np.degrees(max(off, np.arccos(np.clip(pose.t @ T, -1, 1)))))


def ours_fundamental(left: np.ndarray, right: np.ndarray, seed: int) -> np.ndarray:
    F = fit_fundamental(
        left, right, method="ransac", threshold=THRESHOLD, confidence=CONFIDENCE, max_iterations=LIMIT, seed=seed
    )
    return project_to_essential(K.T @ F @ K)


def ours_essential(left: np.ndarray, right: np.ndarray, seed: int) -> np.ndarray:
    return fit_essential(
        left, right, K, method="ransac", threshold=THRESHOLD, confidence=CONFIDENCE, max_iterations=LIMIT, seed=seed
    )


def opencv_fundamental(left: np.ndarray, right: np.ndarray, seed: int) -> np.ndarray | None:
    F, _ = cv2.findFundamentalMat(left, right, cv2.USAC_MAGSAC, THRESHOLD, CONFIDENCE, LIMIT)
    return None if F is None else project_to_essential(K.T @ F[:3] @ K)


def opencv_essential(left: np.ndarray, right: np.ndarray, seed: int) -> np.ndarray | None:
    E, _ = cv2.findEssentialMat(left, right, K, cv2.USAC_MAGSAC, CONFIDENCE, THRESHOLD)
    return None if E is None else E[:3]


METHODS: dict[str, Callable[[np.ndarray, np.ndarray, int], np.ndarray | None]] = {
    "F, ours": ours_fundamental,
    "F, USAC_MAGSAC": opencv_fundamental,
    "E, ours": ours_essential,
    "E, USAC_MAGSAC": opencv_essential,
}


def main() -> None:
    scenes = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    first = int(sys.argv[2]) if len(sys.argv) > 2 else 0
    errors: dict[str, list[float]] = {name: [] for name in METHODS}
    seconds = dict.fromkeys(METHODS, 0.0)
    for seed in range(first, first + scenes):
        left, right, R, T = scene(np.random.default_rng(seed))
        for name, method in METHODS.items():
            began = time.perf_counter()
            try:
                E = method(left, right, seed)
            except (StereocalError, cv2.error):
                E = None
            seconds[name] += time.perf_counter() - began
            errors[name].append(pose_error(E, left, right, R, T))
    print(f"OpenCV {cv2.__version__}, {scenes} scenes, 40 % outliers, pose error in degrees")
    print(f"{'method':18} {'median':>8} {'95th':>8} {'worst':>8} {'ms a fit':>9}")
    for name, values in errors.items():
        q = np.percentile(values, (50, 95, 100))
        print(f"{name:18} {q[0]:8.4f} {q[1]:8.4f} {q[2]:8.3f} {1e3 * seconds[name] / scenes:9.1f}")


if __name__ == "__main__":
    main()
