"""Saddle points: what an inner corner of a chessboard is, and hardly anything else.

Where four squares meet, the brightness rises along one diagonal and falls along the other. Blurred a little, it is a
*saddle*: the Hessian [[Gxx, Gxy], [Gxy, Gyy]] of the smoothed image G has one positive and one negative eigenvalue,
so

    S = Gxy^2 - Gxx Gyy = -l1 l2 > 0,

largest at the corner. Harris's response (:mod:`stereocal.board.harris`) asks for gradients of two directions, which the
outer corner of a dark square and every letter have as well; S asks for the curvature of a crossing, and L-corners,
T-junctions and line ends have a small one. G is smoothed by the binomial (1 4 6 4 1)/16, and the differences reach over
two pixels, which together is a Gaussian of 1.2 px and a pattern as wide as the smallest square looked for.

Every maximum of S over 5x5 pixels is a candidate, down to the level that a fifth of the pixels exceed. Noise and
texture have saddles too, so each has to pass the *ring test* (:mod:`stereocal.board.ring`). Measure and test look at a
neighbourhood of fixed size, so they are made on a pyramid of halved images (:mod:`stereocal.board.pyramid`): large
squares, blur and strong noise are seen at a coarse level, small squares at a fine one.

Source: Chen and Zhang, *A new sub-pixel detector for X-corners*, 2005 (the measure S).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from stereocal.base.checks import Float
from stereocal.board.ring import LEAST_AMPLITUDE, ring_test

_BINOMIAL = np.array([1, 4, 6, 4, 1]) / 16


def saddle_response(image: NDArray[Any], *, backend: str = "numba") -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Smoothed image G and saddle measure S = Gxy^2 - Gxx Gyy.

    Parameters
    ----------
    image : ndarray of shape (H, W), uint8 or float32
        Grey values.
    backend : {"numba", "numpy"}
        The kernel, or the readable reference (they agree to float32's rounding).

    Returns
    -------
    G, S : ndarray of shape (H, W), float32
        S is 0 within two pixels of the border. Derivatives are differences over two pixels, not divided by their step:
        the square root of S is in grey levels.
    """
    if backend == "numba":
        from stereocal.board.saddle_kernels import saddle_measure, smooth_binomial

        G, S = np.empty(image.shape, np.float32), np.empty(image.shape, np.float32)
        smooth_binomial(image, G)
        saddle_measure(G, S)
        return G, S
    smooth = ndimage.correlate1d(image.astype(np.float64), _BINOMIAL, 0, mode="nearest")
    smooth = ndimage.correlate1d(smooth, _BINOMIAL, 1, mode="nearest")
    measure = np.zeros_like(smooth)
    middle = smooth[2:-2, 2:-2]
    xx = smooth[2:-2, 4:] - 2 * middle + smooth[2:-2, :-4]
    yy = smooth[4:, 2:-2] - 2 * middle + smooth[:-4, 2:-2]
    xy = (smooth[4:, 4:] - smooth[4:, :-4] - smooth[:-4, 4:] + smooth[:-4, :-4]) / 4
    measure[2:-2, 2:-2] = xy * xy - xx * yy
    return smooth.astype(np.float32), measure.astype(np.float32)


def saddle_candidates(
    G: NDArray[np.float32],
    S: NDArray[np.float32],
    *,
    least_response: float = 1.0,
    least_amplitude: float = LEAST_AMPLITUDE,
    limit: int = 4000,
    backend: str = "numba",
) -> tuple[Float, NDArray[np.int64]]:
    """Saddles that pass the ring test.

    Parameters
    ----------
    G, S : ndarray of shape (H, W), float32
        From :func:`saddle_response`.
    least_response : float
        Least square root of S, grey levels.
    least_amplitude : float
        Least half difference between light and dark on the ring, grey levels.
    limit : int
        No more maxima than this per megapixel (and at least this many) are tested; the weakest are left out.
    backend : {"numba", "numpy"}
        The kernels, or the readable references (they agree to rounding).

    Returns
    -------
    candidates : ndarray of shape (n, 7), float64
        x, y, the four edge angles t0..t3 (radians, t0 leads from light into dark), the amplitude.
    maxima : ndarray of shape (m, 2), int64
        The pixels (x, y) of the maxima that were tested.
    """
    capacity = int(limit * max(1.0, G.size / 1e6))
    # At most a fifth of all pixels can be saddles, even of a board of the smallest squares: the rest is texture.
    sample = S[3::7, 3::7].ravel()
    fifth = int(0.8 * sample.size)
    threshold = np.float32(max(least_response**2, float(np.partition(sample, fifth)[fifth])))
    maxima = _maxima(S, threshold, backend)
    if len(maxima) > capacity:
        strength = S[maxima[:, 1], maxima[:, 0]]
        maxima = maxima[strength >= np.partition(strength, -capacity)[-capacity]]
    return ring_test(G, maxima, least_amplitude=least_amplitude, backend=backend), maxima


def _maxima(S: NDArray[np.float32], threshold: np.float32, backend: str) -> NDArray[np.int64]:
    """Pixels (x, y) whose S exceeds the threshold and the S of the 5x5 pixels around."""
    if backend == "numba":
        from stereocal.board.saddle_kernels import saddle_maxima

        out = np.empty((S.size // 9 + 1, 2), np.int64)
        return out[: saddle_maxima(S, threshold, out)]
    # The kernel looks block by block, at the largest of each 3x3 pixels: the same order, and the first of equal values.
    height, width = S.shape
    earlier = np.zeros((5, 5), bool)
    earlier[:2] = earlier[2, :2] = True
    largest = (threshold < S) & (ndimage.maximum_filter(S, 5) == S)
    largest &= ndimage.maximum_filter(S, footprint=earlier) < S
    found = [
        (x0 + x, y0 + y)
        for y0 in range(3, height - 5, 3)
        for x0 in range(3, width - 5, 3)
        for y, x in np.argwhere(largest[y0 : y0 + 3, x0 : x0 + 3])
    ]
    return np.array(found, np.int64).reshape(-1, 2)
