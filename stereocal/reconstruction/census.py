"""The census transform: what a pixel's neighbourhood looks like, in the ORDER of its grey values alone.

Two cameras seldom agree on the grey value of a point: gain, exposure, vignetting and the angle of view differ. But
which of two neighbours is the darker one they mostly agree on. The census code of a pixel p is a string of bits, one
for each neighbour q of its window:

    code(p) = ⊗_q  [ I(q) < I(p) − t ],        [·] = 1 if so, else 0,

and two pixels match as well as few of their bits differ (the Hamming distance). Any brightening that keeps the order
leaves the code as it is. The threshold t is R. Spangenberg's idea (2013), here one-sided: without it, the bits of a
blank wall are tossed by the camera's noise.

A 5x5 window gives 24 bits. Bit b belongs to the b-th neighbour, the window read row by row, the centre left out.
A wider window sees more of the pattern, and neighbours side by side say much the same: a *sparse* code takes every
other one, as the black squares of a chessboard. Of a 9x5 window that leaves 22 bits.
Beyond the image its outermost pixels are repeated.

:func:`match_census` takes, for each pixel, the disparity at which the sum of the Hamming distances over a block is
least: winner takes all, no smoothness. Semi-global matching builds on the same codes.

Source: R. Zabih and J. Woodfill, *Non-parametric local transforms for computing visual correspondence* (1994).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import as_image, require_choice, require_integer
from stereocal.base.errors import InputError
from stereocal.base.gray import to_gray

Codes = NDArray[np.uint64]
Disparity = NDArray[np.float32]

PIXELS_AT_A_TIME = 64
"""How many pixels the kernels of the census transform do at once: rows are padded to a multiple of it."""


def census_transform(
    image: ArrayLike,
    *,
    window: tuple[int, int] = (5, 5),
    threshold: int = 0,
    sparse: bool = False,
    backend: str = "numba",
) -> Codes:
    """Return the census code of every pixel, bit b = [I(q_b) < I(p) − t].

    Parameters
    ----------
    image : array_like of shape (H, W) or (H, W, 3), uint8
        Colour is turned to grey.
    window : (int, int)
        Width and height of the window, odd; at most 65 pixels, for the code has 64 bits.
    threshold : int
        t, grey levels: a neighbour counts as darker if it is so by more than this.
    sparse : bool
        Whether every other neighbour is left out, as the white squares of a chessboard with a black centre.
    backend : {"numba", "numpy"}
        The kernel, or the readable reference.

    Returns
    -------
    ndarray of shape (H, W), uint64

    Raises
    ------
    InputError
        If the image is not uint8, or the window is even or too large.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> image = np.random.default_rng(0).integers(0, 200, (20, 30), dtype=np.uint8)
    >>> codes = sc.census_transform(image)
    >>> bool((codes == sc.census_transform(image + 50)).all())  # brightness does not matter
    True
    """
    require_choice(backend, ("numba", "numpy"), "backend")
    gray = to_gray(as_image(image, channels=(1, 3, 4)))
    if gray.dtype != np.uint8:
        raise InputError(f"image must be uint8 (0 to 255), not {gray.dtype}; scale it to 8 bits first")
    places = neighbours(window, sparse)
    threshold = require_integer(threshold, "threshold", minimum=0, maximum=255)
    if runs_compiled(backend):
        planes = census_planes(gray, places, threshold)[:, :, : gray.shape[1]]
        shifts = np.arange(len(planes), dtype=np.uint64)[:, None, None] * np.uint64(8)
        return np.asarray(np.bitwise_or.reduce(planes.astype(np.uint64) << shifts, axis=0), np.uint64)
    return _census_reference(gray, places, threshold)


def runs_compiled(backend: str) -> bool:
    """Whether to call the kernels: asked for, and Numba compiles (vectors exist in compiled code alone).

    With ``NUMBA_DISABLE_JIT=1`` the readable references run instead.
    """
    if backend != "numba":
        return False
    from numba import config

    return not config.DISABLE_JIT


def neighbours(window: tuple[int, int], sparse: bool = False) -> list[tuple[int, int]]:
    """Return the places (v, u), relative to the centre, of the neighbours that a code compares, row by row."""
    rx, ry = _radii(window)
    places = [(v, u) for v in range(-ry, ry + 1) for u in range(-rx, rx + 1) if (v, u) != (0, 0)]
    return [(v, u) for v, u in places if (v + u) % 2 == 0] if sparse else places


def _census_reference(gray: NDArray[np.uint8], places: list[tuple[int, int]], threshold: int) -> Codes:
    """One comparison of the whole image for each neighbour."""
    height, width = gray.shape
    centre = gray.astype(np.int64)
    margin = max((max(abs(v), abs(u)) for v, u in places), default=0)
    padded = np.pad(centre, margin, mode="edge")
    codes = np.zeros(gray.shape, np.uint64)
    for bit, (v, u) in enumerate(places):
        neighbour = padded[margin + v : margin + v + height, margin + u : margin + u + width]
        codes |= (neighbour < centre - threshold).astype(np.uint64) << np.uint64(bit)
    return codes


def census_planes(
    gray: NDArray[np.uint8], places: list[tuple[int, int]], threshold: int, *, flipped: bool = False
) -> NDArray[np.uint8]:
    """Return the census codes as bytes, (⌈bits / 8⌉, H, W + padding), lowest first: what the kernels compare.

    Parameters
    ----------
    gray : ndarray of shape (H, W), uint8
    places : list of (int, int)
        The neighbours, see :func:`neighbours`.
    threshold : int
        t.
    flipped : bool
        Whether `gray` is mirrored left to right; its codes are those of the unflipped image, mirrored.
    """
    from stereocal.reconstruction import matching_costs_kernels as kernels
    from stereocal.reconstruction.vector_primitives import lanes_of

    height, width = gray.shape
    (ry, rx) = (max(abs(place[axis]) for place in places) for axis in (0, 1))
    padded = with_margin(gray, ry, rx, rx + -width % PIXELS_AT_A_TIME)
    offsets = np.array([v * padded.shape[1] + (-u if flipped else u) for v, u in places])
    planes = np.empty((-(-len(places) // 8), height, padded.shape[1] - 2 * rx), np.uint8)
    kernels.census_planes(padded, threshold, ry, rx, offsets, lanes_of(PIXELS_AT_A_TIME), PIXELS_AT_A_TIME, planes)
    return planes


def with_margin(gray: NDArray[np.uint8], rows: int, left: int, right: int) -> NDArray[np.uint8]:
    """``np.pad(gray, ((rows, rows), (left, right)), mode="edge")``, which is slow on small images."""
    height, width = gray.shape
    padded = np.empty((height + 2 * rows, left + width + right), np.uint8)
    padded[rows : rows + height, left : left + width] = gray
    padded[rows : rows + height, :left] = gray[:, :1]
    padded[rows : rows + height, left + width :] = gray[:, -1:]
    padded[:rows] = padded[rows]
    padded[rows + height :] = padded[rows + height - 1]
    return padded


def match_census(
    left: ArrayLike,
    right: ArrayLike,
    *,
    num_disparities: int = 64,
    min_disparity: int = 0,
    block_size: int = 9,
    window: tuple[int, int] = (5, 5),
    subpixel: bool = True,
    left_right_check: int | None = 1,
    uniqueness_ratio: int = 0,
    threads: int | None = None,
    backend: str = "numba",
) -> Disparity:
    """Disparity by the least Hamming distance of census codes, argmin_d Σ popcount(code_L(x, y) ⊕ code_R(x − d, y)).

    Parameters
    ----------
    left, right : array_like of shape (H, W) or (H, W, 3), uint8
        The rectified pair; colour is turned to grey.
    num_disparities, min_disparity : int
        The candidates: `num_disparities` values from `min_disparity` up.
    block_size : int
        Side of the block over which distances are summed, odd.
    window : (int, int)
        Width and height of the census window.
    subpixel : bool
        Whether the disparity is refined to a fraction of a pixel.
    left_right_check : int, optional
        The largest difference, in pixels, to the right image's own best disparity; None does not check.
    uniqueness_ratio : int
        Percent by which the best sum must undercut all others that are not its neighbours; 0 refuses ties alone.
    threads : int, optional
        How many threads share the rows; the result does not depend on it. None takes all cores.
    backend : {"numba", "numpy"}
        The kernels, or the readable reference.

    Returns
    -------
    ndarray of shape (H, W), float32
        Disparity of the left image, pixels; NaN where a check fails, and where a candidate outside the right image
        is the best. There is no blind band at the left border.

    Raises
    ------
    InputError
        If the images are not a pair of equal uint8 images, or a parameter is out of its range.

    Notes
    -----
    OpenCV has no such matcher in its main modules. The two backends are equal to the bit.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> scene = np.random.default_rng(0).integers(0, 256, (40, 120), dtype=np.uint8)
    >>> left, right = scene[:, :-4], scene[:, 4:]  # all of it 4 px away
    >>> disparity = sc.match_census(left, right, num_disparities=16)
    >>> round(float(np.nanmedian(disparity)), 1)
    4.0
    """
    # These modules build on the codes above, so they are imported only now.
    from stereocal.reconstruction.matching_costs import PixelCost, cost_volume, require_block_fits
    from stereocal.reconstruction.sad import as_gray_pair
    from stereocal.reconstruction.winner import Search, match_by_rows, select, thread_count

    require_choice(backend, ("numba", "numpy"), "backend")
    left_gray, right_gray = as_gray_pair(left, right)
    _radii(window)
    search = Search.checked(num_disparities, min_disparity, subpixel, left_right_check, uniqueness_ratio)
    recipe = PixelCost(True, 0, False, (int(window[0]), int(window[1])), sparse=False, threshold=1)
    block_size = require_integer(block_size, "block_size", minimum=1, odd=True)
    require_block_fits(block_size, recipe)
    if not runs_compiled(backend):
        volume = cost_volume(
            left_gray, right_gray, num_disparities=search.num_disparities, min_disparity=search.min_disparity,
            recipe=recipe, block_size=block_size, scaled=False,
        )  # fmt: skip
        return select(volume, search)
    return match_by_rows(left_gray, right_gray, recipe, block_size, search, thread_count(threads))


def _radii(window: tuple[int, int]) -> tuple[int, int]:
    if np.shape(window) != (2,):
        raise InputError(f"window must be (width, height), not {window!r}")
    width, height = (require_integer(side, "a side of window", minimum=1, odd=True) for side in window)
    if not 1 < width * height <= 65:
        raise InputError(f"window must hold 2 to 65 pixels, but is {width}x{height}: the code has at most 64 bits")
    return width // 2, height // 2
