"""``board``: a target to print, true to scale; what it looks like is up to :mod:`stereocal.board.printing`."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stereocal.board.printing import BoardSheet, write_board
from stereocal.workflow.quantities import Length, parse_inner_corners, parse_length


@dataclass(frozen=True)
class TargetRun:
    """What ``board`` did.

    Attributes
    ----------
    path : Path
        The file.
    sheet : BoardSheet
        What is on it.
    paper : str
        Its size by name.
    advice : tuple of str
        What to know about this board.
    """

    path: Path
    sheet: BoardSheet
    paper: str
    advice: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return what ``board --json`` prints."""
        return {
            "files": [str(self.path)],
            "inner_corners": list(self.sheet.board.inner_corners),
            "square_size": self.sheet.board.square_size,
            "unit": "mm",
            "paper": self.paper,
            "paper_size_mm": list(self.sheet.page),
            "advice": list(self.advice),
        }


def make_target(
    inner_corners: str | tuple[int, int],
    square: str | float | Length,
    *,
    paper: str = "A4",
    out: str | os.PathLike[str] = "board.pdf",
) -> TargetRun:
    """Write a target to print.

    Parameters
    ----------
    inner_corners : str or tuple of int
        ``"7x6"`` or (columns, rows).
    square : str, float or Length
        Side of a square; a number without a unit is in millimetres.
    paper : str
        A0 to A6, letter, legal, tabloid.
    out : path
        The file: .pdf, .svg or .png.

    Raises
    ------
    InputError
        If the board does not fit on the paper, or the file's ending is not one of the three.
    DataFileError
        If the file cannot be written.
    """
    length = square if isinstance(square, Length) else parse_length(square)
    sheet = write_board(out, parse_inner_corners(inner_corners), length.value, paper)
    board, advice = sheet.board, []
    if board.is_symmetric:
        advice.append(
            f"columns + rows is even, so the board looks the same after half a turn; {board.columns}x{board.rows + 1} "
            "would tell its ends apart by itself"
        )
    return TargetRun(Path(out), sheet, paper, tuple(advice))
