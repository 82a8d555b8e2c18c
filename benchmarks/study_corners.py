"""How accurate are the corners? Renders with truth, five conditions, beside OpenCV and the Cramer-Rao bound.

    python benchmarks/study_corners.py [images a condition]

For each condition: the RMS 2-D error of stereocal, of cv2.cornerSubPix with half windows 3, 5, 8, 11 and of
findChessboardCornersSB with ACCURACY on the same images; the bound of the model in stereocal's own window; and the
mean of the squared errors normalised by the reported covariance (2 if that is honest).
"""

from __future__ import annotations

import sys

import cv2
import numpy as np
from board_scenes import Lens, random_pose, render

import stereocal as sc
from stereocal.board.subpixel import fit_corner_grid

CONDITIONS = [(0.5, 1, 1.0), (0.8, 3, 1.0), (1.2, 5, 1.0), (0.8, 8, 0.5), (2.0, 3, 1.0)]
BOARD, SIZE = (9, 6), (640, 480)
LENS = Lens(520.0, (322.3, 238.1), (-0.28, 0.09, 0.0008, -0.0006, -0.01))
WINDOWS = (3, 5, 8, 11)


def images(condition, count, seed=0):
    """Renders and their truth."""
    blur, noise, contrast = condition
    rng = np.random.default_rng([seed, int(blur * 10), noise])
    for k in range(count):
        R, t = random_pose(rng, LENS, SIZE, BOARD, tilt=40, border=15)
        light, dark = 120 + 90 * contrast, 120 - 90 * contrast
        yield render(LENS, SIZE, R, t, BOARD, blur=blur, noise=noise, light=light, dark=dark, seed=[seed, k])


def study(condition, count):
    """Errors (M, 2) by method, normalised squared errors, Cramer-Rao variances."""
    errors = {"ours": [], "SB": [], **{f"subpix{w}": [] for w in WINDOWS}}
    normalised, missed = [], {"ours": 0, "SB": 0}
    noise = condition[1]
    bound = []
    for image, truth in images(condition, count):
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
            trace = np.trace(fit.covariances, axis1=1, axis2=2)
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
    print("blur noise contrast | ours   bound  ours/bound | OpenCV's best   ours/best | NEES | missed")
    for condition in CONDITIONS:
        errors, normalised, bound, missed = study(condition, count)
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
