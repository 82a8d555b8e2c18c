"""``rectify``: rectified images, and the picture that proves them.

After rectification a point stands in the same row in both images. The proof is a picture: both images side by side
with lines across them; whatever a line meets on the left it must meet on the right.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from stereocal.base.atomic_files import write_whole
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
        return {
            "pairs": self.pairs,
            **rectification_document(self.rectification),
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
        OpenCV's zoom, as in :func:`stereocal.rectify`; by default all that both cameras see is shown.
    progress : Progress, optional
        Who watches.

    Raises
    ------
    DataFileError
        If a file cannot be read, does not fit the calibration, or cannot be written.
    """
    start = time.perf_counter()
    rig = load_rig(calibration)
    rectification = rectify_for_viewing(rig, alpha=alpha)
    pairs, alone = pair_photographs(left, right)
    if alone:
        raise DataFileError(alone[0].path, "has no partner on the other side; take it out, or add its partner")
    with staged_folder(out) as staged:
        with (progress or Silent()).stage("Rectifying", len(pairs)) as step:
            for pair in pairs:
                _rectify_one(pair, rig, rectification, staged)
                step()
        write_rectification(staged, rectification)
        files = tuple(staged.published())
    return RectificationRun(rectification, len(pairs), Path(out), files, time.perf_counter() - start)


def rectify_for_viewing(rig: StereoRig, *, alpha: float | None = None) -> Rectification:
    """Rectify such that both pictures show all that both cameras see.

    OpenCV's own rule centres the four undistorted corners of the image, which a wide lens does not even have (its
    polynomial turns back before it gets there): on the paper's cameras it puts the principal point near the picture's
    edge. With `alpha` the rule is OpenCV's.
    """
    return rectify_rig(rig, view="common") if alpha is None else rectify_rig(rig, alpha=alpha)


def rectification_document(rectification: Rectification) -> dict[str, Any]:
    """Return a rectification as plain data."""
    matrices = {name: getattr(rectification, name).tolist() for name in ("R1", "R2", "P1", "P2", "Q")}
    return {
        "image_size": list(rectification.image_size),
        **matrices,
        "roi1": list(rectification.roi1),
        "roi2": list(rectification.roi2),
        "warnings": list(rectification.warnings),
    }


def write_rectification(staged: StagedFolder, rectification: Rectification) -> None:
    """Write ``rectification.json``: the frame that rectified images, disparity and depth are in."""
    text = json.dumps(rectification_document(rectification), indent=1, allow_nan=False)
    write_whole(staged.path("rectification.json"), text + "\n")


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


def require_size_of_rig(pair: Pair, images: tuple[NDArray[Any], NDArray[Any]], rig: StereoRig) -> None:
    """Refuse photographs that the calibration does not fit.

    Raises
    ------
    DataFileError
        If left and right differ in size, or their size is not the calibration's.
    """
    left, right = (_size_of(image) for image in images)
    if left != right:
        raise DataFileError(
            pair.right.path,
            f"is {_spelt(right)}, but its left photograph is {_spelt(left)}; both must have the size of the "
            f"calibration, {_spelt(rig.left.image_size)}",
        )
    for photograph, camera in ((pair.left, rig.left), (pair.right, rig.right)):
        if left != camera.image_size:
            raise DataFileError(
                photograph.path,
                f"is {_spelt(left)}, but the calibration is of {_spelt(camera.image_size)} images; use photographs "
                "of that size, or calibrate at this one",
            )


def _size_of(image: NDArray[Any]) -> tuple[int, int]:
    return image.shape[1], image.shape[0]


def _spelt(size: tuple[int, int]) -> str:
    return f"{size[0]}x{size[1]}"


def _rectify_one(pair: Pair, rig: StereoRig, rectification: Rectification, staged: StagedFolder) -> None:
    left, right = pair.left.read(), pair.right.read()
    require_size_of_rig(pair, (left, right), rig)
    rectified = rectification.apply(left, right)
    names = (f"left_{pair.left.path.stem}.png", f"right_{pair.right.path.stem}.png")
    for name, image in zip(names, rectified, strict=True):
        write_image(staged.path(name), image)
    title = f"{pair.left.path.name} and {pair.right.path.name}, rectified"
    figure = draw_rectified_pair(*rectified, axis=rectification.axis, title=title)
    staged.path(f"epipolar_{pair.left.path.stem}.png").write_bytes(to_png(figure))
