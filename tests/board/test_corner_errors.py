"""Errors judged by the neighbours: factor, strays, correlation; grids too small to tell."""

from __future__ import annotations

import numpy as np
import pytest
from board_renders import CAMERA, look_at
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

import stereocal as sc
from stereocal.board.corner_errors import judge_corners


def seen_grid(seed, columns=9, rows=6, tilt=30.0):
    """Corners of a tilted board through a lens that distorts, (N, 2)."""
    board = sc.Chessboard((columns, rows), 1.0)
    R, t = look_at(board, tilt, turn=40.0, seed=seed)
    return CAMERA.project(board.object_points, sc.rotation_vector(R), t)


@settings(max_examples=20)
@given(seed=seeds, sigma=st.floats(0.01, 0.3), claimed=st.floats(0.3, 3.0))
def test_factor_is_what_the_covariances_lack(seed, sigma, claimed):
    rng = np.random.default_rng(seed)
    corners = seen_grid(seed % 50) + sigma * rng.standard_normal((54, 2))
    covariances = np.tile(np.eye(2) * (claimed * sigma) ** 2, (54, 1, 1))
    judged = judge_corners(corners, covariances, (6, 9))
    # 38 degrees of freedom: the estimate scatters by sqrt(2/38) = 23 %, drawn anew each time
    expected = 1 / claimed**2 + 2 / 38
    assert 0.3 * expected < judged.factor < 3 * expected
    assert not judged.strays.any()


def test_factor_on_average_makes_squared_errors_two():
    normalised = []
    for seed in range(60):
        noise = 0.05 * np.random.default_rng(seed).standard_normal((54, 2))
        judged = judge_corners(seen_grid(seed) + noise, np.tile(np.eye(2) * 0.01**2, (54, 1, 1)), (6, 9))
        normalised.append(np.sum(noise**2, axis=1) / (judged.factor * 0.01**2))
    assert np.mean(normalised) == pytest.approx(2, rel=0.08)


def test_overlapping_windows_are_reckoned_with():
    factors = []
    for seed in range(60):
        noise = np.random.default_rng(seed).standard_normal((8, 11, 2))
        errors = np.empty((6, 9, 2))
        # the x error is shared along j, the y error along i, each by a third: means over three, the middle one twice
        errors[..., 0] = noise[:-2, 1:-1, 0] + 4.9 * noise[1:-1, 1:-1, 0] + noise[2:, 1:-1, 0]
        errors[..., 1] = noise[1:-1, :-2, 1] + 4.9 * noise[1:-1, 1:-1, 1] + noise[1:-1, 2:, 1]
        variance = 2 + 4.9**2
        errors *= 0.05 / np.sqrt(variance)
        covariances = np.tile(np.eye(2) * 0.05**2, (54, 1, 1))
        flat = seen_grid(seed, tilt=0.0) + errors.reshape(-1, 2)
        factors.append(judge_corners(flat, covariances, (6, 9), correlation=2 * 4.9 / variance).factor)
    assert np.mean(factors) == pytest.approx(1 + 2 / 38, rel=0.08)


@settings(max_examples=20)
@given(seed=seeds, corner=st.integers(0, 53), angle=st.floats(0, 6.3), far=st.floats(1.0, 3.0))
def test_a_stray_is_found_and_its_covariance_would_cover_it(seed, corner, angle, far):
    rng = np.random.default_rng(seed)
    away = far * np.array([np.cos(angle), np.sin(angle)])
    corners = seen_grid(seed % 50) + 0.02 * rng.standard_normal((54, 2))
    corners[corner] += away
    judged = judge_corners(corners, np.tile(np.eye(2) * 0.02**2, (54, 1, 1)), (6, 9))
    assert judged.strays.tolist() == [k == corner for k in range(54)]
    # a corner of the board itself is predicted from one side only, with a tenth of the certainty
    np.testing.assert_allclose(judged.distances[corner], away, atol=0.35)
    assert 0.3 < judged.factor < 2.2


def test_small_grids_cannot_tell():
    corners = seen_grid(0, 4, 3)
    judged = judge_corners(corners, np.tile(np.eye(2), (12, 1, 1)), (3, 4))
    assert judged.factor == 1
    assert not judged.strays.any()


def test_failed_fits_do_not_spoil_the_others():
    corners = seen_grid(1) + 0.02 * np.random.default_rng(0).standard_normal((54, 2))
    covariances = np.tile(np.eye(2) * 0.02**2, (54, 1, 1))
    covariances[7] = np.nan
    corners[7] += 4
    judged = judge_corners(corners, covariances, (6, 9))
    assert 0.4 < judged.factor < 2
    assert np.nonzero(judged.strays)[0].tolist() == [7]


@settings(max_examples=60)
@given(
    shape=st.tuples(st.integers(3, 9), st.integers(3, 9)),
    doubted=st.floats(0, 0.5),
    lost=st.floats(0, 1),
    sure=st.sampled_from([0.0, 0.1, 1.0]),
    seed=seeds,
)
def test_however_many_are_lost_or_claim_to_be_exact_the_judgement_is_finite(shape, doubted, lost, sure, seed):
    rng = np.random.default_rng(seed)
    j, i = np.divmod(np.arange(shape[0] * shape[1]), shape[1])
    corners = 20.0 * np.column_stack([i, j])
    corners[rng.random(len(corners)) < lost] += rng.normal(0, 30, 2)
    covariances = np.tile(np.eye(2) * 1e-3**2, (len(corners), 1, 1)) * (rng.random((len(corners), 1, 1)) > sure)
    judged = judge_corners(corners, covariances, shape, doubtful=rng.random(len(corners)) < doubted)
    assert np.isfinite(judged.factor)
    assert judged.factor > 0
    assert np.isfinite(judged.distances).all()
