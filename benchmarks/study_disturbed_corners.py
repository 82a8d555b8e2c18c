"""Corners where the picture is not the model's: shadows, fingers, ink, glare, clipping, gamma, motion, tiny squares.

    python benchmarks/study_disturbed_corners.py [images a kind] [kinds, comma-separated]

For each kind, on renders with truth (9 x 6 board, blur 0.8, noise 2; starts up to half a pixel off): the RMS, the 95th
percentile and the largest error of the fit, how many corners are more than 0.3 px off and how many of those say so (by
a normalised squared error below 25), the median of the normalised squared error (1.39 if honest), and the smallest RMS
and 95th percentile of cv2.cornerSubPix with half windows 2, 3, 5, 8, which starts from the truth.
"""

from __future__ import annotations

import sys

import cv2
import numpy as np
from board_scenes import Lens, random_pose, render
from scipy import ndimage

from stereocal.board.subpixel import fit_corner_grid

BOARD, SIZE = (9, 6), (640, 480)
LENS = Lens(520.0, (322.3, 238.1), (-0.28, 0.09, 0.0008, -0.0006, -0.01))
FISHEYE = Lens(240.0, (322.3, 238.1), (0.02, -0.005, 0.001, 0.0), fisheye=True)
WINDOWS = (2, 3, 5, 8)
KINDS = (
    "plain",
    "shadow",
    "soft_shadow",
    "finger",
    "ink",
    "glare",
    "vignetting",
    "clipped",
    "gamma",
    "motion",
    "tiny",
    "border",
    "fisheye",
    "deep",
)


def disturbance(kind, corners, rng):
    """What happens to the light before the blur: a function of the image."""
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    a = rng.uniform(0, 2 * np.pi)
    place = corners.mean(axis=0) + rng.normal(0, 15, 2)
    if kind in ("finger", "glare"):
        place = corners[rng.integers(len(corners))] + rng.normal(0, 6, 2)
    along = (x - place[0]) * np.cos(a) + (y - place[1]) * np.sin(a)
    across = (y - place[1]) * np.cos(a) - (x - place[0]) * np.sin(a)
    if kind == "shadow":
        return lambda image: image * np.where(along > 0, 1.0, 0.45)
    if kind == "soft_shadow":
        return lambda image: image * (1 - 0.55 / (1 + np.exp(-along / 12)))
    if kind == "finger":
        return lambda image: np.where((np.abs(across) < 7) & (along < 0) & (along > -45), 150, image)
    if kind == "glare":
        return lambda image: image + 160 * np.exp(-(along**2 + across**2) / (2 * 14**2))
    if kind == "vignetting":
        return lambda image: image * (1 - 0.5 * ((x - 320) ** 2 + (y - 240) ** 2) / (320**2 + 240**2))
    if kind == "motion":
        kernel = np.zeros((11, 11), np.float32)
        cv2.line(kernel, (5, 5), (5 + round(3 * np.cos(a)), 5 + round(3 * np.sin(a))), 1.0)
        kernel = (kernel + kernel[::-1, ::-1]) / 2  # symmetric, so that it moves nothing
        return lambda image: cv2.filter2D(image, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)
    if kind == "ink":

        def ink(image):
            image = image.copy()
            for cx, cy in (corners[rng.integers(len(corners), size=25)] + rng.normal(0, 9, (25, 2))).astype(int):
                image[max(cy, 0) : cy + 2, max(cx, 0) : cx + 9] = rng.choice([30, 130, 240])
            return image

        return ink
    return None


def scene(kind, k):
    """(image, true corners)."""
    rng = np.random.default_rng([5, k])
    lens = FISHEYE if kind == "fisheye" else LENS
    fill = (0.14, 0.19) if kind == "tiny" else (0.35, 0.9)
    R, t = random_pose(rng, lens, SIZE, BOARD, tilt=40, fill=fill, border=1 if kind == "border" else 15)
    j, i = np.divmod(np.arange(BOARD[0] * BOARD[1]), BOARD[0])
    corners = lens.project(np.stack([i, j, 0 * i], -1).astype(float) @ R.T + t)
    light, dark = (330, 60) if kind == "clipped" else (200, 40)
    options = {"blur": 0.8, "light": light, "dark": dark, "samples": 8, "occluder": disturbance(kind, corners, rng)}
    if kind not in ("gamma", "deep"):
        return render(lens, SIZE, R, t, BOARD, noise=2, seed=[9, k], **options)
    image, truth = render(lens, SIZE, R, t, BOARD, noise=0, seed=[9, k], **options)
    if kind == "gamma":
        encoded = 255 * (image / 255.0) ** (1 / 2.2) + rng.normal(0, 2, image.shape)
        return np.clip(np.rint(encoded), 0, 255).astype(np.uint8), truth
    deep = 64 * ndimage.gaussian_filter(image.astype(np.float64), 0.3) + rng.normal(0, 128, image.shape)
    return np.clip(np.rint(deep), 0, 65535).astype(np.uint16), truth


def study(kind, count):
    """Errors of ours, normalised squared errors, errors of OpenCV by window (count, windows, N)."""
    ours, normalised, theirs = [], [], []
    for k in range(count):
        image, truth = scene(kind, k)
        start = truth + np.random.default_rng(k).uniform(-0.5, 0.5, truth.shape)
        fit = fit_corner_grid(image, start.reshape(BOARD[1], BOARD[0], 2))
        e = (fit.corners - truth)[fit.converged]
        ours.append(np.hypot(*e.T))
        normalised.append(np.einsum("ni,nij,nj->n", e, np.linalg.inv(fit.covariances[fit.converged]), e))
        eight = image if image.dtype == np.uint8 else cv2.convertScaleAbs(image, alpha=1 / 64)
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
        first = truth.astype(np.float32).reshape(-1, 1, 2)
        refined = [cv2.cornerSubPix(eight, first.copy(), (w, w), (-1, -1), criteria) for w in WINDOWS]
        theirs.append([np.hypot(*(r.reshape(-1, 2) - truth).T) for r in refined])
    return np.concatenate(ours), np.concatenate(normalised), np.array(theirs)


def main():
    """Print a line a kind."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 12
    kinds = sys.argv[2].split(",") if len(sys.argv) > 2 else KINDS
    cv2.setNumThreads(1)
    print("kind        |   rms    p95    max | > 0.3 px, owned up | median NSE | OpenCV rms    p95 | ours/OpenCV rms")
    for kind in kinds:
        e, q, other = study(kind, count)
        root, theirs = np.sqrt((e**2).mean()), np.sqrt((other**2).mean(axis=(0, 2))).min()
        far, owned = e > 0.3, (e > 0.3) & (q < 25)
        print(
            f"{kind:11} | {root:.3f}  {np.percentile(e, 95):.3f} {e.max():6.2f} | {far.sum():8} {owned.sum():9} |"
            f" {np.median(q):10.2f} | {theirs:10.3f} {np.percentile(other, 95, axis=(0, 2)).min():6.3f} |"
            f" {root / theirs:6.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
