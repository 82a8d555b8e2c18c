"""Steps that bend along a valley: what they are made of, and that they arrive sooner at the same place."""

from __future__ import annotations

import numpy as np
import pytest
from camera_rigs import board, camera, mono_views

from stereocal.base.rotations import rotation_matrix
from stereocal.camera.bundle import Bundle, BundleState, camera_jacobian, normal_equations, residuals
from stereocal.camera.bundle_geodesic import GeodesicEngine
from stereocal.camera.bundle_problem import intrinsics_of, make_bundle
from stereocal.camera.bundle_solver import damped_step, solve_bundle
from stereocal.camera.distortion import MODELS
from stereocal.camera.parameters import fixed_names, free_columns, intrinsic_names

X = board()


def problem(model: str, views: int, seed: int) -> tuple[Bundle, BundleState]:
    """Views by a Brown lens with noise, to be fitted by a model; the state at the truth, its lens left out."""
    cam = camera()
    corners, where = mono_views(cam, X, views, seed=seed, noise=0.3)
    lens = MODELS[model]
    G = free_columns(intrinsic_names(lens), fixed_names(lens, (), skew=False), None)
    bundle = make_bundle([lens], [[X] * views], [corners], G)
    k = lens.neutral()
    k[: min(5, len(k))] = cam.dist[: len(k)]
    theta = np.concatenate([intrinsics_of(cam)[:5], k])
    R, t = np.stack([rotation_matrix(r) for r, _ in where]), np.stack([t for _, t in where])
    return bundle, BundleState([theta], np.eye(3)[None], np.zeros((1, 3)), R, t)


def test_the_acceleration_solves_its_equations() -> None:
    """(A + μD²) a = −Jᵀr″ with J written out, and r″ by a finer difference than the engine's."""
    bundle, state = problem("brown", 5, seed=1)
    engine = GeodesicEngine(bundle, state, normal_equations)
    mu = 1e-3
    dz, dv = damped_step(engine.equations, mu, *engine._D2)
    bz, bv = engine.bend(dz, dv, mu)
    h = 2e-3
    r = [residuals(bundle, state.moved(bundle.G @ (s * dz), s * dv)) for s in (h, 0.0, -h)]
    second = (r[0] - 2 * r[1] + r[2]) / h**2
    _, J_z, J_v = camera_jacobian(bundle, state, 0)
    full = np.zeros((2 * len(bundle.points), len(dz) + dv.size))
    full[:, : len(dz)] = J_z.reshape(-1, len(dz))
    for view, (a, b) in enumerate(zip(bundle.offsets[:-1], bundle.offsets[1:], strict=True)):
        at = len(dz) + 6 * view
        full[2 * a : 2 * b, at : at + 6] = J_v[a:b].reshape(-1, 6)
    D2 = np.concatenate([engine._D2[0], engine._D2[1].ravel()])
    half = 0.5 * np.linalg.solve(full.T @ full + mu * np.diag(D2), -full.T @ second.ravel())
    got = np.concatenate([bz - dz, (bv - dv).ravel()])
    assert np.linalg.norm(half) > 0
    np.testing.assert_allclose(got * np.sqrt(D2), half * np.sqrt(D2), atol=2e-2 * np.abs(half * np.sqrt(D2)).max())


@pytest.mark.parametrize("backend", ["numba", "numpy"])
def test_the_same_optimum_is_reached(backend: str) -> None:
    bundle, state = problem("brown", 6, seed=2)
    straight, bent = (solve_bundle(bundle, state, in_valley=valley, backend=backend) for valley in (False, True))
    assert bent.converged
    np.testing.assert_allclose(bent.cost, straight.cost, rtol=1e-12)
    np.testing.assert_allclose(bent.state.intrinsics[0], straight.state.intrinsics[0], rtol=1e-5, atol=1e-5)


def test_along_a_valley_fewer_steps_lead_lower_or_as_low() -> None:
    """Ten flat valleys. Where the straight steps end in them is a matter of rounding; the bent ones are no higher."""
    steps = []
    for seed in range(1, 11):
        bundle, state = problem("thin_prism", 8, seed=seed)
        straight, bent = (
            solve_bundle(bundle, state, in_valley=valley, max_iterations=2000) for valley in (False, True)
        )
        assert bent.converged
        assert bent.cost <= straight.cost * (1 + 1e-7)
        steps.append((straight.iterations, bent.iterations))
    straight_steps, bent_steps = np.array(steps).T
    assert np.median(bent_steps / straight_steps) < 0.75
    assert bent_steps.max() < straight_steps.max()
