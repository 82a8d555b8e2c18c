"""Growth: reference = kernel; a lost corner is found again where it is, and none is invented."""

from __future__ import annotations

import numpy as np
import pytest
from board_renders import render
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

import stereocal as sc
from stereocal.board.grid import grow_grids
from stereocal.board.growth import grow_corners, outer_reach
from stereocal.board.saddle import saddle_candidates, saddle_response


def grown(seed, **options):
    """Smoothed image, its largest grid, the truth, all at half size."""
    image, truth = render(sc.Chessboard((7, 6)), seed=seed % 1000, fill=0.7, noise=3, **options)
    G, S = saddle_response(np.ascontiguousarray(image[::2, ::2]))
    return G, grow_grids(G, saddle_candidates(G, S)[0], 7)[0], truth / 2


@settings(max_examples=12)
@given(seed=seeds, turn=st.floats(-180, 180), tilt=st.floats(0, 50), lost=st.integers(1, 30))
def test_lost_corners_grow_again_in_kernel_and_reference(seed, turn, tilt, lost):
    G, grid, _ = grown(seed, turn=turn, tilt=tilt)
    full = grid.known.sum()
    rng = np.random.default_rng(seed)
    keep = grid.known & ~np.isin(np.arange(grid.known.size), rng.choice(grid.known.size, lost)).reshape(
        grid.known.shape
    )
    results = []
    for backend in ("numba", "numpy"):
        points, known, evidence = grid.points.copy(), keep.copy(), grid.evidence.copy()
        added = grow_corners(G, points, known, evidence, grid.parity, 0.35, backend=backend)
        assert added == known.sum() - keep.sum()
        results.append((points, known, evidence))
    for ours, reference in zip(*results, strict=True):
        np.testing.assert_allclose(ours, reference, atol=1e-9)
    if lost < 10:
        assert results[0][1].sum() == full
        assert np.abs(results[0][0] - grid.points)[grid.known].max() < 0.5


@settings(max_examples=12)
@given(seed=seeds, turn=st.floats(-180, 180), tilt=st.floats(0, 50))
def test_outer_squares_reach_as_far_in_kernel_and_reference(seed, turn, tilt):
    G, grid, _ = grown(seed, turn=turn, tilt=tilt)
    points = np.ascontiguousarray(grid.points)
    for side in range(4):
        reach = outer_reach(G, points, side)
        assert reach == pytest.approx(outer_reach(G, points, side, backend="numpy"), abs=1e-12)
        assert 0.7 < reach <= 1.2  # the squares are whole, and no further line follows


def test_nothing_grows_on_a_blank_wall():
    G, grid, _ = grown(0)
    grid.known[:] = False
    i, j = np.array([2, 3, 2, 3]), np.array([2, 2, 3, 3])
    grid.known[i, j] = True
    blank = np.full_like(G, 120.0)
    assert grow_corners(blank, grid.points, grid.known, grid.evidence, grid.parity, 0.1) == 0


def test_a_further_line_is_felt():
    G, grid, _ = grown(3)
    inner = np.ascontiguousarray(grid.window(1, 0, grid.shape[0] - 1, grid.shape[1]).points)
    assert outer_reach(G, inner, 0) > 1.3
