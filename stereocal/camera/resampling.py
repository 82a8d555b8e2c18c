"""Resampling: read an image at places between its pixels.

A picture is warped by *inverse* mapping: for every pixel (i, j) of the new picture a map tells the place (x, y) of the
old one to read, so that no pixel of the new one is left out. Places are seldom whole pixels, and the three ways to read
between them differ in the function that they believe the samples came from.

**Nearest** takes the sample whose pixel (x, y) is in. **Bilinear**: with x = x₀ + a, y = y₀ + b, 0 ≤ a, b < 1,

    t = p₀₀ + a (p₀₁ − p₀₀),   u = p₁₀ + a (p₁₁ − p₁₀),   p = t + b (u − t),

two blends along x and one along y. **Bicubic** is Keys' convolution of 4 × 4 samples with the weights

    w(s) = (c + 2)|s|³ − (c + 3)|s|² + 1     for |s| ≤ 1,
    w(s) = c|s|³ − 5c|s|² + 8c|s| − 4c       for 1 < |s| < 2,

c = −0.75 as in OpenCV (Keys' own choice, −0.5, reproduces quadratics). It keeps contrast better and overshoots at
edges, so that whole-number images are clipped to their range.

**How exact.** OpenCV up to 4 rounds every place to 1/32 pixel and the weights to 1/1024 or 1/32768, which moves edges
by up to 0.016 px and changes grey values by several units at strong edges. OpenCV 5.0 interpolates bilinearly in
float32 without a table, and so does this: equal to the last bit. Its bicubic still goes by the table; this one does
not.

A map can also be *inverted*: see ``undistortion`` for the forward and the inverse map of a lens.

Sources: R. Keys, *Cubic convolution interpolation for digital image processing*, IEEE ASSP 29 (1981).
"""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import as_image, require_choice
from stereocal.base.errors import InputError

SHARPNESS = -0.75
_METHODS = ("bilinear", "nearest", "bicubic")
Image = NDArray[Any]


def remap(
    image: ArrayLike,
    map_x: ArrayLike,
    map_y: ArrayLike,
    *,
    interpolation: str = "bilinear",
    border_value: float | ArrayLike = 0,
    backend: str = "numba",
    out: Image | None = None,
) -> Image:
    """Read an image at (map_x, map_y): out[i, j] = image(map_x[i, j], map_y[i, j]).

    Parameters
    ----------
    image : array_like of shape (H, W) or (H, W, C), C from 1 to 4
        uint8, uint16, float32 or float64 (which may hold NaN: it spreads to the pixels that blend with it).
    map_x, map_y : array_like of shape (h, w), float32
        Places in the image, pixels; the centre of the upper left one is (0, 0). NaN and infinity
        count as outside.
    interpolation : {"bilinear", "nearest", "bicubic"}
        How to read between pixels.
    border_value : float or array_like of C floats
        The image's value outside of its frame; pixels that are partly outside blend with it.
    backend : {"numba", "numpy"}
        The kernel, or the readable reference. float64 images always take the reference, in float64.
    out : ndarray of shape (h, w) or (h, w, C), optional
        Where to write the result, of the image's dtype: fresh memory costs about as much time as the resampling.

    Returns
    -------
    ndarray of shape (h, w) or (h, w, C)
        Of the image's dtype; whole numbers are rounded, ties to even, and clipped to their range.

    Raises
    ------
    InputError
        If an array has the wrong shape or dtype, or the border value does not fit it.

    Notes
    -----
    Answers to ``cv2.remap`` with ``BORDER_CONSTANT``. Bilinear and nearest: equal to OpenCV 5.0 to the last bit for
    uint8, uint16 and float32 (on processors with fused multiply-add, for which OpenCV's kernels are built). OpenCV 4
    rounds the map to 1/32 px: equal to within 1 of 255 where the map holds multiples of 1/32.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> image = np.arange(12, dtype=np.float32).reshape(3, 4)
    >>> x, y = np.meshgrid(np.arange(3) + 0.5, np.arange(3.0))  # half a pixel to the right
    >>> sc.remap(image, x, y)
    array([[ 0.5,  1.5,  2.5],
           [ 4.5,  5.5,  6.5],
           [ 8.5,  9.5, 10.5]], dtype=float32)
    """
    source = _as_samples(image)
    mx, my = (np.ascontiguousarray(m, dtype=np.float32) for m in (map_x, map_y))
    if mx.shape != my.shape or mx.ndim != 2:
        raise InputError(f"map_x and map_y must be two (h, w) arrays of one shape, not {mx.shape} and {my.shape}")
    require_choice(interpolation, _METHODS, "interpolation")
    require_choice(backend, ("numba", "numpy"), "backend")
    samples = source[:, :, None] if source.ndim == 2 else source
    border = _border_samples(border_value, samples)
    shape = mx.shape + source.shape[2:]
    result = np.empty(shape, source.dtype) if out is None else out
    if result.shape != shape or result.dtype != source.dtype or not result.flags.c_contiguous:
        raise InputError(f"out must be a contiguous {source.dtype} array of shape {shape}")
    target = result.reshape(*mx.shape, samples.shape[2])
    if backend == "numpy" or samples.dtype == np.float64:
        mx, my = (np.where(np.isfinite(m), m, np.float32(np.nan)) for m in (mx, my))
        target[...] = {"bilinear": _bilinear, "nearest": _nearest, "bicubic": _bicubic}[interpolation](
            samples, mx, my, border
        )
    else:
        _run_kernel(interpolation, samples, mx, my, border, target)
    return result


def _as_samples(image: ArrayLike) -> Image:
    """Return a contiguous image; unlike other functions' images it may hold NaN, as disparity and depth maps do."""
    array = np.asarray(image)
    if array.dtype not in (np.float32, np.float64):
        return as_image(array, channels=(1, 2, 3, 4))
    if array.ndim not in (2, 3) or array.size == 0 or (array.ndim == 3 and array.shape[2] > 4):
        raise InputError(f"image must be (H, W) or (H, W, C) with 1 to 4 channels, but is {array.shape}")
    return np.ascontiguousarray(array[:, :, 0] if array.ndim == 3 and array.shape[2] == 1 else array)


def _run_kernel(interpolation: str, samples: Image, mx: Image, my: Image, border: Image, out: Image) -> None:
    from stereocal.camera import resampling_kernels as kernels

    whole = samples.dtype.kind == "u"
    magic = np.float32(1.5 * 2**23 if whole else 0)
    channels = (0,) * samples.shape[2]
    if interpolation == "nearest":
        kernels.remap_nearest(samples, mx, my, border.astype(samples.dtype), channels, out)
    elif interpolation == "bilinear":
        kernels.remap_bilinear(samples, mx, my, border, magic, channels, out)
    else:
        low, top = np.float32(0 if whole else -np.inf), np.float32(np.iinfo(samples.dtype).max if whole else np.inf)
        sharpness = np.float32(SHARPNESS)
        for c in range(samples.shape[2]):  # sixteen samples a pixel: plane by plane they fit into vectors best
            source = np.ascontiguousarray(samples[:, :, c : c + 1])
            plane = np.empty((*mx.shape, 1), samples.dtype) if samples.shape[2] > 1 else out
            kernels.remap_bicubic_grey(source, mx, my, sharpness, border[c : c + 1], low, top, magic, plane)
            out[:, :, c] = plane[:, :, 0]


def _border_samples(border_value: float | ArrayLike, samples: Image) -> Image:
    """Return the border's value for each channel, float32 (float64 for such images)."""
    values = np.ravel(np.asarray(border_value, dtype=np.float64)).tolist()
    channels = samples.shape[2]
    if len(values) not in (1, channels) or not all(map(isfinite, values)):
        raise InputError(f"border_value must be 1 or {channels} finite numbers, not {border_value!r}")
    if samples.dtype.kind == "u" and not 0 <= min(values) <= max(values) <= np.iinfo(samples.dtype).max:
        raise InputError(f"border_value must fit the image's dtype, {samples.dtype}, but is {border_value!r}")
    kind = np.float64 if samples.dtype == np.float64 else np.float32
    return np.array(values * channels if len(values) == 1 else values, kind)


def _sample(samples: Image, x: Image, y: Image, border: Image) -> Image:
    """Return samples at whole places (h, w) as floats (h, w, C), the border's value outside."""
    height, width = samples.shape[:2]
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    i, j = np.where(inside, y, 0).astype(np.intp), np.where(inside, x, 0).astype(np.intp)
    return np.where(inside[..., None], samples[i, j], border).astype(np.float64)


def _rounded(samples: Image, value: Image) -> Image:
    """Round and clip to the dtype of whole-number images."""
    if samples.dtype.kind == "u":
        value = np.clip(np.rint(value), 0, np.iinfo(samples.dtype).max)
    return value.astype(samples.dtype)


def _bilinear(samples: Image, mx: Image, my: Image, border: Image) -> Image:
    """t = p₀₀ + a (p₀₁ − p₀₀), u likewise below, p = t + b (u − t).

    Each blend is computed in float64 and rounded once to float32, which is what a fused multiply-add does.
    """
    kind = border.dtype
    x0, y0 = np.floor(mx), np.floor(my)
    a, b = (np.nan_to_num(m - f)[..., None].astype(np.float64) for m, f in ((mx, x0), (my, y0)))

    def blend(first: Image, second: Image, weight: Image) -> Image:
        step = (second - first).astype(kind).astype(np.float64)
        return (first + weight * step).astype(kind).astype(np.float64)

    top = blend(_sample(samples, x0, y0, border), _sample(samples, x0 + 1, y0, border), a)
    bottom = blend(_sample(samples, x0, y0 + 1, border), _sample(samples, x0 + 1, y0 + 1, border), a)
    return _rounded(samples, blend(top, bottom, b))


def _nearest(samples: Image, mx: Image, my: Image, border: Image) -> Image:
    """The sample at the rounded place."""
    return _rounded(samples, _sample(samples, np.rint(mx), np.rint(my), border))


def _bicubic(samples: Image, mx: Image, my: Image, border: Image) -> Image:
    """Σ w(y − i) w(x − j) p_ij over 4 x 4 samples."""
    x0, y0 = np.floor(mx), np.floor(my)
    wx, wy = (keys_weights(np.nan_to_num(m - f).astype(np.float64)) for m, f in ((mx, x0), (my, y0)))
    total = np.zeros((*mx.shape, samples.shape[2]))
    for m in range(4):
        line = sum(wx[n][..., None] * _sample(samples, x0 + n - 1, y0 + m - 1, border) for n in range(4))
        total += wy[m][..., None] * line
    outside = np.isnan(mx) | np.isnan(my)
    return _rounded(samples, np.where(outside[..., None], border, total))


def keys_weights(t: Image, c: float = SHARPNESS) -> list[Image]:
    """Return Keys' weights of the samples at −1, 0, 1 and 2 for a place t in [0, 1) between 0 and 1.

    Parameters
    ----------
    t : ndarray
        Fractions.
    c : float
        Slope of the kernel at distance 1.

    Returns
    -------
    list of 4 ndarrays
        They sum to 1.
    """

    def near(s: Image) -> Image:
        return ((c + 2) * s - (c + 3)) * s * s + 1

    def far(s: Image) -> Image:
        return ((c * s - 5 * c) * s + 8 * c) * s - 4 * c

    return [far(1 + t), near(t), near(1 - t), far(2 - t)]
