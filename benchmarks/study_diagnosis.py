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

With ``harder`` the faults are made as small as they may be met, step by step, to see where naming breaks down:

corner_order     one view only
pairing          both lists shifted by one, in sets of 10 pictures
synchronisation  late by 0.10, 0.05 or 0.03 of an interval (at one picture a second 100, 50 or 30 ms), and by 0.03 with
                 the board moved a third as fast
knocked          0.3, 0.2, 0.1 or 0.05 degrees
bent_board       0.04, 0.03, 0.02 or 0.01 squares

and with ``pairs`` two faults are made at once; a trial is right if both are named, and nothing else.

Run: python benchmarks/study_diagnosis.py [trials] [kind ... | harder | pairs]
"""

from __future__ import annotations

import itertools
import sys
import time
from dataclasses import dataclass

import numpy as np

from stereocal.base.rotations import rotation_matrix
from stereocal.board.chessboard import Chessboard
from stereocal.camera.model import Camera
from stereocal.pair.diagnosis import diagnose_pairs

KINDS = ("healthy", "corner_order", "pairing", "synchronisation", "knocked", "bent_board")
SIZE = (640, 480)


# The faults of ``harder``: kind, what is said of it, and its size.
HARDER = (
    ("corner_order", "one view", {"turned": 1}),
    ("pairing", "shifted by one, 10 pictures", {"shift": 1, "pictures": 10}),
    ("synchronisation", "0.10 of an interval", {"late": 0.10}),
    ("synchronisation", "0.05 of an interval", {"late": 0.05}),
    ("synchronisation", "0.03 of an interval", {"late": 0.03}),
    ("synchronisation", "0.03, a third as fast", {"late": 0.03, "pace": 1 / 3}),
    ("knocked", "0.3 degrees", {"knock": 0.3}),
    ("knocked", "0.2 degrees", {"knock": 0.2}),
    ("knocked", "0.1 degrees", {"knock": 0.1}),
    ("knocked", "0.05 degrees", {"knock": 0.05}),
    ("bent_board", "0.04 squares", {"bend": 0.04}),
    ("bent_board", "0.03 squares", {"bend": 0.03}),
    ("bent_board", "0.02 squares", {"bend": 0.02}),
    ("bent_board", "0.01 squares", {"bend": 0.01}),
)


@dataclass(frozen=True)
class Sizes:
    """How large the faults are; None: drawn as the module says."""

    turned: int | None = None
    shift: int | None = None
    pictures: int | None = None
    late: float | None = None
    knock: float | None = None
    bend: float | None = None
    pace: float = 1.0


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


def trial(kinds: str | set[str], random: np.random.Generator, sizes: Sizes = Sizes()):
    """Return a board and the corners of both cameras, with the faults of these kinds."""
    kinds = {kinds} if isinstance(kinds, str) else kinds
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
    late = random.uniform(0.15, 0.6) * random.choice([-1, 1]) if "synchronisation" in kinds else 0.0
    if late and sizes.late:
        late = np.copysign(sizes.late, late)
    count = sizes.pictures or count
    noise = random.uniform(0.05, 0.25)
    X = board.object_points - board.object_points.mean(axis=0)
    X[:, 2] += shape_of(random, board, 0.001, smooth=False)
    if "bent_board" in kinds:
        bend = random.uniform(0.04, 0.15)
        X[:, 2] += shape_of(random, board, sizes.bend or bend, smooth=True)
    knock_at = int(random.integers(4, count - 3)) if "knocked" in kinds else count + 1
    axis = random.normal(size=3)
    angle = random.uniform(0.3, 2)
    knock = rotation_matrix(axis / np.linalg.norm(axis) * np.radians(sizes.knock or angle))
    way = Path(random)
    pictures: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
    for n in range(count):
        R_board, middle = way.at(sizes.pace * n)
        pictures[0].append(left.project(X @ R_board.T + middle))
        R_board, middle = way.at(sizes.pace * (n + late))
        seen = (X @ R_board.T + middle) @ R.T + T
        pictures[1].append(right.project(seen @ knock.T if n >= knock_at else seen))
    for views in pictures:
        views[:] = [view + noise * random.normal(size=view.shape) for view in views]
    lefts, rights = pictures
    if "corner_order" in kinds:
        turned = random.permutation(count)[: sizes.turned or random.integers(1, count + 1)]
        for n in turned:
            rights[n] = rights[n][::-1].copy()
    if "pairing" in kinds:
        side = rights if random.random() < 0.5 else lefts
        if sizes.shift:
            del side[: sizes.shift]
        elif random.random() < 0.5:
            del side[int(random.integers(1, count - 4))]
        else:
            del side[: int(random.integers(1, 4))]
        shortest = min(len(lefts), len(rights))
        lefts, rights = lefts[:shortest], rights[:shortest]
    return board, lefts, rights


def run(trials: int, kinds: set[str], label: str, seed: list[int], sizes: Sizes) -> None:
    """Print how often exactly these kinds are named."""
    right, others = 0, {}
    began = time.thread_time()
    for n in range(trials):
        board, lefts, rights = trial(kinds, np.random.default_rng([n, *seed]), sizes)
        named = diagnose_pairs(board, lefts, rights, SIZE).kinds
        if named == kinds - {"healthy"}:
            right += 1
        else:
            key = ", ".join(sorted(named)) or "nothing"
            others[key] = others.get(key, 0) + 1
    each = (time.thread_time() - began) / trials
    told = "; ".join(f"{n} x {key}" for key, n in sorted(others.items())) or "-"
    print(f"{label:44} {100 * right / trials:10.1f} %   {told}   ({each:.2f} s each)", flush=True)


def main() -> None:
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    kinds = sys.argv[2:] or KINDS
    print(f"{'made':44} {'named right':>12}   otherwise")
    for kind in kinds:
        if kind == "harder":
            for number, (name, about, sizes) in enumerate(HARDER):
                run(trials, {name}, f"{name}, {about}", [KINDS.index(name), 100 + number], Sizes(**sizes))
        elif kind == "pairs":
            for two in itertools.combinations(KINDS[1:], 2):
                run(trials, set(two), " + ".join(two), [KINDS.index(name) for name in two], Sizes())
        else:
            run(trials, {kind}, kind, [KINDS.index(kind)], Sizes())


if __name__ == "__main__":
    main()
