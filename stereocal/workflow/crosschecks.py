"""``crosscheck``: a second opinion on a calibration, each step by stereocal and by OpenCV."""

from __future__ import annotations

import importlib.util
import json
import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stereocal.base.errors import DataFileError, InputError
from stereocal.board.chessboard import Chessboard
from stereocal.pair.rig import StereoRig
from stereocal.store.calibration_record import METRES
from stereocal.store.calibrations import load_record, recognize_format
from stereocal.workflow.photographs import Pair, pair_photographs
from stereocal.workflow.progress import Progress, Silent
from stereocal.workflow.quantities import Length, parse_inner_corners, parse_length
from stereocal.workflow.rectified_pairs import require_size_of_rig

if TYPE_CHECKING:
    from stereocal.verify.comparison import CrosscheckReport

CALIBRATION_FILES = ("calibration.json", "calibration.yml", "calibration.yaml", "camchain.yaml")
Where = str | os.PathLike[str] | Sequence[str]


@dataclass(frozen=True)
class CrosscheckRun:
    """What ``crosscheck`` found.

    Attributes
    ----------
    calibration : Path
        The file in question.
    pairs : int
        Pairs of photographs that were looked at; 0 without photographs.
    report : CrosscheckReport
        Every step.
    """

    calibration: Path
    pairs: int
    report: CrosscheckReport

    def as_dict(self) -> dict[str, Any]:
        """Return what ``crosscheck --json`` prints."""
        return {"calibration": str(self.calibration), "pairs": self.pairs, **self.report.to_document()}


def run_crosscheck(
    calibration: str | os.PathLike[str],
    *,
    left: Where | None = None,
    right: Where | None = None,
    inner_corners: str | tuple[int, int] | None = None,
    square: str | float | None = None,
    progress: Progress | None = None,
) -> CrosscheckRun:
    """Recompute every step of a calibration with stereocal and with OpenCV.

    Parameters
    ----------
    calibration : path
        A calibration of two cameras in any known format, or the folder that ``calibrate`` wrote.
    left, right : path, glob or sequence of them, optional
        The photographs of the board; without them only the steps after calibration are compared. `right` alone may be
        absent: then each photograph holds both images side by side.
    inner_corners, square : optional
        The board; by default what calibration.json says.
    progress : Progress, optional
        Who watches.

    Raises
    ------
    InputError
        If OpenCV is not installed, or photographs come without a board.
    DataFileError
        If a file cannot be read, or photographs and calibration do not fit.
    """
    if importlib.util.find_spec("cv2") is None:
        raise InputError('crosscheck compares with OpenCV, which is not installed: pip install "stereocal[opencv]"')
    from stereocal.verify.second_opinion import crosscheck

    file = find_calibration(calibration)
    record = load_record(file)
    rig = record.calibration
    if not isinstance(rig, StereoRig):
        raise DataFileError(file, "holds one camera, but a rig of two is needed; calibrate both together")
    if left is None and right is not None:
        raise InputError("the left photographs are missing: give --left as well")
    board, length, pairs = None, Length(1.0, ""), list[Pair]()
    if left is not None:
        board, length = _board(file, inner_corners, square)
        pairs, _ = pair_photographs(left, right)
        rig = _in_unit_of_board(rig, record.unit, length.unit)
    images = [(pair.left.read(), pair.right.read()) for pair in pairs]
    for pair, both in zip(pairs, images, strict=True):
        require_size_of_rig(pair, both, rig)
    watcher, stack = progress or Silent(), ExitStack()

    def begin(step: str) -> None:
        stack.close()
        stack.enter_context(watcher.stage(f"Comparing {step}"))

    with stack:
        report = crosscheck(
            rig,
            board=board,
            left_images=[a for a, _ in images],
            right_images=[b for _, b in images],
            names=[pair.left.path.name for pair in pairs],
            used=_used(record.extra, pairs),
            board_points=record.extra.get("board_points"),
            unit=length.unit or "units",
            progress=begin,
        )
    return CrosscheckRun(file, len(pairs), report)


def find_calibration(where: str | os.PathLike[str]) -> Path:
    """Return the calibration file, or the one in a folder.

    Raises
    ------
    DataFileError
        If the folder holds none.
    """
    path = Path(where)
    if not path.is_dir():
        return path
    for name in CALIBRATION_FILES:
        if (path / name).is_file():
            return path / name
    try:
        recognize_format(path)  # left.yaml and right.yaml, and what else is a folder by itself
    except DataFileError:
        names = ", ".join(CALIBRATION_FILES)
        raise DataFileError(path, f"holds no calibration ({names}); name the file itself") from None
    return path


def _in_unit_of_board(rig: StereoRig, unit: str | None, of_board: str) -> StereoRig:
    """The rig with T in the unit of the board's squares, where both units are known."""
    if unit is None or of_board not in METRES or unit == of_board:
        return rig
    return StereoRig(rig.left, rig.right, rig.R, rig.T * (METRES[unit] / METRES[of_board]))


def _used(extra: dict[str, Any], pairs: list[Pair]) -> list[bool] | None:
    """Which pairs our own calibration.json says it was made from; None if it is of other photographs."""
    listed = extra.get("pairs")
    if not isinstance(listed, list) or not all(isinstance(entry, dict) for entry in listed):
        return None
    known = {(entry.get("left"), entry.get("right")): entry.get("used") is True for entry in listed}
    names = [(pair.left.path.name, pair.right.path.name) for pair in pairs]
    return [known[name] for name in names] if all(name in known for name in names) else None


def _board(
    file: Path, inner_corners: str | tuple[int, int] | None, square: str | float | None
) -> tuple[Chessboard, Length]:
    """The board as given, or as our own calibration file remembers it."""
    known: dict[str, Any] = {}
    if file.suffix == ".json" and (inner_corners is None or square is None):
        document = json.loads(file.read_text("utf-8"))
        known = document if isinstance(document, dict) else {}
    corners = inner_corners if inner_corners is not None else known.get("inner_corners")
    size = square if square is not None else known.get("square_size")
    if corners is None or size is None:
        raise InputError("photographs need the board that they show: add --inner-corners 9x6 --square 25mm")
    length = parse_length(size)
    unit = length.unit or (str(known.get("unit") or "") if square is None else "")
    return Chessboard(parse_inner_corners(_as_size(corners)), length.value), Length(length.value, unit)


def _as_size(corners: Any) -> str | tuple[int, int]:
    return corners if isinstance(corners, str) else tuple(corners)
