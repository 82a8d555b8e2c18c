"""Projection as OpenCV's users call it: every shape and number of coefficients, small angles, points behind."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

import stereocal as sc
from stereocal.base.homogeneous import cross_matrix
from stereocal.camera.distortion import model_meant

K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
ALL = [-0.2, 0.05, 0.001, -0.002, 0.01, 0.1, 0.02, 0.001, 0.001, 0.002, -0.001, 5e-4, 0.02, -0.03]
X = np.random.default_rng(0).uniform([-1, -1, 4], [1, 1, 6], (40, 3))
POSE = np.array([0.3, -0.2, 0.1]), np.array([0.1, -0.2, 1.0])


@pytest.mark.parametrize("count", [0, 4, 5, 8, 12, 14])
def test_coefficients_of_every_number_without_a_model_s_name(count: int) -> None:
    """Equal to cv2.projectPoints, its derivatives by rvec, tvec, f, c and k included."""
    dist = np.array(ALL[:count])
    y, J = cv2.projectPoints(X, *POSE, K, dist if count else None)
    shapes = [None, []] if count == 0 else [dist, dist[None], dist[:, None], dist.tolist()]
    for given in shapes:
        found, found_J = sc.project_points(X, *POSE, K, given, jacobian=True)
        np.testing.assert_allclose(found, y[:, 0], atol=1e-10)
        columns = 10 + count
        np.testing.assert_allclose(found_J[:, :columns], J[:, :columns], atol=1e-10 * np.abs(J).max())
        np.testing.assert_allclose(sc.Camera(K, given, (640, 480)).project(X, *POSE), y[:, 0], atol=1e-10)
        back = sc.undistort_points(found, K, given, P=np.eye(3))
        X_c = X @ sc.rotation_matrix(POSE[0]).T + POSE[1]
        np.testing.assert_allclose(back, X_c[:, :2] / X_c[:, 2:], atol=1e-10)


def test_the_number_of_coefficients_corrects_the_default_only() -> None:
    assert model_meant(ALL, "brown") == "tilted"
    assert model_meant([*ALL[:5], *[0] * 9], "brown") == "brown"
    assert model_meant(ALL[:4], "fisheye") == "fisheye"
    with pytest.raises(sc.InputError, match="model 'rational' has 8"):
        sc.project_points(X, *POSE, K, ALL, model="rational")
    with pytest.raises(sc.InputError, match="dist holds 7 coefficients"):
        sc.project_points(X, *POSE, K, ALL[:7])


@pytest.mark.parametrize("points", [X, X[:, None], X[None], X.tolist(), np.asfortranarray(X), X[::2]])
@pytest.mark.parametrize("shape", [(3,), (3, 1), (1, 3), (1, 1, 3)])
def test_shapes(points, shape: tuple[int, ...]) -> None:
    expected = cv2.projectPoints(np.array(points).reshape(-1, 1, 3), *POSE, K, np.array(ALL[:5]))[0][:, 0]
    rvec, tvec = (v.reshape(shape) for v in POSE)
    np.testing.assert_allclose(sc.project_points(points, rvec, tvec, K, ALL[:5]), expected, atol=1e-10)


def test_single_precision_is_read_and_doubles_are_returned() -> None:
    y = sc.project_points(X.astype(np.float32), *(v.astype(np.float32) for v in POSE), K.astype(np.float32))
    assert y.dtype == np.float64
    np.testing.assert_allclose(y, sc.project_points(X, *POSE, K), atol=1e-3)


@pytest.mark.parametrize("rvec", [np.eye(3), [0, 0], "abc", None, [0, 0, np.nan]])
def test_no_rotation_vector(rvec) -> None:
    with pytest.raises(sc.InputError, match="rvec"):
        sc.project_points(X, rvec, [0, 0, 1], K)


def test_no_points() -> None:
    y, J = sc.project_points(np.zeros((0, 3)), *POSE, K, ALL[:5], jacobian=True)
    assert (y.shape, J.shape) == ((0, 2), (0, 15))


def test_behind_the_camera_there_is_no_picture() -> None:
    y = sc.project_points([[0.1, 0.2, 1], [0.1, 0.2, 0], [0.1, 0.2, -1]], [0, 0, 0], [0, 0, 0], K)
    np.testing.assert_array_equal(np.isnan(y), [[False] * 2, [True] * 2, [True] * 2])


@pytest.mark.parametrize("theta", [0.0, 1e-15, 1e-12, 1e-8, 1e-6, 1e-4])
def test_the_derivative_by_a_small_rotation_vector_is_exact(theta: float) -> None:
    """∂R/∂rᵢ = [eᵢ] + ½([eᵢ][r] + [r][eᵢ]) + O(θ²). Between 1e-12 and 1e-6 cv2.Rodrigues loses half of its digits."""
    r = theta * np.array([0.6, -0.48, 0.64])
    rx = cross_matrix(r)
    _, J = sc.project_points(X, r, POSE[1], K, jacobian=True)
    X_c = X @ sc.rotation_matrix(r).T + POSE[1]
    x = X_c[:, :2] / X_c[:, 2:]
    for i, e in enumerate(np.eye(3)):
        ex = cross_matrix(e)
        moved = X @ (ex + 0.5 * (ex @ rx + rx @ ex)).T
        by_r = np.diag(K)[:2] * (moved[:, :2] - x * moved[:, 2:]) / X_c[:, 2:]
        np.testing.assert_allclose(J[:, i].reshape(-1, 2), by_r, atol=1e-10 + 2e3 * theta**2)


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, -1, 0], [0.6, 0, 0.8], [0.36, 0.48, -0.8]])
def test_half_turns_and_beyond(axis: list[float]) -> None:
    for angle in (np.pi - 1e-9, np.pi, np.pi + 1e-9, 1.5 * np.pi, 3 * np.pi):
        r = angle * np.array(axis, dtype=float)
        y, J = cv2.projectPoints(X, r, np.array([0, 0, 20.0]), K, None)
        found, found_J = sc.project_points(X, r, [0, 0, 20], K, jacobian=True)
        np.testing.assert_allclose(found, y[:, 0], atol=1e-9)
        np.testing.assert_allclose(found_J[:, :10], J[:, :10], atol=1e-8)


def test_the_sensor_s_tilt_is_undone_in_both_twins() -> None:
    k = [*ALL[:12], 0.2, -0.3]
    grid = np.random.default_rng(1).uniform(-3, 3, (2000, 2))
    fast, slow = (sc.camera.distortion.undistort_normalized(grid, k, "tilted", backend=b) for b in ("numba", "numpy"))
    assert 0 < np.isnan(fast[:, 0]).sum() < 500
    np.testing.assert_allclose(fast, slow, atol=1e-10)
    inside = np.isfinite(fast[:, 0])
    there = sc.camera.distortion.distort_normalized(fast[inside], k, "tilted")
    np.testing.assert_allclose(there, grid[inside], atol=1e-12)
