"""Match a rectified pair with any of the four matchers, whichever way the rig stands.

Matchers work on 8-bit grey. Pictures of more bits are brought to 8 by one factor for both, so that grey values stay
comparable between left and right. Pictures of a vertical or swapped rig are turned first, and the map turned back.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

import stereocal
from stereocal.base.checks import require_choice, require_integer
from stereocal.base.gray import to_gray
from stereocal.pair.rectification import Rectification
from stereocal.pair.search_direction import turn_back, turn_for_matching

METHODS = ("sad", "bm", "census", "sgm")

BLOCK_SIZES = {"sad": 21, "bm": 21, "census": 9, "sgm": 3}
"""Block size by method when none is given: the paper's for block matching, small where smoothness is asked for."""

Image = NDArray[Any]
Disparity = NDArray[np.float32]


def matcher_settings(
    method: str, *, block_size: int | None, num_disparities: int, min_disparity: int, speckle_size: int
) -> dict[str, int]:
    """Return the matcher's settings, checked, with the method's own block size if none is given.

    Raises
    ------
    InputError
        If one is out of its range.
    """
    require_choice(method, METHODS, "--method")
    size = BLOCK_SIZES[method] if block_size is None else block_size
    return {
        "block_size": require_integer(size, "--block-size", minimum=1, maximum=255, odd=True),
        "num_disparities": require_integer(num_disparities, "--num-disparities", minimum=1, maximum=4096),
        "min_disparity": require_integer(min_disparity, "--min-disparity", minimum=-4096, maximum=4096),
        "speckle_size": require_integer(speckle_size, "--speckle-size", minimum=0),
    }


def match_rectified(
    left: Image,
    right: Image,
    *,
    method: str,
    block_size: int,
    num_disparities: int,
    min_disparity: int = 0,
    speckle_size: int = 0,
) -> Disparity:
    """Match a rectified pair with one of the four matchers and drop speckles."""
    matcher = getattr(stereocal, f"match_{method}")  # the public names, imported when first used
    settings = {"num_disparities": num_disparities, "min_disparity": min_disparity, "block_size": block_size}
    if method == "sgm":  # has a speckle filter of its own, with the range that suits its slanted surfaces
        smooth: Disparity = matcher(left, right, **settings, speckle_size=speckle_size)
        return smooth
    disparity: Disparity = matcher(left, right, **settings)
    if speckle_size:
        disparity = stereocal.filter_speckles(disparity, max_size=speckle_size, max_difference=1.0)
    return disparity


def match_along_baseline(
    left: Image, right: Image, rectification: Rectification, *, method: str, **settings: int
) -> Disparity:
    """Match a rectified pair of any rig: side by side or one above the other, in either order.

    Parameters
    ----------
    left, right : ndarray of shape (H, W), uint8
        The rectified pictures.
    rectification : Rectification
        Of the rig.
    method : {"sad", "bm", "census", "sgm"}
        The matcher.
    **settings : int
        Of :func:`match_rectified`; disparities are counted away from 0, whichever their sign will be.

    Returns
    -------
    ndarray of shape (H, W), float32
        Disparity that Q takes to depth: negative where the cameras are swapped, along y where the rig is vertical; NaN
        where there is none, or where one of the cameras did not look.
    """
    first, second = turn_for_matching(left, rectification), turn_for_matching(right, rectification)
    disparity = match_rectified(first, second, method=method, **settings)
    return turn_back(drop_unseen(disparity, rectification), rectification)


def drop_unseen(disparity: Disparity, rectification: Rectification) -> Disparity:
    """Drop answers where either camera did not look: black borders match black borders perfectly.

    The map is of turned pictures, in which the partner of (x, y) is (x − d, y).
    """
    seen_left, seen_right = (
        turn_for_matching(rectification.valid_mask(side), rectification) for side in ("left", "right")
    )
    valid = np.isfinite(disparity) & seen_left
    y, x = np.nonzero(valid)
    partner = np.rint(x - disparity[y, x]).astype(int)
    inside = (partner >= 0) & (partner < disparity.shape[1])
    valid[y, x] = inside & seen_right[y, np.clip(partner, 0, disparity.shape[1] - 1)]
    return np.where(valid, disparity, np.float32(np.nan))


def to_eight_bits(left: Image, right: Image) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return both images in 8-bit grey, scaled by one factor."""
    gray = to_gray(left, "left"), to_gray(right, "right")
    if gray[0].dtype == np.uint8 and gray[1].dtype == np.uint8:
        return gray
    white = max(float(gray[0].max()), float(gray[1].max()), 1.0)
    scaled = [np.rint(np.clip(image.astype(np.float64) * (255.0 / white), 0, 255)).astype(np.uint8) for image in gray]
    return scaled[0], scaled[1]
