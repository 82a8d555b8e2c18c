"""``detect``: the boards found in photographs, many at a time.

Photographs are read and searched on as many threads as the machine has cores: the kernels release Python's lock. The
answers come back in the order of the photographs, so that nothing depends on how many threads there were.
"""

from __future__ import annotations

import csv
import io
import os
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from stereocal.board.chessboard import Chessboard
from stereocal.board.detection import Detection, detect_chessboard_detailed
from stereocal.report.figures_detection import draw_detection_stages
from stereocal.report.style import to_png
from stereocal.workflow.outputs import staged_folder
from stereocal.workflow.photographs import Photograph, list_photographs
from stereocal.workflow.progress import Progress, Silent
from stereocal.workflow.quantities import parse_inner_corners

Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class FoundBoard:
    """What was found in one photograph.

    Attributes
    ----------
    photograph : Photograph
        Where it was looked for.
    image_size : tuple of int
        (width, height).
    detection : Detection
        What the detector says; its ``stages`` are dropped to save memory.
    """

    photograph: Photograph
    image_size: tuple[int, int]
    detection: Detection

    def as_dict(self) -> dict[str, Any]:
        """Return the entry that ``detect --json`` prints for this photograph."""
        detection = self.detection
        corners = [] if detection.corners is None else detection.corners.tolist()
        return {
            "image": str(self.photograph.path),
            "found": detection.found,
            "corners": corners,
            "image_size": list(self.image_size),
            "confidence": float(detection.confidence),
            "edge_width": None if detection.edge_width is None else float(detection.edge_width),
            "message": detection.message,
        }


@dataclass(frozen=True)
class DetectionRun:
    """What ``detect`` did: a board or none for each photograph, and the files written."""

    board: Chessboard
    boards: tuple[FoundBoard, ...]
    files: tuple[Path, ...]

    @property
    def found(self) -> int:
        """How many photographs show the board."""
        return sum(board.detection.found for board in self.boards)

    def as_list(self) -> list[dict[str, Any]]:
        """Return what ``detect --json`` prints: one entry a photograph."""
        return [board.as_dict() for board in self.boards]


def detect_boards(
    images: str | os.PathLike[str] | Sequence[str | os.PathLike[str]],
    inner_corners: str | tuple[int, int],
    *,
    out: str | os.PathLike[str] | None = None,
    draw: str | os.PathLike[str] | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> DetectionRun:
    """Find the board in each photograph.

    Parameters
    ----------
    images : path, glob, or sequence of them
        Files, folders or globs.
    inner_corners : str or tuple of int
        ``"7x6"`` or (columns, rows).
    out : path, optional
        A CSV of all corners: image, index, column, row, x, y, and their standard deviations.
    draw : path, optional
        A folder for one picture a photograph: the stages of the detection, and how far it got.
    workers : int, optional
        Threads; by default as many as the machine has cores.
    progress : Progress, optional
        Who watches.

    Raises
    ------
    DataFileError
        If a photograph cannot be read, or a result cannot be written.
    """
    board = Chessboard(inner_corners=parse_inner_corners(inner_corners))
    photographs = [Photograph(path) for path in list_photographs(images)]
    with ExitStack() as folders:  # opened first: a folder that cannot be written must not cost a search
        pictures = None if draw is None else folders.enter_context(staged_folder(draw))
        tables = None if out is None else folders.enter_context(staged_folder(Path(out).parent))
        names = _picture_names(photographs)

        def search(photograph: Photograph) -> FoundBoard:
            picture = None if pictures is None else pictures.path(names[photograph])
            return search_board(photograph, board, picture=picture)

        boards = map_in_order(search, photographs, "Finding boards", workers=workers, progress=progress)
        if tables is not None:
            tables.path(Path(out or "").name).write_text(_corner_table(boards, board), encoding="utf-8")
        files = [path for staged in (tables, pictures) if staged is not None for path in staged.published()]
    return DetectionRun(board, tuple(boards), tuple(files))


def search_board(photograph: Photograph, board: Chessboard, *, picture: Path | None = None) -> FoundBoard:
    """Find the board in one photograph and, if `picture` is given, draw how."""
    image = photograph.read_gray()
    detection = detect_chessboard_detailed(image, board)
    if picture is not None:
        figure = draw_detection_stages(image, detection, board.inner_corners, title=photograph.path.name)
        picture.write_bytes(to_png(figure))
    detection.stages.clear()
    return FoundBoard(photograph, (image.shape[1], image.shape[0]), detection)


def map_in_order(
    function: Callable[[Item], Result],
    items: Sequence[Item],
    title: str,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> list[Result]:
    """Return [function(item) for item in items], worked on by several threads; the first error ends the work."""
    with (progress or Silent()).stage(title, len(items)) as step:

        def counted(item: Item) -> Result:
            result = function(item)
            step()
            return result

        threads = min(workers or os.cpu_count() or 1, max(len(items), 1))
        pool = executor or ThreadPoolExecutor(threads, thread_name_prefix="stereocal")
        try:
            return list(pool.map(counted, items))
        finally:
            if executor is None:
                pool.shutdown(cancel_futures=True)


def _picture_names(photographs: Sequence[Photograph]) -> dict[Photograph, str]:
    """Name the pictures after the photographs; where two folders hold the same name, by the folder too."""
    count = Counter(photograph.path.stem for photograph in photographs)
    return {
        photograph: f"{photograph.path.stem}.png"
        if count[photograph.path.stem] == 1
        else f"{photograph.path.parent.name}_{photograph.path.stem}{photograph.path.suffix.replace('.', '_')}.png"
        for photograph in photographs
    }


def _corner_table(boards: Sequence[FoundBoard], board: Chessboard) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["image", "index", "column", "row", "x", "y", "sigma_x", "sigma_y"])
    for found in boards:
        corners, covariances = found.detection.corners, found.detection.covariances
        if corners is None:
            continue
        for index, (x, y) in enumerate(corners):
            row, column = divmod(index, board.columns)
            spread = ["", ""]
            if covariances is not None:
                spread = [f"{covariances[index, axis, axis] ** 0.5:.5f}" for axis in (0, 1)]
            table.writerow([found.photograph.path, index, column, row, repr(float(x)), repr(float(y)), *spread])
    return text.getvalue()
