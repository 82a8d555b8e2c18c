"""Faults made on purpose are named; benchmarks/study_diagnosis.py holds the trials by the hundred."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from stereocal.base.errors import InputError
from stereocal.board.chessboard import Chessboard
from stereocal.pair.corner_order import repair_corner_order
from stereocal.pair.diagnosis import diagnose_pairs

SETS = {"uvc_paper": ((7, 6), 1.0), "opencv_sample": ((9, 6), 30.0), "bumblebee2_chess": ((6, 4), 30.0)}


@pytest.fixture(scope="module")
def study():
    """The study's own maker of faults."""
    path = Path(__file__).parents[2] / "benchmarks" / "study_diagnosis.py"
    spec = importlib.util.spec_from_file_location("study_diagnosis", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("kind", ["healthy", "corner_order", "pairing", "synchronisation", "knocked", "bent_board"])
def test_each_fault_is_named_and_nothing_else(study, kind) -> None:
    named = []
    for n in range(5):
        board, left, right = study.trial(kind, np.random.default_rng([n, study.KINDS.index(kind), 7]))
        result = diagnose_pairs(board, left, right, study.SIZE)
        named.append(result.kinds)
        for finding in result.findings:
            assert finding.message.endswith(".")
            assert len(finding.pairs) > 0
    assert named == [set() if kind == "healthy" else {kind}] * 5


def test_a_gross_detection_is_an_outlier_and_named_by_its_pair(study) -> None:
    board, left, right = study.trial("healthy", np.random.default_rng([1, 1]))
    right[4] = right[4] + [12.0, 5.0]
    (finding,) = diagnose_pairs(board, left, right, study.SIZE).findings
    assert (finding.kind, finding.pairs) == ("outlier", (4,))
    assert "pair 5" in finding.message


def test_shifted_list_says_from_where_and_by_how_much(study) -> None:
    board, left, right = study.trial("healthy", np.random.default_rng([2, 1]))
    del right[6]
    (finding,) = diagnose_pairs(board, left[:-1], right, study.SIZE).findings
    assert finding.kind == "pairing"
    # left image 7 has lost its partner; from the next one on each finds its own one place earlier
    assert finding.pairs == tuple(range(7, len(right)))
    assert "from pair 8 on, left image n belongs to right image n-1" in finding.message


@pytest.mark.parametrize("name", SETS)
def test_photographs_are_healthy_but_for_the_bent_board(data, name) -> None:
    shape, square = SETS[name]
    board = Chessboard(shape, square)
    left, right = (
        np.load(data / name / f"opencv_corners_{side}.npz")["classic_subpix5"].reshape(-1, board.corner_count, 2)
        for side in ("left", "right")
    )
    both = np.isfinite(left).all(axis=(1, 2)) & np.isfinite(right).all(axis=(1, 2))
    left, right, _ = repair_corner_order(board, list(left[both]), list(right[both]), (640, 480))
    result = diagnose_pairs(board, left, right, (640, 480))
    assert result.kinds == ({"bent_board"} if name == "uvc_paper" else set())


def test_bad_input_is_refused() -> None:
    board = Chessboard((7, 6), 1.0)
    with pytest.raises(InputError, match="at least 5 pairs"):
        diagnose_pairs(board, [np.zeros((42, 2))] * 3, [np.zeros((42, 2))] * 3, (640, 480))
    with pytest.raises(InputError, match="42 corners"):
        diagnose_pairs(board, [np.zeros((40, 2))] * 6, [np.zeros((42, 2))] * 6, (640, 480))
