"""Outliers, priors, and the uncertainty of pixels and points."""

from __future__ import annotations

import numpy as np
import pytest
from camera_rigs import SIZE, board, camera, mono_views, rig, stereo_views

import stereocal as sc
from stereocal.base.least_squares import minimize_least_squares
from stereocal.camera.propagation import pixel_covariance, triangulation_covariance


def test_outliers_are_found_left_out_and_named() -> None:
    X = board()
    corners, _ = mono_views(camera(), X, 10, seed=1, noise=0.1)
    clean = sc.calibrate_camera(X, corners, SIZE)
    wrong = {(2, 7), (2, 30), (6, 53)}
    for view, point in wrong:
        corners[view][point] += (9, -6)
    found = sc.calibrate_camera(X, corners, SIZE, reject_outliers=True)
    assert {(c.view, c.point) for c in found.rejected} == wrong
    assert all("px from where the calibration draws it" in c.reason for c in found.rejected)
    assert found.rms < 1.02 * clean.rms
    assert [len(d) for d in found.residuals] == [54] * 10
    assert abs(found.camera.fx - clean.camera.fx) < clean.std[0]


def test_nothing_is_rejected_from_normal_noise() -> None:
    X = board()
    corners, _ = mono_views(camera(), X, 12, seed=3, noise=0.3)
    assert sc.calibrate_camera(X, corners, SIZE, reject_outliers=True).rejected == []


def test_priors_pull_by_their_weight() -> None:
    X = board()
    corners, _ = mono_views(camera(), X, 4, seed=2, noise=0.5)
    free = sc.calibrate_camera(X, corners, SIZE)
    sigma = free.std[0]
    far = sc.calibrate_camera(X, corners, SIZE, priors={"fx": (free.camera.fx + 4 * sigma, 1e6)})
    near = sc.calibrate_camera(X, corners, SIZE, priors={"fx": (free.camera.fx + sigma, 1e-6)})
    half = sc.calibrate_camera(X, corners, SIZE, priors={"fx": (free.camera.fx + sigma, sigma)})
    assert abs(far.camera.fx - free.camera.fx) < 1e-3 * sigma
    np.testing.assert_allclose(near.camera.fx, free.camera.fx + sigma, atol=1e-4)
    # two equally sure sources meet in the middle, and are surer by √2
    np.testing.assert_allclose(half.camera.fx, free.camera.fx + sigma / 2, atol=0.1 * sigma)
    np.testing.assert_allclose(half.std[0], sigma / np.sqrt(2), rtol=0.1)
    with pytest.raises(sc.InputError, match="priors name 'f'"):
        sc.calibrate_camera(X, corners, SIZE, priors={"f": (500, 1)})


def test_covariance_of_pixels_and_points_is_that_of_repeated_experiments() -> None:
    X, truth = board(), rig()
    left, right, _ = stereo_views(truth, X, 8, seed=5)
    rng = np.random.default_rng(0)
    target = np.array([[0.5, -0.3, 12.0], [2.0, 1.0, 25.0]])
    y_left, y_right = truth.left.project(target), truth.right.project(target @ truth.R.T + truth.T)
    pixels, points, claims, pixel_claims = [], [], [], []
    for _ in range(80):
        found = sc.calibrate_stereo(X, [y + rng.normal(0, 0.2, y.shape) for y in left],
                                    [y + rng.normal(0, 0.2, y.shape) for y in right], SIZE)  # fmt: skip
        r = found.rig
        noisy_left, noisy_right = (y + rng.normal(0, 0.1, y.shape) for y in (y_left, y_right))

        def misfit(p: np.ndarray, r=r, a=noisy_left, b=noisy_right) -> np.ndarray:
            P = p.reshape(-1, 3)
            return np.concatenate([(r.left.project(P) - a).ravel(), (r.right.project(P @ r.R.T + r.T) - b).ravel()])

        points.append(minimize_least_squares(misfit, target.ravel()).x)
        pixels.append(r.left.project(target).ravel())
        n = 5 + len(r.left.dist)
        claims.append(triangulation_covariance(target, r.left, r.right, r.R, r.T, found.covariance, corner_std=0.1))
        pixel_claims.append(pixel_covariance(target, r.left, found.covariance[:n, :n]))
    claimed = np.sqrt(np.mean([np.diagonal(c, axis1=1, axis2=2).ravel() for c in claims], axis=0))
    np.testing.assert_allclose(np.std(points, axis=0) / claimed, 1, atol=0.3)
    claimed = np.sqrt(np.mean([np.diagonal(c, axis1=1, axis2=2).ravel() for c in pixel_claims], axis=0))
    np.testing.assert_allclose(np.std(pixels, axis=0) / claimed, 1, atol=0.3)


def test_depth_noise_grows_with_the_square_of_the_distance() -> None:
    """For a rectified pair without distortion σ_Z = Z² σ_d / (f B), σ_d = √2 σ of a corner's coordinate."""
    cam = sc.Camera([[500, 0, 320], [0, 500, 240], [0, 0, 1]], None, SIZE)
    T, Z = np.array([-0.2, 0, 0]), np.array([1.0, 2.0, 5.0])
    X = np.column_stack([np.full(3, 0.1), np.zeros(3), Z])
    C = triangulation_covariance(X, cam, cam, np.eye(3), T, np.zeros((26, 26)), corner_std=0.1)
    np.testing.assert_allclose(np.sqrt(C[:, 2, 2]), Z**2 * np.sqrt(2) * 0.1 / (500 * 0.2), rtol=1e-12)
