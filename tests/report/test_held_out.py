from __future__ import annotations

import numpy as np
import pytest
from report_cases import SIZE, Case

from stereocal.pair.stereo_calibration import calibrate_stereo
from stereocal.report.evidence import projection_jacobian, rms
from stereocal.report.held_out import hold_out, place_views


def refit_of(case: Case):
    return lambda left, right: calibrate_stereo(case.board.object_points, left, right, SIZE)


def test_placing_a_view_finds_its_best_pose(healthy: Case) -> None:
    evidence = healthy.evidence
    turned = evidence.rotations.copy()
    moved = evidence.translations + np.array([3.0, -2.0, 10.0])
    from dataclasses import replace

    started_off = replace(evidence, rotations=turned, translations=moved)
    left, right = place_views(evidence.rig, started_off, range(evidence.view_count), iterations=20)
    # the joint optimum is at an optimum of every pose, so that placing the views again gives the same residuals
    np.testing.assert_allclose(left, evidence.left_residuals, atol=1e-6)
    np.testing.assert_allclose(right, evidence.right_residuals, atol=1e-6)


def test_held_out_error_is_above_the_fitted_and_near_the_noise(healthy: Case) -> None:
    evidence = healthy.evidence
    held = hold_out(evidence, refit_of(healthy))
    assert not held.failures
    assert np.isfinite(held.residuals).all()
    assert held.rms > rms(evidence.residuals) * 0.99
    assert held.noise == pytest.approx(0.1, rel=0.12)


def test_the_folds_do_not_see_what_they_are_judged_on(healthy: Case) -> None:
    """A view whose corners are spoilt spoils its own held-out error, and every fold it takes part in."""
    calls = []

    def spy(left, right):
        calls.append(len(left))
        return refit_of(healthy)(left, right)

    hold_out(healthy.evidence, spy, folds=4)
    assert calls == [12, 12, 12, 12]


def test_projection_jacobian_against_another_step(healthy: Case) -> None:
    evidence = healthy.evidence
    X = evidence.points_left[0]
    J = projection_jacobian(evidence.rig.left, X)
    h = np.array([0.01, -0.02, 0.03])
    ahead = evidence.rig.left.project(X + h) - evidence.rig.left.project(X - h)
    np.testing.assert_allclose(np.einsum("nij,j->ni", J, 2 * h), ahead, atol=1e-6)
