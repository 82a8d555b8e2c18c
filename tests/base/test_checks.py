from __future__ import annotations

import numpy as np
import pytest

from stereocal.base import checks
from stereocal.base.errors import InputError


@pytest.mark.parametrize("shape", [(7, 2), (7, 1, 2), (1, 7, 2)])
def test_points_come_in_every_shape_that_opencv_users_pass(shape: tuple[int, ...]) -> None:
    given = np.arange(14, dtype=np.float32).reshape(shape)
    points = checks.as_points(given, 2, "points")
    assert points.shape == (7, 2)
    assert points.dtype == np.float64
    assert points.flags.c_contiguous
    np.testing.assert_array_equal(points, np.arange(14).reshape(7, 2))


def test_one_point_may_be_a_vector() -> None:
    assert checks.as_points([1, 2, 3], 3, "X").shape == (1, 3)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((5, 3)), r"points must have shape \(N, 2\), but has \(5, 3\)"),
        (np.zeros((2, 3, 2)), r"but has \(2, 3, 2\)"),
        ([[1, np.nan]] * 4, "points holds 4 values that are NaN or infinite"),
        ("corners", r"points must be an \(N, 2\) array of real numbers"),
        (np.ones((5, 2)) * 1j, r"points must be an \(N, 2\) array of real numbers"),
        ([[1, 2], [3]], r"points must be an \(N, 2\) array of real numbers"),
        (np.zeros((3, 2)), "points holds 3 points, but at least 4 are needed"),
    ],
)
def test_bad_points_get_a_sentence(points: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        checks.as_points(points, 2, "points", minimum=4)  # type: ignore[arg-type]


def test_nan_points_pass_where_the_caller_handles_them() -> None:
    assert np.isnan(checks.as_points([[np.nan, 0]], 2, "points", finite=False)).any()


@pytest.mark.parametrize(
    ("K", "message"),
    [
        (np.eye(4), r"K must have shape \(3, 3\)"),
        ([[0, 0, 1], [0, 1, 1], [0, 0, 1]], "positive focal lengths"),
        ([[500, 0, 320], [0, 500, 240], [0, 0.5, 1]], "upper triangular"),
        (np.eye(3) + 0j, r"K must be real numbers of shape \(3, 3\)"),
        ([[500, 0, np.inf], [0, 500, 240], [0, 0, 1]], "NaN or infinite"),
    ],
)
def test_bad_camera_matrix(K: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        checks.as_camera_matrix(K)  # type: ignore[arg-type]


def test_rotation_must_be_orthonormal_and_right_handed() -> None:
    np.testing.assert_array_equal(checks.as_rotation(np.eye(3)), np.eye(3))
    for bad in (np.diag([1, 1, -1]), 1.01 * np.eye(3)):
        with pytest.raises(InputError, match="rotation matrix"):
            checks.as_rotation(bad)


@pytest.mark.parametrize("size", [(0, 480), (640, -1), 640, "640x480", (640, 480, 3)])
def test_bad_image_size(size: object) -> None:
    with pytest.raises(InputError, match="image_size must be"):
        checks.as_image_size(size)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((4, 5), np.int32), "must be uint8, uint16, float32 or float64, not int32"),
        (np.zeros((4, 5, 2), np.uint8), "1 or 3 channels"),
        (np.zeros(5, np.uint8), "1 or 3 channels"),
        (np.zeros((0, 5), np.uint8), "image is empty"),
        (np.full((4, 5), np.nan, np.float32), "NaN"),
    ],
)
def test_bad_image(image: np.ndarray, message: str) -> None:
    with pytest.raises(InputError, match=message):
        checks.as_image(image)


def test_single_channel_axis_is_dropped() -> None:
    assert checks.as_image(np.zeros((4, 5, 1), np.uint16)).shape == (4, 5)


def test_numbers() -> None:
    assert checks.require_positive("2.5", "square_size") == 2.5
    for bad in (0, -1, np.nan, np.inf, None, "big"):
        with pytest.raises(InputError, match="square_size must be"):
            checks.require_positive(bad, "square_size")  # type: ignore[arg-type]
    assert checks.require_integer(21.0, "block_size", minimum=1, odd=True) == 21
    for value, message in ((20, "odd"), (0, "at least 1"), (2.5, "whole"), (True, "whole"), ("many", "whole")):
        with pytest.raises(InputError, match=message):
            checks.require_integer(value, "block_size", minimum=1, odd=True)
    with pytest.raises(InputError, match="from 1 to 255"):
        checks.require_integer(257, "block_size", minimum=1, maximum=255)
    with pytest.raises(InputError, match="backend must be one of numba, numpy, not 'cuda'"):
        checks.require_choice("cuda", ("numba", "numpy"), "backend")
