from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given
from strategies import rotation_vectors

from stereocal.base.rotations import (
    left_jacobian_inverse,
    rotation_matrices,
    rotation_matrix,
    rotation_matrix_jacobian,
    rotation_vector,
)
from stereocal.base.rotations import rotation_vectors as rotation_vectors_of


@given(rotation_vectors)
def test_matrix_is_a_rotation_and_equals_opencv(rvec: np.ndarray) -> None:
    R = rotation_matrix(rvec)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) > 0
    np.testing.assert_allclose(R, cv2.Rodrigues(rvec)[0], atol=1e-14)


@given(rotation_vectors)
def test_vector_inverts_matrix(rvec: np.ndarray) -> None:
    R = rotation_matrix(rvec)
    back = rotation_vector(R)
    assert np.linalg.norm(back) <= np.pi + 1e-12
    np.testing.assert_allclose(rotation_matrix(back), R, atol=1e-13)
    if np.linalg.norm(rvec) < 3:
        np.testing.assert_allclose(back, rvec, atol=1e-13)


@given(rotation_vectors)
def test_jacobian_equals_central_differences(rvec: np.ndarray) -> None:
    h = 1e-6
    for i, analytic in enumerate(rotation_matrix_jacobian(rvec)):
        e = np.zeros(3)
        e[i] = h
        numeric = (rotation_matrix(rvec + e) - rotation_matrix(rvec - e)) / (2 * h)
        np.testing.assert_allclose(analytic, numeric, atol=2e-9)


@given(rotation_vectors, rotation_vectors)
def test_many_at_once_equal_one_by_one(first: np.ndarray, second: np.ndarray) -> None:
    both = np.stack([first, second])
    R = rotation_matrices(both)
    np.testing.assert_allclose(R, np.stack([rotation_matrix(first), rotation_matrix(second)]), atol=1e-14)
    for found, one in zip(rotation_vectors_of(R), R, strict=True):
        np.testing.assert_allclose(rotation_matrix(found), one, atol=1e-13)


@given(rotation_vectors)
def test_left_jacobian_inverse_takes_a_turn_to_the_change_of_the_vector(rvec: np.ndarray) -> None:
    if np.linalg.norm(rvec) > 3:
        return  # next to a half turn the vector jumps to the other side
    J, h = left_jacobian_inverse(rvec[None])[0], 1e-6
    for axis in np.eye(3):
        change = rotation_vector(rotation_matrix(h * axis) @ rotation_matrix(rvec))
        change -= rotation_vector(rotation_matrix(-h * axis) @ rotation_matrix(rvec))
        np.testing.assert_allclose(change / (2 * h), J @ axis, atol=1e-6)
