"""Which pairs a rig is fitted to, and the reason for every one that is left out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from stereocal.base.errors import InputError
from stereocal.base.rotations import rotation_vector
from stereocal.board.chessboard import Chessboard
from stereocal.board.detection import Detection
from stereocal.camera.model import Camera
from stereocal.synthetic.poses import hold_board
from stereocal.synthetic.rig import default_rig
from stereocal.workflow.boards import FoundBoard
from stereocal.workflow.photographs import Pair, Photograph
from stereocal.workflow.rig_fitting import PairRecord, fit_rig
from stereocal.workflow.view_selection import board_tilts, outlying_views

RIG = default_rig()
NOISE = 0.1


def seen(camera: Camera, R: np.ndarray, t: np.ndarray, board: Chessboard, random: np.random.Generator) -> np.ndarray:
    points = camera.project(board.object_points, rotation_vector(R), t)
    return points + random.normal(0, NOISE, points.shape)


def pairs_of(board: Chessboard, count: int, *, tilt: float = 35.0, seed: int = 0) -> list[PairRecord]:
    """Pairs as a perfect detector with a little noise would find them."""
    random = np.random.default_rng(seed)
    records = []
    for k, (R, t) in enumerate(hold_board(RIG, board, count, tilt=tilt, seed=seed)):
        found = [
            FoundBoard(Photograph(Path(side) / f"{k}.png"), (640, 480), Detection(True, corners=corners))
            for side, corners in (
                ("left", seen(RIG.left, R, t, board, random)),
                ("right", seen(RIG.right, RIG.R @ R, RIG.R @ t + RIG.T, board, random)),
            )
        ]
        records.append(PairRecord(Pair(found[0].photograph, found[1].photograph), *found))
    return records


def replaced(record: PairRecord, corners: np.ndarray) -> PairRecord:
    right = FoundBoard(record.right.photograph, record.right.image_size, Detection(True, corners=corners))
    return PairRecord(record.pair, record.left, right)


def test_healthy_pairs_are_all_used() -> None:
    board = Chessboard((9, 6), 25.0)
    records = pairs_of(board, 10)
    fit = fit_rig(records, board)
    assert [record.reason for record in records] == [""] * 10
    assert fit.calibration.rms == pytest.approx(NOISE * np.sqrt(2), rel=0.1)
    assert [record.rms for record in records] == list(fit.view_rms)
    assert fit.calibration.rig.baseline == pytest.approx(RIG.baseline, rel=2e-3)


@pytest.mark.parametrize("seed", range(3))
def test_exchanged_photographs_are_left_out_and_named(seed: int) -> None:
    board = Chessboard((9, 6), 25.0)
    records = pairs_of(board, 12, seed=seed)
    third, eighth = records[3].right.detection.corners, records[8].right.detection.corners
    assert third is not None
    assert eighth is not None
    records[3], records[8] = replaced(records[3], eighth), replaced(records[8], third)
    fit = fit_rig(records, board)
    assert [k for k, record in enumerate(records) if not record.used] == [3, 8]
    assert "sees another rig than most pairs" in records[3].reason
    assert fit.calibration.rms == pytest.approx(NOISE * np.sqrt(2), rel=0.1)


def test_corners_from_the_wrong_end_are_put_right_and_said_so() -> None:
    """A 6x4 board looks the same after half a turn; two right photographs list their corners from the other end."""
    board = Chessboard((6, 4), 30.0)
    records = pairs_of(board, 11)
    for k in (2, 10):
        corners = records[k].right.detection.corners
        assert corners is not None
        records[k] = replaced(records[k], corners[::-1].copy())
    fit = fit_rig(records, board)
    assert [record.flipped for record in records] == [k in (2, 10) for k in range(11)]
    assert all(record.used for record in records)
    assert fit.calibration.rms == pytest.approx(NOISE * np.sqrt(2), rel=0.1)
    assert records[2].as_dict()["flipped"] is True


def test_wrong_corners_in_one_camera_are_left_out() -> None:
    board = Chessboard((9, 6), 25.0)
    records = pairs_of(board, 8)
    corners = records[5].right.detection.corners
    assert corners is not None
    shifted = corners.reshape(6, 9, 2).copy()
    shifted[:3] = shifted[:3][:, ::-1]  # half of the rows read backwards
    records[5] = replaced(records[5], shifted.reshape(-1, 2))
    fit_rig(records, board)
    assert [k for k, record in enumerate(records) if not record.used] == [5]
    assert "has wrong corners" in records[5].reason


def test_views_from_the_side_are_left_out_only_if_enough_remain() -> None:
    board = Chessboard((9, 6), 25.0)
    few, many = pairs_of(board, 8, seed=4), pairs_of(board, 14, seed=4)
    fit_rig(few, board, max_tilt=10.0)
    assert all(record.used for record in few)
    fit = fit_rig(many, board, max_tilt=90.0)
    assert all(record.used for record in many)
    poses = list(zip(fit.calibration.rvecs, fit.calibration.tvecs, strict=True))
    steepest = int(np.argmax(board_tilts(board.object_points, poses)))
    limit = float(np.sort(board_tilts(board.object_points, poses))[-2:].mean())
    fit_rig(many, board, max_tilt=limit)
    assert not many[steepest].used
    assert "seen too much from the side" in many[steepest].reason


def test_board_tilt_is_the_angle_to_the_line_of_sight() -> None:
    X = Chessboard((5, 4)).object_points
    X = X - X.mean(axis=0)
    poses = [(np.array([angle, 0.0, 0.0]), np.array([0.0, 0.0, 10.0])) for angle in (0.0, 0.5, -1.2)]
    np.testing.assert_allclose(board_tilts(X, poses), np.degrees([0.0, 0.5, 1.2]), atol=1e-6)


def test_outlying_views_need_both_factor_and_floor() -> None:
    assert outlying_views([0.1, 0.1, 0.1, 0.9]).tolist() == [False] * 4  # nine times the median, but below a pixel
    assert outlying_views([1.0, 1.1, 0.9, 4.0]).tolist() == [False] * 4  # four pixels, but not five times the median
    assert outlying_views([0.1, 0.1, 0.1, 1.1]).tolist() == [False, False, False, True]


def test_two_pairs_are_too_few() -> None:
    board = Chessboard((9, 6), 25.0)
    with pytest.raises(InputError, match="only 2 of 2 pairs can be used"):
        fit_rig(pairs_of(board, 2), board)
