"""Block matching as OpenCV's StereoBM does it, equal to it bit for bit.

StereoBM is :mod:`stereocal.reconstruction.sad` with tests before and after; it is what
the paper's program calls. Its recipe, with r = block_size // 2, D = num_disparities and c = prefilter_cap:

1. **Prefilter**, against differences in exposure. ``"xsobel"``: the horizontal slope by a Sobel mask,
   clip(∂I/∂x, ±c) + c, in 0 … 2c. The first and the last column are c, and so is the last row if H is odd: OpenCV's
   loop takes rows in pairs. ``"normalized_response"``: the pixel and its neighbours less the mean over a window of
   prefilter_size n, in fixed point:
   clip((g (4I + I_left + I_right + I_above + I_below) − s Σ_window I) >> 10, ±c) + c, where
   s = (1024 + ⌊n²/8⌋) // (2⌊n²/8⌋) and g = s ⌊n²/8⌋, the border replicated.
2. **Texture**: no disparity where Σ |I − c| over the left window is below `texture_threshold`.
3. **Winner**: the smallest SAD, a tie to the larger disparity.
4. **Uniqueness**: no disparity if SAD(d) ≤ m + ⌊m u / 100⌋ for some d more than 1 from the winner, m its SAD.
5. **Subpixel**: with p = SAD(d − 1), n = SAD(d + 1), q = p + n − 2m + |p − n|, the disparity in sixteenths is
   (256 d + trunc(256 (p − n)/q) + 15) >> 4, and 16 d at either end of the search.
6. **Cross-check** (`disp12_max_diff` ≥ 0): the right image's disparity at x' is that of the cheapest left pixel matched
   to it; a pixel goes if it differs by more than `disp12_max_diff` from those at x − ⌊d⌋ and at x − ⌈d⌉ alike.
7. **Region**: the pixels whose window and search lie within the images or, if given, within their regions of interest.
8. **Speckles** of at most `speckle_size` pixels go; `speckle_range` is in SIXTEENTHS of a pixel, unlike StereoSGBM's.

Where StereoBM 4.14 and 5.0 are at fault, and what is done here (each is shown by a test):

* *Cross-check with cap > 31 or block_size > 21.* OpenCV then computes costs in 32 bits but stores them in a matrix of
  16-bit numbers, and reads back the halves of other pixels' costs or memory that was never written. Its answer changes
  from call to call. Here the check is done with the costs that belong to it. For the other sizes OpenCV repeats itself,
  and the answers are equal.
* *min_disparity > 0.* OpenCV's rows run over by `min_disparity` pixels: the first `min_disparity` pixels of the row
  below the region hold disparities of places beyond the right border. Here they are NaN.
* *min_disparity < 0.* Of the last r matched columns the windows end outside the right image; OpenCV compares them
  with columns shifted by up to r. The numbers are reproduced here; :func:`~stereocal.reconstruction.sad.match_sad`
  leaves those pixels out.
* *An empty region*, or with several threads a stripe of rows without any: OpenCV leaves the output as it was
  allocated. Here it is NaN.
* *normalized_response with prefilter_size ≥ 91*: s is 0, the prefiltered image is blank and nothing is matched, here
  as there. From about 73 OpenCV's lookup table is too short for isolated bright or dark spots and it reads beside it;
  here the value is clipped.

Sources: K. Konolige, *Small vision systems: hardware and implementation* (1997), whose algorithm StereoBM is; the
rules by reading OpenCV's documentation and source and by experiment against versions 4.14 and 5.0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import require_choice, require_integer
from stereocal.base.errors import InputError
from stereocal.reconstruction.sad import as_gray_pair
from stereocal.reconstruction.sliding_window import Disparity, slide_window
from stereocal.reconstruction.speckles import filter_speckles

Region = tuple[int, int, int, int]
"""A rectangle of pixels (x, y, width, height), as OpenCV's Rect."""


def match_bm(
    left: ArrayLike,
    right: ArrayLike,
    *,
    num_disparities: int = 64,
    min_disparity: int = 0,
    block_size: int = 21,
    prefilter: str = "xsobel",
    prefilter_size: int = 9,
    prefilter_cap: int = 31,
    texture_threshold: int = 10,
    uniqueness_ratio: int = 15,
    disp12_max_diff: int = -1,
    speckle_size: int = 0,
    speckle_range: int = 0,
    roi1: Region | None = None,
    roi2: Region | None = None,
    threads: int | None = None,
    backend: str = "numba",
) -> Disparity:
    """Disparity by StereoBM's recipe: prefilter, SAD, texture, uniqueness, subpixel, cross-check, speckles.

    Parameters
    ----------
    left, right : array_like of shape (H, W) or (H, W, 3), uint8
        The rectified pair; colour is turned to grey.
    num_disparities : int
        How many disparities are searched, a multiple of 16.
    min_disparity : int
        The least of them, pixels; of either sign.
    block_size : int
        The side of the window, odd, 5 to 255, smaller than the image.
    prefilter : {"xsobel", "normalized_response"}
        What the images go through first.
    prefilter_size : int
        The window of ``"normalized_response"``, odd, 5 to 255.
    prefilter_cap : int
        c, 1 to 63: the filtered images lie in 0 … 2c.
    texture_threshold : int
        The least Σ |I − c| over the window.
    uniqueness_ratio : int
        By how many percent the second best must be worse; 0 does not ask.
    disp12_max_diff : int
        The largest difference to the right image's disparity, pixels; below 0 does not check.
    speckle_size : int
        The largest island that is removed, pixels (an area); 0 removes none.
    speckle_range : int
        How much neighbours in an island may differ, in SIXTEENTHS of a pixel, as in OpenCV; below 0 removes no island.
    roi1, roi2 : (x, y, width, height), optional
        The valid regions of the left and right image (rectification's); None is the whole image.
    threads : int, optional
        How many threads share the rows; the result does not depend on it. None takes all cores.
    backend : {"numba", "numpy"}
        The kernels, or the readable reference (:mod:`stereocal.reconstruction.block_matching_reference`).

    Returns
    -------
    ndarray of shape (H, W), float32
        Disparity of the left image, pixels, a multiple of 1/16; NaN where OpenCV has (min_disparity − 1)·16.

    Raises
    ------
    InputError
        If the images are not a pair of equal uint8 images, or an option is out of its range.

    Notes
    -----
    Answers to ``cv2.StereoBM.compute``: identical, bit for bit, but for OpenCV's faults listed in the module.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> scene = np.random.default_rng(0).integers(0, 256, (40, 120), dtype=np.uint8)
    >>> left, right = scene[:, :-4], scene[:, 4:]  # all of it 4 px away
    >>> disparity = sc.match_bm(left, right, num_disparities=16, block_size=9)
    >>> float(np.nanmedian(disparity))
    4.0
    """
    left_gray, right_gray = as_gray_pair(left, right)
    require_choice(backend, ("numba", "numpy"), "backend")
    num_disparities = require_integer(num_disparities, "num_disparities", minimum=16)
    if num_disparities % 16:
        raise InputError(f"num_disparities must be a multiple of 16, but is {num_disparities}")
    min_disparity = require_integer(min_disparity, "min_disparity", minimum=-(2**11), maximum=2**11)
    block_size = require_integer(block_size, "block_size", minimum=5, maximum=255, odd=True)
    if block_size >= min(left_gray.shape):
        size = f"{left_gray.shape[1]}x{left_gray.shape[0]}"
        raise InputError(f"block_size is {block_size}, but the images are {size}: it must be smaller than both sides")
    texture_threshold = require_integer(texture_threshold, "texture_threshold", minimum=0)
    uniqueness_ratio = require_integer(uniqueness_ratio, "uniqueness_ratio", minimum=0)
    disp12_max_diff = require_integer(disp12_max_diff, "disp12_max_diff", minimum=-(2**31))
    speckle_size = require_integer(speckle_size, "speckle_size", minimum=-(2**31))
    speckle_range = require_integer(speckle_range, "speckle_range", minimum=-(2**31))
    require_choice(prefilter, ("xsobel", "normalized_response"), "prefilter")
    regions = _as_region(roi1, "roi1"), _as_region(roi2, "roi2")

    columns, rows = valid_region(left_gray.shape, num_disparities, min_disparity, block_size, *regions)
    filtered = [
        prefilter_image(image, prefilter, size=prefilter_size, cap=prefilter_cap, backend=backend)
        for image in (left_gray, right_gray)
    ]
    disparity = np.full(left_gray.shape, np.nan, np.float32)
    columns = range(columns.start, min(columns.stop, left_gray.shape[1] + min(0, min_disparity)))
    if len(columns) and len(rows):
        match = _match_by_kernels if backend == "numba" else _match_by_reference
        match(
            filtered, disparity, columns, rows, num_disparities=num_disparities, min_disparity=min_disparity,
            block_size=block_size, cap=prefilter_cap, texture_threshold=texture_threshold,
            uniqueness_ratio=uniqueness_ratio, disp12_max_diff=disp12_max_diff, threads=threads,
        )  # fmt: skip
    if speckle_size > 0 and speckle_range >= 0:
        disparity = filter_speckles(
            disparity, max_size=speckle_size, max_difference=speckle_range / 16, backend=backend
        )
    return disparity


def _as_region(region: Region | None, name: str) -> Region | None:
    if region is None:
        return None
    try:
        x, y, width, height = region
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be (x, y, width, height), not {region!r}") from error
    whole = [require_integer(number, f"each of {name}", minimum=-(2**31)) for number in (x, y, width, height)]
    return whole[0], whole[1], whole[2], whole[3]


def _match_by_kernels(
    filtered: list[NDArray[np.uint8]],
    disparity: Disparity,
    columns: range,
    rows: range,
    *,
    num_disparities: int,
    min_disparity: int,
    block_size: int,
    cap: int,
    texture_threshold: int,
    uniqueness_ratio: int,
    disp12_max_diff: int,
    threads: int | None,
) -> None:
    """Write steps 2 to 7 into `disparity`, which enters as NaN."""
    checked = disp12_max_diff >= 0
    searched = _searched_columns(columns, disparity.shape[1], num_disparities, min_disparity, checked)

    def mark_textured(band: range) -> None:
        _mark_textured(filtered[0], cap, searched, band, block_size // 2, texture_threshold, disparity)

    cost = np.empty(disparity.shape, np.int32) if checked else None
    slide_window(
        filtered[0], filtered[1], disparity, searched, rows,
        num_disparities=num_disparities, min_disparity=min_disparity, block_size=block_size,
        peak=2 * cap, uniqueness_ratio=uniqueness_ratio, subpixel="opencv", cost=cost, prepare=mark_textured,
        threads=threads,
    )  # fmt: skip
    if cost is not None:
        _cross_check(cost, disp12_max_diff, searched, rows, disparity)
        disparity[:, : columns.start] = np.nan
        disparity[:, columns.stop :] = np.nan


def _match_by_reference(
    filtered: list[NDArray[np.uint8]],
    disparity: Disparity,
    columns: range,
    rows: range,
    *,
    num_disparities: int,
    min_disparity: int,
    disp12_max_diff: int,
    threads: int | None,
    **options: int,
) -> None:
    """The same by the reference, on one thread."""
    from stereocal.reconstruction import block_matching_reference as reference

    checked = disp12_max_diff >= 0
    searched = _searched_columns(columns, disparity.shape[1], num_disparities, min_disparity, checked)
    matched, cost = reference.match_filtered(
        filtered[0], filtered[1], searched, rows,
        num_disparities=num_disparities, min_disparity=min_disparity, **options,
    )  # fmt: skip
    if checked:
        reference.cross_check(matched, cost, searched.start, disparity.shape[1], disp12_max_diff)
    kept = matched[:, columns.start - searched.start : columns.stop - searched.start]
    disparity[rows.start : rows.stop, columns.start : columns.stop] = kept


def _searched_columns(columns: range, width: int, num_disparities: int, min_disparity: int, checked: bool) -> range:
    """What is matched before the region is cut out: the cross-check sees the disparities beside the region too."""
    if checked:
        return range(max(0, min_disparity + num_disparities), width + min(0, min_disparity))
    return columns


def valid_region(
    shape: tuple[int, ...],
    num_disparities: int,
    min_disparity: int,
    block_size: int,
    roi1: Region | None = None,
    roi2: Region | None = None,
) -> tuple[range, range]:
    """Return the columns and rows that StereoBM answers for.

    Parameters
    ----------
    shape : (H, W)
    num_disparities, min_disparity, block_size : int
    roi1, roi2 : (x, y, width, height), optional
        The valid regions of the left and right image; None, or one without area, is the whole image. What lies
        outside the image is cut off (OpenCV does not, and reads beside it).

    Notes
    -----
    Answers to ``cv2.getValidDisparityROI``.
    """
    height, width = shape
    whole = (0, 0, width, height)
    x1, y1, w1, h1 = roi1 if roi1 is not None and roi1[2] > 0 and roi1[3] > 0 else whole
    x2, y2, w2, h2 = roi2 if roi2 is not None and roi2[2] > 0 and roi2[3] > 0 else whole
    radius = block_size // 2
    largest = min_disparity + num_disparities - 1
    columns = range(max(0, x1, x2 + largest) + radius, min(width, x1 + w1, x2 + w2) - radius)
    rows = range(max(0, y1, y2) + radius, min(height, y1 + h1, y2 + h2) - radius)
    return columns, rows


def prefilter_image(
    image: NDArray[np.uint8], prefilter: str = "xsobel", *, size: int = 9, cap: int = 31, backend: str = "numba"
) -> NDArray[np.uint8]:
    """Return the image that StereoBM matches, in 0 … 2·cap.

    Parameters
    ----------
    image : ndarray of shape (H, W), uint8
    prefilter : {"xsobel", "normalized_response"}
    size : int
        The window of ``"normalized_response"``, odd, 5 to 255.
    cap : int
        1 to 63.
    backend : {"numba", "numpy"}
        The kernel, or the readable reference.

    Returns
    -------
    ndarray of shape (H, W), uint8
    """
    size = require_integer(size, "prefilter_size", minimum=5, maximum=255, odd=True)
    cap = require_integer(cap, "prefilter_cap", minimum=1, maximum=63)
    if backend == "numpy":
        from stereocal.reconstruction import block_matching_reference as reference

        if prefilter == "xsobel":
            return reference.xsobel(image, cap)
        return reference.normalized_response(image, size, cap)
    from stereocal.reconstruction import block_matching_kernels as kernels

    out = np.empty_like(image)
    if prefilter == "xsobel":
        kernels.prefilter_xsobel(image, cap, np.empty(image.shape[1], np.int16), out)
    else:
        eighth = size * size // 8
        mean_gain = (1024 + eighth) // (2 * eighth)
        scratch = np.empty(image.shape[1], np.int32)
        kernels.prefilter_normalized_response(image, size, cap, eighth * mean_gain, mean_gain, scratch, out)
    return out


def _mark_textured(
    image: NDArray[np.uint8], cap: int, columns: range, rows: range, radius: int, threshold: int, disparity: Disparity
) -> None:
    """Set `disparity` to 0 where the window has texture, to NaN where it has not."""
    from stereocal.reconstruction import block_matching_kernels as kernels

    first, last = columns.start - radius, columns.stop + radius
    beside = np.clip(np.arange(first, last), 0, image.shape[1] - 1)
    inside = first >= 0 and last <= image.shape[1]
    covered = image[:, first:last] if inside else image[:, beside]
    kernels.reject_untextured(
        covered, np.int16(cap), radius, rows.start, rows.stop, columns.start, np.int32(min(threshold, 2**31 - 1)),
        np.empty(last - first, np.int16), np.empty(last - first + 1, np.int32), disparity,
    )  # fmt: skip


def _cross_check(
    cost: NDArray[np.int32], max_difference: int, columns: range, rows: range, disparity: Disparity
) -> None:
    """Remove the disparities that the right image contradicts."""
    from stereocal.reconstruction import block_matching_kernels as kernels

    width = disparity.shape[1]
    kernels.cross_check(
        cost, max_difference, columns.start, columns.stop, rows.start, rows.stop,
        np.empty(width, np.int32), np.empty(width, np.float32), disparity,
    )  # fmt: skip
