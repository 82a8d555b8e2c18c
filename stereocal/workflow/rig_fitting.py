"""From the boards found in pairs to one rig, with a reason for every pair that was left out.

In this order, because each step can only be trusted after the one before:

1. pairs in which either photograph does not show the board, or shows corners that no flat board could have;
2. corner order: where the board looks the same after half a turn, left and right are brought into one order;
3. each camera alone: a view whose residual stands out has wrong corners, whatever the other camera says, and one that
   sees the board from the side costs more than it brings;
4. the rig that each pair sees: photographs of different moments see another rig than the rest;
5. the joint fit, and once more without the pairs that stand out in it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import InputError
from stereocal.board.chessboard import Chessboard
from stereocal.camera.calibration import CameraCalibration, calibrate_camera
from stereocal.pair.corner_order import repair_corner_order
from stereocal.pair.stereo_calibration import StereoCalibration, calibrate_stereo
from stereocal.workflow.boards import FoundBoard
from stereocal.workflow.photographs import Pair
from stereocal.workflow.view_selection import (
    ENOUGH_VIEWS,
    MAX_MISFIT,
    MAX_TILT,
    board_tilts,
    homography_misfit,
    outlying_views,
    rig_disagreement,
)

MIN_PAIRS = 3
"""Zhang's closed form needs three views for its five intrinsics."""


@dataclass
class PairRecord:
    """What became of one pair of photographs.

    Attributes
    ----------
    pair : Pair
        The photographs.
    left, right : FoundBoard
        What was found in each.
    left_corners, right_corners : ndarray of shape (N, 2) or None
        The corners in one order, px; None if either photograph does not show the board.
    reason : str
        Why it was not used; empty if it was.
    flipped : bool
        Whether the two photographs had the corners in opposite order, and one was turned round.
    rms : float
        RMS over the corners of both images in the joint fit, px; NaN if it was not used.
    """

    pair: Pair
    left: FoundBoard
    right: FoundBoard
    left_corners: Float | None = None
    right_corners: Float | None = None
    reason: str = ""
    flipped: bool = False
    rms: float = float("nan")

    @property
    def used(self) -> bool:
        """Whether the pair takes part in the joint fit."""
        return not self.reason

    def as_dict(self) -> dict[str, Any]:
        """Return the pair's entry in ``calibration.json``."""
        return {
            "left": self.pair.left.path.name,
            "right": self.pair.right.path.name,
            "used": self.used,
            "reason": self.reason or None,
            "flipped": self.flipped,
            "rms": self.rms if self.used else None,
        }


@dataclass(frozen=True)
class RigFit:
    """The joint fit and what went into it, view by view.

    Attributes
    ----------
    calibration : StereoCalibration
        The joint fit.
    view_rms : ndarray of shape (V,)
        RMS of each pair over the corners of both images, px.
    left_points, right_points : list of ndarray of shape (N, 2)
        The corners, in one order, px.
    """

    calibration: StereoCalibration
    view_rms: Float
    left_points: list[Float]
    right_points: list[Float]


def fit_rig(
    records: Sequence[PairRecord],
    board: Chessboard,
    *,
    model: str = "brown",
    max_tilt: float = MAX_TILT,
    board_warp: str = "flat",
) -> RigFit:
    """Fit one rig to the pairs that show the board and agree; each record learns what became of it.

    Parameters
    ----------
    records : sequence of PairRecord
        All of one image size. Their reason, flipped and rms are set.
    board : Chessboard
        The target.
    model : str
        Distortion model of both cameras.
    max_tilt : float
        Degrees; a view tilted by more is left out if at least :data:`ENOUGH_VIEWS` others remain.
    board_warp : str
        The board's shape as unknown: flat, bow, released, or auto (by held-out error); views are chosen with it flat.

    Raises
    ------
    InputError
        If fewer than three pairs can be used.
    DegenerateGeometryError
        If the views do not determine the cameras.
    """
    for record in records:
        record.reason = _missing_board(record, board)
        if record.used:
            record.left_corners, record.right_corners = record.left.detection.corners, record.right.detection.corners
    _leave_out_impossible(records, board)
    _require_pairs(records, board)
    _repair_order(records, board)
    left, right = _fit_each(records, board, model)
    if _leave_out(records, np.maximum(left.view_rms, right.view_rms), "has wrong corners"):
        _require_pairs(records, board)
        left, right = _fit_each(records, board, model)
    if _leave_out_tilted(records, board, left, right, max_tilt):
        left, right = _fit_each(records, board, model)
    disagreement = _disagreement(records, board, left, right)
    if _leave_out(records, disagreement, "sees another rig than most pairs (another moment, or a wrong partner)"):
        _require_pairs(records, board)
    calibration = _fit_jointly(records, board, model)
    if _leave_out(records, _both_images(calibration), "does not fit the rig"):
        _require_pairs(records, board)
        calibration = _fit_jointly(records, board, model)
    if board_warp != "flat":
        calibration = _fit_jointly(records, board, model, board_warp)
    used = [record for record in records if record.used]
    view_rms = _both_images(calibration)
    for record, rms in zip(used, view_rms, strict=True):
        record.rms = float(rms)
    return RigFit(calibration, view_rms, *_corners(used))


def _both_images(calibration: StereoCalibration) -> Float:
    """RMS of each pair over both images: they have as many corners each, so their mean squares are averaged."""
    return np.asarray(np.sqrt(np.mean(calibration.view_rms**2, axis=1)))


def _missing_board(record: PairRecord, board: Chessboard) -> str:
    """Say in which photograph the board is missing and why; empty if it is in both."""
    missing = [
        (side, found) for side, found in (("left", record.left), ("right", record.right)) if not found.detection.found
    ]
    if not missing:
        return ""
    if len(missing) == 2:
        return f"no {board} board in either photograph: {missing[0][1].detection.message}"
    side, found = missing[0]
    return f"no {board} board in the {side} photograph: {found.detection.message}"


def _corners(records: Sequence[PairRecord]) -> tuple[list[Float], list[Float]]:
    """Return the left and the right corners of the pairs that show the board in both photographs."""
    both = [(r.left_corners, r.right_corners) for r in records]
    return [left for left, _ in both if left is not None], [right for _, right in both if right is not None]


def _leave_out_impossible(records: Sequence[PairRecord], board: Chessboard) -> None:
    """Give the pairs whose corners no flat board could have a reason."""
    for record in records:
        for side, corners in (("left", record.left_corners), ("right", record.right_corners)):
            if corners is None or not record.used:
                continue
            misfit = homography_misfit(board.object_points, corners)
            if misfit > MAX_MISFIT:
                record.reason = (
                    f"has wrong corners: no flat board looks like those in the {side} photograph, "
                    f"they are off by {misfit:.1f} squares"
                )


def _repair_order(records: Sequence[PairRecord], board: Chessboard) -> None:
    """Bring left and right corners of each pair into one order."""
    used = [record for record in records if record.used]
    left, right, flipped = repair_corner_order(board, *_corners(used), used[0].left.image_size)
    for record, left_corners, right_corners, turned in zip(used, left, right, flipped, strict=True):
        record.left_corners, record.right_corners, record.flipped = left_corners, right_corners, bool(turned)


def _fit_each(
    records: Sequence[PairRecord], board: Chessboard, model: str
) -> tuple[CameraCalibration, CameraCalibration]:
    """Calibrate each camera alone on the views in use."""
    used = [record for record in records if record.used]
    X, size = [board.object_points] * len(used), used[0].left.image_size
    return (
        calibrate_camera(X, _corners(used)[0], size, model=model),
        calibrate_camera(X, _corners(used)[1], size, model=model),
    )


def _fit_jointly(
    records: Sequence[PairRecord], board: Chessboard, model: str, board_warp: str = "flat"
) -> StereoCalibration:
    used = [record for record in records if record.used]
    size, warp = used[0].left.image_size, False if board_warp == "flat" else board_warp
    return calibrate_stereo(board.object_points, *_corners(used), size, model=model, board_warp=warp)


def _poses(calibration: CameraCalibration) -> list[tuple[Float, Float]]:
    return list(zip(calibration.rvecs, calibration.tvecs, strict=True))


def _leave_out_tilted(
    records: Sequence[PairRecord],
    board: Chessboard,
    left: CameraCalibration,
    right: CameraCalibration,
    max_tilt: float,
) -> bool:
    """Give the pairs that look at the board from the side a reason, if enough others remain."""
    used = [record for record in records if record.used]
    tilts = np.maximum(*(board_tilts(board.object_points, _poses(camera)) for camera in (left, right)))
    tilted = tilts > max_tilt
    if not tilted.any() or np.count_nonzero(~tilted) < ENOUGH_VIEWS:
        return False
    for record, out, tilt in zip(used, tilted, tilts, strict=True):
        if out:
            record.reason = (
                f"seen too much from the side: the board is tilted by {tilt:.0f}°, and beyond {max_tilt:.0f}° its "
                "foreshortening and bow cost more than the view brings (--max-tilt 90 keeps it)"
            )
    return True


def _disagreement(
    records: Sequence[PairRecord], board: Chessboard, left: CameraCalibration, right: CameraCalibration
) -> Float:
    used = [record for record in records if record.used]
    return rig_disagreement(board.object_points, _corners(used)[1], right.camera, _poses(left), _poses(right))


def _leave_out(records: Sequence[PairRecord], errors: Float, what: str) -> bool:
    """Give the pairs whose error stands out a reason; return whether there are any."""
    outlying = outlying_views(errors)
    used = [record for record in records if record.used]
    median = float(np.median(errors))
    for record, out, error in zip(used, outlying, errors, strict=True):
        if out:
            record.reason = f"{what}: {error:.1f} px RMS, where the median pair has {median:.2f}"
    return bool(outlying.any())


def _require_pairs(records: Sequence[PairRecord], board: Chessboard) -> None:
    """Raise if too few pairs are left, with what was wrong with the others."""
    used = sum(record.used for record in records)
    if used >= MIN_PAIRS:
        return
    other_sizes = Counter(
        found.detection.other_size
        for record in records
        for found in (record.left, record.right)
        if not found.detection.found and found.detection.other_size
    )
    if other_sizes:
        (columns, rows), count = other_sizes.most_common(1)[0]
        raise InputError(
            f"the {board} board was found in both photographs of {used} of {len(records)} pairs, but {count} "
            f"photographs show one of {columns}x{rows} inner corners; try --inner-corners {columns}x{rows}"
        )
    causes = Counter(record.reason.split(":")[0] for record in records if not record.used)
    why = f" ({causes.most_common(1)[0][0]}, as in {_example(records, causes)})" if causes else ""
    raise InputError(
        f"only {used} of {len(records)} pairs can be used, and at least {MIN_PAIRS} are needed{why}; check "
        "--inner-corners, or take more photographs that show the whole board to both cameras"
    )


def _example(records: Sequence[PairRecord], causes: Counter[str]) -> str:
    cause = causes.most_common(1)[0][0]
    record = next(record for record in records if record.reason.split(":")[0] == cause)
    return str(record.pair.left)
