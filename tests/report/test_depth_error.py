from __future__ import annotations

import numpy as np
import pytest
from report_cases import Case, make_case

from stereocal.report.depth_error import depth_sensitivity, examine_depth, seen_pixels
from stereocal.report.rig_parameters import (
    depth_jacobian,
    depths,
    lens_domain,
    rig_of_vector,
    rig_vector,
    scene_points,
)


def test_a_rig_survives_being_a_vector(healthy: Case) -> None:
    rig = healthy.calibration.rig
    again = rig_of_vector(rig_vector(rig), rig)
    np.testing.assert_allclose(again.left.K, rig.left.K)
    np.testing.assert_allclose(again.right.dist, rig.right.dist)
    np.testing.assert_allclose(again.R, rig.R, atol=1e-12)
    np.testing.assert_allclose(again.T, rig.T)
    assert len(rig_vector(rig)) == len(healthy.calibration.parameter_names)


def test_depth_of_projected_points_is_their_depth(healthy: Case) -> None:
    rig = healthy.truth
    kept, left, right = scene_points(rig, seen_pixels(healthy.evidence), 900.0)
    assert kept.sum() > 10
    np.testing.assert_allclose(depths(rig, left, right), 900.0, rtol=1e-7)


def test_depth_jacobian_predicts_a_small_change(healthy: Case) -> None:
    rig = healthy.calibration.rig
    _, left, right = scene_points(rig, seen_pixels(healthy.evidence), 700.0)
    J = depth_jacobian(rig, left, right)
    random = np.random.default_rng(0)
    change = random.normal(size=J.shape[1]) * np.maximum(np.asarray(healthy.calibration.std), 1e-9) * 1e-3
    moved = depths(rig_of_vector(rig_vector(rig) + change, rig), left, right)
    np.testing.assert_allclose(moved - depths(rig, left, right), J @ change, rtol=2e-3, atol=1e-6)


def test_promised_sigma_covers_the_truth() -> None:
    """Over rigs calibrated from noise, the depth error at the boards scatters as the covariance says."""
    squares = []
    for seed in range(12):
        case = make_case(seed=100 + seed, views=10, noise=0.15)
        pixels = seen_pixels(case.evidence)
        sigma = depth_sensitivity(case.calibration.rig, pixels, np.array([600.0])).sigma(case.calibration.covariance)[0]
        _, left, right = scene_points(case.truth, pixels, 600.0)
        error = depths(case.calibration.rig, left, right) - 600.0
        squares.append(np.mean(error**2) / sigma**2)
    assert 0.4 < np.mean(squares) < 2.0


def test_sigma_grows_as_the_square_of_distance(healthy: Case) -> None:
    block = examine_depth(healthy.evidence, np.asarray(healthy.calibration.covariance), None, disparity_noise=0.5)
    z, noise = np.array(block.facts["distance"]), np.array(block.facts["sigma_from_disparity"])
    rig = healthy.calibration.rig
    np.testing.assert_allclose(noise, z**2 * 0.5 / (rig.left.K[0, 0] * rig.baseline))


def test_a_lens_that_folds_inside_the_image_is_seen() -> None:
    from stereocal.camera.model import Camera

    K = [[400, 0, 319.5], [0, 400, 239.5], [0, 0, 1]]
    assert lens_domain(Camera(K, [-0.1, 0, 0, 0, 0], (640, 480))).share == pytest.approx(1)
    folding = Camera(K, [-0.6, 0.0, 0, 0, 0], (640, 480))  # folds at r = 1/√1.8, r(1 − 0.6 r²) = 0.497: 199 px
    domain = lens_domain(folding)
    assert domain.reach.max() == pytest.approx(400 * (2 / 3) / np.sqrt(1.8), rel=0.01)
    assert domain.contains(np.array([[319.5 + 150, 239.5], [319.5 + 250, 239.5]])).tolist() == [True, False]
    assert 0.3 < domain.share < 0.7
