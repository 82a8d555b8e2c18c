"""Any image to one grey channel.

Luma is ITU-R BT.601's Y = 0.299 R + 0.587 G + 0.114 B. On unsigned integers it is computed in 15-bit fixed point with
rounding, (9798 R + 19235 G + 3735 B + 2¹⁴) >> 15, which is what ``cv2.cvtColor(…, COLOR_RGB2GRAY)`` does, so that both
libraries see the same grey values. Channels are in the order R, G, B (Pillow's, not OpenCV's B, G, R).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import as_image


def to_gray(image: ArrayLike, name: str = "image") -> NDArray[Any]:
    """Return the luma of an image, Y = 0.299 R + 0.587 G + 0.114 B.

    Parameters
    ----------
    image : array_like of shape (H, W), (H, W, 3) or (H, W, 4), uint8, uint16 or float
        Grey, RGB or RGBA; alpha is ignored.
    name : str
        The argument's name, for error messages.

    Returns
    -------
    ndarray of shape (H, W), dtype of `image`

    Raises
    ------
    InputError
        If the array is not an image.

    Notes
    -----
    Answers to ``cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)``: identical on uint8 and uint16.
    """
    array = as_image(image, name, channels=(1, 3, 4))
    if array.ndim == 2:
        return array
    luma: NDArray[Any]
    if array.dtype.kind == "u":
        wide = array.astype(np.uint32)
        luma = (9798 * wide[..., 0] + 19235 * wide[..., 1] + 3735 * wide[..., 2] + (1 << 14)) >> 15
    else:
        luma = 0.299 * array[..., 0] + 0.587 * array[..., 1] + 0.114 * array[..., 2]
    return np.ascontiguousarray(luma.astype(array.dtype))
