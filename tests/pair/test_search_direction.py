"""Swapped and vertical rigs: matchers find the partner, and the depth is the plane's."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import stereocal as sc
from stereocal.pair.rectification import Rectification
from stereocal.pair.search_direction import is_swapped, turn_back, turn_for_matching
from stereocal.workflow.matching import METHODS, match_along_baseline

SIZE = (200, 160)
SHIFT = 9
BASELINE, FOCAL = 60.0, 300.0

RIGS = {
    "side by side": (-BASELINE, 0.0),
    "swapped": (BASELINE, 0.0),
    "one above the other": (0.0, -BASELINE),
    "one below the other": (0.0, BASELINE),
}


def rectified(tx: float, ty: float) -> Rectification:
    K = np.array([[FOCAL, 0, 99.5], [0, FOCAL, 79.5], [0, 0, 1]])
    camera = sc.Camera(K, np.zeros(5), SIZE)
    return sc.rectify(sc.StereoRig(camera, camera, np.eye(3), [tx, ty, 0.0]))


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize("method", METHODS)
def test_a_plane_has_its_depth_whichever_way_the_rig_stands(name: str, method: str) -> None:
    rectification = rectified(*RIGS[name])
    axis, sign = rectification.axis, -1 if is_swapped(rectification) else 1
    left = np.random.default_rng(4).integers(0, 256, SIZE[::-1]).astype(np.uint8)
    right = np.roll(left, -sign * SHIFT, axis=1 - axis)  # x_left - x_right = sign * SHIFT (y where axis is 1)
    disparity = match_along_baseline(
        left, right, rectification, method=method, block_size=9, num_disparities=32, speckle_size=0
    )
    depth = sc.disparity_to_depth(disparity, rectification.Q)
    inside = depth[40:-40, 40:-40]
    assert np.isfinite(inside).all()
    assert_allclose(np.median(inside), rectification.P1[0, 0] * BASELINE / SHIFT, rtol=1e-3)
    assert (inside > 0).all()
    assert np.sign(np.nanmedian(disparity)) == sign


@pytest.mark.parametrize("name", RIGS)
def test_turning_back_undoes_turning_but_for_the_sign(name: str) -> None:
    rectification = rectified(*RIGS[name])
    values = np.random.default_rng(1).normal(size=SIZE[::-1]).astype(np.float32)
    sign = -1 if is_swapped(rectification) else 1
    assert_array_equal(turn_back(turn_for_matching(values, rectification), rectification), sign * values)
    assert is_swapped(rectification) == (sum(RIGS[name]) > 0)
    colour = np.stack([values] * 3, axis=2)
    assert turn_for_matching(colour, rectification).shape[2] == 3
