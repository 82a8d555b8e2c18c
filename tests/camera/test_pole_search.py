"""The search for poles: its linear algebra against the problem written out, and what it finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from camera_rigs import board, camera, mono_views
from hypothesis import given, settings
from hypothesis import strategies as st

from stereocal.base.rotations import rotation_matrix
from stereocal.camera import pole_search
from stereocal.camera.bundle import Bundle, BundleState, camera_jacobian
from stereocal.camera.bundle_problem import intrinsics_of, make_bundle
from stereocal.camera.bundle_solver import solve_bundle
from stereocal.camera.distortion import MODELS
from stereocal.camera.lens_doubts import squared_radii
from stereocal.camera.parameters import fixed_names, free_columns, intrinsic_names

X = board(6, 5)
RATIONAL = MODELS["rational"]
NAMES = intrinsic_names(RATIONAL)
ROWS = [NAMES.index(name) for name in pole_search.RADIAL]


def problem(k: tuple[float, ...], views: int, noise: float) -> tuple[Bundle, BundleState]:
    """Views by a rational lens, and the state at the truth but for its poles: k1, k2 alone."""
    cam = camera("rational", k)
    corners, where = mono_views(cam, X, views, seed=5, noise=noise)
    G = free_columns(NAMES, fixed_names(RATIONAL, (), skew=False), None)
    bundle = make_bundle([RATIONAL], [[X] * views], [corners], G)
    theta = intrinsics_of(cam)
    theta[7:] = 0.0
    R, t = np.stack([rotation_matrix(r) for r, _ in where]), np.stack([t for _, t in where])
    return bundle, BundleState([theta], np.eye(3)[None], np.zeros((1, 3)), R, t)


@settings(max_examples=40)
@given(
    st.sampled_from([(0.7, -0.4, 1.3), (0.0, 0.0, 0.0), (0.0, 0.5, 0.5), (-0.8, -0.8, -0.8), (0.0, 0.0, 2.1)]),
    st.lists(st.floats(-2, 2), min_size=3, max_size=3),
)
def test_coefficients_draw_the_sum_of_the_terms(u: tuple[float, ...], e: list[float]) -> None:
    """f = 1 + Σ e φ, φ = s / (1 − us), and its powers where a pole comes again."""
    k1, k2, k3, k4, k5, k6 = pole_search.rational_coefficients(np.array(u), np.array(e))
    s = np.linspace(0, 0.4, 30)
    f = np.ones_like(s)
    for j in range(3):
        f += e[j] * (s / (1 - u[j] * s)) ** (1 + u[:j].count(u[j]))
    c, q = 1 + s * (k1 + s * (k2 + s * k3)), 1 + s * (k4 + s * (k5 + s * k6))
    np.testing.assert_allclose(c / q, f, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("weight", [1.0, 3.0])
def test_a_promise_is_what_least_squares_of_all_unknowns_wins(weight: float) -> None:
    """ρᵀ Γ⁻¹ ρ against the full linear problem, poses and K and tangential terms in it, for three triples."""
    bundle, state = problem((-0.2, 0.05, 0.001, 0.0, 0.0, 0.1, 0.0, 0.0), 5, 0.5)
    bundle.whitening = np.broadcast_to(weight * np.eye(2), (len(bundle.points), 2, 2)).copy()
    s_max = float(squared_radii(bundle, state, 0).max())
    u = pole_search._INVERSES / s_max
    gram, rho, _ = pole_search._normal_equations_of_terms(bundle, state, ROWS, u)
    without = [i for i in range(bundle.G.shape[1]) if not bundle.G[ROWS, i].any()]
    r, J_z, J_v = camera_jacobian(replace(bundle, G=bundle.G[:, without]), state, 0)
    view = np.repeat(np.arange(5), len(X))
    X_c = np.einsum("nij,nj->ni", state.R_views[view], bundle.points) + state.t_views[view]
    x = X_c[:, :2] / X_c[:, 2:]
    s = np.sum(x * x, axis=1)
    theta = state.intrinsics[0]
    others = np.zeros((2 * len(s), len(without) + 30))
    others[:, : len(without)] = J_z.reshape(-1, len(without))
    for v in range(5):
        of_view, at = slice(v * len(X), (v + 1) * len(X)), len(without) + 6 * v
        others[2 * of_view.start : 2 * of_view.stop, at : at + 6] = J_v[of_view].reshape(-1, 6)
    r_0 = (r - x * theta[:2] * (theta[5] * s + theta[6] * s**2)[:, None]).ravel()
    for poles in ([3, 20, 40], [10, 10, 30], [25, 25, 25]):
        triple = np.array([poles])
        terms = pole_search._terms(triple, len(u))
        phi = [(s / (1 - u[i] * s)) ** (1 + poles[:j].count(i)) for j, i in enumerate(poles)]
        g = np.stack([(x * theta[:2] * f[:, None]).ravel() for f in phi], axis=1)
        scale = np.linalg.norm(np.hstack([others, g]), axis=0)
        F = [
            np.sum((r_0 - A @ np.linalg.lstsq(A, r_0, rcond=1e-13)[0]) ** 2)
            for A in (others / scale[: others.shape[1]], np.hstack([others, g]) / scale)
        ]
        promise = pole_search._solve(gram, rho, terms)[1][0]
        assert promise == pytest.approx(weight**2 * (F[0] - F[1]), rel=1e-3)


def test_the_poles_of_a_lens_are_found_from_a_fit_without_any() -> None:
    """A lens with a pole at 1.5 of the largest s, exact corners: a start that comes down to F = 0 within 40 steps."""
    bundle, state = problem((-2.0, 0.3, 0.0, 0.0, 0.0, -1.7, 0.0, 0.0), 8, 0.0)
    smooth = solve_bundle(replace(bundle, G=np.delete(bundle.G, [6, 9, 10, 11], axis=1)), state)
    starts = pole_search.pole_starts(bundle, smooth.state, 16)
    assert len(starts) > 3
    costs = [solve_bundle(bundle, start, max_iterations=40).cost for start in starts]
    assert smooth.cost > 1e-2
    assert min(costs) < 1e-9 * smooth.cost


def test_of_many_views_some_are_looked_at_and_all_are_kept() -> None:
    bundle, state = problem((-0.2, 0.05, 0.001, 0.0, 0.0, 0.1, 0.0, 0.0), 45, 0.3)
    part, _ = pole_search._some_views(bundle, state)
    assert part.view_count == 23
    for start in pole_search.pole_starts(bundle, state, 2):
        assert len(start.R_views) == 45
        assert np.isfinite(solve_bundle(bundle, start, max_iterations=5).cost)
