from __future__ import annotations

import numpy as np
from report_cases import SIZE, Case, make_case

from stereocal.pair.stereo_calibration import calibrate_stereo
from stereocal.report.halves import compare_halves


def compare(case: Case, seed: int = 0):
    return compare_halves(
        case.evidence, lambda left, right: calibrate_stereo(case.board.object_points, left, right, SIZE), seed=seed
    )


def test_halves_of_an_honest_calibration_differ_as_promised() -> None:
    """The squared ratio averages 1 over rigs: the covariance promises neither too much nor too little."""
    squares = [compare(make_case(seed=50 + s, views=12), seed=s).ratios ** 2 for s in range(10)]
    assert 0.5 < np.mean(squares) < 1.8


def test_shutters_out_of_step_part_the_halves() -> None:
    case = make_case(views=16)
    random = np.random.default_rng(3)
    case.right = [c + random.normal(0, 3, 2) for c in case.right]
    case.calibration = calibrate_stereo(case.board.object_points, case.left, case.right, SIZE)
    assert compare(case).ratios.max() > 1.5


def test_a_half_that_cannot_be_calibrated_gives_no_verdict() -> None:
    case = make_case(views=3)
    assert compare(case) is None
