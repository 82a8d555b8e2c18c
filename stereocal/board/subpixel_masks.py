"""Second sight for corners whose picture is not a corner's alone: shadows, fingers, reflections, letters.

Where the edge of a shadow crosses a window, or a finger covers a square, no choice of the seven unknowns makes the
model of :mod:`stereocal.board.subpixel` look like the picture, and the best one may stand a pixel or more off. Such
fits give themselves away: their residuals are far above those of the board's other corners. They are fitted again, to
the pixels that the model can explain:

1. Where the corner should be is extrapolated from the trusted corners around, by a cubic in (i, j). Levels and blur are
   those of the trusted neighbours; at the edge of a shadow there are two kinds of these, so that both the brightest and
   the darkest are tried.
2. Pixels further from that picture than half of b are masked, the others fitted; then the same from the new fit with a
   quarter, an eighth, and a sixteenth of b, but not less than 3.5 times the board's noise. The limits have to fall
   slowly: a start 0.3 px off leaves 22 grey levels on a good edge.
3. Of the tries, with the slopes of the light around and with even light, the one with most pixels is taken, if it keeps
   at least `LEAST_KEPT` of the window, explains them better than the first fit explained all, and stands where the
   neighbours expect the corner: to 0.15 px and 0.3 times the square root of the extrapolation's leverage. Its
   covariance is that of the pixels left: if one arm of the cross remains, the corner is an extrapolation along it, and
   (J^T J)^-1 says how uncertain.
4. If none will do, and the first fit stands three times further off than that, with residuals `LOST` times the usual
   ones, what it measured is something else: the corner is put where its neighbours expect it, with that uncertainty.

This is least squares with rejection, in the family of Rousseeuw and Leroy, *Robust regression and outlier detection*,
1987; only suspects pay for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.board.corner_errors import median

SUSPECT = 2.2
"""A corner is suspect whose residuals are this many times the board's median, and more than `SUSPECT_SHARE` of b."""
SUSPECT_SHARE = 0.04
LOST = 4.0
"""The same for a corner whose own measurement may be given up."""
LEAST_KEPT = 0.4
"""Of the window's pixels, so many must be explained."""
_LIMITS = (0.5, 0.25, 0.12, 0.06)
_MOST_LEVERAGE = 20.0  # variance of an extrapolated place over that of a corner
_MOST_SUSPECTS = 0.5


@dataclass(frozen=True)
class FitInputs:
    """What the kernel needs besides the picture: see :func:`stereocal.board.subpixel_kernels.fit_saddles`."""

    corners: Float
    steps: Float
    bends: Float
    half: Float
    band: Float
    light: Float
    blur: Float

    def of(self, chosen: NDArray[np.intp]) -> list[Float]:
        """Return the rows of some corners, in the kernel's order."""
        rows = (self.corners, self.steps, self.bends, self.half, self.band, self.light, self.blur)
        return [np.ascontiguousarray(row[chosen]) for row in rows]


def fit_suspects(
    gray: NDArray[Any], shape: tuple[int, int], inputs: FitInputs, results: tuple[Float, Float, Float]
) -> NDArray[np.bool_]:
    """Fit the suspects again, to the pixels that a corner can explain; changes `results` in place.

    Parameters
    ----------
    gray : ndarray of shape (H, W)
    shape : (rows, columns)
    inputs : FitInputs
        Of the second fit.
    results : theta (n, 7), covariance (n, 2, 2), info (n, 4)
        Of the second fit.

    Returns
    -------
    ndarray of shape (n,), bool
        Those that remain suspect.
    """
    theta, covariance, info = results
    noise = np.sqrt(info[:, 0])
    fitted = info[:, 2] > 0
    if not fitted.any():
        return np.zeros(len(theta), np.bool_)
    usual = median(noise[fitted])
    limit = max(SUSPECT * usual, SUSPECT_SHARE * median(np.abs(theta[fitted, 6])))
    trusted = fitted & (noise <= limit)
    suspects = np.nonzero(~trusted)[0]
    if not suspects.size or suspects.size > _MOST_SUSPECTS * len(theta):
        return np.zeros(len(theta), np.bool_)
    expected, allowed, bright, dark = _expectations(theta, trusted, suspects, shape)
    known = np.isfinite(expected).all(axis=1)
    suspects, expected, allowed = suspects[known], expected[known], allowed[known]
    if not suspects.size:
        return ~trusted
    pixels = np.maximum(info[suspects, 1], 1)
    before, kept = noise[suspects].copy(), np.full(len(suspects), LEAST_KEPT)
    for levels in (bright[known], dark[known]):
        for even in (False, True):
            start = np.column_stack([expected, levels])
            tried = _fit_masked(gray, inputs, suspects, start, usual, even)
            explained = tried[2][:, 1] / pixels
            better = (tried[2][:, 2] > 0) & (explained > kept) & (np.sqrt(tried[2][:, 0]) < 0.7 * before)
            better &= np.hypot(*(tried[0][:, :2] - expected[:, :2]).T) <= allowed
            for result, trial in zip(results, tried, strict=True):
                result[suspects[better]] = trial[better]
            kept[better] = explained[better]
    stands = np.hypot(*(theta[suspects, :2] - expected[:, :2]).T) <= 3 * allowed
    off = ~stands & ~(before < LOST * usual)  # also where there is no fit at all
    theta[suspects[off], :2] = expected[off, :2]
    covariance[suspects[off]] = (allowed[off] ** 2)[:, None, None] / 2 * np.eye(2)
    remaining = ~((info[:, 2] > 0) & (np.sqrt(info[:, 0]) <= limit))
    remaining[suspects[off]] = True
    return np.asarray(remaining)


def _fit_masked(
    gray: NDArray[Any], inputs: FitInputs, chosen: NDArray[np.intp], start: Float, usual: float, even: bool
) -> tuple[Float, Float, Float]:
    """Fits of some corners from `start` (n, 7), with ever closer limits of the residuals; `even`: in flat light."""
    from stereocal.board.subpixel_kernels import fit_saddles

    n = len(chosen)
    theta, covariance, info = start.copy(), np.empty((n, 2, 2)), np.empty((n, 4))
    rows = inputs.of(chosen)
    if even:
        rows[5] = np.zeros_like(rows[5])
    for share in _LIMITS:
        limit = np.maximum(share * np.abs(start[:, 6]), 3.5 * usual)
        theta = np.where(np.isfinite(theta), theta, start)
        fit_saddles(gray, *rows, False, 2e-3, 30, limit, np.ones(n, np.int64), theta, covariance, info)
    return theta, covariance, info


def _expectations(
    theta: Float, trusted: NDArray[np.bool_], suspects: NDArray[np.intp], shape: tuple[int, int]
) -> tuple[Float, Float, Float, Float]:
    """(cx, cy, t1, t2, s) by the trusted neighbours, how far off that may be, and the levels (a, b) of two of these."""
    j, i = np.divmod(np.arange(len(theta)), shape[1])
    expected = np.full((len(suspects), 5), np.nan)
    bright, dark, allowed = np.zeros((len(suspects), 2)), np.zeros((len(suspects), 2)), np.zeros(len(suspects))
    for n, k in enumerate(suspects):
        u, v = i - i[k], j - j[k]
        distance = np.maximum(np.abs(u), np.abs(v))
        around = np.nonzero(trusted & (distance <= 4))[0]
        expected[n, :2], leverage = _extrapolated(
            u[around].astype(np.float64), v[around].astype(np.float64), theta[around, :2]
        )
        allowed[n] = 0.15 + 0.3 * np.sqrt(leverage)
        near = np.nonzero(trusted & (distance <= 2))[0]
        if len(near) < 3:
            expected[n, :2] = np.nan
            continue
        expected[n, 2:] = np.median(theta[near, 2:5], axis=0)
        # neighbours along a line have b of the other sign
        sign = np.where((u + v)[near] % 2 == 0, 1.0, -1.0)
        levels = np.column_stack([theta[near, 5], sign * theta[near, 6]])
        order = np.argsort(np.abs(levels[:, 1]), kind="stable")
        bright[n], dark[n] = levels[order[-2]], levels[order[1]]
    return expected, allowed, bright, dark


def _extrapolated(u: Float, v: Float, points: Float) -> tuple[Float, float]:
    """Value and leverage at (0, 0) of the cubic or quadratic through points at (u, v); NaN if neither is sure."""
    for degree in (3, 2):
        terms = [u**p * v**q for p in range(degree + 1) for q in range(degree + 1 - p)]
        weight = 1 / (1 + u * u + v * v)
        T = np.column_stack(terms) * weight[:, None]
        if len(T) < T.shape[1] + 2:
            continue
        inverse = np.linalg.pinv(T, rcond=1e-6)[0]
        # the value at the origin is the first coefficient: known if the terms can be told apart, and not by far levers
        told_apart = np.linalg.matrix_rank(T, tol=1e-6 * np.linalg.norm(T)) == T.shape[1]
        leverage = float(np.sum((inverse * weight) ** 2))
        if told_apart and leverage < _MOST_LEVERAGE:
            return np.asarray(inverse @ (points * weight[:, None])), leverage
    return np.full(2, np.nan), np.inf
