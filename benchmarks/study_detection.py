"""Which boards are found? Renders of hard scenes, beside both OpenCV detectors, and scenes without the board.

    python benchmarks/study_detection.py [images a scene] [--quick] [--only SCENE]

A board counts as found if every corner lies within 1.5 px of the truth (or a tenth of the spacing), in the truth's
order or its half turn. "wrong" counts boards that were returned but are not there.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from board_scenes import Lens, random_pose, render
from opencv_detectors import HEADER, Tally, judge, verdicts
from scipy import ndimage

import stereocal as sc

BROWN = (-0.28, 0.09, 0.0008, -0.0006, -0.01)
SCENES = [
    "plain",
    "barrel",
    "fisheye",
    "tilt65",
    "blur",
    "noise",
    "low_contrast",
    "uneven_light",
    "overexposed",
    "edge",
    "clutter",
    "tiny",
    "small_image",
    "many_corners",
    "few_corners",
    "large_image",
    "half_squares",
    "dark",
    "motion",
    "no_margin",
    "sixteen_bit",
]


def clutter(rng, height, width):
    """A background of lines, boxes, letters and soft texture."""
    image = ndimage.gaussian_filter(rng.uniform(0, 255, (height, width)), rng.uniform(1, 6))
    image = 128 + (image - image.mean()) / image.std() * rng.uniform(5, 40)
    image = np.ascontiguousarray(np.clip(image, 0, 255).astype(np.uint8))
    for _ in range(60):
        p, q = rng.integers(0, [width, height], (2, 2))
        kind, grey = rng.integers(4), int(rng.integers(0, 256))
        if kind == 0:
            cv2.line(image, tuple(map(int, p)), tuple(map(int, q)), grey, int(rng.integers(1, 6)))
        elif kind == 1:
            box = rng.integers(5, 60, 2)
            cv2.rectangle(image, tuple(map(int, p)), tuple(map(int, p + box)), grey, -1)
        elif kind == 2:
            text = "".join(rng.choice(list("ABXKHE8x+#"), 6))
            cv2.putText(image, text, tuple(map(int, p)), 0, float(rng.uniform(0.4, 1.5)), grey, 2)
        else:
            cv2.circle(image, tuple(map(int, p)), int(rng.integers(3, 30)), grey, -1)
    return image.astype(float)


def scene(name, rng):
    """(image, truth, inner corners) of a scene."""
    size, board, lens = (640, 480), (9, 6), Lens(520.0, (322.3, 238.1), BROWN)
    pose = {"tilt": 40, "fill": (0.35, 0.9), "border": 12}
    options = {
        "blur": rng.uniform(0.5, 1.2),
        "noise": rng.uniform(1, 3),
        "background": rng.uniform(60, 200),
        "samples": 4,
    }
    options["light"], options["dark"] = rng.uniform(170, 230), rng.uniform(20, 60)
    board = tuple(int(v) for v in rng.choice([(9, 6), (7, 6), (8, 6), (6, 4), (7, 7), (11, 8), (5, 4)]))
    ramp = None
    if name == "barrel":
        lens = Lens(300.0, (322.3, 238.1), (-0.25, 0.05, 0.001, -0.001, -0.004))
    elif name == "fisheye":
        lens = Lens(190.0, (322.3, 238.1), (-0.02, 0.003, -0.001, 0.0), fisheye=True)
        pose = {"tilt": 45, "fill": (0.6, 1.3), "border": 12}
    elif name == "tilt65":
        pose = {"tilt": 65, "fill": (0.6, 1.0), "border": 8}
    elif name == "blur":
        options["blur"] = rng.uniform(2, 4.5)
        pose["fill"] = (0.6, 0.95)
    elif name == "motion":
        options["blur"] = 0.6
        pose["fill"] = (0.5, 0.95)
    elif name == "noise":
        options["noise"] = rng.uniform(10, 30)
    elif name == "low_contrast":
        middle, half = rng.uniform(50, 200), rng.uniform(4, 12)
        options.update(light=middle + half, dark=middle - half, background=middle, noise=1.5)
    elif name == "dark":
        options.update(light=rng.uniform(14, 30), dark=4, background=6, noise=1.5)
    elif name in ("uneven_light", "overexposed"):
        x, y = np.meshgrid(np.linspace(-1, 1, size[0]), np.linspace(-1, 1, size[1]))
        a = rng.uniform(0, 2 * np.pi)
        ramp = 0.55 + 0.45 * (np.cos(a) * x + np.sin(a) * y)
        spot = np.exp(-((x - rng.uniform(-0.6, 0.6)) ** 2 + (y - rng.uniform(-0.6, 0.6)) ** 2) / 0.3)
        ramp = np.clip(ramp, 0.12, None) if name == "uneven_light" else 0.8 + 1.6 * spot
    elif name == "edge":
        pose["border"] = 2.5
        pose["fill"] = (0.9, 1.3)
    elif name == "clutter":
        options["background"] = clutter(rng, size[1], size[0])
        options["margin"] = rng.uniform(0.1, 0.6)
    elif name == "tiny":
        pose["fill"] = (0.12, 0.25)
        pose["tilt"] = 30
    elif name == "small_image":
        size, lens = (270, 180), Lens(220.0, (136.0, 90.0), BROWN)
        pose.update(fill=(0.5, 0.95), border=4)
    elif name == "many_corners":
        board = (20, 20) if rng.random() < 0.5 else (19, 14)
        pose["fill"] = (0.75, 0.95)
    elif name == "few_corners":
        board = [(5, 3), (4, 3), (3, 3), (5, 4)][rng.integers(4)]
        options["background"] = clutter(rng, size[1], size[0])
    elif name == "large_image":
        size, lens = (4000, 3000), Lens(3300.0, (2001.0, 1480.0), BROWN)
        pose["fill"] = (0.08, 0.9)
        options.update(blur=rng.uniform(0.7, 2.5), noise=rng.uniform(2, 6))
    elif name == "half_squares":
        options["crop"] = 0.5
    elif name == "no_margin":
        options["margin"] = 0.0
        options["background"] = rng.choice([20.0, 235.0])
    R, t = random_pose(rng, lens, size, board, **pose)
    image, truth = render(lens, size, R, t, board, shade=ramp, seed=int(rng.integers(1 << 30)), **options)
    if name == "motion":
        length, angle = rng.uniform(3, 9), rng.uniform(0, np.pi)
        kernel = np.zeros((11, 11), np.float32)
        cv2.line(kernel, (5, 5), (int(5 + length / 2 * np.cos(angle)), int(5 + length / 2 * np.sin(angle))), 1)
        cv2.line(kernel, (5, 5), (int(5 - length / 2 * np.cos(angle)), int(5 - length / 2 * np.sin(angle))), 1)
        image = cv2.filter2D(image, -1, kernel / kernel.sum())
    if name == "sixteen_bit":
        image = image.astype(np.uint16) * 16
    return image, truth, board


def main():
    """Print a line a scene."""
    parser = argparse.ArgumentParser()
    parser.add_argument("count", nargs="?", type=int, default=20)
    parser.add_argument("--quick", action="store_true", help="ask OpenCV only where we fail")
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--save", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print(HEADER)
    behind = 0
    for name in arguments.only or SCENES:
        tally = Tally()
        total = arguments.count if name != "large_image" else max(1, arguments.count // 5)
        for k in range(total):
            image, truth, board = scene(name, np.random.default_rng([arguments.seed, SCENES.index(name), k]))
            bytes_ = image if image.dtype == np.uint8 else (image // 16).astype(np.uint8)
            detection = sc.detect_chessboard_detailed(image, board)
            ours, theirs = judge(detection.corners, truth, board), {}
            if image.size < 3e6 and not (arguments.quick and ours == "found"):
                theirs = verdicts(bytes_, truth, board, until_found=arguments.quick)
            tally.add(f"{k} {board}", ours, theirs, detection.message)
            if arguments.save and ours != "found":
                cv2.imwrite(str(arguments.save / f"{name}_{k}.png"), bytes_)
        behind += tally.behind
        print(tally.line(name, total), flush=True)
        for reason in tally.reasons[:6]:
            print("      ", reason)
    print(f"found by OpenCV, not by us: {behind}")


if __name__ == "__main__":
    main()
