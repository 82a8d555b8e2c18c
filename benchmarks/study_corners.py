"""How accurate are the corners? Renders with truth, five conditions, beside OpenCV and the Cramer-Rao bound.

    python benchmarks/study_corners.py [images a condition] [renderer] [conditions, as 0,3]

The renderer is "exact" (16 x 16 samples in every pixel that an edge crosses, blur of the pixels), or what most would
write: "6 after" (6 x 6 samples in every pixel, blur of the pixels), "6 before" (the same, blur of the samples, then
their mean), or another number. So few samples place an edge that runs along the pixels to a twelfth of a pixel only,
which is more than the fit's own error where there is little noise: the covariances have to notice.

For each condition: the RMS 2-D error of stereocal, of cv2.cornerSubPix with half windows 3, 5, 8, 11 and of
findChessboardCornersSB with ACCURACY on the same images; the bound of the model in stereocal's own window; and the
mean of the squared errors normalised by the reported covariance (2 if that is honest).
"""

from __future__ import annotations

import sys
from functools import lru_cache

import cv2
import numpy as np
from board_scenes import Lens, random_pose, render
from numba import njit

import stereocal as sc
from stereocal.board.subpixel import fit_corner_grid

CONDITIONS = [(0.5, 1, 1.0), (0.8, 3, 1.0), (1.2, 5, 1.0), (0.8, 8, 0.5), (2.0, 3, 1.0)]
BOARD, SIZE = (9, 6), (640, 480)
LENS = Lens(520.0, (322.3, 238.1), (-0.28, 0.09, 0.0008, -0.0006, -0.01))
WINDOWS = (3, 5, 8, 11)


@njit(cache=True)
def _paint(rays, H, columns, rows, dark, light, out):
    """The board's colour at every ray; H maps rays to the board's plane."""
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            a, b = rays[y, x, 0], rays[y, x, 1]
            w = H[2, 0] * a + H[2, 1] * b + H[2, 2]
            X = (H[0, 0] * a + H[0, 1] * b + H[0, 2]) / w
            Y = (H[1, 0] * a + H[1, 1] * b + H[1, 2]) / w
            if -1 < X < columns and -1 < Y < rows:
                out[y, x] = dark if (int(np.floor(X)) + int(np.floor(Y))) % 2 == 0 else light
            elif -2 < X < columns + 1 and -2 < Y < rows + 1:
                out[y, x] = light
            else:
                out[y, x] = 120.0


@lru_cache
def _sample_rays(samples):
    x, y = ((np.arange(n * samples) + 0.5) / samples - 0.5 for n in SIZE)
    return np.concatenate([LENS.rays(np.stack(np.meshgrid(x, part), -1))[..., :2] for part in np.array_split(y, 40)])


def plain_render(R, t, samples, blur_samples, *, blur, noise, light, dark, seed):
    """A render as most would write it; (image, true corners)."""
    rays = _sample_rays(samples)
    image = np.empty(rays.shape[:2], np.float32)
    _paint(rays, np.linalg.inv(np.column_stack([R[:, 0], R[:, 1], t])), *BOARD, float(dark), float(light), image)
    if blur_samples:
        image = cv2.GaussianBlur(image, (0, 0), blur * samples)
    image = cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA)
    if not blur_samples:
        image = cv2.GaussianBlur(image, (0, 0), blur)
    image = image + noise * np.random.default_rng(seed).standard_normal(image.shape)
    j, i = np.divmod(np.arange(BOARD[0] * BOARD[1]), BOARD[0])
    corners = LENS.project(np.stack([i, j, 0 * i], -1).astype(float) @ R.T + t)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), corners


def images(condition, count, renderer, seed=0):
    """Renders and their truth."""
    blur, noise, contrast = condition
    rng = np.random.default_rng([seed, int(blur * 10), noise])
    for k in range(count):
        R, t = random_pose(rng, LENS, SIZE, BOARD, tilt=40, border=15)
        light, dark = 120 + 90 * contrast, 120 - 90 * contrast
        options = {"blur": blur, "noise": noise, "light": light, "dark": dark, "seed": [seed, k]}
        if renderer == "exact":
            yield render(LENS, SIZE, R, t, BOARD, **options)
        else:
            samples, when = renderer.split()
            yield plain_render(R, t, int(samples), when == "before", **options)


def study(condition, count, renderer):
    """Errors (M, 2) by method, normalised squared errors, Cramer-Rao variances."""
    errors = {"ours": [], "SB": [], **{f"subpix{w}": [] for w in WINDOWS}}
    normalised, missed = [], {"ours": 0, "SB": 0}
    noise = condition[1]
    bound = []
    for image, truth in images(condition, count, renderer):
        found = sc.detect_chessboard_detailed(image, BOARD)
        if found.found:
            corners = found.corners
            if np.linalg.norm(corners[0] - truth[0]) > 5:
                raise SystemExit("the first corner is not the first corner")
            e = corners - truth
            errors["ours"].append(e)
            normalised.append(np.einsum("ni,nij,nj->n", e, np.linalg.inv(found.covariances), e))
            # the bound: the same covariance with the true noise (rounding included) in place of the residuals'
            fit = fit_corner_grid(image, truth.reshape(BOARD[1], BOARD[0], 2))
            trace = np.trace(fit.own_covariances, axis1=1, axis2=2)
            bound.append(trace * (noise**2 + 1 / 12) / fit.noise**2)
        else:
            missed["ours"] += 1
        start = truth.astype(np.float32).reshape(-1, 1, 2)
        for w in WINDOWS:
            criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
            refined = cv2.cornerSubPix(image, start.copy(), (w, w), (-1, -1), criteria)
            errors[f"subpix{w}"].append(refined.reshape(-1, 2) - truth)
        ok, sb = cv2.findChessboardCornersSB(image, BOARD, None, cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY)
        if ok:
            sb = sb.reshape(-1, 2)
            sb = min((sb, sb[::-1]), key=lambda c: np.abs(c - truth).max())
            errors["SB"].append(sb - truth)
        else:
            missed["SB"] += 1
    return (
        {k: np.concatenate(v) if v else np.full((1, 2), np.nan) for k, v in errors.items()},
        normalised,
        bound,
        missed,
    )


def rms(errors):
    """Root of the mean squared distance."""
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def main():
    """Print a line a condition."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 12
    renderer = sys.argv[2] if len(sys.argv) > 2 else "exact"
    chosen = [int(k) for k in sys.argv[3].split(",")] if len(sys.argv) > 3 else range(len(CONDITIONS))
    cv2.setNumThreads(1)
    print(f"renderer: {renderer}, {count} images a condition")
    print("blur noise contrast | ours   bound  ours/bound | OpenCV's best   ours/best | NEES | missed")
    for condition in (CONDITIONS[k] for k in chosen):
        errors, normalised, bound, missed = study(condition, count, renderer)
        ours, limit = rms(errors["ours"]), float(np.sqrt(np.concatenate(bound).mean()))
        others = {k: rms(v) for k, v in errors.items() if k != "ours"}
        best = min(others, key=others.get)
        honesty = np.mean(np.concatenate(normalised))
        print(
            f"{condition[0]:4} {condition[1]:5} {condition[2]:8} | {ours:.4f} {limit:.4f} {ours / limit:10.2f} | "
            f"{others[best]:.4f} {best:8} {ours / others[best]:9.2f} | {honesty:.2f} | {missed}",
            {k: round(v, 3) for k, v in others.items()},
            flush=True,
        )


if __name__ == "__main__":
    main()
