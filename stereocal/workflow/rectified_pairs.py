"""``rectify``: rectified images, and the picture that proves them.

After rectification a point stands in the same row in both images. The proof is a picture: both images side by side
with lines across them; whatever a line meets on the left it must meet on the right.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stereocal.base.errors import DataFileError
from stereocal.pair.rectification import Rectification
from stereocal.pair.rectification import rectify as rectify_rig
from stereocal.pair.rig import StereoRig
from stereocal.report.figures_images import draw_rectified_pair
from stereocal.report.style import to_png
from stereocal.store.calibrations import load_calibration
from stereocal.store.images import write_image
from stereocal.workflow.outputs import StagedFolder, staged_folder
from stereocal.workflow.photographs import Pair, pair_photographs
from stereocal.workflow.progress import Progress, Silent


@dataclass(frozen=True)
class RectificationRun:
    """What ``rectify`` did.

    Attributes
    ----------
    rectification : Rectification
        R1, R2, P1, P2, Q.
    pairs : int
        How many pairs were rectified.
    folder : Path
        Where the files stand.
    files : tuple of Path
        Those written.
    seconds : float
        Wall time.
    """

    rectification: Rectification
    pairs: int
    folder: Path
    files: tuple[Path, ...]
    seconds: float

    def as_dict(self) -> dict[str, Any]:
        """Return what ``rectify --json`` prints."""
        geometry = self.rectification
        return {
            "pairs": self.pairs,
            "image_size": list(geometry.image_size),
            "R1": geometry.R1.tolist(),
            "R2": geometry.R2.tolist(),
            "P1": geometry.P1.tolist(),
            "P2": geometry.P2.tolist(),
            "Q": geometry.Q.tolist(),
            "roi1": list(geometry.roi1),
            "roi2": list(geometry.roi2),
            "warnings": list(geometry.warnings),
            "files": [str(path) for path in self.files],
            "seconds": self.seconds,
        }


def rectify_pairs(
    calibration: str | os.PathLike[str],
    left: str | os.PathLike[str],
    right: str | os.PathLike[str],
    *,
    out: str | os.PathLike[str],
    alpha: float | None = None,
    progress: Progress | None = None,
) -> RectificationRun:
    """Rectify one pair of photographs, or all pairs of two folders.

    Parameters
    ----------
    calibration : path
        Of a rig, in any format that :func:`~stereocal.store.calibrations.load_calibration` reads.
    left, right : path or glob
        The photographs.
    out : path
        Folder for ``left_NAME.png``, ``right_NAME.png`` and ``epipolar_NAME.png``.
    alpha : float, optional
        As in :func:`stereocal.rectify`.
    progress : Progress, optional
        Who watches.

    Raises
    ------
    DataFileError
        If a file cannot be read, does not fit the calibration, or cannot be written.
    """
    start = time.perf_counter()
    rig = load_rig(calibration)
    rectification = rectify_rig(rig, alpha=alpha)
    pairs, alone = pair_photographs(left, right)
    if alone:
        raise DataFileError(alone[0].path, "has no partner on the other side; take it out, or add its partner")
    with staged_folder(out) as staged:
        with (progress or Silent()).stage("Rectifying", len(pairs)) as step:
            for pair in pairs:
                _rectify_one(pair, rig, rectification, staged)
                step()
        files = tuple(staged.published())
    return RectificationRun(rectification, len(pairs), Path(out), files, time.perf_counter() - start)


def load_rig(calibration: str | os.PathLike[str]) -> StereoRig:
    """Read a calibration that must be of a rig.

    Raises
    ------
    DataFileError
        If the file holds a single camera, or no calibration.
    """
    rig = load_calibration(calibration)
    if not isinstance(rig, StereoRig):
        raise DataFileError(calibration, "holds one camera, but a rig of two is needed; calibrate both together")
    return rig


def require_size_of_rig(pair: Pair, sizes: tuple[tuple[int, int], tuple[int, int]], rig: StereoRig) -> None:
    """Refuse photographs that the calibration does not fit.

    Raises
    ------
    DataFileError
        If left and right differ in size, or their size is not the calibration's.
    """
    if sizes[0] != sizes[1]:
        raise DataFileError(
            pair.right.path,
            f"is {_spelt(sizes[1])}, but its left photograph is {_spelt(sizes[0])}; both must have the size of the "
            f"calibration, {_spelt(rig.left.image_size)}",
        )
    for photograph, size, camera in zip((pair.left, pair.right), sizes, (rig.left, rig.right), strict=True):
        if size != camera.image_size:
            raise DataFileError(
                photograph.path,
                f"is {_spelt(size)}, but the calibration is of {_spelt(camera.image_size)} images; use photographs "
                "of that size, or calibrate at this one",
            )


def _spelt(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


def _rectify_one(pair: Pair, rig: StereoRig, rectification: Rectification, staged: StagedFolder) -> None:
    left, right = pair.left.read(), pair.right.read()
    require_size_of_rig(pair, ((left.shape[1], left.shape[0]), (right.shape[1], right.shape[0])), rig)
    rectified = rectification.apply(left, right)
    names = (f"left_{pair.left.path.stem}.png", f"right_{pair.right.path.stem}.png")
    for name, image in zip(names, rectified, strict=True):
        write_image(staged.path(name), image)
    figure = draw_rectified_pair(*rectified, title=f"{pair.left.path.name} and {pair.right.path.name}, rectified")
    staged.path(f"epipolar_{pair.left.path.stem}.png").write_bytes(to_png(figure))
