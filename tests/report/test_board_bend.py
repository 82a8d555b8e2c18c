from __future__ import annotations

import numpy as np
import pytest
from report_cases import Case

from stereocal.report.board_bend import bend_basis, free_the_board
from stereocal.synthetic.board_view import bent_points


def step(case: Case):
    return free_the_board(case.evidence, np.asarray(case.calibration.std) > 0)


def test_the_basis_holds_no_pose(healthy: Case) -> None:
    X = np.asarray(healthy.board.object_points)
    basis = bend_basis(X)
    heights = basis[:, 2, : len(X) - 3]
    for mode in (np.ones(len(X)), X[:, 0], X[:, 1]):
        np.testing.assert_allclose(heights.T @ mode, 0, atol=1e-9)
    np.testing.assert_allclose(heights.T @ heights, np.eye(len(X) - 3), atol=1e-9)


def test_a_flat_board_is_flat_by_chance_only(healthy: Case) -> None:
    bend = step(healthy)
    assert bend.f_statistic == pytest.approx(1, abs=0.6)
    assert np.mean((bend.heights / bend.sigma) ** 2) == pytest.approx(1, abs=0.7)
    assert bend.rms < 0.006 * healthy.board.square_size


def test_a_bent_board_is_measured(bent: Case) -> None:
    """The step finds the bow itself, not a part of it, up to the shape's sign convention and the best plane."""
    bend = step(bent)
    true = bent_points(bent.board, 0.15 * 25.0)[:, 2]
    X = np.asarray(bent.board.object_points)
    plane = np.stack([np.ones(len(X)), X[:, 0], X[:, 1]], axis=1)
    true = true - plane @ np.linalg.lstsq(plane, true, rcond=None)[0]
    assert bend.f_statistic > 10
    np.testing.assert_allclose(bend.heights, true, atol=0.15 * np.abs(true).max())
