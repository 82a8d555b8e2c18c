"""Is my calibration good? All measures of a calibration, judged, on one page.

A small RMS answers less than it seems to: it is measured on the views that the parameters were fitted to, in one of
several conventions, and says nothing about depth. :func:`evaluate_calibration` therefore measures eight things: the
data, the fit, the parameters, generalisation to unseen views (the headline), epipolar error, metric error, depth,
and, given a scene, disparity. Each figure is judged by a threshold that names its source
(:mod:`stereocal.report.thresholds`), with the likely cause and the next action where it is not good.

The verdict on the whole is the worst of the verdicts that decide. Advice about photographs does not decide: views that
lie lopsided but determine every parameter make a good calibration, and those that do not show it in its uncertainty.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from stereocal.base.atomic_files import write_whole
from stereocal.base.checks import as_image_size
from stereocal.base.errors import InputError
from stereocal.report.board_bend import free_the_board
from stereocal.report.coverage import examine_data
from stereocal.report.depth_error import examine_depth
from stereocal.report.evidence import Evidence, Refit, gather_evidence
from stereocal.report.fit import examine_fit
from stereocal.report.halves import compare_halves
from stereocal.report.held_out import HeldOut, examine_generalisation, hold_out
from stereocal.report.metric import examine_metric
from stereocal.report.parameters import examine_parameters
from stereocal.report.rectified import examine_epipolar, rectify_corners
from stereocal.report.scene import examine_scene
from stereocal.report.style import to_png
from stereocal.report.verdicts import Block, Grade, Picture, Verdict, spell, worst

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LEAST_VIEWS_TO_HOLD_OUT = 5
_LEAST_VIEWS_TO_HALVE = 8


@dataclass(frozen=True)
class QualityReport:
    """Everything measured on a calibration, and what is to be thought of it.

    Attributes
    ----------
    title : str
    blocks : tuple of Block
        The sections, in the page's order.
    rig : StereoRig
    unit : str
        Of length.
    extra_pictures : tuple of Picture
        Pictures that belong to no block: the rig with its boards.
    """

    title: str
    blocks: tuple[Block, ...]
    rig: Any
    unit: str
    extra_pictures: tuple[Picture, ...] = field(default=())

    @property
    def verdicts(self) -> list[Verdict]:
        """Every verdict, in the page's order."""
        return [verdict for block in self.blocks for verdict in block.verdicts]

    @property
    def overall(self) -> Grade:
        """The verdict on the whole: the worst of those that decide."""
        return worst([v.verdict for v in self.verdicts if v.decides])

    @property
    def actions(self) -> list[Verdict]:
        """Verdicts that ask for something, each action once, bad and deciding ones first."""
        asking = sorted((v for v in self.verdicts if v.action), key=lambda v: (v.verdict != "bad", not v.decides))
        return list({v.action: v for v in reversed(asking)}.values())[::-1]

    @property
    def tiles(self) -> list[tuple[str, str, str]]:
        """The headline figures: name, value, remark."""
        facts = {block.key: block.facts for block in self.blocks}
        held, fit = facts["generalisation"].get("held_out_rms"), facts["fit"]["rms"]["joint"]["opencv"]
        return [
            ("held-out RMS", spell(held, "px") if held else "unknown", f"fitted: {fit:.3f} px"),
            ("rows agree to", spell(facts["epipolar"]["rms"], "px"), f"95 % within {facts['epipolar']['p95']:.2f} px"),
            (
                "σ_Z at the boards",
                spell(facts["depth"]["sigma_z_at_board"], self.unit),
                f"{100 * facts['depth']['sigma_z_at_board'] / facts['depth']['board_distance']:.2g} % of "
                f"{facts['depth']['board_distance']:.3g} {self.unit}",
            ),
            ("baseline", spell(float(self.rig.baseline), self.unit), f"focal length {self.rig.left.K[0, 0]:.1f} px"),
            ("pairs used", str(facts["data"]["pairs_used"]), f"of {facts['data']['pairs_found']}"),
        ]

    @property
    def pictures(self) -> tuple[Picture, ...]:
        """Every picture, drawn when asked for."""
        return (*self.extra_pictures, *(p for block in self.blocks for p in block.pictures))

    @cached_property
    def figures(self) -> dict[str, Figure]:
        """Every picture, drawn: name to matplotlib figure."""
        return {picture.name: picture.draw() for picture in self.pictures}

    @cached_property
    def png(self) -> dict[str, bytes]:
        """Every picture as PNG, rendered once for the page and the folder."""
        return {name: to_png(figure) for name, figure in self.figures.items()}

    def as_dict(self) -> dict[str, Any]:
        """The figures and verdicts as plain data, as ``report.json`` holds them; what is unknown is None."""
        from stereocal.report.page import report_document

        return report_document(self)

    def save_html(self, path: str | os.PathLike[str]) -> Path:
        """Write the page: one file that needs no network, reads on a phone and prints.

        Parameters
        ----------
        path : path

        Returns
        -------
        Path
            The file written.

        Raises
        ------
        DataFileError
            If it cannot be written; what stood there before is untouched.
        """
        from stereocal.report.page import write_page

        return write_page(self, path)

    def save_json(self, path: str | os.PathLike[str]) -> Path:
        """Write the same figures and verdicts as JSON.

        Parameters
        ----------
        path : path

        Returns
        -------
        Path
            The file written.

        Raises
        ------
        DataFileError
            If it cannot be written; what stood there before is untouched.
        """
        from stereocal.report.page import write_document

        return write_document(self, path)

    def save_figures(self, folder: str | os.PathLike[str]) -> list[Path]:
        """Write every picture as PNG into a folder, and return the files."""
        return [write_whole(Path(folder) / f"{name}.png", data) for name, data in self.png.items()]


def evaluate_calibration(
    calibration: Any,
    board: Any,
    left_corners: Sequence[Any],
    right_corners: Sequence[Any],
    image_size: tuple[int, int] | None = None,
    *,
    mono_left: Any = None,
    mono_right: Any = None,
    pairs: Sequence[Mapping[str, Any]] | None = None,
    images: Sequence[Any] | None = None,
    refit: Refit | None = None,
    known_distances: Sequence[tuple[Any, Any, float]] = (),
    disparity_noise: float | None = None,
    scene: tuple[Any, Any] | None = None,
    scene_sweep: Any = None,
    folds: int = 5,
    seed: int = 0,
    unit: str | None = None,
    title: str = "Stereo calibration",
) -> QualityReport:
    """Measure a stereo calibration and judge it.

    Parameters
    ----------
    calibration : StereoCalibration
        From :func:`~stereocal.pair.stereo_calibration.calibrate_stereo`: with ``rig``, ``rvecs``, ``tvecs``.
    board : Chessboard
        The target.
    left_corners, right_corners : sequence of array_like of shape (N, 2)
        The corners that the calibration was made from, pixels, one entry a view, all corners of the board in order.
    image_size : tuple of (width, height), optional
        By default the left camera's.
    mono_left, mono_right : CameraCalibration, optional
        Each camera calibrated alone from the same corners; by default those that `calibration` holds.
    pairs : sequence of mapping, optional
        Every pair of photographs, used or not, in order: ``left`` and ``right`` (names), ``used`` (bool), ``reason``
        (why not), and optionally ``left_edge_width``, ``right_edge_width`` (px). The used ones are the views.
    images : sequence of (left, right), optional
        The photographs of `pairs` (or of the views, without `pairs`), for thumbnails and pictures. Any sequence will
        do, also one that reads them when asked; an entry may hold None.
    refit : callable, optional
        ``refit(left_corners, right_corners)`` calibrates a subset of the views, with the same settings as `calibration`
        was made with; by default ``calibrate_stereo`` with the same model.
    known_distances : sequence of ((xl, yl, xr, yr), (xl, yl, xr, yr), length)
        Pairs of points of the scene, by their pixels in both photographs, whose distance was measured otherwise: the
        only check of absolute scale.
    disparity_noise : float, optional
        σ of the disparities that depth will be made from, pixels; by default 0.25.
    scene : (left, right), optional
        Photographs of a scene, as taken: adds the disparity block.
    scene_sweep : SweepTable, optional
        The paper's sweep of that scene, rectified: adds its figures.
    folds : int
        Folds of the cross-validation.
    seed : int
        Deals views into folds and halves.
    unit : str, optional
        Of the board's square size, for the page: ``"mm"``. By default ``squares`` if the size is 1, else ``units``.
    title : str
        Of the page.

    Returns
    -------
    QualityReport

    Raises
    ------
    InputError
        If corners, views and pairs do not match.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> board = sc.Chessboard((7, 6), 25.0)
    >>> tilts = [(0.4, 0, 0), (-0.4, 0.1, 0), (0, 0.4, 0.1), (0.1, -0.4, 0), (0.3, 0.3, 0.2), (-0.3, 0.3, 0)]
    >>> camera = sc.Camera(K, None, (640, 480))
    >>> left = [camera.project(board.object_points, tilt, [-75, -60, 400]).round(2) for tilt in tilts]
    >>> right = [camera.project(board.object_points, tilt, [-135, -60, 400]).round(2) for tilt in tilts]
    >>> found = sc.calibrate_stereo(board.object_points, left, right, (640, 480))
    >>> report = sc.evaluate_calibration(found, board, left, right, folds=2)
    >>> report.overall
    'good'
    """
    size = as_image_size(image_size if image_size is not None else calibration.rig.left.image_size)
    entries = _pair_entries(pairs, len(left_corners))
    names = [str(p["left"]).rsplit(".", 1)[0] for p in entries if p["used"]]
    label = unit if unit is not None else ("squares" if float(board.square_size) == 1.0 else "units")
    evidence = gather_evidence(calibration, board, left_corners, right_corners, size, names, label)
    if images is not None and len(images) != len(entries):
        raise InputError(f"there are {len(entries)} pairs, but {len(images)} pairs of images; pass one entry a pair")
    refit = refit or _same_model_refit(calibration, board, size)
    held: HeldOut | None = None
    if evidence.view_count >= _LEAST_VIEWS_TO_HOLD_OUT:
        held = hold_out(evidence, refit, folds=folds, seed=seed)
    seen_by_none = held is not None and bool(np.isfinite(held.epipolar).any())
    epipolar = held.epipolar if held is not None and seen_by_none else None
    if epipolar is None:
        epipolar = rectify_corners(evidence.rig, evidence.left, evidence.right).across
    alone = (mono_left or getattr(calibration, "left", None), mono_right or getattr(calibration, "right", None))
    mono = [None if m is None else float(m.rms) for m in alone]
    fit = examine_fit(evidence, mono)
    free = np.asarray(calibration.std) > 0
    bend = free_the_board(evidence, free) if evidence.view_count >= _LEAST_VIEWS_TO_HOLD_OUT else None
    halves = compare_halves(evidence, refit, seed=seed) if evidence.view_count >= _LEAST_VIEWS_TO_HALVE else None
    blocks: tuple[Block, ...] = (
        examine_generalisation(evidence, held, halves, fit.facts["rms"]["joint"]["opencv"]),
        examine_depth(evidence, np.asarray(calibration.covariance), bend, disparity_noise=disparity_noise),
        examine_data(evidence, entries, images),
        fit,
        examine_parameters(calibration, label),
        examine_epipolar(evidence.left.reshape(-1, 2), epipolar.ravel(), size, held_out=seen_by_none),
        examine_metric(evidence, bend, known_distances),
    )
    if scene is not None:
        blocks = (*blocks, examine_scene(evidence.rig, *scene, sweep=scene_sweep))
    return QualityReport(title, blocks, evidence.rig, label, _rig_pictures(evidence, calibration))


def _pair_entries(pairs: Sequence[Mapping[str, Any]] | None, views: int) -> list[Mapping[str, Any]]:
    if pairs is None:
        return [{"left": f"{i + 1}", "right": f"{i + 1}", "used": True, "reason": None} for i in range(views)]
    used = sum(bool(p["used"]) for p in pairs)
    if used != views:
        raise InputError(f"{used} of the pairs are marked as used, but there are corners of {views} views")
    return list(pairs)


def _same_model_refit(calibration: Any, board: Any, size: tuple[int, int]) -> Refit:
    def refit(left: list[Any], right: list[Any]) -> Any:
        # not at the top: calibrating again is only one way to get a refit
        from stereocal.pair.stereo_calibration import calibrate_stereo

        # A calibration that freed the board's shape has another board than the drawing says.
        points = getattr(calibration, "object_points", None)
        X = board.object_points if points is None else points
        return calibrate_stereo(X, left, right, size, model=calibration.rig.left.model)

    return refit


def _rig_pictures(evidence: Evidence, calibration: Any) -> tuple[Picture, ...]:
    from stereocal.report.figures_geometry import draw_rig

    return (
        Picture(
            "rig",
            "Both cameras, and every board where the fit puts it (the dot is its first corner).",
            lambda: draw_rig(
                evidence.rig, list(calibration.rvecs), list(calibration.tvecs), evidence.object_points,
                evidence.columns, unit=evidence.unit,
            ),
        ),
    )  # fmt: skip
