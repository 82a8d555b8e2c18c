"""The engine: its compiled twin equals the equations, and its iteration ends where nothing is left to win."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from camera_rigs import SIZE, board, camera, mono_views
from hypothesis import given, settings
from hypothesis import strategies as st

import stereocal as sc
from stereocal.base.rotations import rotation_matrices, rotation_matrix
from stereocal.camera.bundle import Bundle, BundleState, normal_equations, residuals
from stereocal.camera.bundle_compiled import CompiledEngine
from stereocal.camera.bundle_problem import intrinsics_of, make_bundle
from stereocal.camera.bundle_solver import NumpyEngine, solve_bundle
from stereocal.camera.bundle_sums import EquationsFromSums, has_sums
from stereocal.camera.covariance import bundle_covariance
from stereocal.camera.distortion import MODELS
from stereocal.camera.parameters import free_columns, intrinsic_names

LENSES = {
    "brown": [-0.28, 0.09, 0.001, -0.0005, 0.01],
    "tilted": [-0.2, 0.05, 0.001, -0.0005, 0.01, 0.08, 0.02, 0.005, 0.002, -0.001, 0.001, 0.002, 0.02, -0.03],
    "fisheye": [0.05, -0.02, 0.01, -0.003],
}


def rig_problem(model: str, seed: int, *, weights: bool) -> tuple[Bundle, BundleState]:
    """Two cameras, five views of which each camera missed one, and a state a little off the optimum."""
    rng, cam, X = np.random.default_rng(seed), camera(model, LENSES[model]), board(9, 8)  # more points than a chunk
    corners, where = mono_views(cam, X, 5, seed=seed, noise=0.5)
    R_rig, t_rig = rotation_matrix(rng.normal(0, 0.05, 3)), rng.normal([-3, 0, 0], 0.5)
    R_views = rotation_matrices(np.array([r for r, _ in where]))
    t_views = np.array([t for _, t in where])
    seen = np.array(corners)  # the right camera's corners: anything near will do
    left, right = list(seen), list(seen + rng.normal(0, 5, seen.shape))
    left[1], right[3] = np.zeros((0, 2)), np.zeros((0, 2))
    names = intrinsic_names(MODELS[model])
    one = free_columns(names, {"skew"}, 1.01)
    G = np.zeros((2 * len(names) + 6, 2 * one.shape[1] + 6))
    G[: len(names), : one.shape[1]] = G[len(names) : -6, one.shape[1] : -6] = one
    G[-6:, -6:] = np.eye(6)
    bundle = make_bundle([MODELS[model]] * 2, [[X] * 5] * 2, [left, right], G)
    if weights:
        bundle.whitening = np.eye(2) + rng.normal(0, 0.1, (len(bundle.points), 2, 2))
        bundle.loss, bundle.loss_scale = "huber", 2.0
    theta = intrinsics_of(cam)
    state = BundleState([theta, theta * 1.01], np.stack([np.eye(3), R_rig]), np.stack([np.zeros(3), t_rig]),
                        R_views, t_views)  # fmt: skip
    return bundle, state


@pytest.mark.parametrize("weights", [False, True])
@pytest.mark.parametrize("model", LENSES)
@settings(max_examples=4)
@given(seed=st.integers(0, 10**6))
def test_equations_and_steps_of_the_twins_are_equal(model: str, weights: bool, seed: int) -> None:
    bundle, state = rig_problem(model, seed, weights=weights)
    fast, slow = CompiledEngine(bundle, state), NumpyEngine(bundle, state)
    for _ in range(2):  # at the start, and where a step leads
        a, b = fast.equations, slow.equations
        np.testing.assert_allclose(a.cost, b.cost, rtol=1e-11)
        for name in ("U", "b_shared", "V", "b_views", "W"):
            expected = getattr(b, name)
            np.testing.assert_allclose(getattr(a, name), expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())
        np.testing.assert_allclose(a.residuals, b.residuals, atol=1e-9)
        np.testing.assert_allclose(a.residuals, residuals(bundle, slow.state()), atol=1e-9)
        np.testing.assert_allclose(fast.gradient_norm(), slow.gradient_norm(), rtol=1e-8)
        np.testing.assert_allclose(fast.propose(1e-2), slow.propose(1e-2), rtol=1e-6)
        fast.accept()
        slow.accept()
        np.testing.assert_allclose(fast.state().R_rig, slow.state().R_rig, atol=1e-9)
        np.testing.assert_allclose(fast.state().R_views, slow.state().R_views, atol=1e-9)


@pytest.mark.parametrize("model", ["fov", "division", "polynomial_printed", "rational_function"])
@settings(max_examples=3)
@given(seed=st.integers(0, 10**6))
def test_sums_by_a_kernel_are_those_of_the_equations(model: str, seed: int) -> None:
    """With skew and a tied fx, at a start, at another place, and there with other corners, behind the camera too."""
    rng, X, lens = np.random.default_rng(seed), board(6, 5), MODELS[model]
    corners, where = mono_views(camera(), X, 3, seed=seed, noise=0.5)
    G = free_columns(intrinsic_names(lens), set(lens.fixed_by_default), 1.01)
    bundle = make_bundle([lens], [[X] * 3], [corners], G)
    k = lens.start() + rng.normal(0, 0.01, lens.parameter_count) * G[5:].any(axis=1)
    theta = np.concatenate([intrinsics_of(camera())[:4], [0.7], k])
    R, t = rotation_matrices(np.array([r for r, _ in where])), np.array([t for _, t in where])
    state = BundleState([theta], np.eye(3)[None], np.zeros((1, 3)), R, t)
    there = state.moved(G @ rng.normal(0, 1e-4, G.shape[1]), rng.normal(0, 1e-3, (3, 6)))
    other = replace(bundle, measured=bundle.measured + rng.normal(0, 1, bundle.measured.shape))
    assert has_sums(bundle)
    sums = EquationsFromSums()
    for part, at in ((bundle, state), (bundle, there), (other, there), (bundle, state)):
        a, b = sums(part, at), normal_equations(part, at)
        assert np.isfinite(b.cost)
        np.testing.assert_allclose(a.cost, b.cost, rtol=1e-11)
        for name in ("U", "b_shared", "V", "b_views", "W", "residuals"):
            expected = getattr(b, name)
            np.testing.assert_allclose(getattr(a, name), expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
    behind = BundleState(state.intrinsics, state.R_rig, state.t_rig, R, -t)
    assert sums(bundle, behind).cost == normal_equations(bundle, behind).cost == np.inf


@pytest.mark.parametrize("model", ["brown", "fisheye"])
def test_covariance_of_the_twins_is_equal(model: str) -> None:
    bundle, state = rig_problem(model, 3, weights=False)
    fast, slow = (engine(bundle, state).equations for engine in (CompiledEngine, NumpyEngine))
    assert fast.factors is not None
    assert slow.factors is None
    a, b = bundle_covariance(bundle, state, fast), bundle_covariance(bundle, state, slow)
    for name in ("shared", "shared_views", "views"):
        x, y = getattr(a, name), getattr(b, name)
        np.testing.assert_allclose(x, y, rtol=1e-5, atol=1e-7 * np.abs(y).max())


@pytest.mark.parametrize("noise", [0.05, 1.0])
def test_the_iteration_ends_at_the_optimum(noise: float) -> None:
    X = board()
    corners, _ = mono_views(camera(), X, 8, seed=4, noise=noise)
    found = sc.calibrate_camera(X, corners, SIZE)
    again = sc.calibrate_camera(X, corners, SIZE, initial=found.camera)
    assert found.converged
    np.testing.assert_allclose(found.rms, again.rms, rtol=1e-13)
    np.testing.assert_allclose(found.camera.K, again.camera.K, atol=1e-4 * found.std[:4].min())


def test_many_views_start_from_a_few_and_end_at_the_same_optimum() -> None:
    X = board(5, 4)
    corners, _ = mono_views(camera(), X, 230, seed=6, noise=0.3)
    found = sc.calibrate_camera(X, corners, SIZE)
    names = intrinsic_names(MODELS["brown"])
    bundle = make_bundle([MODELS["brown"]], [[X] * 230], [corners], free_columns(names, {"skew"}, None))
    start = BundleState([intrinsics_of(found.camera)], np.eye(3)[None], np.zeros((1, 3)),
                        rotation_matrices(found.rvecs), found.tvecs)  # fmt: skip
    away = replace(start, intrinsics=[start.intrinsics[0] * 1.02])
    full = solve_bundle(bundle, away)
    assert found.converged
    assert full.converged
    np.testing.assert_allclose(found.rms**2 * len(bundle.points), full.cost, rtol=1e-12)
    # a part of the views that is degenerate must not stand in the way: every fifth one seen in the same plane
    flat, _ = mono_views(camera(), X, 1, seed=7)
    corners[::5] = [flat[0] + np.random.default_rng(i).normal(0, 0.3, flat[0].shape) for i in range(46)]
    assert sc.calibrate_camera(X, corners, SIZE).converged


def test_a_pose_that_its_corners_do_not_hold_is_infinitely_unsure() -> None:
    X = board()
    corners, poses = mono_views(camera(), X, 4, seed=2, noise=0.1)
    lens = MODELS["brown"]
    G = free_columns(intrinsic_names(lens), {"skew"}, None)
    bundle = make_bundle([lens], [[X] * 4], [corners], G)
    R, t = (np.array([pose[k] for pose in poses]) for k in (0, 1))
    R = np.array([rotation_matrix(r) for r in R]) if R.ndim == 2 else R
    state = BundleState([intrinsics_of(camera())], np.eye(3)[None], np.zeros((1, 3)), R, t)
    equations = normal_equations(bundle, state)
    assert np.isfinite(bundle_covariance(bundle, state, equations).shared).all()
    values, Q = np.linalg.eigh(equations.V[1])
    equations = normal_equations(bundle, state)
    equations.V[1] = Q @ np.diag([1e-18 * values[-1], *values[1:]]) @ Q.T
    assert np.isinf(bundle_covariance(bundle, state, equations).shared).all()
