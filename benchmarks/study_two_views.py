"""Two views with 40 % wrong matches: the pose from our consensus beside OpenCV's USAC_MAGSAC.

Each scene: a camera of 640 x 480 pixels moves by about one unit before 150 points 3 to 12 units away; matches carry
noise of 0.5 px per axis, and 40 % of them are replaced by a random place in the right picture. From each fitted F (or
E) the motion is recovered and compared with the truth: the angle of the rotation that is left over, and the angle
between the directions of translation; the pose error is the larger of the two. OpenCV gets the same points, threshold
(1 px), confidence (0.999) and limit on iterations. A failure counts as 180°.

``standard`` is that; each other variant changes one thing:

offsets          a wrong match is a good one moved by 5 to 60 px in any direction
second_motion    wrong matches obey another motion: a thing that moves by itself, with 40 % of the matches
noise_0.3 …      noise of 0.3, 1 or 2 px (the threshold stays 1 px)
points_100 …     100, 500 or 1000 matches
plane, relief    the points lie within 2 or 10 % of their distance of a slanted plane: F is all but undetermined in the
                 first (a refusal is the right answer, and counts as 180°), and E is not
forward          the camera moves along its axis
wide, narrow     a focal length of 250 or 1200 px instead of 500

Run: python benchmarks/study_two_views.py [scenes] [variant ...]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np

from stereocal.base.errors import StereocalError
from stereocal.base.rotations import rotation_matrix
from stereocal.pair.essential import fit_essential
from stereocal.pair.fundamental import fit_fundamental
from stereocal.pair.relative_pose import project_to_essential, recover_pose

SIZE = np.array([640, 480])
THRESHOLD, CONFIDENCE, LIMIT = 1.0, 0.999, 10_000


@dataclass(frozen=True)
class Variant:
    """What a scene is like."""

    count: int = 150
    wrong: float = 0.4
    noise: float = 0.5
    focal: float = 500.0
    outliers: str = "anywhere"
    depth: str = "deep"
    relief: float = 0.02
    forward: bool = False

    @property
    def K(self) -> np.ndarray:
        return np.array([[self.focal, 0, 320], [0, self.focal, 240], [0, 0, 1]])


STANDARD = Variant()
VARIANTS = {
    "standard": STANDARD,
    "offsets": replace(STANDARD, outliers="offsets"),
    "second_motion": replace(STANDARD, outliers="second_motion"),
    "noise_0.3": replace(STANDARD, noise=0.3),
    "noise_1": replace(STANDARD, noise=1.0),
    "noise_2": replace(STANDARD, noise=2.0),
    "points_100": replace(STANDARD, count=100),
    "points_500": replace(STANDARD, count=500),
    "points_1000": replace(STANDARD, count=1000),
    "plane": replace(STANDARD, depth="plane"),
    "relief": replace(STANDARD, depth="plane", relief=0.1),
    "forward": replace(STANDARD, forward=True),
    "wide": replace(STANDARD, focal=250.0),
    "narrow": replace(STANDARD, focal=1200.0),
}


def motion(random: np.random.Generator, variant: Variant) -> tuple[np.ndarray, np.ndarray]:
    """Draw a rotation and a translation of length 1."""
    T = np.array([0.0, 0, -1] if variant.forward else [-1.0, 0, 0]) + random.normal(size=3) * 0.3
    turn = random.normal(size=3) * 0.15 * min(1.0, 500 / variant.focal)
    return rotation_matrix(turn), T / np.linalg.norm(T)


def seen_matches(
    random: np.random.Generator, variant: Variant, R: np.ndarray, T: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return matching pixels of points that both pictures show."""
    K = variant.K
    left = random.uniform((0, 0), SIZE, (20 * variant.count, 2))
    rays = np.column_stack([left, np.ones(len(left))]) @ np.linalg.inv(K).T
    if variant.depth == "plane":
        slant = random.uniform(-0.4, 0.4, 2) * variant.focal / 500
        depth = 6 / (1 + rays[:, :2] @ slant) * random.uniform(1 - variant.relief, 1 + variant.relief, len(left))
    else:
        depth = random.uniform(3, 12, len(left))
    seen = (rays * depth[:, None] @ R.T + T) @ K.T
    right = seen[:, :2] / seen[:, 2:]
    good = (depth > 0.5) & (seen[:, 2] > 0.5) & np.all((right > 0) & (right < SIZE), axis=1)
    return left[good][: variant.count], right[good][: variant.count]


def scene(random: np.random.Generator, variant: Variant = STANDARD):
    """Return matching pixels, of which some are outliers, and the true motion."""
    R, T = motion(random, variant)
    left, right = seen_matches(random, variant, R, T)
    left, right = (p + random.normal(size=p.shape) * variant.noise for p in (left, right))
    bad = random.permutation(len(left))[: int(variant.wrong * len(left))]
    if variant.outliers == "offsets":
        way = random.normal(size=(len(bad), 2))
        right[bad] += way / np.linalg.norm(way, axis=1, keepdims=True) * random.uniform(5, 60, (len(bad), 1))
    elif variant.outliers == "second_motion":
        other = seen_matches(random, variant, *motion(random, variant))
        number = min(len(bad), len(other[0]))
        for points, theirs in zip((left, right), other, strict=True):
            points[bad[:number]] = theirs[:number] + random.normal(size=(number, 2)) * variant.noise
    else:
        right[bad] = random.uniform((0, 0), SIZE, (len(bad), 2))
    return left, right, R, T


def pose_error(
    E: np.ndarray | None, K: np.ndarray, left: np.ndarray, right: np.ndarray, R: np.ndarray, T: np.ndarray
) -> float:
    """Return the larger of the angles by which rotation and direction of translation are off, degrees."""
    if E is None or E.shape != (3, 3):
        return 180.0
    pose = recover_pose(E, left, right, K)
    off = np.arccos(np.clip((np.trace(pose.R @ R.T) - 1) / 2, -1, 1))
    return float(np.degrees(max(off, np.arccos(np.clip(pose.t @ T, -1, 1)))))


def ours_fundamental(left: np.ndarray, right: np.ndarray, K: np.ndarray, seed: int) -> np.ndarray:
    F = fit_fundamental(
        left, right, method="ransac", threshold=THRESHOLD, confidence=CONFIDENCE, max_iterations=LIMIT, seed=seed
    )
    return project_to_essential(K.T @ F @ K)


def ours_essential(left: np.ndarray, right: np.ndarray, K: np.ndarray, seed: int) -> np.ndarray:
    return fit_essential(
        left, right, K, method="ransac", threshold=THRESHOLD, confidence=CONFIDENCE, max_iterations=LIMIT, seed=seed
    )


def opencv_fundamental(left: np.ndarray, right: np.ndarray, K: np.ndarray, seed: int) -> np.ndarray | None:
    F, _ = cv2.findFundamentalMat(left, right, cv2.USAC_MAGSAC, THRESHOLD, CONFIDENCE, LIMIT)
    return None if F is None else project_to_essential(K.T @ F[:3] @ K)


def opencv_essential(left: np.ndarray, right: np.ndarray, K: np.ndarray, seed: int) -> np.ndarray | None:
    E, _ = cv2.findEssentialMat(left, right, K, cv2.USAC_MAGSAC, CONFIDENCE, THRESHOLD)
    return None if E is None else E[:3]


METHODS: dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray, int], np.ndarray | None]] = {
    "F, ours": ours_fundamental,
    "F, USAC_MAGSAC": opencv_fundamental,
    "E, ours": ours_essential,
    "E, USAC_MAGSAC": opencv_essential,
}


def study(name: str, scenes: int) -> None:
    """Print the errors and times of all methods on one variant."""
    variant = VARIANTS[name]
    errors: dict[str, list[float]] = {method: [] for method in METHODS}
    seconds: dict[str, list[float]] = {method: [] for method in METHODS}
    for seed in range(scenes):
        left, right, R, T = scene(np.random.default_rng(seed), variant)
        for label, method in METHODS.items():
            began = time.thread_time()
            try:
                E = method(left, right, variant.K, seed)
            except (StereocalError, cv2.error):
                E = None
            seconds[label].append(time.thread_time() - began)
            errors[label].append(pose_error(E, variant.K, left, right, R, T))
    for label, values in errors.items():
        q = np.percentile(values, (50, 95, 100))
        failed = sum(value == 180.0 for value in values)
        print(
            f"{name:14} {label:16} {q[0]:8.4f} {q[1]:8.4f} {q[2]:8.3f} {failed:7d} "
            f"{1e3 * np.median(seconds[label]):9.2f}",
            flush=True,
        )


def main() -> None:
    scenes = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    cv2.setNumThreads(1)
    # compiled kernels are loaded before the clock runs
    left, right, _, _ = scene(np.random.default_rng(0))
    for method in METHODS.values():
        method(left, right, STANDARD.K, 0)
    print(f"OpenCV {cv2.__version__}, {scenes} scenes, 40 % outliers, pose error in degrees, CPU time of one thread")
    print(f"{'variant':14} {'method':16} {'median':>8} {'95th':>8} {'worst':>8} {'failed':>7} {'ms a fit':>9}")
    for name in sys.argv[2:] or VARIANTS:
        study(name, scenes)


if __name__ == "__main__":
    main()
