"""``demo``: the whole pipeline on a rendered rig of known truth.

Photographs are rendered, written to disk, and from then on treated as anybody's: the commands ``calibrate`` and
``disparity`` get the files and nothing else. What they find is then compared with the truth, and each difference with
a bound that was fixed beforehand: :data:`BOUNDS`, set after seeds 0 to 3; seeds 4 to 9 stayed inside.

The depth map is compared in the photograph's own pixels. A pixel of the map is a point X of the rectified left frame;
R₁ᵀX is that point in the left camera's frame, and the true camera says at which pixel of the photograph it is seen.
There the true depth is known. So an error of the calibration counts as much as one of the matching.
"""

from __future__ import annotations

import json
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure
from numpy.typing import NDArray

from stereocal.base.atomic_files import write_whole
from stereocal.base.checks import Float, require_integer
from stereocal.base.rotations import rotation_vector
from stereocal.pair.rectification import Rectification
from stereocal.pair.rig import StereoRig
from stereocal.reconstruction.depth import disparity_to_points
from stereocal.report.figures_images import show_image
from stereocal.report.style import (
    DIVERGING,
    NO_VALUE,
    PANEL,
    SEQUENTIAL,
    add_colorbar,
    dress_image,
    image_panel_height,
    new_figure,
    to_png,
)
from stereocal.store.calibrations import save_calibration
from stereocal.store.images import read_image
from stereocal.synthetic.rig import SyntheticRig, render_rig
from stereocal.workflow.calibrations import CalibrationRun, calibrate_rig
from stereocal.workflow.depth_maps import DepthMapRun, compute_disparity
from stereocal.workflow.outputs import staged_folder
from stereocal.workflow.progress import Progress, Silent
from stereocal.workflow.rectified_pairs import rectify_for_viewing


@dataclass(frozen=True)
class Bound:
    """A bound that the demo's result has to keep.

    Attributes
    ----------
    key : str
        The measure's name in JSON.
    name : str
        What is measured.
    limit : float
        The bound.
    unit : str
        Its unit.
    at_least : bool
        Whether the measure must reach the bound; otherwise it must not exceed it.
    """

    key: str
    name: str
    limit: float
    unit: str
    at_least: bool = False


BOUNDS = (
    Bound("pairs_used", "pairs used, of those rendered", 80.0, "%", at_least=True),
    Bound("corners", "corners found, RMS distance to the truth", 0.02, "px"),
    Bound("focal_length", "focal lengths, largest relative error", 0.06, "%"),
    Bound("principal_point", "principal points, largest error", 0.1, "px"),
    Bound("rotation", "rotation between the cameras, error", 0.01, "°"),
    Bound("baseline", "baseline, relative error", 0.02, "%"),
    Bound("rows", "rectified rows of true corners, RMS difference", 0.01, "px"),
    Bound("density", "disparity, share of pixels with an answer", 85.0, "%", at_least=True),
    Bound("disparity", "disparity, median error", 0.2, "px"),
    Bound("wrong", "disparity, answers wrong by more than 1 px", 4.0, "%"),
    Bound("depth", "depth, median relative error", 2.0, "%"),
)
"""What the demo promises; the module's docstring says where the numbers are from."""


@dataclass(frozen=True)
class Check:
    """A measure and its bound."""

    bound: Bound
    value: float

    @property
    def holds(self) -> bool:
        """Whether the bound is kept; NaN keeps none."""
        return bool(self.value >= self.bound.limit if self.bound.at_least else self.value <= self.bound.limit)

    def as_dict(self) -> dict[str, Any]:
        """Return the check as plain data."""
        bound = self.bound
        return {
            "measure": bound.key,
            "name": bound.name,
            "value": self.value,
            "bound": bound.limit,
            "unit": bound.unit,
            "kind": "at least" if bound.at_least else "at most",
            "holds": self.holds,
        }


@dataclass(frozen=True)
class DemoRun:
    """What ``demo`` did.

    Attributes
    ----------
    calibration : CalibrationRun
        What ``calibrate`` made of the photographs.
    depth_map : DepthMapRun
        What ``disparity`` made of the scene.
    checks : tuple of Check
        The comparison with the truth.
    folder : Path
        Where everything stands.
    files : tuple of Path
        All that was written.
    seconds : float
        Wall time.
    """

    calibration: CalibrationRun
    depth_map: DepthMapRun
    checks: tuple[Check, ...]
    folder: Path
    files: tuple[Path, ...]
    seconds: float

    @property
    def holds(self) -> bool:
        """Whether every bound is kept."""
        return all(check.holds for check in self.checks)

    def as_dict(self) -> dict[str, Any]:
        """Return what ``demo --json`` prints."""
        return {
            "holds": self.holds,
            "checks": [check.as_dict() for check in self.checks],
            "calibration": self.calibration.as_dict(),
            "disparity": self.depth_map.as_dict(),
            "files": [str(path) for path in self.files],
            "seconds": self.seconds,
        }


def run_demo(
    out: str | os.PathLike[str] = "out/demo",
    *,
    pairs: int = 12,
    seed: int = 0,
    progress: Progress | None = None,
) -> DemoRun:
    """Render a rig, calibrate it from its photographs, make a disparity map, and compare all of it with the truth.

    Parameters
    ----------
    out : path
        Folder: ``photographs/``, what ``calibrate`` writes, ``disparity/``, ``truth/``, ``demo.json``, ``demo.png``.
    pairs : int
        How many pairs of the board are rendered.
    seed : int
        Another seed renders other photographs.
    progress : Progress, optional
        Who watches.

    Raises
    ------
    DataFileError
        If the folder cannot be written.
    """
    start = time.perf_counter()
    watch, folder = progress or Silent(), Path(out)
    require_integer(pairs, "--pairs", minimum=3, maximum=100)
    with staged_folder(folder) as staged:
        with watch.stage("Rendering photographs", 2 * pairs + 2) as step:
            rendered = render_rig(seed=seed, pairs=pairs, progress=step)
        rendered.save_images(staged.staging / "photographs")
        save_calibration(rendered.rig, staged.path("truth/calibration.json"), unit="mm")
        inputs = staged.published()
    calibration = calibrate_rig(
        folder / "photographs" / "left",
        folder / "photographs" / "right",
        rendered.board.inner_corners,
        square=f"{rendered.board.square_size:g}mm",
        out=folder,
        progress=watch,
    )
    scene = folder / "photographs" / "scene"
    depth_map = compute_disparity(
        folder / "calibration.json", scene / "left.png", scene / "right.png", out=folder / "disparity", progress=watch
    )
    rectification = rectify_for_viewing(calibration.fit.calibration.rig)
    errors = disparity_errors(rendered, rectification, depth_map.disparity)
    checks = compare_with_truth(rendered, calibration, rectification, depth_map, errors)
    document = {"holds": all(check.holds for check in checks), "checks": [check.as_dict() for check in checks]}
    left, _ = rectification.apply(read_image(scene / "left.png"), read_image(scene / "right.png"))
    picture = draw_demo(left, depth_map.disparity, errors.in_map)
    files = [
        write_whole(folder / "demo.json", json.dumps(document, indent=1) + "\n"),
        write_whole(folder / "demo.png", to_png(picture)),
        *inputs,
        *calibration.files,
        *depth_map.files,
    ]
    return DemoRun(calibration, depth_map, checks, folder, tuple(files), time.perf_counter() - start)


@dataclass(frozen=True)
class SceneErrors:
    """How wrong a disparity map is, where the truth is known.

    Attributes
    ----------
    in_map : ndarray of shape (H, W)
        Disparity less the true one, px; NaN where there is no disparity or no truth.
    depth : ndarray of shape (n,)
        Relative error of each depth, |Z − Z_true| / Z_true.
    """

    in_map: Float
    depth: Float


def disparity_errors(
    rendered: SyntheticRig, rectification: Rectification, disparity: NDArray[np.float32]
) -> SceneErrors:
    """Compare a disparity map with the true depth of the photograph that it was made of.

    With X the point that the map gives and Z_true the depth that the true camera sees in its place, the true disparity
    there is f B / Z of the point at Z_true, as the map's own frame has it.
    """
    points = disparity_to_points(disparity, rectification.Q).astype(np.float64)
    known = np.isfinite(points).all(axis=2) & (points[..., 2] > 0)
    in_left = points[known] @ rectification.R1  # rows times R₁ are columns times R₁ᵀ
    pixel = np.rint(rendered.rig.left.project(in_left)).astype(int)
    height, width = rendered.scene_depth.shape
    inside = (pixel >= 0).all(axis=1) & (pixel[:, 0] < width) & (pixel[:, 1] < height)
    true_z = np.full(len(pixel), np.nan)
    true_z[inside] = rendered.scene_depth[pixel[inside, 1], pixel[inside, 0]]
    scale = true_z / in_left[:, 2]  # along the ray: from the point found to the point that is there
    in_map = np.full(disparity.shape, np.nan)
    focal_length, baseline = rectification.P1[0, 0], -rectification.P2[0, 3] / rectification.P2[0, 0]
    found_z = points[known][:, 2]
    in_map[known] = focal_length * baseline * (1 / found_z - 1 / (scale * found_z))
    return SceneErrors(in_map, np.abs(1 / scale[np.isfinite(scale)] - 1))


def compare_with_truth(
    rendered: SyntheticRig,
    calibration: CalibrationRun,
    rectification: Rectification,
    depth_map: DepthMapRun,
    errors: SceneErrors,
) -> tuple[Check, ...]:
    """Measure everything that :data:`BOUNDS` bounds."""
    found, true = calibration.fit.calibration.rig, rendered.rig
    measures = {
        "pairs_used": 100 * len(calibration.used) / len(calibration.pairs),
        "corners": _corner_error(rendered, calibration),
        **_camera_errors(found, true),
        "rotation": float(np.degrees(np.linalg.norm(rotation_vector(found.R @ true.R.T)))),
        "baseline": 100 * abs(found.baseline / true.baseline - 1),
        "rows": _row_error(rendered, rectification),
        "density": 100 * depth_map.density,
        "disparity": float(np.nanmedian(np.abs(errors.in_map))),
        "wrong": 100 * float(np.mean(np.abs(errors.in_map[np.isfinite(errors.in_map)]) > 1)),
        "depth": 100 * float(np.median(errors.depth)),
    }
    return tuple(Check(bound, float(measures[bound.key])) for bound in BOUNDS)


def _corner_error(rendered: SyntheticRig, calibration: CalibrationRun) -> float:
    """RMS distance of all corners found to the true ones, px."""
    squared = [
        np.sum((found.detection.corners - true) ** 2, axis=1)
        for record, left, right in zip(calibration.pairs, rendered.left_corners, rendered.right_corners, strict=True)
        for found, true in ((record.left, left), (record.right, right))
        if found.detection.corners is not None
    ]
    return float(np.sqrt(np.mean(np.concatenate(squared))))


def _camera_errors(found: StereoRig, true: StereoRig) -> dict[str, float]:
    """Largest error over both cameras of the focal lengths (relative, %) and the principal points (px)."""
    difference = np.array([found.left.K - true.left.K, found.right.K - true.right.K])
    focal_lengths = np.array([[K[0, 0], K[1, 1]] for K in (true.left.K, true.right.K)])
    return {
        "focal_length": 100 * float(np.abs(difference[:, [0, 1], [0, 1]] / focal_lengths).max()),
        "principal_point": float(np.abs(difference[:, :2, 2]).max()),
    }


def _row_error(rendered: SyntheticRig, rectification: Rectification) -> float:
    """RMS difference in row of the true corners after rectification with the rig that was found, px."""
    rows = [
        rectification.rectify_points(left, "left")[:, 1] - rectification.rectify_points(right, "right")[:, 1]
        for left, right in zip(rendered.left_corners, rendered.right_corners, strict=True)
    ]
    return float(np.sqrt(np.mean(np.concatenate(rows) ** 2)))


def draw_demo(left: NDArray[Any], disparity: NDArray[np.float32], error: Float) -> Figure:
    """Draw the scene, its disparity map and the map's error side by side."""
    height, width = disparity.shape
    total = 3 * PANEL * 0.8
    figure, grid = new_figure(total, image_panel_height((3 * width, height), total, 0.6), columns=3)
    show_image(grid[0, 0], left)
    dress_image(grid[0, 0], (width, height), "left photograph, rectified")
    missing = {"bad": NO_VALUE}
    low, high = np.nanpercentile(disparity, (0.5, 99.5))
    shown = grid[0, 1].imshow(
        disparity, cmap=colormaps[SEQUENTIAL].with_extremes(**missing), vmin=low, vmax=high, interpolation="nearest"
    )
    dress_image(grid[0, 1], (width, height), "disparity that was found")
    add_colorbar(figure, shown, grid[0, 1], "px")
    shown = grid[0, 2].imshow(
        error, cmap=colormaps[DIVERGING].with_extremes(**missing), vmin=-1, vmax=1, interpolation="nearest"
    )
    dress_image(grid[0, 2], (width, height), "its error against the truth")
    add_colorbar(figure, shown, grid[0, 2], "px")
    return figure
