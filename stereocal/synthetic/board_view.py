"""A chessboard, flat or bent, photographed by a camera: the picture and the exact place of every corner.

**Inverse mapping.** The ray (x, y, 1) behind a sample, turned into the board's frame, starts at o = −Rᵀt and runs along
d = Rᵀ(x, y, 1)ᵀ. The board's surface is z = b (1 − 4 (X − c)²/L²): flat for b = 0, else a parabolic cylinder that rises
by b (the *bow*) in the middle of its length L, as cardboard does. The ray meets it where

    A τ² + B τ + C = 0,   A = q d_x²,   B = d_z + 2 q (o_x − c) d_x,   C = o_z − b + q (o_x − c)²,   q = 4 b/L²,

taken as τ = −2 C/(B + sign(B) √(B² − 4 A C)), which is the near root and has no division that fails as b → 0.

**What is seen there.** With squares of side 1, the wave S(x) = +1 on [0, 1), −1 on [1, 2) … changes sign at every
corner line, and S(X) S(Y) = +1 are the dark squares. A sample that took the value at one point would place an edge only
to the step between samples: with four samples a pixel, a horizontal edge could be off by 1/8 px, more than what corner
detectors achieve. So each sample takes the mean over its own footprint w, cut at the print's edge: the part of it that
is dark is ½ (p_x p_y + s_x s_y), p the part that is printed and s the mean of S, (T(X + w/2) − T(X − w/2))/w with T the
integral of S, a triangle wave. The mean over a symmetric footprint moves no edge; it is why the true corners are true
to 1e-3 px at any pose.

**Truth.** The corners are the projections of (X, Y, z(X)), by the same camera model that everything else uses.

The square diagonally outside the first corner is dark, the paper has a bright margin of one square around it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float, as_array, as_rotation, require_choice, require_integer, require_positive
from stereocal.base.errors import InputError
from stereocal.base.rotations import rotation_vector
from stereocal.board.chessboard import Chessboard
from stereocal.camera.model import Camera
from stereocal.synthetic.exposure import aperture_kernel, blur_pad, develop, gather, vignette
from stereocal.synthetic.rays import RayTable, ray_table

Radiance = NDArray[np.float32]

MIDDLE, SWING = 120.0, 80.0
"""Grey of the board's mean, and half the difference of bright and dark at contrast 1."""

MARGIN = 1.0
"""Bright paper around the squares, in squares."""

_FAR = 4.0
"""A footprint of more squares than this is seen at grazing incidence and not drawn."""


def render_board(
    camera: Camera,
    R: ArrayLike,
    t: ArrayLike,
    board: Chessboard,
    *,
    blur: float = 0.8,
    noise: float = 2.0,
    contrast: float = 1.0,
    vignetting: float = 0.2,
    supersampling: int = 4,
    background: float = 90.0,
    bow: float = 0.0,
    seed: int = 0,
    backend: str = "numba",
) -> tuple[NDArray[np.uint8], Float]:
    """Photograph a chessboard.

    Parameters
    ----------
    camera : Camera
        With its lens.
    R : array_like of shape (3, 3)
        Rotation from the board's frame to the camera's.
    t : array_like of 3 numbers
        Translation of the same, in units of the board's square_size.
    board : Chessboard
        What is seen.
    blur : float
        σ of the lens's spot, pixels.
    noise : float
        σ of the sensor's noise, grey levels.
    contrast : float
        1: dark 40, bright 200.
    vignetting : float
        Loss of light in the farthest corner, 0..1.
    supersampling : int
        Samples a pixel in each direction, at least 4.
    background : float
        Grey behind the board.
    bow : float
        How far the board's middle stands out behind its ends, in units of square_size.
    seed : int
        Of the noise.
    backend : {"numba", "numpy"}
        Which of the twins.

    Returns
    -------
    image : ndarray of shape (H, W), uint8
    corners : ndarray of shape (N, 2), float64
        The true corners, pixels, also those outside the image.

    Raises
    ------
    InputError
        If the pose shows the board's back, or an argument is out of range.

    Notes
    -----
    Agreement of the twins: 1e-4 grey levels before noise.
    """
    rotation, translation = as_rotation(R), as_array(np.ravel(np.asarray(t, dtype=np.float64)), (3,), "t")
    require_integer(supersampling, "supersampling", minimum=4, maximum=16)
    table = ray_table(camera, supersampling=supersampling, pad=blur_pad(blur))
    radiance = np.full(table.raster_shape, background, dtype=np.float32)
    paint_board(table, rotation, translation, board, radiance, contrast=contrast, bow=bow, backend=backend)
    light = gather(radiance, aperture_kernel(blur, supersampling, table.pad), supersampling, backend=backend)
    shading = vignette(camera, vignetting)
    image = develop(light, noise=noise, random=np.random.default_rng(seed), shading=shading)
    return image, true_corners(camera, rotation, translation, board, bow=bow)


def true_corners(camera: Camera, R: Float, t: Float, board: Chessboard, *, bow: float = 0.0) -> Float:
    """Return the exact projections of the board's inner corners, (N, 2) pixels."""
    return camera.project(bent_points(board, bow), rotation_vector(R), t)


def bent_points(board: Chessboard, bow: float) -> Float:
    """Return the corners (X, Y, z(X)) of a board bent into a parabolic cylinder, (N, 3) in units of square_size."""
    points = np.array(board.object_points, dtype=np.float64)
    _, centre, length = _bend(board, bow)
    x = points[:, 0] / board.square_size
    points[:, 2] = bow * (1 - 4 * ((x - centre) / length) ** 2)
    return points


def paint_board(
    table: RayTable,
    R: Float,
    t: Float,
    board: Chessboard,
    radiance: Radiance,
    *,
    contrast: float = 1.0,
    bow: float = 0.0,
    backend: str = "numba",
) -> None:
    """Paint the board over the background that `radiance` holds.

    Parameters
    ----------
    table : RayTable
        The camera's rays.
    R, t : ndarray of shape (3, 3) and (3,)
        Pose, board to camera.
    board : Chessboard
        What is painted.
    radiance : ndarray of `table.raster_shape`, float32
        Changed in place.
    contrast, bow, backend
        As in :func:`render_board`.
    """
    require_choice(backend, ("numba", "numpy"), "backend")
    require_positive(contrast, "contrast")
    origin = -R.T @ t / board.square_size
    if origin[2] >= 0:
        raise InputError("the camera stands behind the board; turn the pose so that it sees the printed side")
    shape = (float(board.columns), float(board.rows), MARGIN, *_bend(board, bow))
    levels = (MIDDLE - SWING * contrast, MIDDLE + SWING * contrast)
    if backend == "numba":
        from stereocal.synthetic.rendering_kernels import board_kernel

        board_kernel(table.nodes, table.weights, np.ascontiguousarray(R), origin, shape, levels, radiance)
    else:
        _paint(table, R, origin, shape, levels, radiance)


def meet_board(rays: Float, R: Float, origin: Float, bow: float, centre: float, length: float) -> Float:
    """Return (X, Y) on the board, in squares, of rays (…, 2) from the camera at `origin`; NaN where they miss it.

    Parameters
    ----------
    rays : ndarray of shape (…, 2)
        (x, y) of (x, y, 1) in the camera's frame.
    R : ndarray of shape (3, 3)
        Rotation, board to camera.
    origin : ndarray of shape (3,)
        The camera's centre in the board's frame, squares.
    bow, centre, length : float
        b, c, L of the surface z = b (1 − 4 (X − c)²/L²), squares.
    """
    dx, dy, dz = (R[0, i] * rays[..., 0] + R[1, i] * rays[..., 1] + R[2, i] for i in range(3))
    q = 4 * bow / length**2
    ox = origin[0] - centre
    A = q * dx * dx
    B = dz + 2 * q * ox * dx
    C = origin[2] - bow + q * ox * ox
    with np.errstate(invalid="ignore", divide="ignore"):
        tau = -2 * C / (B + np.copysign(np.sqrt(B * B - 4 * A * C), B))
        tau = np.where(tau > 0, tau, np.nan)
    return np.stack([origin[0] + tau * dx, origin[1] + tau * dy], axis=-1)


def _bend(board: Chessboard, bow: float) -> tuple[float, float, float]:
    """(b, c, L) in squares: the squares' own length is L, its middle c."""
    return bow / board.square_size, (board.columns - 1) / 2, board.columns + 1.0


def _paint(
    table: RayTable, R: Float, origin: Float, shape: Any, levels: tuple[float, float], radiance: Radiance
) -> None:
    """The definition of ``board_kernel``."""
    columns, rows, margin, bow, centre, length = shape
    dark, bright = levels
    place = meet_board(table.rays(), R, origin, bow, centre, length)
    with np.errstate(invalid="ignore"):
        near = (place[..., 0] > -3 - margin) & (place[..., 0] < columns + 2 + margin)
        near &= (place[..., 1] > -3 - margin) & (place[..., 1] < rows + 2 + margin)
        footprint = np.abs(_half_step(place, 0)) + np.abs(_half_step(place, 1))
        near &= (footprint < _FAR).all(axis=-1)
    x, y = place[near].T
    wx, wy = np.maximum(footprint[near].T, 1e-12)
    paper = _inside(x, wx, -1 - margin, columns + margin) * _inside(y, wy, -1 - margin, rows + margin)
    printed = _inside(x, wx, -1, columns) * _inside(y, wy, -1, rows)
    waves = _mean_wave(x, wx, -1, columns) * _mean_wave(y, wy, -1, rows)
    shade = bright - (bright - dark) * 0.5 * (printed + waves)
    radiance[near] = (1 - paper) * radiance[near] + paper * shade


def _half_step(place: Float, axis: int) -> Float:
    """Step of a sample along a raster axis: central differences, one-sided at the ends."""
    return np.asarray(np.gradient(place, axis=axis))


def _inside(x: Float, w: Float, low: float, high: float) -> Float:
    """Part of [x − w/2, x + w/2] that lies within [low, high]."""
    return np.maximum((np.minimum(x + w / 2, high) - np.maximum(x - w / 2, low)) / w, 0)


def _mean_wave(x: Float, w: Float, low: float, high: float) -> Float:
    """∫ S over [x − w/2, x + w/2] ∩ [low, high], divided by w: a difference of T."""
    return (_triangle(np.clip(x + w / 2, low, high)) - _triangle(np.clip(x - w / 2, low, high))) / w


def _triangle(x: Float) -> Float:
    y = x - 2 * np.floor(x / 2)
    return np.where(y < 1, y, 2 - y)
