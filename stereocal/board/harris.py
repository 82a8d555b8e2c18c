"""Harris corners: where the image differs from itself shifted in every direction.

Shift a small window H of the image by (dx, dy). To first order the squared change of its content is

    E(dx, dy) = sum H (I_x dx + I_y dy)^2 = (dx, dy) M (dx, dy)^T,      M = [[A*H, C*H], [C*H, B*H]]      [eq 5]

with the gradient I_x, I_y [eq 2a], A = I_x^2 [eq 2b], B = I_y^2 [eq 2c] and C = I_x I_y [eq 4] (the paper prints
I_x^2 I_x^2, which has another unit). M is symmetric, so a turn of the axes makes it diag(l1, l2) [eq 6], the changes
along the least and the most visible direction:

    l = ( A + B -+ sqrt( (A - B)^2 + 4 C^2 ) ) / 2            [eq 7], A, B, C smoothed

Both small: a flat area. One large: an edge, which slides along itself unseen. Both large: a corner. Harris and Stephens
avoid the square root by the response

    Q = l1 l2 - a (l1 + l2)^2 = (A B - C^2) - a (A + B)^2          [eq 8]

which is positive for corners, negative along edges, and near 0 in flat areas. A corner is a pixel whose Q exceeds
a threshold [eq 9]; the list of corners (u, v, q) is sorted by q, the strongest first [eq 10]. What the paper does not
say, but needs, is that only *local maxima* of Q are listed: a corner lifts Q in all the pixels around it.

The window H: the paper smooths with a Gaussian, ``cv2.cornerHarris`` sums over a square box. Both are here.

What Harris cannot tell is *what sort* of corner it sees: the letters beside a board, the outer corners of the squares
and the tips of fingers all respond. So the detector goes on with a measure that only saddles pass
(:mod:`stereocal.board.saddle`).

Sources: Harris and Stephens, *A combined corner and edge detector*, Alvey 1988; the paper's section 2.1.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from stereocal.base.checks import Float, require_choice, require_integer, require_positive
from stereocal.base.errors import InputError
from stereocal.base.gray import to_gray

# The derivative of a smoothed signal, (1, 2, 1)/4 smoothing repeated: Sobel's masks of 3, 5, 7 taps.
_SMOOTHING = {3: (1, 2, 1), 5: (1, 4, 6, 4, 1), 7: (1, 6, 15, 20, 15, 6, 1)}
_DERIVATIVE = {3: (-1, 0, 1), 5: (-1, -2, 0, 2, 1), 7: (-1, -4, -5, 0, 5, 4, 1)}
_REFLECT_101 = "mirror"  # the border rule gfedcb|abcdefgh|gfedcba; SciPy calls it "mirror", OpenCV REFLECT_101


def image_gradient(image: Float, aperture: int = 3) -> tuple[Float, Float]:
    """Gradient of an image by Sobel's masks, (I_x, I_y) [eq 2a].

    Parameters
    ----------
    image : ndarray of shape (H, W), float64
        Grey values.
    aperture : int
        3, 5 or 7: taps of the mask, which differentiates along one axis and smooths along the other.

    Returns
    -------
    Ix, Iy : ndarray of shape (H, W), float64
        Unscaled: a ramp of one grey level per pixel gives 8 with aperture 3. Borders reflect about the edge pixel.

    Notes
    -----
    Paper: [eq 2a]. Answers to ``cv2.Sobel`` (identical on integers).
    """
    derivative, smoothing = _DERIVATIVE[aperture], _SMOOTHING[aperture]
    Ix = ndimage.correlate1d(
        ndimage.correlate1d(image, derivative, 1, mode=_REFLECT_101), smoothing, 0, mode=_REFLECT_101
    )
    Iy = ndimage.correlate1d(
        ndimage.correlate1d(image, smoothing, 1, mode=_REFLECT_101), derivative, 0, mode=_REFLECT_101
    )
    return Ix, Iy


def structure_tensor(
    Ix: Float, Iy: Float, *, block_size: int = 3, window: str = "box", sigma: float = 1.0
) -> tuple[Float, Float, Float]:
    """Structure tensor M = [[A*H, C*H], [C*H, B*H]], A = I_x^2, B = I_y^2, C = I_x I_y.

    Parameters
    ----------
    Ix, Iy : ndarray of shape (H, W), float64
        The gradient.
    block_size : int
        Side of the box window; for the Gaussian it is not used.
    window : {"box", "gaussian"}
        H: the sum over a box, as OpenCV has it, or a Gaussian of unit sum, as the paper has it.
    sigma : float
        Standard deviation of the Gaussian, pixels.

    Returns
    -------
    A, B, C : ndarray of shape (H, W), float64
        The smoothed entries.

    Notes
    -----
    Paper: [eq 2b], [eq 2c], [eq 4] (printed I_x^2 I_x^2; must be I_x I_y), [eq 5].
    """

    def smooth(entry: Float) -> Float:
        if window == "gaussian":
            return np.asarray(ndimage.gaussian_filter(entry, sigma, mode=_REFLECT_101))
        # The box of an even side reaches one pixel further to the left and up, as OpenCV anchors it.
        ones, origin = np.ones(block_size), 0
        rows = ndimage.correlate1d(entry, ones, 0, mode=_REFLECT_101, origin=origin)
        return np.asarray(ndimage.correlate1d(rows, ones, 1, mode=_REFLECT_101, origin=origin))

    return smooth(Ix * Ix), smooth(Iy * Iy), smooth(Ix * Iy)


def tensor_eigenvalues(A: Float, B: Float, C: Float) -> tuple[Float, Float]:
    """Eigenvalues of the structure tensor, l = (A + B -+ sqrt((A - B)^2 + 4 C^2)) / 2.

    Parameters
    ----------
    A, B, C : ndarray, float64
        Entries of M = [[A, C], [C, B]].

    Returns
    -------
    smaller, larger : ndarray, float64
        M turned to its diagonal form diag(l1, l2).

    Notes
    -----
    Paper: [eq 6], [eq 7]. The printed radicand A^2 + 2AB + B + 4C^2 must read A^2 - 2AB + B^2 + 4C^2. Answers to
    ``cv2.cornerMinEigenVal`` for the smaller one.
    """
    trace = A + B
    spread = np.sqrt((A - B) ** 2 + 4 * C * C)
    return (trace - spread) / 2, (trace + spread) / 2


def harris_response(
    image: ArrayLike,
    *,
    block_size: int = 3,
    aperture: int = 3,
    k: float = 0.04,
    window: str = "box",
    sigma: float = 1.0,
    backend: str = "numba",
) -> NDArray[Any]:
    """Corner response Q = (A B - C^2) - k (A + B)^2 of the smoothed structure tensor.

    Parameters
    ----------
    image : array_like of shape (H, W) or (H, W, 3), uint8, uint16 or float
        Grey or RGB. Integers are divided by their largest value, so that the response of an 8-bit image is that of the
        same image in [0, 1].
    block_size : int
        Side of the box window, odd.
    aperture : {3, 5, 7}
        Taps of Sobel's mask.
    k : float
        The paper's a: 0.04 to 0.06. The larger, the more an edge is punished.
    window : {"box", "gaussian"}
        The window of the sum: OpenCV's box, or the paper's Gaussian.
    sigma : float
        Standard deviation of the Gaussian window, pixels.
    backend : {"numba", "numpy"}
        The kernel, or the readable reference. The kernel serves the box window with aperture 3; all else is computed by
        the reference.

    Returns
    -------
    ndarray of shape (H, W), float64 (float32 from the kernel)

    Raises
    ------
    InputError
        If the image or an option is not valid.

    Notes
    -----
    Paper: [eq 8]. Answers to ``cv2.cornerHarris``: equal to 1e-6 of the largest response with the box window. Each
    gradient is scaled by 1 / (2^(aperture - 1) * block_size) as OpenCV does.

    Examples
    --------
    >>> import numpy as np
    >>> checker = np.kron([[0, 255], [255, 0]], np.ones((8, 8))).astype(np.uint8)
    >>> bool(harris_response(checker).argmax() in (7 * 16 + 7, 7 * 16 + 8, 8 * 16 + 7, 8 * 16 + 8))
    True
    """
    gray = to_gray(image)
    block_size = require_integer(block_size, "block_size", minimum=1, odd=True)
    aperture = require_integer(aperture, "aperture", minimum=3, maximum=7, odd=True)
    require_choice(window, ("box", "gaussian"), "window")
    require_choice(backend, ("numba", "numpy"), "backend")
    sigma = require_positive(sigma, "sigma")
    if min(gray.shape) < max(aperture, block_size):
        raise InputError(
            f"image is {gray.shape[1]}x{gray.shape[0]}, smaller than the window; choose a smaller block_size"
        )
    scale = 1.0 / (2 ** (aperture - 1) * block_size)
    if gray.dtype.kind == "u":
        scale /= np.iinfo(gray.dtype).max
    if backend == "numba" and window == "box" and aperture == 3:
        from stereocal.board.harris_kernels import harris_box3_float, harris_box3_small_uint8, harris_box3_uint8

        response = np.empty(gray.shape, np.float32)
        # On bytes the window sums whole numbers, squares of gradients up to 1020: exact in float32 up to 3x3, in int32
        # up to 45x45.
        if gray.dtype == np.uint8 and block_size <= 3:
            harris_box3_small_uint8(gray, block_size, k, scale, response)
        elif gray.dtype == np.uint8 and block_size <= 45:
            harris_box3_uint8(gray, block_size, k, scale, response)
        else:
            harris_box3_float(gray.astype(np.float64), block_size, k, scale, response)
        return response
    Ix, Iy = image_gradient(gray.astype(np.float64), aperture)
    A, B, C = structure_tensor(Ix * scale, Iy * scale, block_size=block_size, window=window, sigma=sigma)
    return (A * B - C * C) - k * (A + B) ** 2


def harris_corners(
    image: ArrayLike,
    *,
    threshold: float,
    min_distance: int = 1,
    max_corners: int | None = None,
    block_size: int = 3,
    aperture: int = 3,
    k: float = 0.04,
    window: str = "box",
    sigma: float = 1.0,
    backend: str = "numba",
) -> Float:
    """Harris corners, c = (u, v, q): local maxima of the response with Q(u, v) > threshold, strongest first.

    Parameters
    ----------
    image : array_like of shape (H, W) or (H, W, 3)
        Grey or RGB.
    threshold : float
        t_H, in units of the response of the image scaled to [0, 1].
    min_distance : int
        A corner is the largest response within this many pixels to every side (a square neighbourhood).
    max_corners : int, optional
        Keep only the strongest.
    block_size, aperture, k, window, sigma, backend
        As in :func:`harris_response`.

    Returns
    -------
    ndarray of shape (n, 3), float64
        (u, v, q), u to the right, v down, sorted by q descending; equal q by v, then u.

    Raises
    ------
    InputError
        If the image or an option is not valid.

    Notes
    -----
    Paper: [eq 9], [eq 10]; the suppression of pixels beside a maximum is needed but not named there.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> checker = np.kron([[0, 255], [255, 0]], np.ones((8, 8))).astype(np.uint8)
    >>> u, v, q = sc.harris_corners(checker, threshold=1e-4)[0]
    >>> bool(abs(u - 7.5) < 1 and abs(v - 7.5) < 1)
    True
    """
    reach = require_integer(min_distance, "min_distance", minimum=1)
    options = {"block_size": block_size, "aperture": aperture, "k": k, "window": window, "sigma": sigma}
    Q = harris_response(image, backend=backend, **options)  # type: ignore[arg-type]
    is_peak = (ndimage.maximum_filter(Q, 2 * reach + 1, mode="nearest") == Q) & (threshold < Q)
    v, u = np.nonzero(is_peak)
    q = Q[v, u].astype(np.float64)
    order = np.lexsort((u, v, -q))[:max_corners]
    return np.column_stack([u[order], v[order], q[order]]).astype(np.float64)
