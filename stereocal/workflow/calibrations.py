"""``calibrate``: photographs to a calibrated rig and its report.

The path of the data::

    photographs → boards → pairs that show the same board in both → one corner order left and right
                → each camera alone, gross errors left out → pairs that agree on one rig → joint fit
                → calibration.json, calibration.yml, report.html, report.json, figures/

Nothing is left out silently: every pair ends up in the result with ``used`` and, if it was not used, the reason.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from stereocal.base.errors import DataFileError
from stereocal.board.chessboard import Chessboard
from stereocal.report.quality import QualityReport
from stereocal.store.images import read_image
from stereocal.workflow.boards import FoundBoard, map_in_order, search_board
from stereocal.workflow.calibration_files import calibration_document, write_calibration_files
from stereocal.workflow.first_run import compile_calibration_ahead
from stereocal.workflow.outputs import staged_folder
from stereocal.workflow.photographs import Pair, Photograph, pair_photographs
from stereocal.workflow.progress import Progress, Silent
from stereocal.workflow.quantities import Length, parse_inner_corners, parse_length
from stereocal.workflow.rectified_pairs import rectify_for_viewing
from stereocal.workflow.rig_fitting import PairRecord, RigFit, fit_rig
from stereocal.workflow.view_selection import MAX_TILT

NO_PARTNER = "has no partner on the other side: give both photographs of a pair the same name"


@dataclass(frozen=True)
class CalibrationRun:
    """What ``calibrate`` did.

    Attributes
    ----------
    board : Chessboard
        The target, its square in the unit of `square`.
    square : Length
        The side of a square, with its unit if one was named.
    model : str
        The distortion model.
    pairs : tuple of PairRecord
        Every pair, used or not.
    skipped : tuple of str
        A sentence for each photograph that could not be used at all.
    fit : RigFit
        The joint fit, each camera alone, and the corners that went in.
    scene : (ndarray, ndarray) or None
        Photographs of an ordinary scene.
    report : QualityReport
        Its verdicts.
    folder : Path
        Where the files stand.
    files : tuple of Path
        Those written.
    seconds : float
        Wall time.
    """

    board: Chessboard
    square: Length
    model: str
    pairs: tuple[PairRecord, ...]
    skipped: tuple[str, ...]
    fit: RigFit
    scene: tuple[NDArray[Any], NDArray[Any]] | None = None
    report: QualityReport | None = None
    folder: Path = field(default_factory=Path)
    files: tuple[Path, ...] = ()
    seconds: float = 0.0

    @property
    def warnings(self) -> list[str]:
        """What is odd about the rig (cameras swapped, upside down, ...), a sentence each."""
        return list(rectify_for_viewing(self.fit.calibration.rig).warnings)

    @property
    def used(self) -> list[PairRecord]:
        """The pairs of the joint fit, in its order."""
        return [record for record in self.pairs if record.used]

    def as_dict(self) -> dict[str, Any]:
        """Return what ``calibrate --json`` prints."""
        return calibration_document(self) | {"files": [str(path) for path in self.files], "seconds": self.seconds}


def calibrate_rig(
    left: str | os.PathLike[str],
    right: str | os.PathLike[str] | None,
    inner_corners: str | tuple[int, int],
    *,
    square: str | float | Length = "1",
    model: str = "brown",
    out: str | os.PathLike[str] = "out",
    skip_bad: bool = False,
    max_tilt: float = MAX_TILT,
    board_warp: str = "flat",
    swap: bool = False,
    scene: tuple[str | os.PathLike[str], str | os.PathLike[str]] | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> CalibrationRun:
    """Calibrate a stereo rig from photographs of a chessboard.

    Parameters
    ----------
    left, right : path or glob
        The photographs of each camera; `right` is None for frames with both images side by side.
    inner_corners : str or tuple of int
        ``"7x6"`` or (columns, rows).
    square : str, float or Length
        Side of a square; it sets the unit of T.
    model : str
        Distortion model of both cameras.
    out : path
        Folder for the results.
    skip_bad : bool
        Whether photographs that cannot be read, have another size or have no partner are left out instead of ending
        the job.
    max_tilt : float
        Degrees; views that see the board more from the side are left out if enough others remain.
    board_warp : str
        Whether the board's shape is an unknown too: flat (no), bow, released, or auto (decided by held-out error).
    swap : bool
        Whether left and right are to be exchanged: the photographs called left were taken by the right camera.
    scene : (path, path), optional
        Left and right photograph of an ordinary scene, for the report's last block.
    workers : int, optional
        Threads for the detection.
    progress : Progress, optional
        Who watches.

    Raises
    ------
    DataFileError
        If a photograph cannot be used (unless `skip_bad`), or the results cannot be written.
    InputError
        If fewer than three pairs show the board.
    DegenerateGeometryError
        If the views do not determine the cameras.
    """
    start = time.perf_counter()
    watch = progress or Silent()
    length = square if isinstance(square, Length) else parse_length(square)
    board = Chessboard(inner_corners=parse_inner_corners(inner_corners), square_size=length.value)
    scene_images = None if scene is None else (read_image(scene[0]), read_image(scene[1]))
    with staged_folder(out) as staged:
        pairs, alone = pair_photographs(left, right)
        if swap:
            pairs = [Pair(pair.right, pair.left) for pair in pairs]
        problems = [DataFileError(photograph.path, NO_PARTNER) for photograph in alone]
        _stop_or_go_on(problems, skip_bad)
        compile_calibration_ahead(model)
        records, unusable = _find_in_pairs(pairs, board, workers, watch)
        _stop_or_go_on(unusable, skip_bad)
        problems += unusable
        with watch.stage("Calibrating"):
            fit = fit_rig(records, board, model=model, max_tilt=max_tilt, board_warp=board_warp)
        run = CalibrationRun(
            board=board,
            square=length,
            model=model,
            pairs=tuple(records),
            skipped=tuple(str(problem) for problem in problems),
            fit=fit,
            scene=scene_images,
            folder=Path(out),
        )
        report = write_calibration_files(run, staged, watch)
        files = tuple(staged.published())
    return replace(run, report=report, files=files, seconds=time.perf_counter() - start)


def _find_in_pairs(
    pairs: Sequence[Pair], board: Chessboard, workers: int | None, watch: Progress
) -> tuple[list[PairRecord], list[DataFileError]]:
    """Find the board in both photographs of each pair; return the pairs, and what was wrong with the other files."""

    def search(photograph: Photograph) -> FoundBoard | DataFileError:
        try:
            return search_board(photograph, board)
        except DataFileError as error:
            return error

    photographs = [photograph for pair in pairs for photograph in (pair.left, pair.right)]
    found = map_in_order(search, photographs, "Finding boards", workers=workers, progress=watch)
    problems = [item for item in found if isinstance(item, DataFileError)]
    records = [
        PairRecord(pair, left, right)
        for pair, left, right in zip(pairs, found[::2], found[1::2], strict=True)
        if isinstance(left, FoundBoard) and isinstance(right, FoundBoard)
    ]
    if not records:
        return records, problems
    sizes = Counter(size for record in records for size in (record.left.image_size, record.right.image_size))
    common = sizes.most_common(1)[0][0]
    same = []
    for record in records:
        odd = [found for found in (record.left, record.right) if found.image_size != common]
        problems += [
            DataFileError(
                found.photograph.path,
                f"is {found.image_size[0]}x{found.image_size[1]}, but most photographs are {common[0]}x{common[1]}: "
                "a calibration holds for one size, the same left and right; take it again",
            )
            for found in odd
        ]
        if not odd:
            same.append(record)
    return same, problems


def _stop_or_go_on(problems: Sequence[DataFileError], skip_bad: bool) -> None:
    """Raise the first problem, unless bad photographs are to be skipped."""
    if problems and not skip_bad:
        first, others = problems[0], len(problems) - 1
        more = f" ({others} more like this)" if others else ""
        raise DataFileError(first.path, f"{first.problem}, or give --skip-bad to go on without it{more}")
