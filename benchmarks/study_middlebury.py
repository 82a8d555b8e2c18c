"""Our matchers and OpenCV's on scenes of known disparity: who is right, how often, and how fast.

    python benchmarks/study_middlebury.py [--data DIR] [--scene DIR …] [--pictures DIR [--pair LEFT RIGHT …]]

`--data` holds the folders motorcycle, teddy and tsukuba. `--scene` adds scenes in the layout of Middlebury 2014 and
2021 (im0.png, im1.png, disp0.pfm, calib.txt with ndisp). `--pair` takes a rectified pair of unknown truth (``stereocal
rectify`` makes one): it gets a sheet of pictures and no figures.

Columns: percent of the pixels with known truth whose disparity is off by more than 1 or 2 pixels, a pixel without a
disparity counting as off; over all of them, and over those that the right camera sees as well ("noc"). Density:
percent of all pixels with a disparity. Then, of the pixels with a disparity alone, the percentage off by more than 1
and the root mean square error. Milliseconds: median, one thread, warm, of the thread's own processor time.

Which pixels the right camera sees follows from the left truth: project every pixel to its place in the right image and
keep, at each place, the nearest surface; a pixel more than 1 px of disparity behind it is hidden.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

import stereocal as sc

Matcher = Callable[[np.ndarray, np.ndarray, int], np.ndarray]


@dataclass
class Scene:
    name: str
    left: np.ndarray
    right: np.ndarray
    truth: np.ndarray  # NaN where unknown
    disparities: int

    @property
    def visible(self) -> np.ndarray:
        y, x = np.nonzero(np.isfinite(self.truth))
        d = self.truth[y, x]
        there = np.rint(x - d).astype(int)
        real = (there >= 0) & (there < self.truth.shape[1])
        nearest = np.full(self.truth.shape, -np.inf)
        np.maximum.at(nearest, (y[real], there[real]), d[real])
        seen = np.zeros(self.truth.shape, bool)
        seen[y[real], x[real]] = d[real] >= nearest[y[real], there[real]] - 1
        return seen


def gray(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise SystemExit(f"cannot read {path}")
    return image


def known(truth: np.ndarray, scale: float = 1.0) -> np.ndarray:
    truth = truth.astype(np.float64) / scale
    return np.where(np.isfinite(truth) & (truth > 0), truth, np.nan)


def small_scenes(data: Path) -> Iterator[Scene]:
    at = data / "motorcycle"
    if at.is_dir():
        truth = known(np.load(at / "motorcycle_disp.npz")["arr_0"])
        yield Scene("motorcycle", gray(at / "motorcycle_left.png"), gray(at / "motorcycle_right.png"), truth, 64)
    at = data / "teddy"
    if at.is_dir():
        truth = known(cv2.imread(str(at / "disp2.pgm"), cv2.IMREAD_UNCHANGED), 4)
        yield Scene("teddy", gray(at / "im2.png"), gray(at / "im6.png"), truth, 64)
    at = data / "tsukuba"
    if at.is_dir():
        truth = known(cv2.imread(str(at / "truedisp.row3.col3.pgm"), cv2.IMREAD_UNCHANGED), 16)
        left, right = (gray(at / f"scene1.row3.col{n}.ppm") for n in (3, 4))
        yield Scene("tsukuba", left, right, truth, 16)


def middlebury_scene(folder: Path) -> Scene:
    settings = dict(line.split("=", 1) for line in (folder / "calib.txt").read_text().split("\n") if "=" in line)
    truth = known(cv2.imread(str(folder / "disp0.pfm"), cv2.IMREAD_UNCHANGED))
    disparities = -(-int(settings["ndisp"]) // 16) * 16
    return Scene(folder.name, gray(folder / "im0.png"), gray(folder / "im1.png"), truth, disparities)


def opencv_map(disparity: np.ndarray) -> np.ndarray:
    return np.where(disparity < 0, np.nan, disparity / 16.0)


def sgbm(mode: int) -> Matcher:
    def match(left: np.ndarray, right: np.ndarray, d: int) -> np.ndarray:
        return opencv_map(cv2.StereoSGBM.create(0, d, 5, 8 * 25, 32 * 25, 0, 0, 10, 100, 2, mode).compute(left, right))

    return match


def sgm(**options: object) -> Matcher:
    return lambda left, right, d: sc.match_sgm(left, right, num_disparities=d, threads=1, **options)


MATCHERS: dict[str, Matcher] = {
    "OpenCV BM 15": lambda left, right, d: opencv_map(cv2.StereoBM.create(d, 15).compute(left, right)),
    "OpenCV SGBM 3WAY": sgbm(cv2.STEREO_SGBM_MODE_SGBM_3WAY),
    "OpenCV SGBM 5 paths": sgbm(cv2.STEREO_SGBM_MODE_SGBM),
    "OpenCV SGBM HH": sgbm(cv2.STEREO_SGBM_MODE_HH),
    "match_sad 15": lambda left, right, d: sc.match_sad(left, right, num_disparities=d, block_size=15, threads=1),
    "match_bm 15": lambda left, right, d: sc.match_bm(left, right, num_disparities=d, block_size=15, threads=1),
    "match_census": lambda left, right, d: sc.match_census(left, right, num_disparities=d, threads=1),
    "match_sgm": sgm(),
    "match_sgm 5 paths": sgm(paths=5),
    "match_sgm 4 paths": sgm(paths=4),
    "match_sgm census": sgm(cost="census"),
    "match_sgm bt": sgm(cost="bt", block_size=5),
    "match_sgm sad": sgm(cost="sad", block_size=5),
    "match_sgm, weighted median": lambda left, right, d: sc.weighted_median(
        sc.match_sgm(left, right, num_disparities=d, threads=1), left, threads=1
    ),
    "match_sgm, holes filled": lambda left, right, d: sc.fill_holes(
        sc.match_sgm(left, right, num_disparities=d, threads=1)
    ),
}


def scores(disparity: np.ndarray, scene: Scene) -> list[float]:
    error = np.abs(disparity - scene.truth)
    has_truth, answered = np.isfinite(scene.truth), np.isfinite(error)
    row = [100 * np.mean(~(error <= limit)[where]) for where in (has_truth, scene.visible) for limit in (1, 2)]
    row += [100 * np.mean(np.isfinite(disparity)), 100 * np.mean(error[answered] > 1)]
    return [*row, float(np.sqrt(np.mean(error[answered] ** 2)))]


def timed(matcher: Matcher, scene: Scene) -> tuple[np.ndarray, float]:
    matcher(scene.left, scene.right, scene.disparities)
    times = []
    for _ in range(5):
        start = time.thread_time()
        disparity = matcher(scene.left, scene.right, scene.disparities)
        times.append(time.thread_time() - start)
    return disparity, 1e3 * statistics.median(times)


def picture(disparity: np.ndarray, scene: Scene) -> np.ndarray:
    low, high = 0.0, float(scene.disparities)
    if np.isfinite(scene.truth).any():
        low, high = np.nanpercentile(scene.truth, (0.5, 99.5))
    share = np.clip((np.nan_to_num(disparity, nan=low) - low) / (high - low), 0, 1)
    color = cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_TURBO)
    color[~np.isfinite(disparity)] = 0
    return color


def labelled(image: np.ndarray, text: str) -> np.ndarray:
    canvas = cv2.copyMakeBorder(image, 22, 2, 2, 2, cv2.BORDER_CONSTANT, value=(255, 255, 255))
    return cv2.putText(canvas, text, (4, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)


def contact_sheet(tiles: list[np.ndarray], columns: int) -> np.ndarray:
    blank = np.full_like(tiles[0], 255)
    rows = [tiles[i : i + columns] for i in range(0, len(tiles), columns)]
    return np.vstack([np.hstack(row + [blank] * (columns - len(row))) for row in rows])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    shared = Path(__file__).parents[2] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("STEREOCAL_DATA") or shared))
    parser.add_argument("--scene", type=Path, nargs="*", default=[])
    parser.add_argument("--pictures", type=Path, help="folder for one contact sheet a scene")
    parser.add_argument("--pair", type=Path, nargs=2, action="append", default=[], help="rectified, truth unknown")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    for scene in [*small_scenes(arguments.data), *map(middlebury_scene, arguments.scene)]:
        height, width = scene.left.shape
        print(f"\n## {scene.name}: {width}x{height}, {scene.disparities} disparities\n")
        print("| matcher | bad1 | bad2 | bad1 noc | bad2 noc | density | bad1 of answers | RMSE | ms |")
        print("|---|---|---|---|---|---|---|---|---|")
        tiles = [
            labelled(cv2.cvtColor(scene.left, cv2.COLOR_GRAY2BGR), "left"),
            labelled(picture(scene.truth, scene), "truth"),
        ]
        for name, matcher in MATCHERS.items():
            disparity, milliseconds = timed(matcher, scene)
            numbers = " | ".join(f"{number:.2f}" for number in scores(disparity, scene))
            print(f"| {name} | {numbers} | {milliseconds:.1f} |", flush=True)
            tiles.append(labelled(picture(disparity, scene), name))
        if arguments.pictures:
            arguments.pictures.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(arguments.pictures / f"{scene.name}.png"), contact_sheet(tiles, 4))
    for left, right in arguments.pair if arguments.pictures else []:
        pair = gray(left), gray(right)
        scene = Scene(left.stem, *pair, np.full(pair[0].shape, np.nan), 64)
        tiles = [labelled(cv2.cvtColor(scene.left, cv2.COLOR_GRAY2BGR), "left")]
        for name, matcher in MATCHERS.items():
            tiles.append(labelled(picture(matcher(*pair, scene.disparities), scene), name))
        cv2.imwrite(str(arguments.pictures / f"{scene.name}.png"), contact_sheet(tiles, 4))


if __name__ == "__main__":
    main()
