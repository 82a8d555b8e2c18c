"""Textured rectangles and spheres: where a ray meets them, and what colour is there.

A surface is one row of a table, so that a kernel can run through all of them for every ray; lengths are in the rig's
unit:

===========  ==========================================================================
columns      meaning
===========  ==========================================================================
0            kind: 0 rectangle, 1 sphere
1:4          centre c
4:7, 7:10    unit vectors a, b along the sides (of a sphere: two axes of its map)
10, 11       half lengths along a and b (of a sphere: its radius, twice)
12:15        colour R, G, B, grey levels
15           wavelength λ of the texture's coarsest octave
16           contrast of the texture, 0..1
17           seed of the texture
18           pattern: 0 fractal noise, 1 planks
===========  ==========================================================================

**Meeting.** A ray o + τ d meets a rectangle's plane at τ = n·(c − o)/(n·d), n = a × b, and the rectangle where the
point's coordinates along a and b are within the half lengths. It meets a sphere where |o + τ d − c| = r, the smaller
positive root. The nearest of all is what is seen.

**Texture.** Value noise (Perlin's 1985 idea in its simplest form): a hash gives each point of a lattice of step λ a
number in [−1, 1], between them the quintic 6t⁵ − 15t⁴ + 10t³ leads over, and three octaves (λ, λ/2, λ/4) are summed. It
is defined on the surface, so both cameras see the same; its finest octave is some pixels wide at the distances of the
room, so that a few samples a pixel do not alias it; and it never repeats, which a stereo matcher would stumble over.

**Light.** Lambert: ½ + ½ |n·l|; the same from both cameras.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float
from stereocal.base.rotations import rotation_matrix

COLUMNS = 19
LIGHT = np.array([-0.48, -0.6, -0.64])
"""Direction towards the light, unit length: upper left, behind the camera."""

_MASK = 0xFFFFFFFF
_NEAREST = 1e-6


def rectangle(
    centre: ArrayLike,
    along: ArrayLike,
    down: ArrayLike,
    half: tuple[float, float],
    colour: tuple[float, float, float],
    *,
    wavelength: float,
    contrast: float = 0.8,
    seed: int = 0,
    pattern: int = 0,
) -> Float:
    """Return the row of a rectangle; see the module for the columns."""
    look = [*colour, wavelength, contrast, float(seed), float(pattern)]
    return np.concatenate([[0.0], np.ravel(centre), np.ravel(along), np.ravel(down), half, look])


def sphere(
    centre: ArrayLike,
    radius: float,
    colour: tuple[float, float, float],
    *,
    wavelength: float,
    contrast: float = 0.8,
    seed: int = 0,
) -> Float:
    """Return the row of a sphere; see the module for the columns."""
    look = [*colour, wavelength, contrast, float(seed), 0.0]
    return np.concatenate([[1.0], np.ravel(centre), [1, 0, 0], [0, 1, 0], [radius, radius], look])


def box(
    centre: ArrayLike,
    half: tuple[float, float, float],
    colour: tuple[float, float, float],
    *,
    yaw: float = 0.0,
    wavelength: float,
    contrast: float = 0.8,
    seed: int = 0,
    pattern: int = 0,
) -> list[Float]:
    """Return the six rectangles of a box, turned by `yaw` degrees about the vertical."""
    middle = np.asarray(centre, dtype=np.float64)
    axes = rotation_matrix([0.0, np.radians(yaw), 0.0]).T
    return [
        rectangle(
            middle + side * half[i] * axes[i],
            axes[j],
            axes[k],
            (half[j], half[k]),
            colour,
            wavelength=wavelength,
            contrast=contrast,
            seed=seed + face,
            pattern=pattern,
        )
        for face, (i, j, k, side) in enumerate(_FACES)
    ]


_FACES = [(i, (i + 1) % 3, (i + 2) % 3, side) for i in range(3) for side in (-1.0, 1.0)]


def trace(
    surfaces: Float, origin: Float, directions: Float, *, backend: str = "numba"
) -> tuple[Float, NDArray[np.int64]]:
    """Find what each ray meets first.

    Parameters
    ----------
    surfaces : ndarray of shape (P, 19)
        The table.
    origin : ndarray of shape (3,)
        Where the rays start.
    directions : ndarray of shape (N, 3)
        Where they go; of any length, NaN for no ray.
    backend : {"numba", "numpy"}
        Which of the twins.

    Returns
    -------
    tau : ndarray of shape (N,)
        The ray's parameter at the first surface: o + τ d; NaN where it meets none.
    index : ndarray of shape (N,), int64
        Which surface; −1 for none.
    """
    if backend == "numba":
        from stereocal.synthetic.rendering_kernels import trace_kernel

        tau, index = np.empty(len(directions)), np.empty(len(directions), dtype=np.int64)
        trace_kernel(surfaces, origin, np.ascontiguousarray(directions), tau, index)
        return tau, index
    nearest = np.full(len(directions), np.inf)
    index = np.full(len(directions), -1, dtype=np.int64)
    for i, surface in enumerate(surfaces):
        met = _meet(surface, origin, directions)
        closer = met < nearest
        nearest[closer], index[closer] = met[closer], i
    return np.where(index >= 0, nearest, np.nan), index


def shade(surfaces: Float, points: Float, index: NDArray[np.int64]) -> Float:
    """Return the colour (N, 3) of points on surfaces `index`; 0 where that is −1."""
    colours = np.zeros((len(points), 3))
    for i, surface in enumerate(surfaces):
        here = index == i
        if not here.any():
            continue
        offset = points[here] - surface[1:4]
        if surface[0] == 0:
            normal = np.cross(surface[4:7], surface[7:10])[None, :]
            p, q = offset @ surface[4:7], offset @ surface[7:10]
        else:
            normal = offset / surface[10]
            p = surface[10] * np.arctan2(offset[:, 0], -offset[:, 2])
            q = surface[10] * np.arcsin(np.clip(offset[:, 1] / surface[10], -1, 1))
        light = 0.5 + 0.5 * np.abs(normal @ LIGHT)
        value = 1 + surface[16] * texture(p / surface[15], q / surface[15], int(surface[17]), int(surface[18]))
        colours[here] = surface[12:15] * (light * value)[:, None]
    return colours


def texture(p: Float, q: Float, seed: int, pattern: int) -> Float:
    """Return three octaves of value noise at (p, q) in wavelengths, in [−1, 1]; pattern 1 adds the seams of planks."""
    stretch = 0.35 if pattern == 1 else 1.0
    value = (
        0.5 * _value_noise(stretch * p, q, seed)
        + 0.3 * _value_noise(2 * stretch * p, 2 * q, seed + 101)
        + 0.2 * _value_noise(4 * stretch * p, 4 * q, seed + 202)
    )
    if pattern == 1:
        gap = q - np.rint(q)
        value = value - 0.6 * np.exp(-((gap / 0.06) ** 2))
    return np.asarray(np.clip(1.4 * value, -1, 1))


def _value_noise(p: Float, q: Float, seed: int) -> Float:
    i, j = np.floor(p), np.floor(q)
    a, b = _fade(p - i), _fade(q - j)
    i, j = i.astype(np.int64), j.astype(np.int64)
    upper = (1 - a) * _hash(i, j, seed) + a * _hash(i + 1, j, seed)
    lower = (1 - a) * _hash(i, j + 1, seed) + a * _hash(i + 1, j + 1, seed)
    return np.asarray((1 - b) * upper + b * lower)


def _fade(t: Float) -> Float:
    return t * t * t * (t * (6 * t - 15) + 10)


def _hash(i: NDArray[np.int64], j: NDArray[np.int64], seed: int) -> Float:
    """A number in [−1, 1) for a lattice point: multiply, fold, multiply, in 32 bits."""
    h = ((i & _MASK) * 374761393 & _MASK) + ((j & _MASK) * 668265263 & _MASK) + (seed * 1103515245 & _MASK)
    h = (h ^ (h >> 13)) & _MASK
    h = (h * 1274126177) & _MASK
    h ^= h >> 16
    return h / 2147483648.0 - 1.0


def _meet(surface: Float, origin: Float, d: Float) -> Float:
    """τ of every ray at one surface; inf where it misses."""
    offset = surface[1:4] - origin
    with np.errstate(divide="ignore", invalid="ignore"):
        if surface[0] == 0:
            normal = np.cross(surface[4:7], surface[7:10])
            tau = (normal @ offset) / (d @ normal)
            point = tau[:, None] * d - offset
            hit = (np.abs(point @ surface[4:7]) <= surface[10]) & (np.abs(point @ surface[7:10]) <= surface[11])
        else:
            a, b = np.sum(d * d, axis=1), d @ offset
            root = b * b - a * (offset @ offset - surface[10] ** 2)
            tau = (b - np.sqrt(root)) / a
            hit = root >= 0
        return np.where(hit & (tau > _NEAREST), tau, np.inf)
