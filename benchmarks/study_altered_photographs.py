"""Which boards are found in real photographs made worse? Every photograph, altered as cameras and rooms alter them.

    python benchmarks/study_altered_photographs.py [FOLDER] [--only ALTERATION ...] [--every N] [--quick] [--save TO]

FOLDER holds the photographs (default: STEREOCAL_DATA). Each is made dark, bright, blurred, bent, small, … by a random
amount; where the corners go is known, because the alteration's map is. The truth on the unaltered photograph is our own
detection there, which the tests compare with OpenCV's. Printed for each alteration: how many are found by us, by
findChessboardCorners and by findChessboardCornersSB (default flags; exhaustive and accurate), by either of them under
any of seven settings of flags, and how many of the last we miss. With --quick OpenCV is asked only where we fail.
"""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

import cv2
import numpy as np
from opencv_detectors import HEADER, Tally, judge, verdicts
from scipy import ndimage
from study_detection import clutter

import stereocal as sc

SETS = {"uvc_paper": (7, 6), "opencv_sample": (9, 6), "bumblebee2_chess": (6, 4)}


def warped(image, truth, backward, size):
    """The image seen through a map: `backward` takes output pixels (..., 2) to input pixels; four samples a side."""
    width, height = size
    n = 3
    y, x = np.mgrid[: height * n, : width * n]
    source = backward(np.stack([(x + 0.5) / n - 0.5, (y + 0.5) / n - 0.5], -1).astype(np.float64))
    value = cv2.remap(image, source.astype(np.float32), None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    value = cv2.resize(value.astype(np.float32), size, None, 0, 0, cv2.INTER_AREA)
    # where a corner comes to lie: the inverse by Newton's method with differences
    coarse = np.stack(np.meshgrid(np.arange(0, width, 4), np.arange(0, height, 4)), -1).reshape(-1, 2).astype(float)
    there = backward(coarse)
    p = coarse[[np.argmin(((there - t) ** 2).sum(-1)) for t in truth]]
    for _ in range(30):
        e = backward(p) - truth
        dx, dy = (backward(p + half) - backward(p - half) for half in 0.5 * np.eye(2))
        p = p - np.linalg.solve(np.stack([dx, dy], -1), e[..., None])[..., 0].clip(-8, 8)
    inside = (p > 3).all() and (p < np.array(size) - 4).all() and np.abs(backward(p) - truth).max() < 0.01
    return (value, p) if inside else None


def bend(rng, image, truth):
    """Paper bent along a random direction, seen from a random side."""
    height, width = image.shape
    a, b = rng.uniform(0, 2 * np.pi, 2)
    along, towards = np.array([np.cos(a), np.sin(a)]), np.array([np.cos(b), np.sin(b)])
    middle, extent = truth.mean(axis=0), np.ptp(truth, axis=0).max()
    waves, depth, phase = rng.uniform(0.3, 1.2), rng.uniform(0.02, 0.1) * extent, rng.uniform(0, 2 * np.pi)

    def backward(p):
        u = (p - middle) @ along / extent
        return p + (depth * np.sin(2 * np.pi * waves * u + phase))[..., None] * towards

    return warped(image, truth, backward, (width, height))


def fisheye(rng, image, truth):
    """An equidistant lens of a wide field: r = f theta looks where a lens without distortion has f tan theta."""
    height, width = image.shape
    middle = np.array([width, height]) / 2 - 0.5
    half = 0.5 * np.hypot(width, height)
    corner = np.deg2rad(rng.uniform(50, 75))  # field of the photograph's own corner
    f = half / np.tan(corner)
    g = half / corner * rng.uniform(0.8, 1.2)

    def backward(p):
        d = p - middle
        r = np.linalg.norm(d, axis=-1, keepdims=True)
        theta = np.minimum(r / g, 1.5)
        return middle + d * np.where(r > 1e-9, f * np.tan(theta) / np.maximum(r, 1e-9), f / g)

    return warped(image, truth, backward, (width, height))


def tilt(rng, image, truth):
    """A further perspective, as if the camera had gone to the side."""
    height, width = image.shape
    f = 0.9 * width
    K = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]])
    a = rng.uniform(0, 2 * np.pi)
    R = cv2.Rodrigues(np.deg2rad(rng.uniform(20, 55)) * np.array([np.cos(a), np.sin(a), 0]))[0]
    middle = np.append((truth.mean(axis=0) - [width / 2, height / 2]) / f, 1.0)
    # the board's middle turns about itself and comes to the image's
    t = np.array([0, 0, rng.uniform(0.9, 1.6)]) - R @ middle
    H = np.linalg.inv(K @ np.column_stack([R[:, 0], R[:, 1], R[:, 2] + t]) @ np.linalg.inv(K))

    def backward(p):
        q = p @ H[:, :2].T + H[:, 2]
        return q[..., :2] / q[..., 2:]

    return warped(image, truth, backward, (width, height))


def turn(rng, image, truth):
    """Turned in the image plane by any angle, a little smaller."""
    height, width = image.shape
    a, scale = rng.uniform(0, 2 * np.pi), rng.uniform(1.0, 1.6)
    A = scale * np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]])
    middle = truth.mean(axis=0)
    return warped(image, truth, lambda p: (p - [width / 2, height / 2]) @ A.T + middle, (width, height))


def small(rng, image, truth):
    """The photograph far away in a scene of clutter."""
    height, width = image.shape
    scale = rng.uniform(0.18, 0.5)
    small = cv2.resize(image.astype(np.float32), None, None, scale, scale, cv2.INTER_AREA)
    scene = cv2.resize(clutter(rng, height, width), (width, height)).astype(np.float32)
    x, y = int(rng.uniform(0, width - small.shape[1])), int(rng.uniform(0, height - small.shape[0]))
    scene[y : y + small.shape[0], x : x + small.shape[1]] = small
    sx, sy = small.shape[1] / width, small.shape[0] / height
    return scene, (truth + 0.5) * [sx, sy] - 0.5 + [x, y]


def shrunk(rng, image, truth):
    """A camera of few pixels."""
    height, width = image.shape
    scale = rng.uniform(0.25, 0.5)
    small = cv2.resize(image.astype(np.float32), None, None, scale, scale, cv2.INTER_AREA)
    return small, (truth + 0.5) * [small.shape[1] / width, small.shape[0] / height] - 0.5


def large(rng, image, truth):
    """A camera of many pixels and no more detail."""
    scale = rng.uniform(2, 4)
    big = cv2.resize(image.astype(np.float32), None, None, scale, scale, cv2.INTER_CUBIC)
    height, width = image.shape
    return big, (truth + 0.5) * [big.shape[1] / width, big.shape[0] / height] - 0.5


def cropped(rng, image, truth):
    """The board's corners reach the border: a few pixels up to half a square are left around them."""
    low, high = truth.min(axis=0), truth.max(axis=0)
    step = np.sqrt(np.prod(high - low) / len(truth))
    margin = rng.uniform(0.3, 1.0, 4) * step + 2
    x0, y0 = np.maximum(np.floor(low - margin[:2]), 0).astype(int)
    x1, y1 = np.ceil(high + margin[2:]).astype(int)
    side = int(rng.integers(4))  # the other sides keep the picture's border
    height, width = image.shape
    x0, y0, x1, y1 = (
        x0 if side == 0 else 0,
        y0 if side == 1 else 0,
        x1 if side == 2 else width,
        y1 if side == 3 else height,
    )
    return image[y0:y1, x0:x1].astype(np.float32), truth - [x0, y0]


def bright(rng, image, truth):
    """Overexposed: light saturates and flows over into the dark."""
    light = image * rng.uniform(1.5, 4.0)
    for share, sigma in ((rng.uniform(0, 0.3), 2.0), (rng.uniform(0, 0.15), 10.0)):
        light = light + share * ndimage.gaussian_filter(np.maximum(light - 230, 0), sigma)
    return light, truth


def motion(rng, image, truth):
    """The camera moved by 3 to 12 pixels."""
    length, angle = rng.uniform(3, 12), rng.uniform(0, np.pi)
    kernel = np.zeros((15, 15), np.float32)
    for t in np.linspace(-0.5, 0.5, 201):
        x, y = 7 + t * length * np.cos(angle), 7 + t * length * np.sin(angle)
        kernel[round(y), round(x)] += 1
    return cv2.filter2D(image.astype(np.float32), -1, kernel / kernel.sum()), truth


def _coordinates(image):
    return np.meshgrid(np.linspace(-1, 1, image.shape[1]), np.linspace(-1, 1, image.shape[0]))


def shadow(rng, image, truth):
    """A shadow with a hard edge across the board."""
    x, y = _coordinates(image)
    middle = truth.mean(axis=0) / np.array(image.shape[::-1]) * 2 - 1
    a = rng.uniform(0, 2 * np.pi)
    side = np.cos(a) * (x - middle[0]) + np.sin(a) * (y - middle[1])
    return image * (rng.uniform(0.15, 0.5) + 0.6 / (1 + np.exp(-side / rng.uniform(0.003, 0.03)))), truth


def glare(rng, image, truth):
    """A lamp's reflection on the board."""
    x, y = _coordinates(image)
    p, q = truth[int(rng.integers(len(truth)))] / np.array(image.shape[::-1]) * 2 - 1
    spot = np.exp(-((x - p) ** 2 + (y - q) ** 2) / rng.uniform(0.005, 0.1))
    return image + rng.uniform(60, 220) * spot, truth


def vignette(rng, image, truth):
    """Light falls off towards the image's corners."""
    x, y = _coordinates(image)
    return image * np.clip(1 - rng.uniform(0.4, 0.5) * (x * x + y * y), 0.03, 1), truth


def jpeg(rng, image, truth):
    """Compressed hard."""
    quality = int(rng.integers(5, 30))
    return cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], 0), truth


def moire(rng, image, truth):
    """The screen's rows beat with the sensor's."""
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    wave = np.sin(rng.uniform(-1.5, 1.5) * x + rng.uniform(-1.5, 1.5) * y) + np.sin(rng.uniform(-0.2, 0.2) * (x + y))
    return image * (1 + rng.uniform(0.05, 0.2) * wave), truth


ALTERATIONS = {
    "as it is": lambda rng, image, truth: (image, truth),
    "dark": lambda rng, image, truth: (image * rng.uniform(0.04, 0.25), truth),
    "bright": bright,
    "gamma": lambda rng, image, truth: (255 * (image / 255) ** np.exp(rng.uniform(-1.3, 1.3)), truth),
    "low contrast": lambda rng, image, truth: (rng.uniform(30, 200) + image * rng.uniform(0.04, 0.15), truth),
    "blurred": lambda rng, image, truth: (ndimage.gaussian_filter(image.astype(float), rng.uniform(1.5, 6)), truth),
    "motion": motion,
    "noise": lambda rng, image, truth: (image + rng.uniform(10, 35) * rng.standard_normal(image.shape), truth),
    "jpeg": jpeg,
    "bent": bend,
    "fisheye": fisheye,
    "tilted": tilt,
    "turned": turn,
    "small": small,
    "shrunk": shrunk,
    "large": large,
    "cropped": cropped,
    "shadow": shadow,
    "glare": glare,
    "vignette": vignette,
    "moire": moire,
}


def altered(name, rng, image, truth):
    """The altered photograph as bytes, and its corners; None if no try keeps the board inside."""
    for _ in range(10):
        result = ALTERATIONS[name](rng, image, truth)
        if result is not None:
            light, corners = result
            noise = 0 if name == "as it is" else rng.uniform(0.3, 1.5)
            light = light + noise * rng.standard_normal(light.shape)
            return np.clip(np.rint(light), 0, 255).astype(np.uint8), corners
    return None


def photographs(folder, every):
    """(name, image, truth, board) of every photograph, or of every n-th."""
    for name, board in SETS.items():
        paths = sorted(folder.glob(f"{name}/left/*.jpg")) + sorted(folder.glob(f"{name}/right/*.jpg"))
        for path in paths[::every]:
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            yield f"{path.parent.parent.name[:3]} {path.parent.name} {path.stem}", image, board


def main():
    """Print a line an alteration."""
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", nargs="?", type=Path, default=os.environ.get("STEREOCAL_DATA"))
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="ask OpenCV only where we fail")
    parser.add_argument("--save", type=Path, help="folder for the pictures that OpenCV finds and we miss")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    pictures = [
        (label, image, truth, board)
        for label, image, board in photographs(Path(arguments.folder), arguments.every)
        if (truth := sc.detect_chessboard(image, board)) is not None
    ]
    print(f"{len(pictures)} photographs\n{HEADER}")
    behind = 0
    for name in arguments.only or ALTERATIONS:
        tally, spent, total = Tally(), 0.0, 0
        for number, (label, image, truth, board) in enumerate(pictures):
            rng = np.random.default_rng([arguments.seed, list(ALTERATIONS).index(name), number])
            made = altered(name, rng, image, truth)
            if made is None:
                continue
            gray, corners = made
            total += 1
            start = time.perf_counter()
            detection = sc.detect_chessboard_detailed(gray, board)
            spent += time.perf_counter() - start
            ours = judge(detection.corners, corners, board)
            theirs = {}
            if ours != "found" or not arguments.quick:
                theirs = verdicts(gray, corners, board, until_found=arguments.quick)
            tally.add(f"{label} #{number}", ours, theirs, detection.message)
            if arguments.save and ours != "found":
                kind = "behind" if "found" in theirs.values() else "none"
                cv2.imwrite(str(arguments.save / f"{name}_{arguments.seed}_{number}_{ours}_{kind}.png"), gray)
        behind += tally.behind
        print(f"{tally.line(name, total)}   ({1e3 * spent / max(total, 1):.0f} ms)", flush=True)
        for reason in tally.reasons:
            if "found by" in reason or "wrong" in reason:
                print("      ", reason)
    print(f"found by OpenCV, not by us: {behind}")


if __name__ == "__main__":
    main()
