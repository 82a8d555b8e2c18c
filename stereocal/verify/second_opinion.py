"""A second opinion: each step of a calibration recomputed by stereocal and by OpenCV, and where they part.

"Is OpenCV right about my rig?" has an answer for each step of the pipeline, on the same input: corners, homographies,
both cameras, the joint optimum, F and E, rectification, maps, interpolation, disparity, speckles, points in space. The
steps that need photographs are left out where there are none; the images are then a random texture.

This is the one room that imports OpenCV; nothing that it computes enters any result of the library.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter

from stereocal.base.checks import Float
from stereocal.base.errors import InputError
from stereocal.base.gray import to_gray
from stereocal.board.chessboard import Chessboard
from stereocal.board.detection import detect_chessboard
from stereocal.pair.corner_order import repair_corner_order
from stereocal.pair.rectification import rectify
from stereocal.pair.rig import StereoRig
from stereocal.verify import opencv_calls
from stereocal.verify.comparison import CrosscheckReport, StepComparison, not_compared
from stereocal.verify.crosscheck_given import judge_given
from stereocal.verify.crosscheck_images import (
    compare_disparity,
    compare_epipolar,
    compare_maps,
    compare_points,
    compare_rectification,
    compare_remap,
    compare_undistortion,
)
from stereocal.verify.crosscheck_points import (
    compare_camera,
    compare_chain,
    compare_corners,
    compare_homographies,
    compare_stereo,
)

Image = NDArray[Any]


def crosscheck(
    rig: StereoRig,
    *,
    board: Chessboard | None = None,
    left_images: Sequence[Image] = (),
    right_images: Sequence[Image] = (),
    names: Sequence[str] = (),
    used: Sequence[bool] | None = None,
    board_points: ArrayLike | None = None,
    scene: tuple[Image, Image] | None = None,
    unit: str = "units",
    progress: Callable[[str], None] = lambda step: None,
) -> CrosscheckReport:
    """Recompute every step of a calibration with stereocal and with OpenCV.

    Parameters
    ----------
    rig : StereoRig
        The calibration in question, from whatever tool.
    board : Chessboard, optional
        The target; needed with photographs.
    left_images, right_images : sequence of ndarray
        Photographs of the board, in pairs: they bring the steps from corners to the joint optimum.
    names : sequence of str
        What to call each pair in the sentences; by default their numbers.
    used : sequence of bool, optional
        The pairs that the calibration was made from, where that is known: only these judge whether it is at an optimum.
    board_points : array_like of shape (N, 3), optional
        The board's shape as the calibration found it, where it was not taken for flat.
    scene : (ndarray, ndarray), optional
        A pair for the dense steps; the first photographs if absent, a random texture if there are none.
    unit : str
        What the board's squares are measured in, for the sentences.
    progress : callable
        Called with the name of each step before it begins.

    Returns
    -------
    CrosscheckReport

    Raises
    ------
    InputError
        If there are photographs but no board, or not as many left as right, or too few show the board.

    Examples
    --------
    >>> import numpy as np, stereocal as sc
    >>> camera = sc.Camera([[430, 0, 320], [0, 430, 240], [0, 0, 1]], [-0.3, 0.1, 0, 0, 0], (640, 480))
    >>> report = crosscheck(sc.StereoRig(camera, camera, np.eye(3), [-60.0, 0, 0]))
    >>> [step.step for step in report.steps][:2]
    ['undistorted points', 'F and E']
    """
    steps: list[StepComparison] = []
    if left_images or right_images:
        if board is None:
            raise InputError("photographs need the board that they show: give its inner corners and square size")
        if len(left_images) != len(right_images):
            raise InputError(f"{len(left_images)} left and {len(right_images)} right photographs are no pairs")
        called = list(names) or [f"pair {k + 1}" for k in range(len(left_images))]
        photographs = _Photographs(board, (list(left_images), list(right_images)), called, used, board_points, unit)
        steps += _photographed_steps(rig, photographs, progress)
    if {rig.left.model, rig.right.model} <= set(opencv_calls.FLAGS_OF_MODEL):
        pair = scene or ((left_images[0], right_images[0]) if left_images else _textured_pair(rig))
        steps += _rig_steps(rig, pair, progress)
    else:
        steps.append(not_compared("the rig's own steps", f"OpenCV's pinhole functions have no {rig.left.model} model."))
    return CrosscheckReport(cv2.__version__, tuple(steps))


@dataclass(frozen=True)
class _Photographs:
    """What is known of the photographs of the board."""

    board: Chessboard
    images: tuple[list[Image], list[Image]]
    names: list[str]
    used: Sequence[bool] | None
    board_points: ArrayLike | None
    unit: str


def _photographed_steps(
    rig: StereoRig, photographs: _Photographs, progress: Callable[[str], None]
) -> list[StepComparison]:
    board, unit, names = photographs.board, photographs.unit, photographs.names
    steps: list[StepComparison] = []
    found: list[list[Float | None]] = []
    classic: list[list[Float | None]] = []
    for side, images, camera in zip(("left", "right"), photographs.images, (rig.left, rig.right), strict=True):
        progress(f"corners, {side}")
        found.append([detect_chessboard(image, board) for image in images])
        compared, by_opencv = compare_corners(side, images, found[-1], board, camera.image_size, names)
        steps += compared
        classic.append(by_opencv)
    pairs = [(k, a, b) for k, (a, b) in enumerate(zip(*found, strict=True)) if a is not None and b is not None]
    complete = [k for k, _, _ in pairs]
    if len(complete) < 3:
        raise InputError(
            f"the board is found in both images of {len(complete)} pairs, but at least 3 are needed; "
            f"is it {board} inner corners?"
        )
    size, X, model = rig.left.image_size, board.object_points, rig.left.model
    left, right, flipped = repair_corner_order(board, [a for _, a, _ in pairs], [b for _, _, b in pairs], size)
    if any(flipped):
        counts = f"{sum(flipped)} of {len(flipped)} pairs"
        finding = f"{counts} were numbered from opposite ends and turned; OpenCV does not check."
        source = "a flip ruins a stereo calibration"
        steps.append(StepComparison("corner order", sum(flipped), "pairs", 0, source, "stereocal", finding))
    progress("homographies")
    steps.append(compare_homographies(X, left))
    mono = []
    for side, views in (("left", left), ("right", right)):
        progress(f"intrinsics, {side}")
        step, _, theirs = compare_camera(side, X, views, size, model)
        steps.append(step)
        mono.append(theirs)
    progress("joint optimum")
    steps.append(compare_stereo(X, (left, right), size, model, (mono[0], mono[1])))
    progress("each its own corners")
    nearer = {step.nearer for step in steps if step.step.endswith("classic")}
    verdict = nearer.pop() if len(nearer) == 1 else "unknown"
    ours, theirs_found = (found[0], found[1]), (classic[0], classic[1])
    steps.append(compare_chain(board, ours, theirs_found, size, model, unit, names, verdict))
    progress("the given calibration")
    steps.append(_judge(rig, photographs, (left, right), complete))
    return steps


def _judge(
    rig: StereoRig, photographs: _Photographs, views: tuple[list[Float], list[Float]], complete: list[int]
) -> StepComparison:
    """Judge the given calibration by the pairs and the board that it was made from, as far as they are known."""
    X, note = photographs.board.object_points, ""
    kept = [k for k, pair in enumerate(complete) if photographs.used is None or photographs.used[pair]]
    if 3 <= len(kept) < len(complete):
        views = ([views[0][k] for k in kept], [views[1][k] for k in kept])
        note = f"by the {len(kept)} pairs that it was made from, "
    if photographs.board_points is not None:
        X = np.asarray(photographs.board_points, dtype=np.float64).reshape(X.shape)
        note += "with the board's shape as it found it, "
    return judge_given(X, views, rig, photographs.unit, note=note)


def _rig_steps(rig: StereoRig, pair: tuple[Image, Image], progress: Callable[[str], None]) -> list[StepComparison]:
    progress("undistortion and epipolar geometry")
    steps = [compare_undistortion(rig), compare_epipolar(rig)]
    progress("rectification")
    steps.append(compare_rectification(rig))
    # From here on the frame is the one that both cameras fill: OpenCV's rule can put the principal point far outside.
    rectification = rectify(rig, view="common")
    steps.append(compare_maps(rig, rectification))
    maps_left, maps_right = rectification.maps()
    images = [to_gray(image) for image in pair]
    steps.append(compare_remap(images[0], maps_left))
    progress("disparity and points")
    left, right = (
        cv2.remap(im, *maps, cv2.INTER_LINEAR) for im, maps in zip(images, (maps_left, maps_right), strict=True)
    )
    matching, speckles, disparity = compare_disparity(left, right)
    return [*steps, matching, speckles, compare_points(disparity, rectification.Q)]


def _textured_pair(rig: StereoRig) -> tuple[Image, Image]:
    """Random texture, seen shifted by ten pixels: something for matchers to chew on where there are no photographs."""
    width, height = rig.left.image_size
    texture = gaussian_filter(np.random.default_rng(0).normal(0, 1, (height, width + 10)), 1.2)
    picture = np.clip(127 + 90 * texture / np.abs(texture).max() * 2, 0, 255).astype(np.uint8)
    return np.ascontiguousarray(picture[:, :width]), np.ascontiguousarray(picture[:, 10:])
