"""From light to grey levels: what a lens and a sensor make of a raster of radiance.

    light ─ lens blur ⊗ pixel area ─► sampled once a pixel ─ vignetting ─ noise ─ 8 bits ─► image

1. **Blur and pixel area.** The lens spreads a point into a spot (a Gaussian of σ px), the pixel collects what falls on
   its square. Both are convolutions, applied at the raster's finer step *before* a value is taken once a pixel, so that
   what is finer than a pixel is averaged, not aliased. Gaussian and square both separate into rows and columns: two
   passes with one kernel, and each pass computes only the samples that the image keeps.
2. **Vignetting.** Light falls off towards the corners: 1 − v r²/r_c², r_c the distance of the farthest corner from the
   principal point. It moves no edge by more than the blur's width times the fall-off's slope, below 1e-3 px.
3. **Noise.** Gaussian, of σ grey levels, from a seeded generator: the same seed gives the same photograph anywhere.
4. **Quantisation.** Rounded to 0..255 and clipped there.

The kernel's weights sum to 1, so a uniform light gives a uniform image, and total light is kept (tests hold both).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.camera.model import Camera
from stereocal.synthetic.rays import sample_offsets

CUT = 4.0
"""The Gaussian is cut at this many σ."""


def blur_pad(blur: float) -> int:
    """Return the border in pixels from which blur brings in light."""
    return int(np.ceil(CUT * blur)) + 1


def aperture_kernel(blur: float, supersampling: int, pad: int) -> Float:
    """Return the weights with which one pixel gathers the samples around it along one axis.

    Parameters
    ----------
    blur : float
        σ of the lens's spot, pixels; 0 for none.
    supersampling : int
        s, samples a pixel.
    pad : int
        Pixels gathered on each side.

    Returns
    -------
    ndarray of shape (s (2 pad + 1),), float64
        Gaussian ⊗ square of one pixel, sampled at the samples' positions; sums to 1.
    """
    positions = (np.arange(-pad, pad + 1)[:, None] + sample_offsets(supersampling)).ravel()
    within = sample_offsets(supersampling)
    if blur <= 0:
        weights = (np.abs(positions) < 0.5).astype(np.float64)
    else:
        # the square is the s samples of a pixel, each spread by the Gaussian
        distance = positions[:, None] - within[None, :]
        deviations = np.minimum(np.abs(distance), 2 * CUT * blur) / blur  # capped: a tiny blur would overflow
        weights = np.where(deviations <= CUT, np.exp(-0.5 * deviations**2), 0.0).sum(axis=1)
    return np.asarray(weights / weights.sum())


def gather(
    radiance: NDArray[np.float32], kernel: Float, supersampling: int, *, backend: str = "numba"
) -> NDArray[np.float32]:
    """Blur a raster of samples and take it once a pixel.

    Parameters
    ----------
    radiance : ndarray of shape (s (H + 2 pad), s (W + 2 pad)), float32
        Light at every sample.
    kernel : ndarray of shape (s (2 pad + 1),)
        From :func:`aperture_kernel`.
    supersampling : int
        s.
    backend : {"numba", "numpy"}
        Which of the twins.

    Returns
    -------
    ndarray of shape (H, W), float32
    """
    pad = (len(kernel) // supersampling - 1) // 2
    rows, columns = (side // supersampling - 2 * pad for side in radiance.shape)
    weights = kernel.astype(np.float32)
    if backend == "numba":
        from stereocal.synthetic.rendering_kernels import gather_kernel

        out = np.empty((rows, columns), dtype=np.float32)
        gather_kernel(radiance, weights, supersampling, out)
        return out
    along_rows = np.zeros((radiance.shape[0], columns), dtype=np.float32)
    for t, weight in enumerate(weights):
        along_rows += weight * radiance[:, t : t + supersampling * columns : supersampling]
    image = np.zeros((rows, columns), dtype=np.float32)
    for t, weight in enumerate(weights):
        image += weight * along_rows[t : t + supersampling * rows : supersampling]
    return image


def vignette(camera: Camera, strength: float) -> NDArray[np.float32]:
    """Return 1 − v r²/r_c² for every pixel, (H, W) float32."""
    width, height = camera.image_size
    x = np.arange(width) - camera.cx
    y = np.arange(height) - camera.cy
    square = x[None, :] ** 2 + y[:, None] ** 2
    return np.asarray(1 - strength * square / square.max(), dtype=np.float32)


def develop(
    light: NDArray[np.float32], *, noise: float, random: np.random.Generator, shading: NDArray[np.float32] | None = None
) -> NDArray[np.uint8]:
    """Return grey levels: light · shading + noise, rounded, clipped to 0..255.

    Parameters
    ----------
    light : ndarray of shape (H, W) or (H, W, 3), float32
        In grey levels.
    noise : float
        σ, grey levels.
    random : numpy.random.Generator
        Where the noise comes from.
    shading : ndarray of shape (H, W), optional
        Vignetting.
    """
    levels: Any = light
    if shading is not None:
        levels = levels * (shading if light.ndim == 2 else shading[..., None])
    if noise > 0:
        levels = levels + np.float32(noise) * random.standard_normal(light.shape, dtype=np.float32)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)
