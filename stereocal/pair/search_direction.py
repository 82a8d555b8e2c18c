"""Turn a rectified pair so that every matcher finds it: along rows, to the left, from 0 up.

Matchers look for the partner of the pixel (x, y) at (x − d, y), d = 0, 1, 2, … That is right for one kind of rig only:
side by side, the left camera first. The rectified baseline b = P2[axis, 3] / f tells the others:

- b > 0 (swapped cameras): the partner stands at x + |d|. In mirrored pictures, u = W − 1 − x, it stands at u − |d|.
- axis 1 (one camera above the other): the partner stands in the same column. In transposed pictures columns are rows.

The map that a matcher returns for the turned pictures is turned back, and for swapped cameras its sign with it: then it
obeys d = x_left − x_right (or y) and Q makes the right depth of it, whatever the rig.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.pair.rectification import Rectification

Image = NDArray[Any]


def is_swapped(rectification: Rectification) -> bool:
    """Tell whether the first camera stands right of (or below) the second, so that disparities are negative."""
    return bool(rectification.P2[rectification.axis, 3] > 0)


def turn_for_matching(picture: Image, rectification: Rectification) -> Image:
    """Turn one rectified picture so that partners lie along rows, to the left.

    Parameters
    ----------
    picture : ndarray of shape (H, W) or (H, W, C)
        The rectified left or right picture.
    rectification : Rectification
        Where it comes from.

    Returns
    -------
    ndarray
        Of shape (H, W, …) for a horizontal rig, (W, H, …) for a vertical one; C-contiguous.
    """
    rows = np.swapaxes(picture, 0, 1) if rectification.axis == 1 else picture
    return np.ascontiguousarray(rows[:, ::-1] if is_swapped(rectification) else rows)


def turn_back(disparity: Image, rectification: Rectification) -> Image:
    """Turn a disparity map of turned pictures back into the rectified left picture's frame, sign included.

    Parameters
    ----------
    disparity : ndarray of float32
        Of the turned left picture, px, NaN where there is none.
    rectification : Rectification
        The same that the pictures were turned by.

    Returns
    -------
    ndarray of shape (H, W), float32
        d = x_left − x_right (y for a vertical rig), which Q takes to depth; negative where the cameras are swapped.
    """
    rows = -disparity[:, ::-1] if is_swapped(rectification) else disparity
    return np.ascontiguousarray(rows.T if rectification.axis == 1 else rows)
