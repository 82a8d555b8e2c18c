"""``disparity``: disparity, depth and point cloud of one pair.

The pair is rectified, matched along its baseline, cleaned of speckles, and turned into depth by Q. Each file of the
result has another reader: PFM and 16-bit PNG hold the numbers, the coloured PNG is for the eye, ``depth.pfm`` is in the
unit of the calibration, ``cloud.ply`` is in colour, and ``rectification.json`` says in which frame all of it is.
"""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.base.errors import InputError
from stereocal.pair.rectification import Rectification
from stereocal.pair.search_direction import is_swapped
from stereocal.reconstruction.depth import disparity_to_depth, disparity_to_points
from stereocal.report.figures_images import draw_disparity, to_display
from stereocal.report.style import SEQUENTIAL, to_png
from stereocal.store.clouds import write_ply
from stereocal.store.disparity_files import write_disparity, write_pfm
from stereocal.store.images import write_image
from stereocal.workflow.matching import match_along_baseline, matcher_settings, to_eight_bits
from stereocal.workflow.outputs import StagedFolder, staged_folder
from stereocal.workflow.photographs import Pair, Photograph
from stereocal.workflow.progress import Progress, Silent
from stereocal.workflow.rectified_pairs import load_rig, rectify_for_viewing, require_size_of_rig, write_rectification

Image = NDArray[Any]
Disparity = NDArray[np.float32]


@dataclass(frozen=True)
class DepthMapRun:
    """What ``disparity`` did.

    Attributes
    ----------
    disparity : ndarray of shape (H, W), float32
        Of the rectified left image, px; NaN where there is none.
    depth : ndarray of shape (H, W), float32
        Along the optical axis, in the unit of the calibration.
    method : str
        The matcher.
    settings : dict
        Its parameters.
    density : float
        Share of all pixels that have a disparity.
    matching_seconds : float
        Of the matcher alone.
    seconds : float
        Of everything, files included.
    points : int
        In the cloud.
    folder : Path
        Where the files stand.
    files : tuple of Path
        Those written.
    warnings : tuple of str
        What is odd about the rig, and what was done about it.
    """

    disparity: Disparity
    depth: Disparity
    method: str
    settings: dict[str, int]
    density: float
    matching_seconds: float
    seconds: float
    points: int
    folder: Path
    files: tuple[Path, ...]
    warnings: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return what ``disparity --json`` prints."""
        depth = self.depth[np.isfinite(self.depth)]
        low, middle, high = (float(value) for value in np.percentile(depth, (5, 50, 95))) if depth.size else (None,) * 3
        return {
            "method": self.method,
            **self.settings,
            "image_size": [self.disparity.shape[1], self.disparity.shape[0]],
            "density": self.density,
            "depth_percentiles": {"5": low, "50": middle, "95": high},
            "points": self.points,
            "warnings": list(self.warnings),
            "files": [str(path) for path in self.files],
            "matching_seconds": self.matching_seconds,
            "seconds": self.seconds,
        }


def compute_disparity(
    calibration: str | os.PathLike[str],
    left: str | os.PathLike[str],
    right: str | os.PathLike[str],
    *,
    method: str = "sgm",
    block_size: int | None = None,
    num_disparities: int = 64,
    min_disparity: int = 0,
    speckle_size: int = 100,
    out: str | os.PathLike[str] = "out/disparity",
    progress: Progress | None = None,
) -> DepthMapRun:
    """Make a disparity map, depth and a coloured point cloud of one pair of photographs.

    Parameters
    ----------
    calibration : path
        Of the rig.
    left, right : path
        The photographs, as the cameras took them.
    method : {"sad", "bm", "census", "sgm"}
        The matcher.
    block_size : int, optional
        Side of the window; by default :data:`~stereocal.workflow.matching.BLOCK_SIZES`.
    num_disparities, min_disparity : int
        How many disparities are searched, from which one up.
    speckle_size : int
        Patches of at most so many pixels are dropped; 0 keeps them.
    out : path
        Folder for the files.
    progress : Progress, optional
        Who watches.

    Raises
    ------
    DataFileError
        If a file cannot be read, does not fit the calibration, or cannot be written.
    InputError
        If a setting makes no sense.
    """
    start = time.perf_counter()
    watch = progress or Silent()
    settings = matcher_settings(
        method,
        block_size=block_size,
        num_disparities=num_disparities,
        min_disparity=min_disparity,
        speckle_size=speckle_size,
    )
    rig = load_rig(calibration)
    pair = Pair(Photograph(Path(left)), Photograph(Path(right)))
    with staged_folder(out) as staged:
        images = pair.left.read(), pair.right.read()
        require_size_of_rig(pair, images, rig)
        if settings["num_disparities"] >= rig.left.image_size[0]:
            raise InputError(
                f"--num-disparities {num_disparities} is more than the images are wide ({rig.left.image_size[0]} px); "
                "search fewer"
            )
        rectification = rectify_for_viewing(rig)
        rectified = rectification.apply(*images)
        with watch.stage(f"Matching ({method})"):
            eight = to_eight_bits(*rectified)
            clock = time.perf_counter()
            disparity = match_along_baseline(eight[0], eight[1], rectification, method=method, **settings)
            matching_seconds = time.perf_counter() - clock
        depth, points = _write_depth_files(staged, rectified[0], disparity, rectification)
        files = tuple(staged.published())
    run = DepthMapRun(
        disparity=disparity,
        depth=depth,
        method=method,
        settings=settings,
        density=float(np.isfinite(disparity).mean()),
        matching_seconds=matching_seconds,
        seconds=0.0,
        points=points,
        folder=Path(out),
        files=files,
        warnings=(*rectification.warnings, *_turned(rectification), *_left_out(disparity, rectification)),
    )
    return replace(run, seconds=time.perf_counter() - start)


def _turned(rectification: Rectification) -> list[str]:
    """Say what was done about a rig that matchers do not expect, and what it means for the files."""
    said = []
    if rectification.axis == 1:
        said.append("Matched along columns here, so the depth is right; the disparity is along y.")
    if is_swapped(rectification):
        said.append(
            "Searched to the other side here, so the depth is right; the disparity is negative, which the "
            "16-bit disparity.png cannot hold: it is not written."
        )
    return said


def _fits_sixteen_bits(disparity: Disparity) -> bool:
    """Whether disparity.png (KITTI's encoding: 16 bits, 256 levels a pixel) can hold the map."""
    return not np.any((disparity < 0) | (disparity > 65535 / 256))


def _left_out(disparity: Disparity, rectification: Rectification) -> list[str]:
    """Say so if disparity.png is not written; of swapped rigs :func:`_turned` has said it."""
    if _fits_sixteen_bits(disparity) or is_swapped(rectification):
        return []
    return [
        "The 16-bit disparity.png holds disparities from 0 to 255 alone and is not written: read disparity.pfm instead."
    ]


def color_disparity(disparity: Disparity) -> NDArray[np.uint8]:
    """Return the map in colour, (H, W, 3): the 1 and 99 percentile span the scale, black is no disparity."""
    from matplotlib import colormaps

    valid = np.isfinite(disparity)
    low, high = np.percentile(disparity[valid], (1, 99)) if valid.any() else (0.0, 1.0)
    share = (np.where(valid, disparity, low) - low) / max(high - low, 1e-6)
    rgb = np.asarray(colormaps[SEQUENTIAL](np.clip(share, 0, 1), bytes=True))[..., :3].copy()
    rgb[~valid] = 0
    return rgb


def _write_depth_files(
    staged: StagedFolder, left: Image, disparity: Disparity, rectification: Rectification
) -> tuple[Disparity, int]:
    """Write all files of a disparity map; return the depth and the number of points of the cloud."""
    depth = disparity_to_depth(disparity, rectification.Q)
    depth[~(depth > 0)] = np.nan
    depth[np.isinf(depth)] = np.nan
    points = disparity_to_points(disparity, rectification.Q)
    points[~((np.abs(disparity) >= 1) & (depth > 0))] = (
        np.nan
    )  # below one pixel the depth is not known even to a factor of two
    write_disparity(staged.path("disparity.pfm"), disparity)
    if _fits_sixteen_bits(disparity):
        write_disparity(staged.path("disparity.png"), disparity)
    shown = np.abs(disparity) if is_swapped(rectification) else disparity  # bright is near, for any rig
    write_image(staged.path("disparity_color.png"), color_disparity(shown))
    figure = draw_disparity(shown, image=left, title="disparity of the left image")
    staged.path("disparity_figure.png").write_bytes(to_png(figure))
    write_pfm(staged.path("depth.pfm"), np.where(np.isfinite(depth), depth, np.float32(np.inf)))
    count = write_ply(staged.path("cloud.ply"), points, to_display(left))
    write_rectification(staged, rectification)
    write_image(staged.path("left_rectified.png"), left if left.dtype != np.float32 else to_display(left))
    return depth, count
