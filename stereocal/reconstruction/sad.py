"""Block matching by the sum of absolute differences: the paper's equation 22.

In a rectified pair a point of the left image at (x, y) is seen in the right one at (x − d, y). Which d? The one at
which the two windows around the points look most alike, where "alike" is the smallest sum of absolute differences
[eq 22]

    SAD(x, y, d) = Σᵢ Σⱼ |I_L(x + i, y + j) − I_R(x + i − d, y + j)|,      i, j = −r … r,      block_size = 2r + 1,

    d*(x, y) = argmin_d SAD(x, y, d),      d = min_disparity … min_disparity + num_disparities − 1.

The paper prints |I_L(x, y) − I_R(x + i, y + j)|: one pixel against a window, and no disparity.

**Where there is an answer.** A pixel is matched only if its whole window lies in the left image, and in the right image
at EVERY disparity of the search:

    max(0, d_max) + r ≤ x < W − r + min(0, d_min),      r ≤ y < H − r.

A pixel nearer to the border would compare sums over fewer pixels, or be denied the disparity it has; both give answers
that look like any other and are wrong. It is OpenCV's rule, and the paper's counts (section 3) depend on it: at block
size 255 it leaves less than a quarter of a 640x480 image. All other pixels are NaN.

**Ties** go to the larger disparity, as in OpenCV.

**Options**, all off: a parabola through SAD(d* − 1), SAD(d*), SAD(d* + 1), whose vertex is the disparity to a fraction
of a pixel,

    d = d* + (S₋ − S₊) / (2 (S₋ − 2 S₀ + S₊));

and the left-right check: the right image's own best disparity d_R(x') = argmin_d SAD(x' + d, y, d), over the same sums,
must agree, |d* − d_R(x − d*)| ≤ left_right_check. It removes what only one of the cameras sees.

Sources: T. Kanade et al. (1995) for SAD in hardware; P. Fua (1993) for the left-right check; D. Scharstein and
R. Szeliski (2002) for the place of both among other methods.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import require_choice, require_integer
from stereocal.base.errors import InputError
from stereocal.base.gray import to_gray
from stereocal.reconstruction.sliding_window import Disparity, slide_window


def match_sad(
    left: ArrayLike,
    right: ArrayLike,
    *,
    num_disparities: int = 64,
    min_disparity: int = 0,
    block_size: int = 21,
    subpixel: bool = False,
    left_right_check: int | None = None,
    threads: int | None = None,
    backend: str = "numba",
) -> Disparity:
    """Disparity by the smallest sum of absolute differences, d* = argmin_d Σ |I_L(x+i, y+j) − I_R(x+i−d, y+j)| [eq 22].

    Parameters
    ----------
    left, right : array_like of shape (H, W) or (H, W, 3), uint8
        The rectified pair; colour is turned to grey.
    num_disparities : int
        How many disparities are searched.
    min_disparity : int
        The least of them, pixels; of either sign.
    block_size : int
        The side of the window, odd, pixels.
    subpixel : bool
        Whether a parabola refines the best disparity to a fraction of a pixel.
    left_right_check : int, optional
        The largest difference, in pixels, to the right image's own best disparity; None does not check.
    threads : int, optional
        How many threads share the rows; the result does not depend on it. None takes all cores.
    backend : {"numba", "numpy"}
        The kernel, or the readable reference.

    Returns
    -------
    ndarray of shape (H, W), float32
        Disparity of the left image, pixels; NaN within d_max + r of the left border and r of the others, where the
        window or the search leaves the image (see the module), and where the check fails.

    Raises
    ------
    InputError
        If the images are not a pair of equal uint8 images, or the window does not fit into them.

    Notes
    -----
    Paper: [eq 22]. Answers to ``cv2.absdiff`` and ``cv2.boxFilter(normalize=False)`` at each disparity, then the
    smallest: identical. ``cv2.StereoBM`` is more than that: it is ``match_bm``'s part.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> scene = np.random.default_rng(0).integers(0, 256, (40, 120), dtype=np.uint8)
    >>> left, right = scene[:, :-4], scene[:, 4:]  # all of it 4 px away
    >>> disparity = sc.match_sad(left, right, num_disparities=16, block_size=9)
    >>> float(np.nanmedian(disparity))
    4.0
    """
    require_choice(backend, ("numba", "numpy"), "backend")
    left_gray, right_gray = as_gray_pair(left, right)
    num_disparities = require_integer(num_disparities, "num_disparities", minimum=1)
    min_disparity = require_integer(min_disparity, "min_disparity", minimum=-(2**15), maximum=2**15)
    block_size = require_integer(block_size, "block_size", minimum=1, odd=True)
    require_window_fits(block_size, left_gray.shape)
    tolerance = -1
    if left_right_check is not None:
        tolerance = require_integer(left_right_check, "left_right_check", minimum=0)
    columns, rows = matched_region(left_gray.shape, num_disparities, min_disparity, block_size // 2)
    disparity = np.full(left_gray.shape, np.nan, np.float32)
    if len(columns) == 0 or len(rows) == 0:
        return disparity
    if backend == "numpy":
        sums = sad_volume(left_gray, right_gray, num_disparities, min_disparity, block_size)
        matched = _best_disparity(sums, columns, min_disparity, subpixel, tolerance)
        disparity[rows.start : rows.stop, columns.start : columns.stop] = matched
        return disparity
    disparity[rows.start : rows.stop, columns.start : columns.stop] = 0
    slide_window(
        left_gray, right_gray, disparity, columns, rows,
        num_disparities=num_disparities, min_disparity=min_disparity, block_size=block_size,
        subpixel="parabola" if subpixel else "none", left_right=tolerance, threads=threads,
    )  # fmt: skip
    return disparity


def sad_volume(
    left: NDArray[np.uint8], right: NDArray[np.uint8], num_disparities: int, min_disparity: int, block_size: int
) -> NDArray[np.int64]:
    """SAD(x, y, d) of every matched pixel at every disparity: equation 22 as it stands [eq 22].

    Parameters
    ----------
    left, right : ndarray of shape (H, W), uint8
        The rectified pair.
    num_disparities, min_disparity, block_size : int
        As in :func:`match_sad`.

    Returns
    -------
    ndarray of shape (num_disparities, rows, columns), int64
        Over the matched pixels alone, :func:`matched_region`; the first index is d − min_disparity.
    """
    radius = block_size // 2
    columns, rows = matched_region(left.shape, num_disparities, min_disparity, radius)
    sums = np.empty((num_disparities, len(rows), len(columns)), np.int64)
    across = slice(columns.start - radius, columns.stop + radius)
    down = slice(rows.start - radius, rows.stop + radius)
    for index in range(num_disparities):
        d = min_disparity + index
        difference = np.abs(
            left[down, across].astype(np.int64) - right[down, across.start - d : across.stop - d].astype(np.int64)
        )
        windows = np.lib.stride_tricks.sliding_window_view(difference, (block_size, block_size))
        sums[index] = windows.sum(axis=(2, 3))
    return sums


def _best_disparity(
    sums: NDArray[np.int64], columns: range, min_disparity: int, subpixel: bool, left_right: int
) -> NDArray[np.float64]:
    """argmin over d, refined and checked as asked for."""
    count = len(sums)
    best = count - 1 - np.argmin(sums[::-1], axis=0)  # from above: a tie goes to the larger disparity
    disparity = (min_disparity + best).astype(np.float64)
    if subpixel:
        below, least, above = (
            np.take_along_axis(sums, np.clip(best + step, 0, count - 1)[None], axis=0)[0] for step in (-1, 0, 1)
        )
        curvature = below - 2 * least + above
        inside = (best > 0) & (best < count - 1) & (curvature > 0)
        disparity[inside] += 0.5 * (below - above)[inside] / curvature[inside]
    if left_right >= 0:
        disparity[np.abs(best - _best_of_right(sums, best)) > left_right] = np.nan
    return disparity


def _best_of_right(sums: NDArray[np.int64], best: NDArray[np.int64]) -> NDArray[np.int64]:
    """The right image's own best disparity, at the pixel x − d*(x) that each left pixel x was matched to."""
    count, height, width = sums.shape
    # seen[d, y, x'] = SAD(x' + d, y, d), x' counted from columns.start − d_max
    never = np.iinfo(np.int64).max
    seen = np.full((count, height, width + count - 1), never)
    for d in range(count):
        seen[d, :, count - 1 - d : count - 1 - d + width] = sums[d]
    best_of_right = count - 1 - np.argmin(seen[::-1], axis=0)
    return np.take_along_axis(best_of_right, np.arange(width) + count - 1 - best, axis=1)


def matched_region(
    shape: tuple[int, ...], num_disparities: int, min_disparity: int, radius: int
) -> tuple[range, range]:
    """Return the columns and rows whose whole search lies in both images."""
    height, width = shape
    largest = min_disparity + num_disparities - 1
    columns = range(max(0, largest) + radius, width - radius + min(0, min_disparity))
    return columns, range(radius, height - radius)


def as_gray_pair(left: ArrayLike, right: ArrayLike) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return a rectified pair as two grey uint8 images of one size.

    Raises
    ------
    InputError
        If one is not a uint8 image, or their sizes differ.
    """
    for image, name in ((left, "left"), (right, "right")):
        kind = np.asarray(image).dtype
        if kind != np.uint8:
            remedy = "scale it to 8 bits first" if kind.kind in "uif" else "read_image gives one from a file"
            raise InputError(f"{name} must be a uint8 image (0 to 255), not {kind}; {remedy}")
    pair = to_gray(left, "left"), to_gray(right, "right")
    if pair[0].shape != pair[1].shape:
        sizes = " and ".join(f"{image.shape[1]}x{image.shape[0]}" for image in pair)
        raise InputError(f"left and right must have one size, but are {sizes}: rectify the pair first")
    return pair


def require_window_fits(block_size: int, shape: tuple[int, ...]) -> None:
    """Refuse a window that is larger than the image."""
    if block_size > min(shape):
        raise InputError(
            f"block_size is {block_size}, but the images are {shape[1]}x{shape[0]}: the window must fit into them"
        )
