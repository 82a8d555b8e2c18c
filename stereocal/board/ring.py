"""The ring test: does a saddle look like the crossing of two edges all the way round?

Noise, texture and letters have saddle points too. On a circle of radius 4 around an inner corner one meets dark, light,
dark, light. So the samples of G on the circle, v(k) at the angles 2 pi k / 32, have to

1. reach over at least a few grey levels, from darkest to lightest;
2. cross the middle grey m = (min v + max v) / 2 exactly four times;
3. cross it at opposite angles (t2 = t0 + pi, t3 = t1 + pi, to 26 degrees) that leave every square 17 degrees and more;
4. look the same half a turn on. Split into an even and an odd part under that half turn,

       sum (v(k) - v(k+16))^2 <= 0.35 sum (v(k) + v(k+16) - 2 m)^2,

   the *symmetry test*: an L-corner or the end of a line is odd, a crossing is even.

The circle's centre is not the pixel but the saddle point of the quadratic through it: with the gradient g and the
Hessian H there, the point p - H^-1 g, no further than two pixels away. Before all that, a look at eight pixels of the
circle rejects two thirds of the maxima: their odd part must be smaller than their even part.

The four angles are interpolated between the two samples that a crossing lies between. The first, t0, is the one that
leads with growing angle from light into dark: what passes knows its two edge directions and its polarity, and that is
what corners are linked by (:mod:`stereocal.board.links`).

Sources: Bennett and Lasenby, *ChESS - quick and robust detection of chess-board features*, CVIU 2014, sum over such a
ring to get a response. Ours: crossings located on the ring, and their polarity carried into the graph.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float

RING_RADIUS = 4.0
RING_STEPS = 32
LEAST_AMPLITUDE = 2.0
"""Least half difference between light and dark on the ring, grey levels."""
_ANGLES = np.arange(RING_STEPS) * (2 * np.pi / RING_STEPS)
_COSINE, _SINE = np.cos(_ANGLES), np.sin(_ANGLES)


def ring_test(
    G: NDArray[np.float32],
    pixels: NDArray[np.int64],
    *,
    least_amplitude: float = LEAST_AMPLITUDE,
    backend: str = "numba",
) -> Float:
    """The saddles around which a ring shows dark, light, dark, light, alike on opposite sides.

    Parameters
    ----------
    G : ndarray of shape (H, W), float32
        The smoothed image.
    pixels : ndarray of shape (m, 2), int64
        x, y of maxima of the saddle measure, two pixels and more from the border.
    least_amplitude : float
        Least half difference between light and dark on the ring, grey levels.
    backend : {"numba", "numpy"}
        The kernel, or the readable reference (they agree to rounding).

    Returns
    -------
    ndarray of shape (n, 7), float64
        Of those that pass: x, y, the four edge angles t0..t3 (radians, t0 leads from light into dark), the amplitude.
    """
    if backend == "numba":
        from stereocal.board import ring_kernels

        out = np.empty((len(pixels), 7))
        return out[: ring_kernels.ring_test(G, pixels, _COSINE, _SINE, RING_RADIUS, least_amplitude, out)]
    gray = G.astype(np.float64)
    rows = [_ring_of(gray, int(x), int(y), least_amplitude) for x, y in pixels]
    return np.array([row for row in rows if row is not None]).reshape(-1, 7)


def bilinear(gray: Float, x: Float, y: Float) -> Float:
    """Grey values between pixels; points outside count as the border's."""
    x = np.clip(x, 0.0, gray.shape[1] - 1.001)
    y = np.clip(y, 0.0, gray.shape[0] - 1.001)
    ix, iy = x.astype(np.int64), y.astype(np.int64)
    fx, fy = x - ix, y - iy
    upper = gray[iy, ix] * (1 - fx) + gray[iy, ix + 1] * fx
    lower = gray[iy + 1, ix] * (1 - fx) + gray[iy + 1, ix + 1] * fx
    return np.asarray(upper * (1 - fy) + lower * fy)


def _looks_alike(gray: Float, x: int, y: int, least_amplitude: float) -> bool:
    """Eight pixels around, opposite ones more alike than not; true where they do not all lie in the image."""
    height, width = gray.shape
    if x < 4 or y < 4 or x >= width - 4 or y >= height - 4:
        return True
    offsets = np.array([(-4, 0), (0, -4), (-3, -3), (3, -3)])
    first = gray[y + offsets[:, 1], x + offsets[:, 0]]
    opposite = gray[y - offsets[:, 1], x - offsets[:, 0]]
    low, high = min(first.min(), opposite.min()), max(first.max(), opposite.max())
    odd, even = np.sum((first - opposite) ** 2), np.sum((first + opposite - (low + high)) ** 2)
    return bool(high - low >= 1.4 * least_amplitude and odd < even)


def _saddle_point(gray: Float, x: int, y: int) -> tuple[float, float] | None:
    """Where the quadratic through the pixel, with differences over two pixels, has its saddle; None if far away."""
    gx, gy = (gray[y, x + 2] - gray[y, x - 2]) / 4, (gray[y + 2, x] - gray[y - 2, x]) / 4
    xx = (gray[y, x + 2] - 2 * gray[y, x] + gray[y, x - 2]) / 4
    yy = (gray[y + 2, x] - 2 * gray[y, x] + gray[y - 2, x]) / 4
    xy = (gray[y + 2, x + 2] - gray[y + 2, x - 2] - gray[y - 2, x + 2] + gray[y - 2, x - 2]) / 16
    det = xx * yy - xy * xy
    if det == 0:
        return None
    dx, dy = (xy * gy - yy * gx) / det, (xy * gx - xx * gy) / det
    return (x + dx, y + dy) if dx * dx + dy * dy < 4.0 else None


def _ring_of(gray: Float, x: int, y: int, least_amplitude: float) -> list[float] | None:
    """The row of one saddle, or None."""
    if not _looks_alike(gray, x, y, least_amplitude):
        return None
    center = _saddle_point(gray, x, y)
    if center is None:
        return None
    v = bilinear(gray, center[0] + RING_RADIUS * _COSINE, center[1] + RING_RADIUS * _SINE)
    middle, amplitude = (v.max() + v.min()) / 2, (v.max() - v.min()) / 2
    above, following = v - middle, np.roll(v, -1) - middle
    places = np.nonzero((above > 0) != (following > 0))[0]
    if amplitude < least_amplitude or len(places) != 4:
        return None
    t = (places + above[places] / (above[places] - following[places])) * (2 * np.pi / RING_STEPS)
    if np.abs(t[2:] - t[:2] - np.pi).max() > 0.45 or min(t[1] - t[0], t[2] - t[1]) < 0.3:
        return None
    half = RING_STEPS // 2
    odd, even = np.sum((above[:half] - above[half:]) ** 2), np.sum((above[:half] + above[half:]) ** 2)
    if odd > 0.35 * even:
        return None
    first_falls = above[places[0]] > 0
    return [*center, *np.roll(t, 0 if first_falls else -1), amplitude]
