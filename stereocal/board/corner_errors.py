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
after the fit of that polynomial is error of the corners, wherever it comes from. With A the sum over all windows of the
projectors onto what no polynomial explains, and C_k the covariance that the fit of corner k reports,

    S = x^T A x + y^T A y,        E S = f  sum_k ( A_kk + rho/2 sum_{l next to k} A_kl ) tr C_k,

and f, S over that sum at f = 1, is the factor by which the reported covariances are to be multiplied. rho is the
correlation of neighbours whose windows overlap: the offset of a line at a corner is its mean over xi in [-h, h] steps,
the next corner takes it over [1 - h, 1 + h], so that rho = 1 - 1/(2 h) of the one component of their errors that they
share. f is known as well as the degrees of freedom allow, nu = 2 (tr A)^2 / tr A^2 (38 for 9 x 6 corners). An estimate
f of a chi-square over nu has E 1/f = nu / (nu - 2), so that what is used is f + 2/nu: squared errors over it average to
their expectation. Where squares are few and the lens is a strong fisheye, the polynomial itself is left behind: then
windows of 6 x 6 and degree 5 are tried, and f is cautious rather than bold.

**Strays.** A corner on the edge of a shadow, under a finger or in a reflection may be a pixel off while its own fit
looks fair. Its neighbours predict it: the place of k that makes S least is d = (A x)_k / A_kk away, which errors of
variance sigma^2 alone would make sigma^2 (A^2)_kk / A_kk^2. Where ``|d|^2`` exceeds 120 times that (by chance never),
the corner is a *stray*: it is kept, as it is what was measured, but its covariance grows by ``|d|^2 / 2`` in each
direction. Strays are set aside one after the other, the worst first, or they would spoil the judgement of the others;
for the same reason sigma^2 is here by the lesser of two f that a stray spoils little: that without corner k, and that
by the median of all ``|d|^2``. Setting corners s aside is letting them lie where S is least, which leaves
``A - A_:s A_ss^-1 A_s:`` in the place of A. A corner whose neighbours are then too few to predict it (A_kk = 0) is not
judged. Corners known to be doubtful (:mod:`stereocal.board.subpixel_masks`) are set
aside from the start.

Sources: the residual of a smoother as an estimate of the noise is Wahba's, *Spline models for observational data*,
1990; nu by two moments is Satterthwaite's, 1946.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float

STRAY = 120.0
"""A corner is a stray from this normalised squared distance on."""

_LACK = 2.5
"""The larger polynomial is believed where it leaves this many times less."""
_LEAST_SHARE, _LEAST_VARIANCE = 1e-3, 1e-12
"""No corner is known thirty times better than the others of its board, nor to less than a millionth of a pixel."""


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


@lru_cache(maxsize=64)
def _roughness(shape: tuple[int, int], side: int, degree: int) -> Float | None:
    """A (N, N), for windows of at most side x side corners; None if a polynomial leaves too little of them."""
    size = min(side, shape[0]), min(side, shape[1])
    v, u = (np.linspace(-1, 1, n) for n in size)
    terms = [np.outer(v**q, u**p).ravel() for p in range(size[1]) for q in range(size[0]) if p + q <= degree]
    Q, _ = np.linalg.qr(np.array(terms).T)
    if len(Q) - Q.shape[1] < 3:
        return None
    projector = np.eye(len(Q)) - Q @ Q.T
    index = np.arange(shape[0] * shape[1]).reshape(shape)
    A = np.zeros((index.size, index.size))
    for window in np.lib.stride_tricks.sliding_window_view(index, size).reshape(-1, len(Q)):
        A[np.ix_(window, window)] += projector
    A.flags.writeable = False
    return A


@lru_cache(maxsize=64)
def _adjacent(shape: tuple[int, int]) -> Float:
    """(N, N): 1 where two corners are neighbours along a line."""
    j, i = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    return np.asarray(np.abs(np.subtract.outer(i, i)) + np.abs(np.subtract.outer(j, j)) == 1, dtype=np.float64)


def judge_corners(
    corners: Float,
    covariances: Float,
    shape: tuple[int, int],
    *,
    correlation: float = 0.0,
    doubtful: NDArray[np.bool_] | None = None,
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
    doubtful : ndarray of shape (N,), bool, optional
        Corners that are not to judge the others; they come back as strays.

    Returns
    -------
    CornerErrors

    Notes
    -----
    One factor for the whole board: a few dozen degrees of freedom do not allow more.
    """
    n = len(corners)
    spread = np.trace(covariances, axis1=1, axis2=2) / 2
    known = np.isfinite(spread)
    aside = ~known if doubtful is None else ~known | doubtful
    A = _roughness(shape, 5, 4)
    if A is None or np.count_nonzero(aside) > n // 2:
        return CornerErrors(1.0, aside, np.zeros((n, 2)))
    usual = median(spread[known])
    # a window without any noise, a flat patch, claims to know its corner exactly
    spread = np.maximum(np.where(known, spread, usual), max(_LEAST_SHARE * usual, _LEAST_VARIANCE))
    # about the middle, or the digits of large coordinates are lost
    middle = corners - corners[~aside].mean(axis=0)
    adjacent = correlation / 2 * _adjacent(shape)
    judged = _judge(middle, spread, A, adjacent, aside)
    if judged.factor > 2.0:
        finer = _roughness(shape, 6, 5)
        if finer is not None:
            second = _judge(middle, spread, finer, adjacent, aside)
            judged = second if judged.factor > _LACK * second.factor else judged
    return judged


def _judge(corners: Float, spread: Float, A: Float, adjacent: Float, aside: NDArray[np.bool_]) -> CornerErrors:
    """The same for one A; `spread` is tr C_k / 2, `adjacent` rho/2 for neighbours."""
    strays, left = aside.copy(), A
    while True:
        s = np.nonzero(strays)[0]
        if s.size:
            left = A - A[:, s] @ np.linalg.lstsq(A[np.ix_(s, s)], A[s], rcond=None)[0]
        diagonal, trace = np.diag(left), float(np.trace(left))
        if trace < 1:  # so many are set aside that the polynomial passes through the rest
            return CornerErrors(1.0, strays, _distances(A, corners, strays))
        mute = strays | (diagonal < 1e-6)
        own = np.where(mute, 1.0, diagonal)
        squared = np.where(mute, 1.0, np.einsum("kl,kl->k", left, left))
        expected = 2 * float(_weights(left, adjacent) @ spread)
        rough = left @ corners
        S = max(float(np.sum(corners * rough)), 0.0)  # exact corners leave less than rounding
        size = np.einsum("nk,nk->n", rough, rough)
        score = np.where(mute, 0.0, size / (squared * spread))
        without = (S - size / own) / (expected * np.maximum(1 - squared / (own * trace), 0.05))
        level = np.minimum(without, median(score[~mute]) / 1.386)
        score = score / np.maximum(level, 0.1)
        worst = int(np.argmax(score))
        if score[worst] < STRAY or s.size > len(corners) // 3:
            break
        strays[worst] = True
    freedom = 2 * trace**2 / float(squared[~mute].sum())
    return CornerErrors(S / expected + 2 / freedom, strays, _distances(A, corners, strays))


def _distances(A: Float, corners: Float, strays: NDArray[np.bool_]) -> Float:
    """How far the strays lie from where their neighbours want them."""
    distances, s = np.zeros_like(corners), np.nonzero(strays)[0]
    if s.size:
        distances[s] = np.linalg.lstsq(A[np.ix_(s, s)], A[s] @ corners, rcond=None)[0]
    return distances


def median(values: Float) -> float:
    """Return the median, of two in the middle the larger: of a few dozen values ten times sooner than numpy.median."""
    return float(np.sort(values)[len(values) // 2])


def _weights(left: Float, adjacent: Float) -> Float:
    """A_kk + rho/2 sum of A_kl over the neighbours l."""
    return np.asarray(np.diag(left) + np.einsum("kl,kl->k", left, adjacent))
