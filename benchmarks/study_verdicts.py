"""Do the report's verdicts agree with the truth? Random rigs, healthy and with faults.

    python benchmarks/study_verdicts.py [--trials 200] [--seed 0] [--json FILE]

Each trial draws a rig, photographs a board with it (corners by projection, with noise), calibrates and evaluates.
Half of the trials are healthy: 12 to 25 views, tilted, a flat board, corner noise of 0.04 to 0.16 px. The others have
one fault, drawn in turn: few views, no tilt, blur, the wrong count of squares, shutters out of step, a bent board,
each from mild to severe.

The truth is known: points at the distance of the boards are projected by the true rig and their depth is computed by
the calibrated one. *Beyond the promise* is a calibration whose RMS depth error there is more than twice the σ_Z that
its report promises. Counted are:

- of the faulty calibrations beyond the promise: how many are called bad (a calibration that is refused counts as bad);
- of all faulty ones: how many are called bad, and how many not good;
- of the healthy ones: how many are called good, and how many are beyond the promise.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from stereocal.base.errors import StereocalError
from stereocal.base.rotations import rotation_matrix
from stereocal.board.chessboard import Chessboard
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig
from stereocal.pair.stereo_calibration import calibrate_stereo
from stereocal.report.quality import evaluate_calibration
from stereocal.report.rig_parameters import depths, scene_points
from stereocal.synthetic.corners import simulate_corners
from stereocal.synthetic.poses import Pose, sees_whole
from stereocal.synthetic.rig import default_rig

Corners = list[np.ndarray]


@dataclass
class Trial:
    """One calibration and what was said about it."""

    fault: str
    verdict: str
    depth_error: float
    promise: float
    reasons: tuple[str, ...]

    @property
    def beyond(self) -> bool:
        """Whether the depth error is more than twice what the page promises; a refusal promises nothing."""
        return self.verdict != "refused" and self.depth_error > 2 * self.promise


def draw_rig(random: np.random.Generator) -> StereoRig:
    """The default rig with another focal length, baseline, distortion and attitude."""
    base = default_rig()
    scale = random.uniform(0.9, 1.6)
    cameras = []
    for camera in (base.left, base.right):
        K = np.array(camera.K)
        K[0, 0] *= scale
        K[1, 1] *= scale
        K[:2, 2] += random.normal(0, 6, 2)
        cameras.append(Camera(K, np.array(camera.dist) * random.uniform(0.3, 1.0), camera.image_size))
    R = rotation_matrix(random.normal(0, 0.015, 3)) @ np.asarray(base.R)
    return StereoRig(cameras[0], cameras[1], R, np.asarray(base.T) * random.uniform(0.7, 2.0))


def hold_board(rig: StereoRig, board: Chessboard, views: int, tilt: float, random: np.random.Generator) -> list[Pose]:
    """Boards that both cameras see whole: anywhere in the left image, tilted by 0.4 to 1 of `tilt` degrees."""
    corners = np.array([[-1, -1], [board.columns, -1], [board.columns, board.rows], [-1, board.rows]])
    outline = np.column_stack([corners * board.square_size, np.zeros(4)])
    extent, poses = float(np.ptp(outline, axis=0).max()), list[Pose]()
    reach = np.array(rig.left.image_size) / (2 * rig.left.fx)
    while len(poses) < views:
        direction, angle = random.uniform(0, 2 * np.pi), np.radians(tilt) * random.uniform(0.4, 1.0)
        R = rotation_matrix([angle * np.cos(direction), angle * np.sin(direction), 0.0])
        R = R @ rotation_matrix([0, 0, np.radians(random.uniform(-20, 20))])
        distance = extent * random.uniform(0.9, 2.2) * rig.left.fx / 430
        place = np.array([*(random.uniform(-1, 1, 2) * reach), 1.0]) * distance
        t = place - R @ outline.mean(axis=0)
        if sees_whole(rig.left, R, t, outline) and sees_whole(rig.right, rig.R @ R, rig.R @ t + rig.T, outline):
            poses.append((R, t))
    return poses


def take(
    rig: StereoRig,
    board: Chessboard,
    random: np.random.Generator,
    *,
    views: int,
    tilt: float,
    noise: float,
    **options: Any,
) -> tuple[Corners, Corners]:
    """Photograph the board: the corners of both cameras."""
    poses = hold_board(rig, board, views, tilt, random)
    return simulate_corners(rig, board, poses, noise=noise, seed=int(random.integers(2**31)), **options)


def healthy(rig: StereoRig, board: Chessboard, random: np.random.Generator) -> tuple[Corners, Corners]:
    """12 to 25 tilted views of a flat board, 0.04 to 0.16 px of noise."""
    return take(
        rig,
        board,
        random,
        views=int(random.integers(12, 26)),
        tilt=random.uniform(30, 45),
        noise=random.uniform(0.04, 0.16),
    )


def few_views(rig: StereoRig, board: Chessboard, random: np.random.Generator) -> tuple[Corners, Corners]:
    """Three or four views."""
    return take(rig, board, random, views=int(random.integers(3, 5)), tilt=40, noise=random.uniform(0.08, 0.2))


def no_tilt(rig: StereoRig, board: Chessboard, random: np.random.Generator) -> tuple[Corners, Corners]:
    """Boards that face the camera: tilts of at most 0.5 to 4 degrees."""
    return take(rig, board, random, views=int(random.integers(8, 20)), tilt=random.uniform(0.5, 4), noise=0.12)


def blur(rig: StereoRig, board: Chessboard, random: np.random.Generator) -> tuple[Corners, Corners]:
    """Corner errors of 0.6 to 2 px, and one corner in fifty lost to something else."""
    return take(
        rig, board, random, views=int(random.integers(8, 20)), tilt=40, noise=random.uniform(0.6, 2.0), outliers=0.02
    )


def wrong_count(rig: StereoRig, board: Chessboard, random: np.random.Generator) -> tuple[Corners, Corners]:
    """The board has a row and a column more than was said, and the detector takes any part of it."""
    larger = Chessboard((board.columns + 1, board.rows + 1), board.square_size)
    left, right = take(rig, larger, random, views=int(random.integers(8, 20)), tilt=40, noise=0.12)

    def part(corners: np.ndarray) -> np.ndarray:
        row, column = random.integers(0, 2, 2)
        grid = corners.reshape(larger.rows, larger.columns, 2)
        return grid[row : row + board.rows, column : column + board.columns].reshape(-1, 2)

    return [part(c) for c in left], [part(c) for c in right]


def out_of_step(rig: StereoRig, board: Chessboard, random: np.random.Generator) -> tuple[Corners, Corners]:
    """Between the two exposures the hand moves: 2 to 15 mm and up to 2 degrees, another way in each view."""
    poses = hold_board(rig, board, int(random.integers(8, 20)), 40, random)
    speed = random.uniform(2, 15)
    moved = []
    for R, t in poses:
        moved.append(
            (rotation_matrix(random.normal(0, np.radians(speed / 15), 3)) @ R, t + random.normal(0, speed, 3) * 0.6)
        )
    left, _ = simulate_corners(rig, board, poses, noise=0.12, seed=int(random.integers(2**31)))
    _, right = simulate_corners(rig, board, moved, noise=0.12, seed=int(random.integers(2**31)))
    return left, right


def bent(rig: StereoRig, board: Chessboard, random: np.random.Generator) -> tuple[Corners, Corners]:
    """A board that bows by 0.03 to 0.25 of a square."""
    return take(
        rig, board, random, views=int(random.integers(8, 20)), tilt=40, noise=random.uniform(0.06, 0.15),
        bow=random.uniform(0.03, 0.25) * random.choice([-1, 1]) * board.square_size,
    )  # fmt: skip


FAULTS: dict[str, Callable[..., tuple[Corners, Corners]]] = {
    "few views": few_views,
    "no tilt": no_tilt,
    "blur": blur,
    "wrong square count": wrong_count,
    "shutters out of step": out_of_step,
    "bent board": bent,
}


def true_depth_error(truth: StereoRig, found: StereoRig, pixels: np.ndarray, distance: float) -> float:
    """RMS depth error of the found rig at `distance`, over pixels of the left image."""
    _, left, right = scene_points(truth, pixels, np.full(len(pixels), distance))
    error = depths(found, left, right) - distance
    error = error[np.isfinite(error)]
    return float(np.sqrt(np.mean(error**2))) if len(error) else float("inf")


def run_trial(fault: str, seed: int) -> Trial:
    """Draw, calibrate, evaluate, compare with the truth."""
    random = np.random.default_rng(seed)
    board = Chessboard((8, 6), 25.0)
    rig = draw_rig(random)
    left, right = (healthy if fault == "healthy" else FAULTS[fault])(rig, board, random)
    try:
        calibration = calibrate_stereo(board.object_points, left, right, rig.left.image_size)
        report = evaluate_calibration(calibration, board, left, right)
    except (StereocalError, np.linalg.LinAlgError) as error:
        return Trial(fault, "refused", float("nan"), float("nan"), (str(error)[:80],))
    facts = {block.key: block.facts for block in report.blocks}["depth"]
    corners = np.concatenate(left)
    pixels = corners[np.linspace(0, len(corners) - 1, 60).astype(int)]
    error = true_depth_error(rig, calibration.rig, pixels, facts["board_distance"])
    reasons = tuple(
        f"{v.name}: {v.spelt_value} {v.verdict}" for v in report.verdicts if v.decides and v.verdict != "good"
    )
    return Trial(fault, report.overall, error, facts["sigma_z_at_board"], reasons)


def main() -> None:
    """Run the study and print its table."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--trials", type=int, default=200, help="trials with faults, and as many healthy ones")
    arguments.add_argument("--seed", type=int, default=0)
    arguments.add_argument("--json", help="write every trial here")
    arguments.add_argument("--verbose", action="store_true")
    options = arguments.parse_args()
    start = time.process_time()
    names = ["healthy"] * options.trials + [list(FAULTS)[i % len(FAULTS)] for i in range(options.trials)]
    trials = [run_trial(name, 1000 * options.seed + i) for i, name in enumerate(names)]
    print(f"{'':22s} {'n':>4s} {'good':>5s} {'usable':>6s} {'bad':>5s} {'refused':>7s}  {'beyond':>6s}  of these bad")
    for name in ["healthy", *FAULTS]:
        _print_row(name, [t for t in trials if t.fault == name])
    faulty = [t for t in trials if t.fault != "healthy"]
    _print_row("all faults", faulty)
    beyond = [t for t in faulty if t.beyond or t.verdict == "refused"]
    caught = sum(t.verdict in ("bad", "refused") for t in beyond)
    good = sum(t.verdict == "good" for t in trials if t.fault == "healthy")
    print(
        f"\nfaulty and beyond the promise, called bad: {caught} of {len(beyond)} = {caught / max(len(beyond), 1):.1%}"
    )
    print(f"healthy, called good: {good} of {options.trials} = {good / options.trials:.1%}")
    print(f"{time.process_time() - start:.0f} s of CPU")
    if options.verbose:
        for t in trials:
            if (t.fault == "healthy") != (t.verdict == "good") or t.beyond:
                print(t.fault, t.verdict, f"{t.depth_error:.3g} of {t.promise:.3g}", *t.reasons, sep=" | ")
    if options.json:
        with open(options.json, "w", encoding="utf-8") as stream:
            json.dump([vars(t) for t in trials], stream)


def _print_row(name: str, trials: list[Trial]) -> None:
    counts = [sum(t.verdict == v for t in trials) for v in ("good", "usable", "bad", "refused")]
    beyond = [t for t in trials if t.beyond]
    bad = sum(t.verdict == "bad" for t in beyond)
    print(
        f"{name:22s} {len(trials):4d} {counts[0]:5d} {counts[1]:6d} {counts[2]:5d} {counts[3]:7d}  "
        f"{len(beyond):6d}  {bad:6d}"
    )


if __name__ == "__main__":
    main()
