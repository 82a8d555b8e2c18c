"""Does it say no where there is no board? Scenes, textures, and boards of another size.

    python benchmarks/study_false_positives.py DATA

DATA is the folder of photographs. Prints every detection of a board that is not there, and how often the size that is
there was named.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

import stereocal as sc

SIZES = [(9, 6), (8, 6), (7, 6), (7, 7), (6, 6), (8, 5), (6, 4), (5, 4), (5, 3), (4, 3), (3, 3)]
BOARDS = {"uvc_paper": [(7, 6), (7, 7)], "opencv_sample": [(9, 6)], "bumblebee2_chess": [(6, 4)]}


def textures(count=40):
    """White and smoothed noise, stripes, binary blocks."""
    rng = np.random.default_rng(0)
    for k in range(count):
        kind = k % 4
        if kind == 0:
            yield rng.integers(0, 256, (480, 640)).astype(np.uint8)
        elif kind == 1:
            image = ndimage.gaussian_filter(rng.standard_normal((480, 640)), rng.uniform(1, 8))
            yield np.clip(128 + 60 * image / image.std(), 0, 255).astype(np.uint8)
        elif kind == 2:
            side = int(rng.integers(5, 25))
            blocks = rng.integers(0, 2, (480 // side + 1, 640 // side + 1)) * 180 + 30
            yield np.kron(blocks, np.ones((side, side)))[:480, :640].astype(np.uint8)
        else:
            y, x = np.mgrid[:480, :640]
            a, b = rng.uniform(0.1, 0.6, 2)
            yield np.clip(128 + 50 * np.sin(a * x) + 50 * np.sin(b * y), 0, 255).astype(np.uint8)


def main():
    """Print what was found that is not there."""
    data = Path(sys.argv[1])
    empty = [*data.glob("zhang/images/*.jpg"), *data.glob("t*/*.p[pn][mg]"), *data.glob("motorcycle/*.png")]
    empty += [*data.glob("uvc_paper/scene/*.jpg")]
    images = [(p.name, cv2.imread(str(p), 0)) for p in empty] + [(f"texture{k}", t) for k, t in enumerate(textures())]
    false = tried = 0
    for name, image in images:
        for size in SIZES:
            tried += 1
            found = sc.detect_chessboard_detailed(image, size)
            if found.found:
                false += 1
                print("false:", name, size, np.ptp(found.corners, axis=0))
    print(f"no board: {false} false of {tried}")
    false = tried = named = asked = 0
    for folder, true in BOARDS.items():
        for path in sorted([*data.glob(f"{folder}/left/*.jpg"), *data.glob(f"{folder}/right/*.jpg")]):
            image = cv2.imread(str(path), 0)
            for size in SIZES:
                if size in true or size[::-1] in true:
                    continue
                tried += 1
                found = sc.detect_chessboard_detailed(image, size)
                if found.found:
                    false += 1
                    print("false:", folder, path.parent.name, path.name, size, np.ptp(found.corners, axis=0))
                else:
                    asked += 1
                    named += found.other_size in true
    print(f"another size: {false} false of {tried}; the true size named {named} of {asked} times")


if __name__ == "__main__":
    main()
