"""Undistortion maps: kernel = reference = OpenCV to the last bit, and the two maps undo one another."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

from stereocal.base.errors import InputError
from stereocal.base.rotations import rotation_matrix
from stereocal.camera.model import Camera
from stereocal.camera.resampling import remap
from stereocal.camera.undistortion import (
    distortion_maps,
    tilt_matrix,
    undistort_image,
    undistortion_maps,
    valid_pixels,
)

MODELS = {"pinhole": 0, "polynomial": 2, "brown": 5, "rational": 8, "thin_prism": 12, "tilted": 14}
SPREAD = np.array([0.3, 0.1, 0.003, 0.003, 0.02, 0.1, 0.1, 0.02, 0.01, 0.01, 0.01, 0.01, 0.02, 0.02])


def draw(seed: int, model: str):
    random = np.random.default_rng(seed)
    f = random.uniform(80, 700)
    width, height = (int(s) for s in random.integers(8, 140, 2))
    K = np.array([[f, 0, width / 2 + random.normal()], [0, f * 1.01, height / 2 + random.normal()], [0, 0, 1]])
    P = np.array([[f * 0.97, 0, width / 2, -50], [0, f * 0.97, height / 2, 0], [0, 0, 1, 0]])
    dist = (random.normal(size=14) * SPREAD)[: MODELS[model]]
    return K, dist, (width, height), rotation_matrix(random.normal(size=3) * 0.1), P


@pytest.mark.parametrize("model", MODELS)
@given(seed=seeds)
@settings(max_examples=25)
def test_maps_equal_opencv_to_the_last_bit(model, seed) -> None:
    K, dist, size, R, P = draw(seed, model)
    padded = np.pad(dist, (0, 4 - len(dist))) if len(dist) < 4 else dist
    theirs = cv2.initUndistortRectifyMap(K, padded, R, P, size, cv2.CV_32FC1)
    ours = undistortion_maps(K, dist, size, R=R, P=P, model=model)
    for a, b in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(a, b)


@given(width=st.integers(1, 40), height=st.integers(1, 4))
@settings(max_examples=25)
def test_maps_write_their_own_memory_only(width, height) -> None:
    """The kernel works on eight pixels at a time; a row need not hold a multiple of eight."""
    K = np.array([[30.0, 0, 10], [0, 31, 2], [0, 0, 1]])
    blocks = [np.full(width * height + 16, 7, np.float32) for _ in "xy"]
    maps = tuple(block[:-16].reshape(height, width) for block in blocks)
    undistortion_maps(K, [-0.1, 0.02, 0, 0, 0], (width, height), out=maps)
    fresh = undistortion_maps(K, [-0.1, 0.02, 0, 0, 0], (width, height))
    for block, given_map, own in zip(blocks, maps, fresh, strict=True):
        np.testing.assert_array_equal(given_map, own)
        np.testing.assert_array_equal(block[-16:], 7)


@pytest.mark.parametrize("model", MODELS)
@given(seed=seeds)
@settings(max_examples=10)
def test_kernel_equals_reference_within_a_float32_step(model, seed) -> None:
    K, dist, size, R, P = draw(seed, model)
    kernel = undistortion_maps(K, dist, size, R=R, P=P, model=model)
    reference = undistortion_maps(K, dist, size, R=R, P=P, model=model, backend="numpy")
    for a, b in zip(kernel, reference, strict=True):
        assert np.all(np.abs(a - b) <= np.spacing(np.abs(b)))


@given(seed=seeds)
@settings(max_examples=15)
def test_fisheye_maps_equal_opencv(seed) -> None:
    random = np.random.default_rng(seed)
    K = np.array([[250.0, 0, 320], [0, 251, 240], [0, 0, 1]])
    k = random.normal(size=4) * [0.05, 0.02, 0.01, 0.005]
    R = rotation_matrix(random.normal(size=3) * 0.05)
    P = np.array([[180.0, 0, 300], [0, 180, 200], [0, 0, 1]])
    theirs = cv2.fisheye.initUndistortRectifyMap(K, k, R, P, (64, 48), cv2.CV_32FC1)
    ours = undistortion_maps(K, k, (64, 48), R=R, P=P, model="fisheye")
    reference = undistortion_maps(K, k, (64, 48), R=R, P=P, model="fisheye", backend="numpy")
    for a, b, c in zip(ours, theirs, reference, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-4)
        assert np.all(np.abs(a - c) <= np.spacing(np.abs(c)))


@pytest.mark.parametrize("backend", ["numba", "numpy"])
def test_a_fisheye_shows_nothing_twice(backend) -> None:
    """Turned by 100°, half of the picture looks behind the camera: no mirror image there, but NaN."""
    K = np.array([[30.0, 0, 32], [0, 30, 24], [0, 0, 1]])
    R = rotation_matrix([0, np.radians(100), 0])
    x, y = undistortion_maps(K, [0.01, 0, 0, 0], (64, 48), R=R, model="fisheye", backend=backend)
    behind = (np.linalg.inv(K @ R) @ [[0.0, 63], [24, 24], [1, 1]])[2] <= 0
    assert behind.tolist() in ([True, False], [False, True])
    np.testing.assert_array_equal(np.isnan(x[24, [0, 63]]), behind)
    np.testing.assert_array_equal(np.isnan(x), np.isnan(y))


@given(tau_x=st.floats(-0.5, 0.5), tau_y=st.floats(-0.5, 0.5))
def test_tilted_sensor_leaves_the_axis_alone(tau_x, tau_y) -> None:
    axis = tilt_matrix(tau_x, tau_y) @ [0, 0, 1]
    np.testing.assert_allclose(axis[:2] / axis[2], 0, atol=1e-12)


@pytest.mark.parametrize(
    ("model", "dist"),
    [
        ("brown", [-0.3, 0.1, 0.001, 0.002, -0.01]),
        ("rational", [-0.2, 0.05, 0.001, 0.002, 0, 0.05, 0.01, 0]),
        ("fisheye", [0.02, -0.01, 0.003, -0.001]),
        ("division", [-0.2]),
        ("fov", [0.7]),
    ],
)
def test_the_two_maps_are_inverse_to_each_other(model, dist) -> None:
    size = (120, 90)
    K = np.array([[90.0, 0, 60], [0, 91, 45], [0, 0, 1]])
    R, P = rotation_matrix([0.03, -0.02, 0.04]), np.array([[85.0, 0, 58], [0, 85, 46], [0, 0, 1]])
    there = undistortion_maps(K, dist, size, R=R, P=P, model=model)
    back = distortion_maps(K, dist, size, R=R, P=P, model=model)
    u, v = np.meshgrid(np.arange(120.0), np.arange(90.0))
    for (first, second), name in (((there, back), "photograph and back"), ((back, there), "new picture and back")):
        # read the second map where the first one points to: the pixel itself must come out
        gone = [remap(m, *first, border_value=-1000) for m in second]
        inside = (first[0] > 1) & (first[0] < 118) & (first[1] > 1) & (first[1] < 88)
        assert inside.mean() > 0.5, name
        off = np.hypot(gone[0] - u, gone[1] - v)[inside]
        assert off.max() < 0.02, name  # the rest is bilinear interpolation of the second map


def test_undistorted_lines_are_straight() -> None:
    """A picture of a distorted straight edge, undistorted, has a straight edge."""
    camera = Camera([[300, 0, 160], [0, 300, 120], [0, 0, 1]], [-0.4, 0.15], (320, 240))
    u, v = np.meshgrid(np.arange(320.0), np.arange(240.0))
    ideal = camera.undistort_points(np.stack([u.ravel(), v.ravel()], 1)).reshape(240, 320, 2)
    offset = ideal[..., 1] - (40 + 0.1 * ideal[..., 0])
    photograph = (255 / (1 + np.exp(-2 * offset))).astype(np.uint8)
    flat = undistort_image(photograph, camera).astype(float)
    columns = np.arange(30, 290, 20)
    rows = np.array([np.interp(127.5, flat[20:120, c], np.arange(20.0, 120)) for c in columns])
    assert np.abs(rows - (40 + 0.1 * columns)).max() < 0.05
    bent = np.array([np.interp(127.5, photograph[20:120, c], np.arange(20.0, 120)) for c in columns])
    assert np.abs(bent - (40 + 0.1 * columns)).max() > 3


def test_valid_pixels_leaves_out_what_folds_over() -> None:
    camera = Camera([[300, 0, 160], [0, 300, 120], [0, 0, 1]], [-0.45, 0.0], (320, 240))
    P = np.array([[60.0, 0, 160], [0, 60, 120], [0, 0, 1]])
    maps = undistortion_maps(camera.K, camera.dist, camera.image_size, P=P)
    inside = (maps[0] >= 0) & (maps[0] <= 319) & (maps[1] >= 0) & (maps[1] <= 239)
    valid = valid_pixels(maps, camera, P=P)
    assert valid[120, 160]
    assert not np.any(valid & ~inside)
    # far out the cubic comes back: the photograph's middle is shown a second time there, and must not count
    assert np.count_nonzero(inside & ~valid) > 500
    radius = np.hypot(*np.meshgrid(np.arange(320) - 160, np.arange(240) - 120)) / 60
    assert radius[valid].max() < np.sqrt(1 / (3 * 0.45)) + 0.02


def test_an_image_of_another_size_is_refused() -> None:
    camera = Camera([[300, 0, 160], [0, 300, 120], [0, 0, 1]], None, (320, 240))
    with pytest.raises(InputError, match="320x240"):
        undistort_image(np.zeros((100, 100), np.uint8), camera)
    with pytest.raises(InputError, match="no inverse"):
        undistortion_maps(camera.K, None, (320, 240), P=np.zeros((3, 3)))
