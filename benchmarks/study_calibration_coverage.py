"""Are the standard deviations honest? 500 synthetic rigs, and how often 95 % intervals hold the truth.

Each rig has its own cameras, R, T, poses and noise. Counted is, for each parameter, |found − truth| ≤ 1.96 σ with the σ
that the calibration states. A right method gives 93 to 97 % (the count itself is uncertain by 1 % for 500 rigs).

    python benchmarks/study_calibration_coverage.py [--rigs 500] [--pairs 10]
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

import stereocal as sc
from stereocal.base.rotations import rotation_matrix, rotation_vector

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from camera_rigs import SIZE, board, stereo_views


def random_rig(rng: np.random.Generator) -> sc.StereoRig:
    """Two webcams, each a little different."""
    cameras = []
    for _ in range(2):
        f = rng.uniform(480, 620)
        K = [[f, 0, 320 + rng.normal(0, 8)], [0, f * rng.uniform(0.99, 1.01), 240 + rng.normal(0, 8)], [0, 0, 1]]
        cameras.append(sc.Camera(K, [rng.uniform(-0.3, 0), rng.uniform(0, 0.1), *rng.normal(0, 1e-3, 2), 0.0], SIZE))
    return sc.StereoRig(
        *cameras, rotation_matrix(rng.normal(0, 0.02, 3)), [-rng.uniform(2, 4), *rng.normal(0, 0.05, 2)]
    )


def main() -> None:
    """Run the study and print the coverage of every parameter."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--rigs", type=int, default=500)
    parser.add_argument("--pairs", type=int, default=10)
    arguments = parser.parse_args()
    X, hits, pose_hits, baseline_hits, names = board(), [], [], [], ()
    for seed in range(arguments.rigs):
        rng = np.random.default_rng([7, seed])
        rig = random_rig(rng)
        left, right, poses = stereo_views(rig, X, arguments.pairs, seed=seed, noise=float(rng.uniform(0.05, 0.5)))
        found = sc.calibrate_stereo(X, left, right, SIZE)
        names = found.parameter_names
        truth = []
        for c in (rig.left, rig.right):
            truth += [c.fx, c.fy, c.cx, c.cy, 0.0, *c.dist]
        truth += [*rotation_vector(rig.R), *rig.T]
        value = []
        for c in (found.rig.left, found.rig.right):
            value += [c.fx, c.fy, c.cx, c.cy, 0.0, *c.dist]
        value += [*rotation_vector(found.rig.R), *found.rig.T]
        hits.append(np.abs(np.array(value) - truth) <= 1.96 * found.std)
        baseline_hits.append(abs(found.rig.baseline - rig.baseline) <= 1.96 * found.baseline_std)
        sigma = np.sqrt(np.diagonal(found.pose_covariances, axis1=1, axis2=2))
        apart = np.hstack([found.rvecs, found.tvecs]) - np.array([np.concatenate(p) for p in poses])
        pose_hits.append((np.abs(apart) <= 1.96 * sigma).mean(axis=0))
    coverage = 100 * np.mean(hits, axis=0)
    for name, percent in zip(names, coverage, strict=True):
        if not name.endswith("skew"):
            print(f"{name:14s} {percent:5.1f} %")
    print(f"{'baseline':14s} {100 * np.mean(baseline_hits):5.1f} %")
    for name, percent in zip(("r_x", "r_y", "r_z", "t_x", "t_y", "t_z"), 100 * np.mean(pose_hits, axis=0), strict=True):
        print(f"{'pose ' + name:14s} {percent:5.1f} %")
    free = np.array([not name.endswith("skew") for name in names])
    print(f"{arguments.rigs} rigs: lowest {coverage[free].min():.1f} %, highest {coverage[free].max():.1f} %")


if __name__ == "__main__":
    main()
