"""Which boards are found in photographs that go wrong? Beside both OpenCV detectors, on quick renders.

    python benchmarks/study_hard_photographs.py [images a scene] [--quick] [--only SCENE ...] [--save FOLDER]

A board's picture (with its frame, marks, paper, margin) is laid into the image by a homography behind a bend and a
lens, four samples a pixel in each direction; then light, blooming, blur, noise, JPEG. `study_detection.py` has the
exact renders. "wrong" counts boards returned whose corners are not all within a tenth of the spacing of the truth.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import cv2
import numpy as np
from opencv_detectors import HEADER, Tally, judge, verdicts
from scipy import ndimage
from study_detection import clutter

import stereocal as sc

SQUARE = 48  # pixels of the board's picture a square
SIZES = [(9, 6), (7, 6), (8, 6), (6, 4), (7, 7), (11, 8), (5, 4)]


def picture(board, rng, style):
    """The printed sheet (H, W) 0..1 and the pixel of its first inner corner."""
    columns, rows = board
    margin = {"no_margin": 0.0, "half_margin": 0.5}.get(style, float(rng.uniform(0.5, 1.2)))
    frame = float(rng.uniform(0.3, 1.0)) if style == "black_frame" else 0.0
    gap = float(rng.choice([0.0, rng.uniform(0.2, 0.6)])) if frame else 0.0
    pad = round((margin + frame + gap) * SQUARE)
    j, i = np.divmod(np.arange((columns + 1) * (rows + 1)), columns + 1)
    squares = ((i + j) % 2).reshape(rows + 1, columns + 1).astype(np.float32)
    sheet = np.pad(np.kron(squares, np.ones((SQUARE, SQUARE), np.float32)), pad, constant_values=1.0)
    if style == "half_squares":
        half = SQUARE // 2
        sheet = np.pad(sheet[pad + half : -pad - half, pad + half : -pad - half], pad + half, constant_values=1.0)
    if frame:
        low, width = round(margin * SQUARE), round(frame * SQUARE)
        sheet[low : low + width, low:-low] = sheet[-low - width : -low, low:-low] = 0
        sheet[low:-low, low : low + width] = sheet[low:-low, -low - width : -low] = 0
    if style == "marked":
        for _ in range(12):  # a dot or a cross in some squares
            x, y = pad + SQUARE * (rng.integers(0, [columns + 1, rows + 1]) + 0.5)
            tone = 1.0 - float(sheet[int(y), int(x)])
            cv2.circle(sheet, (int(x), int(y)), int(rng.integers(5, 12)), tone, -1)
    if style == "rounded":  # ink spreads: light and dark meet in a rounded corner, by up to an eighth of a square
        spread = rng.uniform(2, 5)
        sheet = (ndimage.gaussian_filter(sheet, spread) > rng.uniform(0.42, 0.58)).astype(np.float32)
    if style in ("parted", "merged"):  # a thin or a thick print: dark squares smaller or larger, by up to 0.28 squares
        kernel = np.ones((2 * int(rng.integers(2, 7)) + 1,) * 2, np.uint8)
        sheet = (cv2.dilate if style == "parted" else cv2.erode)(sheet, kernel)
    if style == "legend":  # arrows, dots and words close to the outer squares, and a label over a corner of the sheet
        sheet = (255 * sheet).astype(np.uint8)
        low, high = pad - int(0.12 * SQUARE), sheet.shape[0] - pad + int(0.4 * SQUARE)
        cv2.putText(sheet, "pattern: chessboard 9x6 - 25.0 mm", (pad, low), 0, 0.5, 0, 1)
        cv2.putText(sheet, "www.calibration.example ->", (pad, high), 0, 0.8, 0, 2)
        for k in range(5):
            cv2.circle(sheet, (low, pad + SQUARE * (k + 1)), SQUARE // 6, 0, -1)
        cv2.rectangle(sheet, (0, 0), (pad - SQUARE // 4, pad - SQUARE // 4), 0, -1)
        sheet = sheet.astype(np.float32) / 255
    if style == "text":
        sheet = (255 * sheet).astype(np.uint8)
        for y in (pad // 2 + 8, sheet.shape[0] - pad // 3):
            cv2.putText(sheet, "CHESSBOARD 25 mm A4 X+#", (pad, y), 0, 0.9, 0, 2)
        sheet = sheet.astype(np.float32) / 255
    return sheet, pad + SQUARE - 0.5


def bent(points, size, bend, k, curl):
    """Image-side distortion: parabola of depth bend (share of the size) along a direction, and a radial term."""
    center, scale = np.array(size) / 2, max(size) / 2
    d = (points - center) / scale
    r2 = (d**2).sum(-1, keepdims=True)
    u = d @ bend[0]
    u = np.maximum(u, 0) if curl else u
    return points + scale * (u**2)[..., None] * bend[1] + scale * k * r2 * d


def lay(sheet, corner, board, rng, size, *, tilt, fill, bend, k, border, turn, curl, background, dark, light):
    """The sheet in the image, supersampled, and the true corners; None if they do not lie inside.

    `turn` fixes the angle in the image; with `curl` the bend begins at a line through the board: flat here, bent there.
    """
    width, height = size
    columns, rows = board
    grid = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1).reshape(-1, 2) - [
        (columns - 1) / 2,
        (rows - 1) / 2,
    ]
    for _ in range(500):
        a, b, angle = rng.uniform(0, 2 * np.pi), np.deg2rad(rng.uniform(0.3, 1) * tilt), rng.uniform(0, 2 * np.pi)
        angle = angle if turn is None else turn
        R = cv2.Rodrigues(b * np.array([np.cos(a), np.sin(a), 0]))[0] @ cv2.Rodrigues(np.array([0, 0, angle]))[0]
        f = 0.85 * width
        depth = f * (max(board) + 1) / (rng.uniform(*fill) * min(size) * 1.2)
        place = rng.uniform(0.2, 0.8, 2) * size
        t = np.array([*(place - np.array(size) / 2) / f * depth, depth])
        K = np.array([[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]])
        H = K @ np.column_stack([R[:, :2], t])
        H = (
            H
            @ np.diag([1 / SQUARE, 1 / SQUARE, 1])
            @ np.array(
                [[1, 0, -corner - SQUARE * (columns - 1) / 2], [0, 1, -corner - SQUARE * (rows - 1) / 2], [0, 0, 1]]
            )
        )
        pixels = (grid - grid[0]) * SQUARE + corner
        flat = cv2.perspectiveTransform(pixels[None], H)[0]
        truth = flat.copy()  # the inverse map is bent(): find the image point whose bent image is the flat one
        with np.errstate(all="ignore"):
            for _ in range(60):
                truth = truth - (bent(truth, size, bend, k, curl) - flat)
        if not np.isfinite(truth).all() or np.abs(bent(truth, size, bend, k, curl) - flat).max() > 1e-3:
            continue
        if truth.min() < border or (truth > np.array(size) - 1 - border).any():
            continue
        n = 4
        y, x = np.mgrid[: height * n, : width * n]
        fine = np.stack([(x + 0.5) / n - 0.5, (y + 0.5) / n - 0.5], -1)
        mapped = cv2.perspectiveTransform(bent(fine, size, bend, k, curl).reshape(1, -1, 2), np.linalg.inv(H))
        mapped = mapped.reshape(height * n, width * n, 2).astype(np.float32)
        value = cv2.remap(sheet, mapped, None, cv2.INTER_LINEAR, borderValue=-1.0)
        value = cv2.resize(np.stack([np.maximum(value, 0), value >= 0], -1).astype(np.float32), size, None, 0, 0, 3)
        cover = value[..., 1]
        return dark * cover + (light - dark) * value[..., 0] + background * (1 - cover), truth
    return None


def finger(image, truth, board, rng):
    """A skin-toned ellipse over the margin, its tip up to 0.8 squares from the outermost corners."""
    grid = truth.reshape(board[1], board[0], 2)
    k = int(rng.integers(board[1]))
    step = grid[k, -1] - grid[k, -2]
    tip = grid[k, -1] + rng.uniform(1.0, 1.5) * step
    center = tip + 2.2 * step
    angle = float(np.rad2deg(np.arctan2(step[1], step[0])))
    axes = (int(2.2 * np.linalg.norm(step)), int(0.6 * np.linalg.norm(step)))
    cv2.ellipse(image, tuple(int(v) for v in center), axes, angle, 0, 360, float(rng.uniform(90, 150)), -1)


SCENES = [
    "plain",
    "bent",
    "heavily_bent",
    "fisheye",
    "tilt",
    "blooming",
    "low_contrast",
    "dark",
    "uneven_light",
    "glare",
    "jpeg",
    "motion",
    "blur",
    "noise",
    "small_image",
    "small_board",
    "black_frame",
    "rounded",
    "marked",
    "finger",
    "coloured",
    "clutter",
    "text",
    "no_margin",
    "half_squares",
    "interlaced",
    "shadow",
    "moire",
    "parted",
    "merged",
    "bloomed_apart",
    "legend",
    "dark_background",
    "smallest_squares",
    "turned_45",
    "vignette",
    "gamma",
    "curled",
    "glare_spots",
    "screen",
    "bayer",
]


def scene(name, rng):
    """(image uint8, grey or RGB; truth; inner corners)."""
    size = (270, 180) if name == "small_image" else (640, 480)
    board = SIZES[int(rng.integers(len(SIZES)))]
    light, dark, background = rng.uniform(160, 230), rng.uniform(15, 60), rng.uniform(40, 220)
    tilt, fill, k, border = 40.0, (0.4, 0.95), float(rng.uniform(0, 0.08)), 8
    depth = {"bent": 0.06, "heavily_bent": 0.18, "curled": 0.35}.get(name, 0.0)
    if name == "fisheye":
        k, fill, border = float(rng.uniform(0.3, 0.8)), (0.7, 1.3), 6
    if name == "tilt":
        tilt, fill = 68.0, (0.6, 1.1)
    if name in ("small_board", "small_image"):
        fill = (0.14, 0.3) if name == "small_board" else (0.5, 0.95)
    if name == "low_contrast":
        middle, half = rng.uniform(40, 200), rng.uniform(3, 10)
        light, dark, background = middle + half, middle - half, middle
    if name == "dark":
        light, dark, background = rng.uniform(10, 25), 3, 5
    if name in ("clutter", "text", "finger", "black_frame"):
        background = cv2.resize(clutter(rng, size[1], size[0]), size)
    if name == "smallest_squares":  # 6 to 9 pixels a square
        fill, tilt = ((max(board) + 1) * 6 / (1.2 * min(size)), (max(board) + 1) * 9 / (1.2 * min(size))), 25.0
    if name == "dark_background":
        background = rng.uniform(0, 20)
    styles = ("black_frame", "rounded", "marked", "text", "no_margin", "half_squares", "parted", "merged", "legend")
    style = {"dark_background": "no_margin", "bloomed_apart": "parted"}.get(name, name if name in styles else "")
    sheet, corner = picture(board, rng, style)
    laid = None
    for _ in range(20):
        a, b = rng.uniform(0, 2 * np.pi, 2)
        bend = (np.array([np.cos(a), np.sin(a)]), depth * np.array([np.cos(b), np.sin(b)]))
        options = {"tilt": tilt, "fill": fill, "bend": bend, "k": k, "border": border}
        options["turn"] = np.pi / 4 + rng.integers(4) * np.pi / 2 if name == "turned_45" else None
        options["curl"] = name == "curled"
        laid = lay(sheet, corner, board, rng, size, **options, background=background, dark=dark, light=light)
        if laid is not None:
            break
    assert laid is not None, "no pose found"
    image, truth = laid
    return spoil(image, truth, board, name, rng), truth, board


def spoil(image, truth, board, name, rng):
    """What light, lens, sensor and file do to the picture."""
    height, width = image.shape
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-1, 1, height))
    noise, blur = rng.uniform(1, 3), rng.uniform(0.4, 1.2)
    if name == "finger":
        finger(image, truth, board, rng)
    if name in ("blooming", "bloomed_apart"):
        image = image * rng.uniform(1.5, 3.5)
        for share, sigma in ((0.25, 3.0), (0.12, 12.0)):
            image = image + share * ndimage.gaussian_filter(np.maximum(image - 230, 0), sigma)
    if name == "uneven_light":
        a = rng.uniform(0, 2 * np.pi)
        image = image * np.clip(0.52 + 0.5 * (np.cos(a) * x + np.sin(a) * y), 0.06, None)
    if name == "shadow":
        a, c = rng.uniform(0, 2 * np.pi), rng.uniform(-0.3, 0.3)
        edge = 1 / (1 + np.exp(-(np.cos(a) * x + np.sin(a) * y - c) / rng.uniform(0.004, 0.08)))
        image = image * (0.3 + 0.7 * edge)
    if name == "glare":
        p, q = truth.mean(axis=0) / [width, height] * 2 - 1
        image = image + rng.uniform(60, 200) * np.exp(-((x - p) ** 2 + (y - q) ** 2) / rng.uniform(0.02, 0.2))
    if name == "glare_spots":
        for place in truth[rng.choice(len(truth), 4)]:
            p, q = place / [width, height] * 2 - 1
            image = image + rng.uniform(100, 255) * np.exp(-((x - p) ** 2 + (y - q) ** 2) / rng.uniform(0.001, 0.01))
    if name == "vignette":
        image = image * np.clip(1 - 0.48 * (x * x + y * y), 0.03, 1)
    if name == "gamma":
        image = 255 * (np.clip(image, 0, 255) / 255) ** np.exp(rng.uniform(-1.5, 1.5))
    if name == "screen":  # a screen's pixels, and its glow where it should be black
        lattice = 1 + 0.25 * np.sin(rng.uniform(1.5, 3.5) * width / 2 * x) * np.sin(
            rng.uniform(1.5, 3.5) * height / 2 * y
        )
        image = 30 + 0.85 * image * lattice + 40 * np.exp(-((x - 0.3) ** 2 + (y + 0.2) ** 2) / 0.3)
    if name == "blur":
        blur = rng.uniform(2, 4.5)
    if name == "noise":
        noise = rng.uniform(10, 30)
    if name in ("dark", "low_contrast"):
        noise = rng.uniform(0.7, 1.8)
    image = ndimage.gaussian_filter(image, blur)
    if name == "motion":
        length, angle = rng.uniform(3, 12), rng.uniform(0, np.pi)
        kernel = np.zeros((15, 15), np.float32)
        d = length / 2 * np.array([np.cos(angle), np.sin(angle)])
        cv2.line(kernel, tuple(int(v) for v in 7 - np.rint(d)), tuple(int(v) for v in 7 + np.rint(d)), 1.0)
        image = cv2.filter2D(image, -1, kernel / kernel.sum())
    if name == "interlaced":
        shifted = np.roll(image, int(rng.integers(1, 4)), axis=1)
        image[1::2] = shifted[1::2]
    if name == "moire":
        image = image + 12 * np.sin(0.9 * width / 2 * x + 0.5 * height / 2 * y)
    image = np.clip(np.rint(image + noise * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)
    if name == "jpeg":
        image = cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(5, 25))])[1], 0)
    if name == "bayer":  # colours that do not match: every second pixel of every second row is darker
        image[::2, ::2] = (image[::2, ::2] * rng.uniform(0.6, 0.9)).astype(np.uint8)
    if name == "coloured":
        tint = rng.uniform(0.2, 1.0, 3)
        image = np.clip(image[..., None] * tint, 0, 255).astype(np.uint8)
    return image


def main():
    """Print a line a scene."""
    parser = argparse.ArgumentParser()
    parser.add_argument("count", nargs="?", type=int, default=10)
    parser.add_argument("--only", nargs="*")
    parser.add_argument("--quick", action="store_true", help="ask OpenCV only where we fail")
    parser.add_argument("--save", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    print(HEADER)
    behind = 0
    for name in arguments.only or SCENES:
        tally, spent = Tally(), 0.0
        for number in range(arguments.count):
            rng = np.random.default_rng([arguments.seed, SCENES.index(name), number])
            image, truth, board = scene(name, rng)
            gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
            start = time.perf_counter()
            detection = sc.detect_chessboard_detailed(image, board)
            spent += time.perf_counter() - start
            ours, theirs = judge(detection.corners, truth, board), {}
            if ours != "found" or not arguments.quick:
                theirs = verdicts(gray, truth, board, until_found=arguments.quick)
            tally.add(f"{number} {board}", ours, theirs, detection.message)
            if arguments.save and ours != "found":
                cv2.imwrite(str(arguments.save / f"{name}_{arguments.seed}_{number}_{board[0]}x{board[1]}.png"), gray)
        behind += tally.behind
        print(f"{tally.line(name, arguments.count)}   ({1e3 * spent / arguments.count:.0f} ms)", flush=True)
        for reason in tally.reasons[:8]:
            print("      ", reason)
    print(f"found by OpenCV, not by us: {behind}")


if __name__ == "__main__":
    main()
