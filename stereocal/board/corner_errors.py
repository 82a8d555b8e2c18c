"""How wrong the corners really are: their neighbours tell.

A fit knows its own noise: with residuals that are independent from pixel to pixel, (J^T J)^-1 sigma^2 is the
covariance of the corner (:mod:`stereocal.board.subpixel`). But residuals are not always independent. A sharp edge that
runs along the pixels' rows meets every pixel at the same phase, and what the model gets wrong there moves the whole
edge; where it runs askew the phases alternate, and the same error cancels. JPEG, the interpolation of a Bayer pattern,
sharpening, and the samples of a renderer tie neighbouring pixels together too. In all these cases the window cannot
tell: the covariance is too small (an edge displaced as a whole leaves no residual) or too large (residuals that
alternate cancel).

**The grid tells.** A lens and a flat or gently bent board show the corners as a smooth function of their indices: in
any 5 x 5 corners, each coordinate is a polynomial of degree 4 in (i, j), to a few thousandths of a pixel. What is left
after the fit of that polynomial is error of the corners, wherever it comes from. With P the projector onto what no
polynomial explains and C_k the covariance that the fit of corner k reports,

    r = P x,        E |r|^2 = f  sum_k ( P_kk + rho/2 sum_{l next to k} P_kl ) tr C_k,

and f, the mean over all windows of ``|r|^2`` over that sum at f = 1, is the factor by which the reported covariances
are to be multiplied. rho is the correlation of neighbours whose windows overlap: the offset of a line at a corner is
its mean over xi in [-h, h] steps, the next corner takes it over [1 - h, 1 + h], so that rho = 1 - 1/(2 h) of the one
component of their errors that they share. f is known as well as the degrees of freedom nu allow: windows of the
polynomials overlap, so nu = 2 (tr A)^2 / tr A^2 with A the sum of the projectors (38 for 9 x 6 corners). An estimate f
of a chi-square over nu has E 1/f = nu / (nu - 2), so that what is used is f + 2/nu: squared errors over it average to
their expectation. Where squares are few and the lens is a strong fisheye, the polynomial itself is left behind:
then windows of 6 x 6 and degree 5 are tried, and f is cautious rather than bold.

**Strays.** A corner on the edge of a shadow, under a finger or in a reflection may be a pixel off while its own fit
looks fair. Its neighbours predict it: d = r_k / P_kk is its distance from the polynomial through all the others. Where
``|d|^2 P_kk`` exceeds 80 f tr C_k / 2 (by chance hardly once in 1e10), the corner is a *stray*: it is kept, as it is
what was measured, but its covariance grows by ``|d|^2 / 2`` in each direction. Strays are taken out one after the
other, the worst first, and put where the others see them, or they would spoil the judgement of the others. For the same
reason f is here the least of three that a stray spoils little: f without corner k, exact by
``|r|^2 - |r_k|^2 / P_kk``; the median over the corners; the lower quartile over the windows.

Sources: the residual of a smoother as an estimate of the noise is Wahba's, *Spline models for observational data*,
1990; nu by two moments is Satterthwaite's, 1946.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float

STRAY = 80.0
"""A corner is a stray from this normalised squared distance on."""

_LACK = 2.5
"""The larger polynomial is believed where it leaves this many times less."""


@dataclass(frozen=True)
class CornerErrors:
    """What the neighbours say of the corners.

    Attributes
    ----------
    factor : float
        By which the covariances are to be multiplied; 1 where the grid is too small to tell.
    strays : ndarray of shape (N,), bool
    distances : ndarray of shape (N, 2)
        Of strays from where the others see them, px; otherwise 0.
    """

    factor: float
    strays: NDArray[np.bool_]
    distances: Float


@dataclass(frozen=True)
class _Windows:
    """Windows of a grid and the projector P that takes polynomials out of them."""

    members: NDArray[np.intp]  # (W, n)
    projector: Float  # (n, n)
    beside: Float  # (n,): sum over the neighbours l of k of P_kl
    freedom: float  # nu, both coordinates
    home: NDArray[np.intp]  # (N, 2): the window in which a corner is judged best, and its place in that


@lru_cache(maxsize=64)
def _windows(shape: tuple[int, int], side: int, degree: int) -> _Windows | None:
    """Windows of at most side x side corners; None if a polynomial leaves too little of them."""
    size = min(side, shape[0]), min(side, shape[1])
    v, u = (np.linspace(-1, 1, n) for n in size)
    terms = [np.outer(v**q, u**p).ravel() for p in range(size[1]) for q in range(size[0]) if p + q <= degree]
    Q, _ = np.linalg.qr(np.array(terms).T)
    if len(Q) - Q.shape[1] < 3:
        return None
    projector = np.eye(len(Q)) - Q @ Q.T
    rows, columns = np.divmod(np.arange(len(Q)), size[1])
    adjacent = np.abs(np.subtract.outer(rows, rows)) + np.abs(np.subtract.outer(columns, columns)) == 1
    beside = np.sum(projector * adjacent, axis=1)
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    members = np.lib.stride_tricks.sliding_window_view(index, size).reshape(-1, size[0] * size[1])
    total = np.zeros((index.size, index.size))
    judged, home = np.zeros(index.size), np.zeros((index.size, 2), np.intp)
    for w, member in enumerate(members):
        total[np.ix_(member, member)] += projector
        better = np.nonzero(np.diag(projector) > judged[member] + 1e-9)[0]
        judged[member[better]] = np.diag(projector)[better]
        home[member[better], 0], home[member[better], 1] = w, better
    freedom = 2 * np.trace(total) ** 2 / np.sum(total * total)
    return _Windows(members, projector, beside, float(freedom), home)


def judge_corners(
    corners: Float, covariances: Float, shape: tuple[int, int], *, correlation: float = 0.0
) -> CornerErrors:
    """Compare the corners of a full grid with what their neighbours say.

    Parameters
    ----------
    corners : ndarray of shape (N, 2)
        Row by row.
    covariances : ndarray of shape (N, 2, 2)
        As their fits report them, px^2; NaN where a fit failed.
    shape : (rows, columns)
    correlation : float
        rho: of the offsets of a line at two neighbouring corners, by their windows' overlap.

    Returns
    -------
    CornerErrors

    Notes
    -----
    One factor for the whole board: a few dozen degrees of freedom do not allow more.
    """
    n = len(corners)
    none = CornerErrors(1.0, np.zeros(n, np.bool_), np.zeros((n, 2)))
    windows = _windows(shape, 5, 4)
    spread = np.trace(covariances, axis1=1, axis2=2)
    known = np.isfinite(spread)
    if windows is None or not known.any():
        return none
    spread = np.where(known, spread, np.median(spread[known]))
    judged = _judge(corners, spread, windows, correlation)
    if judged.factor > 2.0:
        finer = _windows(shape, 6, 5)
        if finer is not None:
            second = _judge(corners, spread, finer, correlation)
            judged = second if judged.factor > _LACK * second.factor else judged
    return judged


def _judge(corners: Float, spread: Float, windows: _Windows, correlation: float) -> CornerErrors:
    """The same with windows of one kind; `spread` is tr C_k."""
    points, strays = corners.copy(), np.zeros(len(corners), np.bool_)
    weight = np.diag(windows.projector)
    expected = spread[windows.members] @ (weight + correlation / 2 * windows.beside)
    own = weight[windows.home[:, 1]]
    part = np.bincount(windows.members.ravel(), minlength=len(corners)) / (len(expected) * weight.sum())
    for _ in range(len(corners) // 4 + 1):
        left = np.matmul(windows.projector, points[windows.members])  # (W, n, 2)
        squares = np.einsum("wnk,wnk->wn", left, left)
        sums = squares.sum(axis=1)
        distance = left[windows.home[:, 0], windows.home[:, 1]] / own[:, None]
        score = np.einsum("nk,nk->n", distance, distance) * own / (spread / 2)
        without = sums.sum() - np.bincount(windows.members.ravel(), (squares / weight).ravel(), len(corners))
        usual = min(float(np.median(score)) / 1.386, float(np.percentile(sums / expected, 25)))
        level = np.minimum(without / ((1 - part) * expected.sum()), usual)
        score = np.where(strays, 0, score / np.maximum(level, 0.1))
        worst = int(np.argmax(score))
        if score[worst] < STRAY:
            break
        strays[worst] = True
        points[strays] -= distance[strays]
    factor = float(np.mean(sums / expected)) + 2 / windows.freedom
    return CornerErrors(factor, strays, np.where(strays[:, None], corners - points, 0.0))
