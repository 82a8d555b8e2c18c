"""Measure the corners of a board that was found: the fit on the photograph, and what stands in where it does not hold.

The blurred saddle (:mod:`stereocal.board.subpixel`) is fitted at full resolution. That is also the last test of a
detection: the fits of nearly all corners have to converge near their places. There are three kinds of pictures whose
corners are not blurred saddles, though a board is there:

**Parted squares.** Glare, ink or a thin print leaves a gap between squares that should touch, or a bridge. Then the
saddle is fitted on the level whose gaps are closed (:mod:`stereocal.board.pyramid`), on which it was found.

**Shadows.** A shadow's edge across the board makes four grey levels around a corner of what should be two, and the fit
runs along that edge by pixels. Light is a factor: in the logarithm of the picture the shadow is a step that is added,
smaller than the one from light to dark, so the logarithm is fitted too.

**Strong blur.** Where the blur s of the next edges reaches into the window, h + 2.2 s / step > 1, a border corner's
square, often cut, mixes with what lies beyond the board.

In these cases there are three sets of corners: the fit's, that of the logarithm's fit, and the saddle points of the
smoothed level that the grid was made of, coarse but hard to mislead. **The smoothest is believed**: lens and paper
are smooth, so third differences along the lines of the grid,

    P(i+2) - 3 P(i+1) + 3 P(i) - P(i-1),

are errors of the corners but for a common part; the set of the least sum of their squares is the most likely one. Where
the fit agrees with it to a twentieth of a step, the fit stands; the other corners are taken from the smoothest set,
with the distance between the two as their uncertainty. So are single corners whose fit was lost.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.board.pyramid import logarithm
from stereocal.board.subpixel import HALF_WINDOW, SaddleFit, fit_corner_grid

MOST_LOST = 0.05
"""So many of the corners, as a share, may be lost to the fit."""
FAR = 0.05
"""The fit is not believed where it is further than this from the smoothest set, in steps."""
UNSURE = 0.03
"""Nor taken for granted where it claims no more than this, in steps (square root of the covariance's trace)."""


def measure_corners(gray: NDArray[Any], corners: Float) -> SaddleFit:
    """Fit the corners of a full grid, and take the smoothest of three sets where the fit does not hold.

    Parameters
    ----------
    gray : ndarray of shape (H, W)
        The image.
    corners : ndarray of shape (J, I, 2)
        The board's corners as the grid has them.
    """
    fit, step = fit_corner_grid(gray, corners), _shortest_step(corners)
    if _is_sure(fit, step):
        return fit
    given = corners.reshape(-1, 2)
    sets = [given]
    if not _is_blurred(fit, step):
        other = _fit_of_logarithm(gray, corners)
        sets.append(np.where(other.converged[:, None], other.corners, given))
        fit = fit if is_measured(fit) else other
    sets.append(np.where(fit.converged[:, None], fit.corners, given))
    smoothest = min(sets, key=lambda points: _roughness(points.reshape(corners.shape)))
    distance = np.sqrt(np.sum((smoothest - fit.corners) ** 2, axis=1))
    lost = ~fit.converged | (distance > FAR * step)
    variance = np.where(fit.converged, distance, FAR * step) ** 2 / 2
    return replace(
        fit,
        corners=np.where(lost[:, None], smoothest, fit.corners),
        covariances=np.where(lost[:, None, None], variance[:, None, None] * np.eye(2), fit.covariances),
    )


def _is_sure(fit: SaddleFit, step: float) -> bool:
    """Whether nothing speaks against the fit: the rule; all else are exceptions."""
    spread = fit.covariances[:, 0, 0] + fit.covariances[:, 1, 1]
    trusted = fit.converged.all() and not fit.strays.any() and spread.max() < (UNSURE * step) ** 2
    return bool(trusted) and not _is_blurred(fit, step)


def _fit_of_logarithm(gray: NDArray[Any], corners: Float) -> SaddleFit:
    """The fit on the logarithm of the part of the image that the board lies in."""
    around = 1.5 * np.sqrt(np.max(np.sum(np.diff(corners, axis=1) ** 2, axis=-1)))
    low = np.maximum(np.floor(corners.min(axis=(0, 1)) - around), 0).astype(int)
    high = np.ceil(corners.max(axis=(0, 1)) + around).astype(int)
    fit = fit_corner_grid(logarithm(gray[low[1] : high[1], low[0] : high[0]]), corners - low)
    return replace(fit, corners=fit.corners + low)


def _roughness(grid: Float) -> float:
    """Mean square of the third differences along both axes (of the second, where an axis has three corners)."""
    total, count = 0.0, 0
    for axis in (0, 1):
        d = np.diff(grid, min(3, grid.shape[axis] - 1), axis=axis)
        total, count = total + float(np.sum(d * d)), count + d.size
    return total / count


def measure_in_level(level: NDArray[Any], corners: Float, scale: float) -> SaddleFit:
    """The fit made on a level, in the image's pixels.

    Parameters
    ----------
    level : ndarray of shape (H, W)
        The level.
    corners : ndarray of shape (J, I, 2)
        In the level's pixels.
    scale : float
        From the level's pixels to the image's.
    """
    fit = fit_corner_grid(level, corners)
    return replace(
        fit,
        corners=scale * (fit.corners + 0.5) - 0.5,
        covariances=scale**2 * fit.covariances,
        edge_widths=scale * fit.edge_widths,
    )


def is_measured(fit: SaddleFit) -> bool:
    """Whether nearly all fits converged."""
    return bool(np.count_nonzero(~fit.converged) <= MOST_LOST * len(fit.converged))


def edge_width(fit: SaddleFit) -> float:
    """Standard deviation of the blur of the board's edges, px: the median of the measured corners."""
    return _middle(fit.edge_widths[fit.converged])


def confidence(fit: SaddleFit) -> float:
    """Share of the contrast that the model explains, in the median corner: 1 - (noise / half contrast)^2."""
    unexplained = (2 * fit.noise[fit.converged] / fit.contrasts[fit.converged]) ** 2
    return float(np.clip(1 - _middle(unexplained), 0, 1))


def _is_blurred(fit: SaddleFit, step: float) -> bool:
    """Whether the blur of the next edges reaches into the windows."""
    return not fit.converged.any() or HALF_WINDOW + 2.2 * np.sqrt(2) * edge_width(fit) / step > 1


def _shortest_step(corners: Float) -> float:
    along_i, along_j = corners[:, 1:] - corners[:, :-1], corners[1:] - corners[:-1]
    return float(np.sqrt(min(np.sum(along_i * along_i, axis=-1).min(), np.sum(along_j * along_j, axis=-1).min())))


def _middle(values: Float) -> float:
    """The median (of two in the middle the larger), twenty times sooner than numpy.median says it of a few values."""
    return float(np.sort(values)[len(values) // 2])
