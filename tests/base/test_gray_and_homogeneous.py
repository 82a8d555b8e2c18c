from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import seeds

from stereocal.base.gray import to_gray
from stereocal.base.homogeneous import cross_matrix, from_homogeneous, to_homogeneous


@given(seeds, st.sampled_from([np.uint8, np.uint16]), st.sampled_from([3, 4]))
def test_gray_equals_opencv(seed: int, dtype: type, channels: int) -> None:
    image = np.random.default_rng(seed).integers(0, np.iinfo(dtype).max, (9, 13, channels), dtype, endpoint=True)
    rgb = np.ascontiguousarray(image[..., :3])
    np.testing.assert_array_equal(to_gray(image), cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY))


def test_gray_of_gray_is_itself_and_of_float_is_the_formula() -> None:
    gray = np.arange(12, dtype=np.uint8).reshape(3, 4)
    np.testing.assert_array_equal(to_gray(gray), gray)
    rgb = np.random.default_rng(0).random((3, 4, 3))
    np.testing.assert_allclose(to_gray(rgb), rgb @ [0.299, 0.587, 0.114])


@given(seeds)
def test_homogeneous_round_trip_and_cross_product(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(6, 3))
    np.testing.assert_allclose(from_homogeneous(3.5 * to_homogeneous(points)), points)
    v, w = rng.normal(size=(2, 3))
    np.testing.assert_allclose(cross_matrix(v) @ w, np.cross(v, w))


def test_points_at_infinity_are_infinite_without_a_warning() -> None:
    with np.errstate(all="raise"):
        assert np.isinf(from_homogeneous(np.array([[1.0, 2.0, 0.0]]))).all()


def test_gray_refuses_what_is_no_image() -> None:
    with pytest.raises(ValueError, match="channels"):
        to_gray(np.zeros((4, 4, 2), np.uint8))
