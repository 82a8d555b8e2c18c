"""The engine for a board of unknown shape: its kernels equal the dense equations, and its fits end where theirs do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from camera_rigs import SIZE, board, camera, mono_views, poses
from scipy.linalg import block_diag

import stereocal as sc
from stereocal.base.rotations import rotation_matrices, rotation_matrix
from stereocal.camera.board_shape import shape_basis
from stereocal.camera.bundle import Bundle, BundleState
from stereocal.camera.bundle_problem import intrinsics_of, make_bundle
from stereocal.camera.bundle_shaped import ShapedEngine, has_sparse_shape
from stereocal.camera.bundle_solver import NumpyEngine, solve_bundle
from stereocal.camera.distortion import MODELS
from stereocal.camera.parameters import free_columns, intrinsic_names

LENSES = {
    "brown": [-0.28, 0.09, 0.001, -0.0005, 0.01],
    "division": [-0.2],
    "fisheye": [0.05, -0.02, 0.01, -0.003],
}


def problem(
    model: str, kind: str, views: int, *, weights: bool = False, priors: bool = False
) -> tuple[Bundle, BundleState]:
    """Two cameras that each miss a view, corners missing, focal lengths tied, a bent board; near the optimum."""
    rng, cam, X = np.random.default_rng(views), camera(model, LENSES[model]), board(7, 5)
    bent = X + np.column_stack([np.zeros((len(X), 2)), 0.02 * (X[:, 0] - 3) ** 2])
    R_rig, t_rig = rotation_matrix([0.01, 0.05, -0.02]), np.array([-2.0, 0.1, 0.0])
    where = poses(views, rng, X, (cam, np.eye(3), np.zeros(3)), (cam, R_rig, t_rig))
    R_views, t_views = rotation_matrices(np.array([r for r, _ in where])), np.array([t for _, t in where])
    X_0 = bent @ R_views.transpose(0, 2, 1) + t_views[:, None]
    images = [[cam.project(x @ R.T + t) + rng.normal(0, 0.1, (len(X), 2)) for x in X_0]
              for R, t in ((np.eye(3), np.zeros(3)), (R_rig, t_rig))]  # fmt: skip
    seen = [[np.arange(len(X))] * views for _ in range(2)]
    seen[0][1], seen[1][2] = np.arange(0), np.arange(0)
    seen[0][0], seen[1][3] = np.arange(3, 35), np.arange(1, 35, 2)
    objects, images = ([[part[i] for part, i in zip(side, chosen, strict=True)] for side, chosen in
                        zip(sides, seen, strict=True)] for sides in ([[X] * views] * 2, images))  # fmt: skip
    names, basis = intrinsic_names(MODELS[model]), shape_basis(kind, X)
    one = free_columns(names, {"skew"}, 1.01)
    G = block_diag(one, one, np.eye(6), np.eye(basis.shape[2]))
    bundle = make_bundle([MODELS[model]] * 2, objects, images, G)
    bundle.shape_basis = basis
    bundle.shape_index = np.concatenate([number for side in seen for number in side])
    if weights:
        bundle.whitening = np.eye(2) + rng.normal(0, 0.1, (len(bundle.points), 2, 2))
        bundle.loss, bundle.loss_scale = "cauchy", 0.3
    if priors:
        bundle.prior_weights, bundle.prior_means = np.zeros(len(G)), np.zeros(len(G))
        bundle.prior_weights[[0, 2 * len(names) + 3]] = 0.5, 3.0
        bundle.prior_means[[0, 2 * len(names) + 3]] = 531, -2.1
    theta = intrinsics_of(cam)
    theta[:2] = 532 * np.array([1.01, 1])
    return bundle, BundleState([theta, theta * 1.01], np.stack([np.eye(3), R_rig]), np.stack([np.zeros(3), t_rig]),
                               R_views, t_views, rng.normal(0, 0.01, basis.shape[2]))  # fmt: skip


@pytest.mark.parametrize("options", [{}, {"weights": True}, {"priors": True}], ids=["plain", "weights", "priors"])
@pytest.mark.parametrize("views", [6, 30], ids=["points first", "poses first"])
@pytest.mark.parametrize("kind", ["bow", "released"])
@pytest.mark.parametrize("model", LENSES)
def test_equations_and_steps_of_the_twins_are_equal(model: str, kind: str, views: int, options: dict) -> None:
    bundle, state = problem(model, kind, views, **options)
    assert has_sparse_shape(bundle)
    fast, slow = ShapedEngine(bundle, state), NumpyEngine(bundle, state)
    for _ in range(2):  # at the start, and where a step leads
        a, b = fast.equations, slow.equations
        np.testing.assert_allclose(a.cost, b.cost, rtol=1e-11)
        for name in ("U", "b_shared", "V", "b_views", "W"):
            expected = getattr(b, name)
            np.testing.assert_allclose(getattr(a, name), expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())
        np.testing.assert_allclose(a.residuals, b.residuals, atol=1e-9)
        np.testing.assert_allclose(fast.gradient_norm(), slow.gradient_norm(), rtol=1e-8)
        np.testing.assert_allclose(fast.propose(1e-2), slow.propose(1e-2), rtol=1e-6)
        fast.accept()
        slow.accept()
        for name in ("shape", "R_rig", "t_rig", "R_views", "t_views"):
            np.testing.assert_allclose(getattr(fast.state(), name), getattr(slow.state(), name), atol=1e-9)


@pytest.mark.parametrize("kind", ["bow", "released"])
def test_fits_of_the_twins_end_at_the_same_optimum(kind: str) -> None:
    bundle, state = problem("brown", kind, 9)
    fast, slow = (solve_bundle(bundle, state, backend=backend) for backend in ("numba", "numpy"))
    assert fast.converged
    np.testing.assert_allclose(fast.cost, slow.cost, rtol=1e-12)
    np.testing.assert_allclose(fast.state.shape, slow.state.shape, atol=1e-6)
    np.testing.assert_allclose(fast.state.intrinsics[0][:4], slow.state.intrinsics[0][:4], rtol=1e-6)


def test_a_point_behind_a_camera_costs_more_than_any_fit() -> None:
    bundle, state = problem("brown", "released", 6)
    behind = replace(state, t_views=-state.t_views)
    assert ShapedEngine(bundle, behind).cost == np.inf


def test_what_the_kernels_do_not_know_is_left_to_the_equations() -> None:
    bundle, _ = problem("brown", "bow", 6)
    assert not has_sparse_shape(replace(bundle, shape_basis=None))
    prior = np.zeros(len(bundle.G))
    prior[-1] = 1.0
    assert not has_sparse_shape(replace(bundle, prior_weights=prior, prior_means=np.zeros(len(prior))))
    mixed = bundle.G.copy()
    mixed[0, 1] = 0.5
    assert not has_sparse_shape(replace(bundle, G=mixed))


@pytest.mark.parametrize("kind", ["released", "auto"])
def test_backends_calibrate_alike(kind: str) -> None:
    X = board(7, 5)
    bent = X + np.column_stack([np.zeros((len(X), 2)), 0.1 * np.abs(X[:, 0] - 3)])
    corners, _ = mono_views(camera(), bent, 10, seed=8, noise=0.1)
    fast, slow = (sc.calibrate_camera(X, corners, SIZE, board_warp=kind, backend=b) for b in ("numba", "numpy"))
    assert fast.board.kind == slow.board.kind == "released"
    np.testing.assert_allclose(fast.rms, slow.rms, rtol=1e-12)
    np.testing.assert_allclose(fast.board.points, slow.board.points, atol=1e-6)
    np.testing.assert_allclose(fast.std, slow.std, rtol=1e-4)
    assert fast.board.held_out_rms == pytest.approx(slow.board.held_out_rms, rel=1e-6)
