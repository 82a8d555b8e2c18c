"""What the neighbours know about a corner's window: steps, bends, light.

Three things about the picture around corner (i, j) of a grid are seen better from the corners around it than in the
window of its fit:

- the **steps** P(i+1) - P(i) along both lines, which set the window's size and shape: central differences, one-sided at
  the border;
- the **bends** of the lines, which a window of one corner can hardly tell from a shift: the component of the second
  difference P(i+1) - 2 P(i) + P(i-1) along the line's normal, at the border that of the corner next to it. A second
  difference has six times the variance of a corner, so the mean over 3 x 3 corners is taken;
- the **light**: the levels a (middle grey) and b (half the contrast) of the corners' first fits change from corner to
  corner, and the median of these changes over 5 x 5 corners is the slope in the window. It is a median because at the
  edge of a shadow the levels jump between two columns, and must not seem to slope in the columns around.

The functions here are the readable twins of :mod:`stereocal.board.subpixel_geometry_kernels`, which a board of 54
corners needs at once, without a dozen small NumPy calls.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from stereocal.base.checks import Float, require_choice

STEEPEST = 0.5
"""Largest slope of b, relative, a step."""


def grid_steps(grid: Float, *, backend: str = "numba") -> tuple[Float, Float]:
    """Steps and bends of a full grid of corners.

    Parameters
    ----------
    grid : ndarray of shape (J, I, 2)
        Corners, row by row.
    backend : {"numba", "numpy"}

    Returns
    -------
    steps : ndarray of shape (J, I, 4)
        (dx, dy) along i, then along j.
    bends : ndarray of shape (J, I, 2)
        Of the line along i, then of that along j, px a step squared.
    """
    require_choice(backend, ("numba", "numpy"), "backend")
    if backend == "numba":
        from stereocal.board.subpixel_geometry_kernels import steps_and_bends

        steps, bends = np.empty((*grid.shape[:2], 4)), np.empty((*grid.shape[:2], 2))
        steps_and_bends(np.ascontiguousarray(grid), steps, bends)
        return steps, bends
    along_i, along_j = _differences(grid, 1), _differences(grid, 0)
    bends = np.empty((*grid.shape[:2], 2))
    for axis, step in ((1, along_i), (0, along_j)):
        second = np.zeros_like(grid)
        if grid.shape[axis] >= 3:
            inner = np.diff(grid, 2, axis=axis)
            second = np.concatenate([inner.take([0], axis), inner, inner.take([-1], axis)], axis=axis)
        normal = np.stack([-step[..., 1], step[..., 0]], axis=-1) / np.linalg.norm(step, axis=-1, keepdims=True)
        bends[..., 1 - axis] = np.sum(second * normal, axis=-1)
    bends = ndimage.uniform_filter(bends, (3, 3, 1), mode="nearest")
    return np.concatenate([along_i, along_j], axis=-1), bends


def light_slopes(levels: Float, *, backend: str = "numba") -> Float:
    """Light around each corner.

    Parameters
    ----------
    levels : ndarray of shape (J, I, 2)
        a and abs(b) of each corner, grey levels.
    backend : {"numba", "numpy"}

    Returns
    -------
    ndarray of shape (J, I, 5)
        a, its slopes along i and along j in grey levels a step, and those of b over b.
    """
    require_choice(backend, ("numba", "numpy"), "backend")
    light = np.empty((*levels.shape[:2], 5))
    if backend == "numba":
        from stereocal.board.subpixel_geometry_kernels import median_slopes

        median_slopes(np.ascontiguousarray(levels), STEEPEST, light)
        return light
    light[..., 0] = levels[..., 0]
    b = np.maximum(levels[..., 1], 1e-6)
    for k, axis in enumerate((1, 0)):
        slopes = ndimage.median_filter(_differences(levels, axis), (5, 5, 1), mode="nearest")
        light[..., 1 + k] = slopes[..., 0]
        light[..., 3 + k] = np.clip(slopes[..., 1] / b, -STEEPEST, STEEPEST)
    return light


def _differences(grid: Float, axis: int) -> Float:
    """Central differences along an axis, one-sided at the ends."""
    step = np.diff(grid, axis=axis)
    first, last = step.take([0], axis), step.take([-1], axis)
    middle = (np.delete(step, 0, axis) + np.delete(step, -1, axis)) / 2
    return np.asarray(np.concatenate([first, middle, last], axis=axis))
