"""The compiled solvers, scores and refinement against their readable twins, OpenCV and finite differences."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from strategies import seeds
from two_view_scenes import K, two_views

from stereocal.base.homogeneous import cross_matrix, to_homogeneous
from stereocal.pair.consensus import best_model, draw_samples
from stereocal.pair.essential import fit_essential_detailed
from stereocal.pair.fundamental import fit_fundamental_detailed
from stereocal.pair.two_view_models import TwoViewModel, essential_model, fundamental_model
from stereocal.pair.two_view_refinement import refine_model
from stereocal.pair.two_view_solvers import minimal_models, normalizing_transform

INVERSE = np.linalg.inv(K)


def nearest(one: np.ndarray, many: np.ndarray) -> float:
    """Largest difference of a matrix from the most similar of many, up to sign."""
    return float(np.minimum(np.abs(many - one).max(axis=1), np.abs(many + one).max(axis=1)).min())


def models_near(view, seed: int) -> tuple[TwoViewModel, TwoViewModel, np.ndarray]:
    """An F and a motion near the true ones, and the matches as rows."""
    E = cross_matrix(view.T) @ view.R
    off = 1 + 0.01 * np.random.default_rng(seed).normal(size=(3, 3))
    T1, T2 = normalizing_transform(view.left), normalizing_transform(view.right)
    F = np.linalg.inv(T2).T @ INVERSE.T @ E @ INVERSE @ np.linalg.inv(T1)
    points = np.ascontiguousarray(np.hstack([view.left, view.right]).T)
    return fundamental_model(F * off, T2, T1), essential_model(E * off, INVERSE, INVERSE), points


@given(seed=seeds)
@settings(max_examples=30)
def test_minimal_kernels_find_what_their_twins_find(seed) -> None:
    view = two_views(seed, noise=0.5, wrong=0.3, count=40)
    x, xp = to_homogeneous(view.left) @ INVERSE.T, to_homogeneous(view.right) @ INVERSE.T
    for size in (5, 7):
        # other ways through the algebra: only well-conditioned solutions agree to all digits
        samples = draw_samples(np.random.default_rng(seed), 4, size, 40)
        ours, twin = (minimal_models(x, xp, samples, backend=backend) for backend in ("numba", "numpy"))
        np.testing.assert_allclose(np.linalg.norm(ours, axis=1), 1)
        off = [nearest(one, ours) for one in twin] + [nearest(one, twin) for one in ours]
        assert np.quantile(off, 0.75) < 1e-7
        assert abs(len(ours) - len(twin)) <= 2  # a double root may be seen by one only
        for sample in samples:
            for matrix in minimal_models(x, xp, sample[None]).reshape(-1, 3, 3):
                assert np.abs(np.sum((xp[sample] @ matrix) * x[sample], axis=1)).max() < 1e-12
                EEt = matrix @ matrix.T
                if size == 5:
                    assert np.abs(2 * EEt @ matrix - np.trace(EEt) * matrix).max() < 1e-4
                assert abs(np.linalg.det(matrix)) < 1e-4


@given(seed=seeds)
@settings(max_examples=20)
def test_scores_choose_the_same_model(seed) -> None:
    view = two_views(seed, noise=0.5, wrong=0.4, count=150)
    points = np.hstack([view.left, view.right]).T.copy()
    x, xp = to_homogeneous(view.left) @ INVERSE.T, to_homogeneous(view.right) @ INVERSE.T
    models = minimal_models(x, xp, draw_samples(np.random.default_rng(seed), 20, 7, 150)) @ np.kron(INVERSE, INVERSE)
    for score in ("msac", "lmeds"):
        ours = best_model(models, points, score, 1.0)
        twin = best_model(models, points, score, 1.0, backend="numpy")
        assert ours[0] == twin[0]
        assert ours[1] == pytest.approx(twin[1], rel=1e-9)
    F = models[ours[0]].reshape(3, 3)
    ones = np.ones(1)
    theirs = [
        cv2.sampsonDistance(np.append(a, ones).reshape(3, 1), np.append(b, ones).reshape(3, 1), F)
        for a, b in zip(view.left, view.right, strict=True)
    ]
    assert best_model(models[ours[0]][None], points, "msac", 1.0)[1] == pytest.approx(np.minimum(theirs, 1).sum())


def test_draws_are_distinct_equal_in_both_backends_and_all_equally_likely() -> None:
    ours, twin = (
        draw_samples(np.random.default_rng(3), 20_000, 3, 6, backend=backend) for backend in ("numba", "numpy")
    )
    np.testing.assert_array_equal(ours, twin)
    ours = np.sort(ours, axis=1)
    assert np.all(np.diff(ours, axis=1) > 0)
    assert ours.min() == 0
    assert ours.max() == 5
    counts = np.unique(ours, axis=0, return_counts=True)[1]
    assert len(counts) == 20  # 6 over 3
    assert np.abs(counts - 1000).max() < 5 * np.sqrt(1000)


@given(seed=seeds)
@settings(max_examples=20)
def test_derivatives_are_those_of_a_step(seed) -> None:
    for model in models_near(two_views(seed), seed)[:2]:
        assert model.F.ravel() @ model.F.ravel() == pytest.approx(1)
        F, D, h = model.F.ravel(), model.derivatives(), 1e-6
        for step, row in zip(np.eye(model.freedom), D, strict=True):
            numeric = (model.advanced(h * step).F - model.advanced(-h * step).F).ravel() / (2 * h)
            # F is kept at norm 1, which the derivatives leave to the caller
            np.testing.assert_allclose(numeric, row - (row @ F) * F, atol=1e-7 * max(1, np.abs(D).max()))


@pytest.mark.parametrize(("extent", "exact"), [(0.0, True), (25.0, False), (25.0, True)])
@given(seed=seeds)
@settings(max_examples=8)
def test_refinement_kernel_takes_its_twins_steps(extent, exact, seed) -> None:
    view = two_views(seed, noise=0.5, wrong=0.3 if extent else 0.0, count=130)
    *models, points = models_near(view, seed)
    for model in models:
        ours, twin = (
            refine_model(model, points, reach=5.0, extent=extent, exact=exact, rounds=8, backend=backend)
            for backend in ("numba", "numpy")
        )
        np.testing.assert_allclose(ours.model.state, twin.model.state, atol=1e-6)
        np.testing.assert_allclose(ours.F, twin.F, atol=1e-8)
        np.testing.assert_allclose(ours.weights, twin.weights, atol=1e-5)
        assert ours.cost == pytest.approx(twin.cost, rel=1e-6)
        assert ours.log_likelihood == pytest.approx(twin.log_likelihood, rel=1e-7)
        np.testing.assert_allclose(
            ours.covariance, twin.covariance, rtol=1e-4, atol=1e-6 * np.abs(twin.covariance).max()
        )


@given(seed=seeds)
@settings(max_examples=15)
def test_distances_are_those_of_opencvs_corrected_matches(seed) -> None:
    view = two_views(seed, noise=1.0)
    model, _, points = models_near(view, seed)
    new_left, new_right = cv2.correctMatches(model.F, view.left[None].copy(), view.right[None].copy())
    theirs = np.sum((new_left[0] - view.left) ** 2, axis=1) + np.sum((new_right[0] - view.right) ** 2, axis=1)
    good = np.isfinite(theirs).astype(float)  # OpenCV finds no root for a few
    theirs = np.nansum(theirs)
    for backend in ("numba", "numpy"):
        ours = refine_model(model, points, good, rounds=0, backend=backend)
        assert ours.cost <= theirs * (1 + 1e-6)
        assert ours.cost == pytest.approx(theirs, rel=1e-3)


@pytest.mark.parametrize("method", ["ransac", "lmeds"])
def test_whole_fits_agree(method) -> None:
    view = two_views(4, count=100, noise=0.3, wrong=0.3)
    ours, twin = (
        fit_fundamental_detailed(view.left, view.right, method=method, backend=backend)
        for backend in ("numba", "numpy")
    )
    np.testing.assert_allclose(ours.F, twin.F, rtol=1e-4, atol=1e-8)
    np.testing.assert_array_equal(ours.inliers, twin.inliers)
    assert ours.iterations == twin.iterations
    ours, twin = (
        fit_essential_detailed(view.left, view.right, K, method=method, backend=backend)
        for backend in ("numba", "numpy")
    )
    np.testing.assert_allclose(ours.E, twin.E, atol=1e-5)
    np.testing.assert_allclose(ours.covariance, twin.covariance, rtol=1e-2, atol=1e-3 * np.abs(twin.covariance).max())
