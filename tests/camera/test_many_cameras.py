"""The engine takes any number of cameras, and a camera may miss a view: three cameras, no view seen by all."""

from __future__ import annotations

import numpy as np
import pytest
from camera_rigs import board, camera, poses
from scipy.linalg import block_diag

from stereocal.base.rotations import rotation_matrix
from stereocal.camera.bundle import BundleState
from stereocal.camera.bundle_problem import intrinsics_of, make_bundle
from stereocal.camera.bundle_solver import solve_bundle
from stereocal.camera.covariance import bundle_covariance
from stereocal.camera.distortion import MODELS
from stereocal.camera.parameters import fixed_names, free_columns, intrinsic_names

X = board()
CAMERAS = [
    camera(),
    camera("fisheye", (0.05, -0.02, 0.01, -0.003), f=420.0),
    camera("polynomial", (-0.2, 0.05), f=600.0),
]
R = np.stack([np.eye(3), rotation_matrix([0.01, 0.05, -0.02]), rotation_matrix([-0.02, -0.04, 0.01])])
T = np.array([[0, 0, 0], [-2.0, 0.1, 0.05], [1.5, -0.2, 0.1]])
VIEWS = 12


def problem(noise: float, seed: int = 0):
    """A rig of three cameras with three lenses: each view is seen by two of them, or by one."""
    rng = np.random.default_rng(seed)
    where = poses(VIEWS, rng, X, *zip(CAMERAS, R, T, strict=True))
    images = [[np.zeros((0, 2))] * VIEWS for _ in CAMERAS]
    for v, (r, t) in enumerate(where):
        X_0 = X @ rotation_matrix(r).T + t
        for c in {v % 3, (v + 1) % 3} if v < 9 else {v % 3}:
            images[c][v] = CAMERAS[c].project(X_0 @ R[c].T + T[c]) + rng.normal(0, 1, (len(X), 2)) * noise
    models = [MODELS[c.model] for c in CAMERAS]
    parts = [free_columns(intrinsic_names(m), fixed_names(m, ("k3",) if m.name == "brown" else (), skew=False), None)
             for m in models]  # fmt: skip
    bundle = make_bundle(models, [[X] * VIEWS] * 3, images, np.asarray(block_diag(*parts, np.eye(12))))
    truth = BundleState(
        [intrinsics_of(c) for c in CAMERAS], R, T, np.stack([rotation_matrix(r) for r, _ in where]),
        np.stack([t for _, t in where]),
    )  # fmt: skip
    return bundle, truth


def disturbed(state: BundleState, bundle, seed: int = 1) -> BundleState:
    """The state some way off: 2 % in focal length, degrees in rotation, parts of a square in translation."""
    rng = np.random.default_rng(seed)
    shared = (bundle.G @ bundle.G.T @ np.ones(len(bundle.G))) * rng.normal(0, 0.01, len(bundle.G))
    for theta, part in zip(state.intrinsics, bundle.intrinsic_slices, strict=True):
        shared[part][:4] += rng.normal(0, 8, 4)
        assert len(theta) == part.stop - part.start
    return state.moved(shared, rng.normal(0, 0.03, (len(state.R_views), 6)))


@pytest.mark.parametrize("backend", ["numba", "numpy"])
def test_three_cameras_that_never_see_a_board_together(backend: str) -> None:
    bundle, truth = problem(0.0)
    found = solve_bundle(bundle, disturbed(truth, bundle), backend=backend)
    assert found.converged
    assert np.sqrt(found.cost / len(bundle.points)) < 1e-7
    np.testing.assert_allclose(found.state.R_rig, R, atol=1e-7)
    np.testing.assert_allclose(found.state.t_rig, T, atol=1e-5)
    for theta, true in zip(found.state.intrinsics, truth.intrinsics, strict=True):
        np.testing.assert_allclose(theta, true, atol=1e-3)


def test_their_uncertainty_is_that_of_repeated_experiments() -> None:
    bundle, truth = problem(0.0)
    clean, rng, found = bundle.measured, np.random.default_rng(5), []
    for _ in range(40):
        bundle, _ = problem(0.0)
        bundle.measured = clean + rng.normal(0, 0.2, clean.shape)
        solution = solve_bundle(bundle, truth)
        found.append((solution.state.t_rig[1:].ravel(), bundle_covariance(bundle, solution.state, solution.equations)))
    rows = [row for part in bundle.rig_slices[1:] for row in range(part.start + 3, part.stop)]
    claimed = np.sqrt(np.mean([np.diag(joint.shared)[rows] for _, joint in found], axis=0))
    np.testing.assert_allclose(np.std([t for t, _ in found], axis=0) / claimed, 1, atol=0.35)
    np.testing.assert_allclose(np.mean([joint.variance for _, joint in found]), 0.04, rtol=0.03)
