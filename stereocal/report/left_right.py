"""Does the right image agree? The share of disparities that matching the other way round confirms.

The right image's own disparity comes from matching the mirrored pair with its sides exchanged: if left pixel x matches
right pixel x − d, then in the mirror (x → W − 1 − x) the right image's pixel matches one d to its left, which is what a
matcher of the left image finds. A left pixel is confirmed if the pixel that it points to points back to within a pixel.
Unlike the number of disparities, that share cannot be raised by smoothing. A pixel whose match lies where the right
image has no computable window cannot be asked, and does not count.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def mirror(image: NDArray[Any]) -> NDArray[Any]:
    """The image seen in a mirror, x → W − 1 − x."""
    return np.ascontiguousarray(image[:, ::-1])


def confirmed_pixels(
    disparity: NDArray[np.float32], right_disparity: NDArray[np.float32], columns: range, tolerance: float = 1.0
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Left pixels whose match in the right image has the same disparity within `tolerance`.

    Parameters
    ----------
    disparity : ndarray of shape (H, W)
        Of the left image, pixels, NaN where there is none.
    right_disparity : ndarray of shape (H, W)
        Of the right image: its pixel x matches left pixel x + d.
    columns : range
        The columns that the matcher answers for in a left image; in the right image they are mirrored.
    tolerance : float
        Pixels.

    Returns
    -------
    confirmed, asked : ndarray of bool, shape (H, W)
        Pixels that are confirmed, and those that could be asked.
    """
    width = disparity.shape[1]
    y, x = np.nonzero(np.isfinite(disparity))
    d = disparity[y, x]
    at = np.rint(x - d).astype(np.int64)
    inside = (at > width - 1 - columns.stop) & (at <= width - 1 - columns.start)
    y, x, d, at = y[inside], x[inside], d[inside], at[inside]
    asked, confirmed = np.zeros(disparity.shape, dtype=bool), np.zeros(disparity.shape, dtype=bool)
    asked[y, x] = True
    confirmed[y, x] = np.abs(right_disparity[y, at] - d) <= tolerance  # NaN compares as False
    return confirmed, asked
