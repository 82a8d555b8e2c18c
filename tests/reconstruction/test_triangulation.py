"""Triangulation: against OpenCV, the truth, and the scatter of many noisy pairs."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from strategies import seeds
from two_view_scenes import K, two_views

from stereocal.base.errors import DegenerateGeometryError, InputError
from stereocal.reconstruction.triangulation import (
    depths,
    fundamental_of_projections,
    triangulate_points,
    triangulate_points_detailed,
)


def projections(view) -> tuple[np.ndarray, np.ndarray]:
    return K @ np.eye(3, 4), K @ np.column_stack([view.R, view.T])


@pytest.mark.parametrize("method", ["linear", "midpoint", "optimal"])
@given(seed=seeds)
@settings(max_examples=25)
def test_exact_matches_give_the_points_back(method, seed) -> None:
    view = two_views(seed)
    X = triangulate_points(*projections(view), view.left, view.right, method=method)
    np.testing.assert_allclose(X, view.X, rtol=1e-6, atol=1e-6)


@given(seed=seeds)
@settings(max_examples=25)
def test_linear_equals_opencv(seed) -> None:
    view = two_views(seed, noise=1.0)
    theirs = cv2.triangulatePoints(*projections(view), view.left.T, view.right.T)
    ours = triangulate_points(*projections(view), view.left, view.right)
    np.testing.assert_allclose(ours, (theirs[:3] / theirs[3]).T, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("method", ["linear", "optimal"])
@given(seed=seeds)
@settings(max_examples=15)
def test_kernels_equal_their_twins(method, seed) -> None:
    view = two_views(seed, noise=1.0)
    ours, twin = (
        triangulate_points(*projections(view), view.left, view.right, method=method, backend=backend)
        for backend in ("numba", "numpy")
    )
    np.testing.assert_allclose(ours, twin, rtol=1e-8, atol=1e-10)


@given(seed=seeds)
@settings(max_examples=25)
def test_optimal_has_the_smallest_reprojection_error(seed) -> None:
    view = two_views(seed, noise=2.0)
    P = projections(view)
    best = triangulate_points_detailed(*P, view.left, view.right).errors
    for method in ("linear", "midpoint"):
        other = triangulate_points_detailed(*P, view.left, view.right, method=method).errors
        assert np.all(best <= other * (1 + 1e-9) + 1e-9)


def test_covariance_is_the_scatter_of_many_noisy_pairs() -> None:
    view = two_views(4, count=1)
    P, sigma, many = projections(view), 0.3, 4000
    random = np.random.default_rng(0)
    left, right = (p + sigma * random.normal(size=(many, 2)) for p in (view.left, view.right))
    result = triangulate_points_detailed(*P, left, right, sigma=sigma)
    predicted = triangulate_points_detailed(*P, view.left, view.right, sigma=sigma).covariances[0]
    np.testing.assert_allclose(np.cov(result.points.T), predicted, rtol=0.12, atol=0.05 * np.trace(predicted))
    assert np.sqrt(predicted[2, 2]) > 2 * np.sqrt(predicted[0, 0])  # long along the line of sight


def test_points_behind_a_camera_are_told() -> None:
    view = two_views(1)
    P1, P2 = projections(view)
    assert triangulate_points_detailed(P1, P2, view.left, view.right).in_front.all()
    turned = K @ np.column_stack([view.R, -view.T])  # the wrong one of the four motions
    assert not triangulate_points_detailed(P1, turned, view.left, view.right).in_front.any()
    np.testing.assert_allclose(depths(P1, view.X), view.X[:, 2])
    np.testing.assert_allclose(depths(-3 * P1, view.X), view.X[:, 2])  # P is known up to scale and sign


def test_parallel_rays_are_infinitely_far_and_infinitely_unsure() -> None:
    P1, P2 = K @ np.eye(3, 4), K @ np.column_stack([np.eye(3), [-1.0, 0, 0]])
    result = triangulate_points_detailed(P1, P2, [[320.0, 240.0]], [[320.0, 240.0]], method="linear")
    assert not np.isfinite(result.points).all() or np.abs(result.points).max() > 1e12
    assert not result.in_front[0] or np.abs(result.points).max() > 1e12


def test_fundamental_of_projections_holds_for_matches() -> None:
    view = two_views(2)
    F = fundamental_of_projections(*projections(view))
    x, xp = (np.column_stack([p, np.ones(len(p))]) for p in (view.left, view.right))
    np.testing.assert_allclose(np.sum(xp * (x @ F.T), axis=1), 0, atol=1e-9)


def test_bad_input_is_refused() -> None:
    P = K @ np.eye(3, 4)
    with pytest.raises(DegenerateGeometryError, match="same point"):
        triangulate_points(P, P, [[1.0, 2.0]], [[1.0, 2.0]], method="optimal")
    with pytest.raises(DegenerateGeometryError, match="same point"):
        triangulate_points(P, P, [[1.0, 2.0]], [[1.0, 2.0]], method="midpoint")
    with pytest.raises(InputError, match=r"\(3, 4\)"):
        triangulate_points(np.eye(3), P, [[1.0, 2.0]], [[1.0, 2.0]])
    with pytest.raises(InputError, match="method must be one of"):
        triangulate_points(P, P, [[1.0, 2.0]], [[1.0, 2.0]], method="guess")
