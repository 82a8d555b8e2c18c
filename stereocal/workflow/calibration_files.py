"""The files that ``calibrate`` writes.

``calibration.json`` is lossless and holds everything that is known: the cameras, R and T, every pair with the reason
why it was left out, standard deviations and the covariance. ``calibration.yml`` is for OpenCV: ``cv2.FileStorage`` and
the stereo_calib sample read it; a lens model that OpenCV does not have gets none. ``report.html`` is for people,
``report.json`` for scripts, ``figures/`` for papers.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from stereocal.report.figures_images import draw_corners, draw_rectified_pair
from stereocal.report.quality import QualityReport, evaluate_calibration
from stereocal.report.style import to_png
from stereocal.store.calibration_record import OPENCV_MODELS
from stereocal.store.calibrations import save_calibration
from stereocal.sweep.disparity_sweep import PAPER_BLOCK_SIZES, SweepTable, sweep_disparity
from stereocal.workflow.depth_maps import to_eight_bits
from stereocal.workflow.outputs import StagedFolder
from stereocal.workflow.progress import Progress
from stereocal.workflow.rectified_pairs import rectify_for_viewing
from stereocal.workflow.rig_fitting import PairRecord

if TYPE_CHECKING:
    from stereocal.workflow.calibrations import CalibrationRun

OPENCV_LENSES = (*OPENCV_MODELS, "polynomial", "fisheye")


def calibration_document(run: CalibrationRun) -> dict[str, Any]:
    """Return everything that is known about a calibration, as plain data: what ``calibration.json`` holds."""
    rig = run.fit.calibration.rig
    extra = _beyond_the_rig(run)
    sides = {
        side: {
            "image_size": list(camera.image_size),
            "model": camera.model,
            "K": camera.K.tolist(),
            "dist": camera.dist.tolist(),
            **extra.pop(side),
        }
        for side, camera in (("left", rig.left), ("right", rig.right))
    }
    geometry = {"R": rig.R.tolist(), "T": rig.T.tolist(), "baseline": rig.baseline}
    return {**sides, **geometry, "unit": run.square.unit or None, **extra}


def write_calibration_files(run: CalibrationRun, staged: StagedFolder, progress: Progress) -> QualityReport:
    """Write all files of a calibration into the staged folder and return its report."""
    rig = run.fit.calibration.rig
    extra = _beyond_the_rig(run)
    save_calibration(rig, staged.path("calibration.json"), extra=extra, unit=run.square.unit or None)
    if run.model in OPENCV_LENSES:
        save_calibration(
            rig,
            staged.path("calibration.yml"),
            format="opencv",
            extra={"rms": extra["rms"]},
            unit=run.square.unit or None,
        )
    report = evaluate_run(run)
    with progress.stage("Writing the report"):
        report.save_json(staged.path("report.json"))
        report.save_html(staged.path("report.html"))
        report.save_figures(staged.path("figures/x").parent)
        for name, figure in _example_figures(run):
            staged.path(f"figures/{name}.png").write_bytes(to_png(figure))
    return report


def _example_figures(run: CalibrationRun) -> Iterator[tuple[str, Figure]]:
    """Draw the pair that fits like the median one: its corners on the photographs, and the pair rectified."""
    median = np.argsort(run.fit.view_rms)[len(run.fit.view_rms) // 2]
    record, corners = run.used[median], (run.fit.left_points[median], run.fit.right_points[median])
    photographs = record.pair.left.read(), record.pair.right.read()
    for side, image, points in zip(("left", "right"), photographs, corners, strict=True):
        yield (
            f"corners_{side}",
            draw_corners(image, points, run.board.columns, title=f"{side}: corners that were found"),
        )
    rectification = rectify_for_viewing(run.fit.calibration.rig)
    yield (
        "rectified_pair",
        draw_rectified_pair(
            *rectification.apply(*photographs),
            left_corners=rectification.rectify_points(corners[0], "left"),
            right_corners=rectification.rectify_points(corners[1], "right"),
            axis=rectification.axis,
        ),
    )


def evaluate_run(run: CalibrationRun) -> QualityReport:
    """Return the verdicts on a calibration."""
    fit = run.fit
    pairs = [
        record.as_dict()
        | {"left_edge_width": record.left.detection.edge_width, "right_edge_width": record.right.detection.edge_width}
        for record in run.pairs
    ]
    return evaluate_calibration(
        fit.calibration,
        run.board,
        fit.left_points,
        fit.right_points,
        pairs=pairs,
        images=PairImages(run.pairs),
        unit=run.square.unit or None,
        scene=run.scene,
        scene_sweep=_sweep_scene(run),
    )


def _sweep_scene(run: CalibrationRun) -> SweepTable | None:
    """The paper's section 3 on the scene, if there is one; windows end where they no longer fit into the image."""
    if run.scene is None:
        return None
    left, right = to_eight_bits(*rectify_for_viewing(run.fit.calibration.rig).apply(*run.scene))
    sizes = [size for size in PAPER_BLOCK_SIZES if size < min(left.shape[:2])]
    return sweep_disparity(left, right, block_sizes=sizes)


class PairImages(Sequence[tuple[Any, Any]]):
    """The photographs of the pairs, read when they are asked for: a folder may hold more than fits into memory."""

    def __init__(self, records: Sequence[PairRecord]) -> None:
        self._records = records

    def __len__(self) -> int:
        return len(self._records)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return PairImages(self._records[index])
        pair = self._records[index].pair
        return pair.left.read(), pair.right.read()


def _beyond_the_rig(run: CalibrationRun) -> dict[str, Any]:
    """Return what is known beside the cameras, R and T."""
    calibration = run.fit.calibration
    std = dict(zip(calibration.parameter_names, calibration.std.tolist(), strict=True))
    alone = calibration.left, calibration.right
    left, right = (
        {"rms": rms, "rms_alone": None if camera is None else camera.rms}
        for rms, camera in zip((calibration.left_rms, calibration.right_rms), alone, strict=True)
    )
    return {
        "left": left,
        "right": right,
        "rms": calibration.rms,
        "rms_definition": "sqrt(sum of squared distances / number of points), px, over both images",
        "square_size": run.square.value,
        "inner_corners": list(run.board.inner_corners),
        "pairs_used": len(run.used),
        "pairs": [record.as_dict() for record in run.pairs],
        "skipped": list(run.skipped),
        "std": {**std, "baseline": calibration.baseline_std},
        "parameter_names": list(calibration.parameter_names),
        "covariance": calibration.covariance.tolist(),
        "board_shape": calibration.board.kind,
        "board_points": None if calibration.board.kind == "flat" else calibration.board.points.tolist(),
        "converged": calibration.converged,
        "iterations": calibration.iterations,
    }
