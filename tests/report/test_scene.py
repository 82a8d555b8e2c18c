from __future__ import annotations

import cv2
import numpy as np
import pytest

from stereocal.report.left_right import confirmed_pixels
from stereocal.report.scene import row_offsets


def scene(offset: float) -> tuple[np.ndarray, np.ndarray]:
    """A random texture, 9 px of disparity, the right image lower by `offset` rows."""
    random = np.random.default_rng(2)
    wide = cv2.GaussianBlur(random.integers(0, 256, (240, 400)).astype(np.float32), (0, 0), 2.0)
    wide = (wide - wide.min()) / np.ptp(wide) * 255
    left = wide[:, 40:360]
    shift = np.float32([[1, 0, -49], [0, 1, offset]])
    right = cv2.warpAffine(wide, shift, (320, 240), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return left.astype(np.uint8), np.clip(right, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("offset", [0.0, 1.0, -2.0, 2.4])
def test_a_row_offset_is_measured_with_its_sign(offset: float) -> None:
    whole, parts = row_offsets(*scene(offset), 32)
    assert whole == pytest.approx(offset, abs=0.35)
    assert np.nanmax(np.abs(parts - offset)) < 0.6


def test_a_blank_wall_tells_nothing() -> None:
    blank = np.full((120, 200), 90, np.uint8)
    whole, parts = row_offsets(blank, blank, 32)
    assert np.isnan(whole)
    assert np.isnan(parts).all()


def test_confirmed_pixels() -> None:
    disparity = np.full((1, 20), np.nan, np.float32)
    disparity[0, [10, 12, 14, 4]] = [3, 3, 3, 3]
    back = np.full((1, 20), np.nan, np.float32)
    back[0, [7, 9, 1]] = [3, 8, 3]
    # a matcher of 20 columns that answers from 3 to 19 answers, mirrored, from 0 to 16
    confirmed, asked = confirmed_pixels(disparity, back, range(3, 19))
    assert np.flatnonzero(confirmed).tolist() == [4, 10]
    assert np.flatnonzero(asked).tolist() == [4, 10, 12, 14]
    _, fewer = confirmed_pixels(disparity, back, range(10, 19))
    assert np.flatnonzero(fewer).tolist() == [4, 10, 12]
