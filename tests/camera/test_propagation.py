"""Uncertainty carried to pixels and to points in space, against drawn errors and against its closed form."""

import numpy as np
import pytest

import stereocal as sc

SIZE = (640, 480)
LEFT = sc.Camera([[500, 0.3, 320], [0, 510, 240], [0, 0, 1]], [-0.25, 0.08, 0.001, -0.002, 0.01], SIZE)
RIGHT = sc.Camera([[480, 0, 300], [0, 470, 250], [0, 0, 1]], [0.05, -0.01, 0.002, -0.001], SIZE, model="fisheye")
RVEC, T = np.array([0.05, -0.2, 0.02]), np.array([-0.3, 0.01, 0.05])
POINTS = np.array([[0.1, -0.2, 1.5], [-0.3, 0.2, 2.0], [0.5, 0.4, 4.0]])


def _values(camera: sc.Camera) -> np.ndarray:
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.skew, *camera.dist])


def _camera(values: np.ndarray, like: sc.Camera) -> sc.Camera:
    fx, fy, cx, cy, s = values[:5]
    return sc.Camera([[fx, s, cx], [0, fy, cy], [0, 0, 1]], values[5:], like.image_size, like.model)


def _triangulate(values: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Where the rays of two corners meet, by Newton on the sum of squares: nothing of the library but project."""
    left, right = _camera(values[:10], LEFT), _camera(values[10:19], RIGHT)
    X = POINTS.copy()

    def project(X: np.ndarray) -> np.ndarray:
        return np.hstack([left.project(X), right.project(X, values[19:22], values[22:25])])

    for _ in range(6):
        g = np.stack([(project(X + e) - project(X - e)) / 2e-6 for e in 1e-6 * np.eye(3)], axis=2)
        X = X - np.stack([np.linalg.lstsq(a, b, rcond=None)[0] for a, b in zip(g, project(X) - corners, strict=True)])
    return X


def test_pixels_spread_as_drawn_parameters_make_them():
    rng = np.random.default_rng(0)
    A = rng.normal(0, 1, (10, 10)) * np.array([0.5, 0.5, 0.3, 0.3, 0.1, *[1e-4] * 5])[:, None]
    C = A @ A.T
    drawn = _values(LEFT) + rng.normal(size=(4000, 10)) @ A.T
    pixels = np.array([_camera(values, LEFT).project(POINTS) for values in drawn])
    claimed = sc.pixel_covariance(POINTS, LEFT, C)
    for i in range(len(POINTS)):
        np.testing.assert_allclose(np.cov(pixels[:, i].T), claimed[i], atol=0.08 * np.trace(claimed[i]))


def test_points_in_space_move_as_parameters_and_corners_do():
    values = np.concatenate([_values(LEFT), _values(RIGHT), RVEC, T])
    corners = np.hstack([LEFT.project(POINTS), RIGHT.project(POINTS, RVEC, T)])
    step = np.concatenate([[1e-2] * 5, [1e-5] * 5, [1e-2] * 5, [1e-5] * 4, [1e-5] * 6])
    J = np.stack(
        [
            (_triangulate(values + e, corners) - _triangulate(values - e, corners)) / (2 * h)
            for e, h in zip(np.diag(step), step, strict=True)
        ],
        axis=2,
    )
    B = np.stack(
        [(_triangulate(values, corners + e) - _triangulate(values, corners - e)) / 2e-3 for e in 1e-3 * np.eye(4)],
        axis=2,
    )
    A = np.random.default_rng(1).normal(0, 1, (25, 25)) * step[:, None]
    C = A @ A.T
    expected = J @ C @ J.transpose(0, 2, 1) + 0.2**2 * B @ B.transpose(0, 2, 1)
    claimed = sc.triangulation_covariance(POINTS, LEFT, RIGHT, sc.rotation_matrix(RVEC), T, C, corner_std=0.2)
    np.testing.assert_allclose(claimed, expected, rtol=1e-4, atol=1e-6 * np.abs(expected).max())


def test_what_a_camera_does_not_see_has_no_covariance():
    X = np.array([[0, 0, 2.0], [0, 0, -2.0]])
    pixels = sc.pixel_covariance(X, LEFT, np.eye(10))
    assert np.isfinite(pixels[0]).all()
    assert np.isnan(pixels[1]).all()
    points = sc.triangulation_covariance(X, LEFT, RIGHT, np.eye(3), T, np.eye(25))
    assert np.isfinite(points[0]).all()
    assert np.isnan(points[1]).all()


@pytest.mark.parametrize("wrong", [np.eye(9), np.ones(10), np.ones((10, 11))])
def test_a_covariance_of_another_size_is_refused(wrong):
    with pytest.raises(sc.InputError, match=r"covariance must have shape \(10, 10\)"):
        sc.pixel_covariance(POINTS, LEFT, wrong)
    with pytest.raises(sc.InputError, match=r"covariance must have shape \(25, 25\)"):
        sc.triangulation_covariance(POINTS, LEFT, RIGHT, np.eye(3), T, wrong)


def test_a_negative_spread_of_corners_is_refused():
    with pytest.raises(sc.InputError, match="corner_std must not be negative"):
        sc.triangulation_covariance(POINTS, LEFT, RIGHT, np.eye(3), T, np.eye(25), corner_std=-1)
