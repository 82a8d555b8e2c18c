"""Levels: means, doubles and grown tones are what they say, and the finest closed level comes only when asked for."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy import ndimage

from stereocal.board.pyramid import closed_levels, levels
from stereocal.board.pyramid_kernels import double, halve, spread_darkest


def test_halves_and_doubles_keep_straight_ramps():
    y, x = np.mgrid[:12, :16].astype(np.float32)
    ramp = 3 * x + 5 * y
    half, twice = np.empty((6, 8), np.float32), np.empty((24, 32), np.float32)
    halve(ramp, half)
    double(ramp, twice)
    Y, X = np.mgrid[:6, :8]
    np.testing.assert_allclose(half, 3 * (2 * X + 0.5) + 5 * (2 * Y + 0.5))
    Y, X = np.mgrid[:24, :32]
    expected = 3 * (X / 2 - 0.25) + 5 * (Y / 2 - 0.25)
    np.testing.assert_allclose(twice[1:-1, 1:-1], expected[1:-1, 1:-1], rtol=1e-6)


@pytest.mark.parametrize(("tone", "theirs"), [(1, cv2.erode), (-1, cv2.dilate)])
def test_grown_tones_are_least_and_largest_of_nine(tone, theirs):
    image = np.random.default_rng(3).integers(0, 256, (31, 47)).astype(np.uint8)
    out = np.empty(image.shape, np.float32)
    spread_darkest(image, tone, out)
    np.testing.assert_array_equal(out, theirs(image, np.ones((3, 3), np.uint8)))
    reference = ndimage.minimum_filter if tone > 0 else ndimage.maximum_filter
    np.testing.assert_array_equal(out, reference(image, 3, mode="nearest"))


def test_levels_run_from_coarse_to_fine():
    image = np.zeros((480, 640), np.uint8)
    assert [(level.shape, scale) for level, scale in levels(image, 9)] == [
        ((240, 320), 2.0),
        ((480, 640), 1.0),
        ((960, 1280), 0.5),
    ]
    assert [scale for _, scale in levels(np.zeros((1080, 1920), np.uint8), 9)] == [8.0, 4.0, 2.0, 1.0]


@pytest.mark.parametrize("worth_it", [True, False])
def test_gaps_are_closed_in_the_image_itself_only_where_it_is_worth_it(worth_it):
    image = np.random.default_rng(0).integers(0, 256, (480, 640)).astype(np.uint8)
    scales = [scale for _, scale in closed_levels(image, 9, lambda: worth_it)]
    assert scales == [4.0] * 4 + [2.0] * 4 + [1.0] * 4 * worth_it
