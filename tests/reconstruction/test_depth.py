"""Depth: the same bits as OpenCV's, the truth of a projected scene, and the law of the square."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

from stereocal.base.errors import DegenerateGeometryError, InputError
from stereocal.reconstruction.depth import (
    disparity_to_depth,
    disparity_to_points,
    reprojection_matrix,
    sigma_z,
)

cv2 = pytest.importorskip("cv2")

F, CENTRE, B = 520.0, (311.5, 243.25), 60.0


def _stereo_rectify_q(T, shift):
    """Q by OpenCV for two equal cameras without rotation, the right principal point `shift` px further right."""
    left = np.array([[F, 0, CENTRE[0]], [0, F, CENTRE[1]], [0, 0, 1]])
    right = left + np.array([[0, 0, shift], [0, 0, 0], [0, 0, 0]])
    flags = 0 if shift else cv2.CALIB_ZERO_DISPARITY
    size, none = (640, 480), np.zeros(5)
    return cv2.stereoRectify(
        left, none, right, none, size, np.eye(3), np.reshape(np.array(T, float), (3, 1)), flags=flags, alpha=-1
    )[4]


@settings(max_examples=40)
@given(seed=seeds, height=st.integers(1, 40), width=st.integers(1, 60), general=st.booleans())
def test_points_and_depth_are_opencvs_to_the_last_bit(seed, height, width, general) -> None:
    rng = np.random.default_rng(seed)
    d = rng.uniform(-20, 80, (height, width)).astype(np.float32)
    Q = rng.normal(size=(4, 4)) if general else reprojection_matrix(F, CENTRE, B, principal_offset=rng.normal())
    expected = cv2.reprojectImageTo3D(d, Q)
    np.testing.assert_array_equal(disparity_to_points(d, Q), expected)
    np.testing.assert_array_equal(disparity_to_depth(d, Q), expected[..., 2])


@settings(max_examples=20)
@given(seed=seeds)
def test_no_disparity_is_no_point_never_zero(seed) -> None:
    rng = np.random.default_rng(seed)
    d = rng.uniform(1, 60, (12, 17)).astype(np.float32)
    missing = rng.random(d.shape) < 0.3
    masked = np.ma.masked_array(d.copy(), missing)
    d[missing] = rng.choice([np.nan, np.inf, -np.inf], missing.sum())
    Q = reprojection_matrix(F, CENTRE, B)
    for given_as in (d, masked):
        for result in (
            disparity_to_points(given_as, Q)[..., 0], disparity_to_depth(given_as, Q), sigma_z(given_as, Q),
        ):  # fmt: skip
            np.testing.assert_array_equal(np.isnan(result), missing)
            assert result.dtype == np.float32
            assert type(result) is np.ndarray


def test_zero_disparity_is_a_point_at_infinity() -> None:
    assert disparity_to_depth(np.zeros((1, 1)), reprojection_matrix(F, CENTRE, B))[0, 0] == np.inf


@pytest.mark.parametrize("shift", [0.0, 7.5])
def test_q_from_five_numbers_is_stereo_rectifys(shift) -> None:
    np.testing.assert_allclose(
        reprojection_matrix(F, CENTRE, B, principal_offset=shift), _stereo_rectify_q([-B, 0, 0], shift), atol=1e-9
    )


@settings(max_examples=25)
@given(seed=seeds, vertical=st.booleans())
def test_a_projected_scene_comes_back(seed, vertical) -> None:
    """Physics, no oracle: project points into both cameras, subtract, reproject."""
    rng = np.random.default_rng(seed)
    T = np.array([0.0, -B, 0.0] if vertical else [-B, 0.0, 0.0])
    Q = _stereo_rectify_q(T, 0.0)
    y, x = np.mgrid[:9, :13].astype(float)
    Z = rng.uniform(300, 5000, x.shape)
    cx, cy = -Q[0, 3], -Q[1, 3]
    X = np.stack([(x - cx) / Q[2, 3] * Z, (y - cy) / Q[2, 3] * Z, Z], axis=-1)
    moved = X + T
    axis, centre = (1, cy) if vertical else (0, cx)
    d = (y if vertical else x) - (Q[2, 3] * moved[..., axis] / moved[..., 2] + centre)
    np.testing.assert_allclose(disparity_to_points(d, Q), X, rtol=2e-6, atol=1e-3)


def test_sigma_z_is_the_law_of_the_square() -> None:
    Z = np.array([[500.0, 1000.0, 2000.0, 4000.0]])
    d = F * B / Z
    np.testing.assert_allclose(
        sigma_z(d, reprojection_matrix(F, CENTRE, B), sigma_d=0.2), Z**2 * 0.2 / (F * B), rtol=1e-6
    )
    # The principal points' offset moves the disparities, not the depths, nor their error.
    offset = reprojection_matrix(F, CENTRE, B, principal_offset=12.0)
    np.testing.assert_allclose(sigma_z(d - 12.0, offset, sigma_d=0.2), Z**2 * 0.2 / (F * B), rtol=1e-6)


def test_sigma_z_is_the_spread_of_noisy_depths() -> None:
    rng = np.random.default_rng(1)
    Q = reprojection_matrix(F, CENTRE, B, principal_offset=3.0)
    d = np.full((200, 500), 21.0)
    spread = disparity_to_depth(d + rng.normal(scale=0.1, size=d.shape), Q).std()
    assert spread == pytest.approx(sigma_z(d, Q, sigma_d=0.1)[0, 0], rel=0.01)


def test_sigma_d_may_differ_from_pixel_to_pixel() -> None:
    Q = reprojection_matrix(F, CENTRE, B)
    d = np.full((2, 3), 10.0)
    sigma_d = np.arange(6.0).reshape(2, 3)
    np.testing.assert_allclose(sigma_z(d, Q, sigma_d=sigma_d), sigma_d * sigma_z(d, Q, sigma_d=1.0), rtol=1e-6)


def test_bad_input_is_named() -> None:
    d, Q = np.ones((3, 4)), reprojection_matrix(F, CENTRE, B)
    with pytest.raises(InputError, match=r"disparity must have shape \(H, W\)"):
        disparity_to_points(np.ones(3), Q)
    with pytest.raises(InputError, match="Q must have shape"):
        disparity_to_depth(d, np.eye(3))
    with pytest.raises(InputError, match="sigma_d"):
        sigma_z(d, Q, sigma_d=-0.1)
    with pytest.raises(InputError, match="sigma_d"):
        sigma_z(d, Q, sigma_d=np.ones((2, 2)))
    with pytest.raises(InputError, match="sigma_d"):
        sigma_z(d, Q, sigma_d="a tenth")
    with pytest.raises(InputError, match="baseline"):
        reprojection_matrix(F, CENTRE, 0.0)
    with pytest.raises(DegenerateGeometryError, match="baseline"):
        disparity_to_points(d, np.diag([1.0, 1.0, 1.0, 1.0]))
