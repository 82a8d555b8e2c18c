"""Faults of stereo pairs, made on purpose: are they named right, and are healthy rigs left alone?

Each trial draws a rig (two cameras of 640 x 480 with barrel distortion, a baseline of 2 to 5 squares, a slight turn), a
board of 7 x 6 or 9 x 6 corners moved along a smooth path through the common view in 16 to 24 pictures, noise of 0.05 to
0.25 px per axis and a board that is flat to 0.003 squares, and then one fault:

corner_order     1 to all of the right views list their corners from the other end
pairing          one picture is missing in one list, from a random place on, or the lists are shifted by 1 to 3
synchronisation  the right camera exposes 0.15 to 0.6 of a picture's interval later
knocked          the right camera turns by 0.3 to 2 degrees after a random picture
bent_board       heights of 0.04 to 0.15 squares: a fold or a bow
healthy          none

A trial is right if exactly the fault's kind is named, and nothing else.

Run: python benchmarks/study_diagnosis.py [trials] [kind]
"""

from __future__ import annotations

import sys
import time

import numpy as np

from stereocal.base.rotations import rotation_matrix
from stereocal.board.chessboard import Chessboard
from stereocal.camera.model import Camera
from stereocal.pair.diagnosis import diagnose_pairs

KINDS = ("healthy", "corner_order", "pairing", "synchronisation", "knocked", "bent_board")
SIZE = (640, 480)


class Path:
    """A smooth random path of the board through the common view."""

    def __init__(self, random: np.random.Generator) -> None:
        self.phase = random.uniform(0, 2 * np.pi, (2, 6))
        self.speed = random.uniform(0.35, 0.9, (2, 6))

    def at(self, moment: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the board's rotation and the place of its middle."""
        slow, quick = np.sin(self.speed * [[moment], [2.1 * moment]] + self.phase)
        pose = (slow + 0.5 * quick) / 1.5 * np.array([0.45, 0.45, 0.35, 2.2, 1.6, 3.0])
        return rotation_matrix(pose[:3]), pose[3:] + np.array([0.0, 0, 13.0])


def shape_of(random: np.random.Generator, board: Chessboard, height: float, *, smooth: bool) -> np.ndarray:
    """Return heights of the board's corners, `height` from lowest to highest."""
    X = board.object_points[:, :2]
    if not smooth:
        return random.normal(size=len(X)) * height
    way = X @ (lambda a: np.array([np.cos(a), np.sin(a)]))(random.uniform(0, np.pi))
    way = (way - way.mean()) / np.ptp(way) * 2
    z = np.abs(way - random.uniform(-0.3, 0.3)) if random.random() < 0.5 else way**2
    plane = np.column_stack([np.ones(len(X)), X])
    z = z - plane @ np.linalg.lstsq(plane, z, rcond=None)[0]
    return z / np.ptp(z) * height


def trial(kind: str, random: np.random.Generator):
    """Return a board and the corners of both cameras, with the fault of that kind."""
    board = Chessboard((7, 6) if random.random() < 0.5 else (9, 6), 1.0)

    def camera() -> Camera:
        f = random.uniform(420, 650)
        K = np.array(
            [
                [f, 0, 320 + 10 * random.normal()],
                [0, f * random.uniform(0.99, 1.01), 240 + 10 * random.normal()],
                [0, 0, 1],
            ]
        )
        return Camera(K, random.normal(size=5) * [0.05, 0.02, 0.001, 0.001, 0] + [-0.3, 0.1, 0, 0, 0], SIZE)

    left, right = camera(), camera()
    R = rotation_matrix(random.normal(size=3) * 0.03)
    T = np.array([-random.uniform(2, 5), 0.05 * random.normal(), 0.05 * random.normal()])
    count = int(random.integers(16, 25))
    late = random.uniform(0.15, 0.6) * random.choice([-1, 1]) if kind == "synchronisation" else 0.0
    noise = random.uniform(0.05, 0.25)
    X = board.object_points - board.object_points.mean(axis=0)
    X[:, 2] += shape_of(random, board, 0.001, smooth=False)
    if kind == "bent_board":
        X[:, 2] += shape_of(random, board, random.uniform(0.04, 0.15), smooth=True)
    knock_at = int(random.integers(4, count - 3)) if kind == "knocked" else count + 1
    axis = random.normal(size=3)
    knock = rotation_matrix(axis / np.linalg.norm(axis) * np.radians(random.uniform(0.3, 2)))
    way = Path(random)
    pictures: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
    for n in range(count):
        R_board, middle = way.at(n)
        pictures[0].append(left.project(X @ R_board.T + middle))
        R_board, middle = way.at(n + late)
        seen = (X @ R_board.T + middle) @ R.T + T
        pictures[1].append(right.project(seen @ knock.T if n >= knock_at else seen))
    for views in pictures:
        views[:] = [view + noise * random.normal(size=view.shape) for view in views]
    lefts, rights = pictures
    if kind == "corner_order":
        turned = random.permutation(count)[: random.integers(1, count + 1)]
        for n in turned:
            rights[n] = rights[n][::-1].copy()
    if kind == "pairing":
        side = rights if random.random() < 0.5 else lefts
        if random.random() < 0.5:
            del side[int(random.integers(1, count - 4))]
        else:
            del side[: int(random.integers(1, 4))]
        shortest = min(len(lefts), len(rights))
        lefts, rights = lefts[:shortest], rights[:shortest]
    return board, lefts, rights


def main() -> None:
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    kinds = sys.argv[2:] or KINDS
    print(f"{'made':16} {'named right':>12}   otherwise")
    for kind in kinds:
        right, others = 0, {}
        began = time.perf_counter()
        for n in range(trials):
            board, lefts, rights = trial(kind, np.random.default_rng([n, KINDS.index(kind)]))
            named = diagnose_pairs(board, lefts, rights, SIZE).kinds
            if named == (set() if kind == "healthy" else {kind}):
                right += 1
            else:
                key = ", ".join(sorted(named)) or "nothing"
                others[key] = others.get(key, 0) + 1
        each = (time.perf_counter() - began) / trials
        told = "; ".join(f"{n} x {key}" for key, n in sorted(others.items())) or "-"
        print(f"{kind:16} {100 * right / trials:10.1f} %   {told}   ({each:.2f} s each)", flush=True)


if __name__ == "__main__":
    main()
