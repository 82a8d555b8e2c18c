from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import stereocal as sc
from stereocal.verify.comparison import CrosscheckReport, StepComparison, not_compared
from stereocal.verify.crosscheck_given import judge_given
from stereocal.verify.crosscheck_points import (
    _smaller_beyond_noise,
    compare_chain,
    compare_stereo,
    projection_difference,
)
from stereocal.verify.opencv_calls import calibrate_camera
from stereocal.verify.second_opinion import crosscheck

SIZE = (640, 480)


def make_rig(dist: tuple[float, ...] = (-0.38, 0.15, 0.001, -0.0005, 0.0)) -> sc.StereoRig:
    left = sc.Camera([[430, 0, 322], [0, 431, 244], [0, 0, 1]], dist, SIZE)
    right = sc.Camera([[428, 0, 318], [0, 429, 239], [0, 0, 1]], dist, SIZE)
    return sc.StereoRig(left, right, sc.rotation_matrix([0.01, 0.02, -0.005]), [-60.0, 0.5, 1.0])


def simulated_views(
    rig: sc.StereoRig, noise: float = 0.1, inner_corners: tuple[int, int] = (9, 6)
) -> tuple[np.ndarray, tuple[list, list]]:
    rng = np.random.default_rng(5)
    X = sc.Chessboard(inner_corners, 25.0).object_points
    left, right = [], []
    for _ in range(14):
        R = sc.rotation_matrix([*rng.uniform(-0.6, 0.6, 2), rng.uniform(-0.3, 0.3)])
        centre = np.array([rng.uniform(-90, 120), rng.uniform(-70, 70), rng.uniform(380, 600)])
        in_left = (X - X.mean(0)) @ R.T + centre
        still = np.zeros(3)
        left.append(rig.left.project(in_left, still, still) + rng.normal(0, noise, (len(X), 2)))
        right.append(rig.right.project(in_left @ rig.R.T + rig.T, still, still) + rng.normal(0, noise, (len(X), 2)))
    return X, (left, right)


def test_without_photographs_every_step_of_the_rig_is_compared() -> None:
    report = crosscheck(make_rig())
    steps = {step.step: step for step in report.steps}
    assert set(steps) == {
        "undistorted points", "F and E", "rectification", "rectification maps", "remap", "disparity", "speckle filter",
        "points in space",
    }  # fmt: skip
    exact = ["F and E", "rectification", "rectification maps", "disparity", "speckle filter", "points in space"]
    assert all(steps[name].agrees for name in exact), report.summary()
    # OpenCV's five iterations: our points come back, its points do not.
    bad = steps["undistorted points"]
    assert not bad.agrees
    assert bad.nearer == "stereocal"
    assert bad.figures["ours_round_trip_px"] < 1e-9 < 0.01 < bad.figures["opencv_round_trip_px"]
    assert "five iterations" in bad.finding


def test_opencv_4_is_told_that_it_rounds_coordinates() -> None:
    step = next(step for step in crosscheck(make_rig()).steps if step.step == "remap")
    assert step.figures["ours_error"] <= 0.5 + 1e-4  # weights in float32, then rounding
    assert ("1/32" in step.finding) == (cv2.__version__ < "5")


def test_a_model_that_opencv_lacks_is_said_to_be_so() -> None:
    camera = sc.Camera([[430, 0, 320], [0, 430, 240], [0, 0, 1]], [0.9], SIZE, model="fov")
    report = crosscheck(sc.StereoRig(camera, camera, np.eye(3), [-60.0, 0, 0]))
    assert [step.compared for step in report.steps] == [False]
    assert "no fov model" in report.steps[0].finding


def test_the_given_calibration_is_judged() -> None:
    rig = make_rig()
    X, views = simulated_views(rig)
    best = sc.calibrate_stereo(X, *views, SIZE)
    at_optimum = judge_given(X, views, best.rig, "mm")
    assert at_optimum.agrees
    assert at_optimum.figures["gradient_cosine"] < 1e-6
    off = sc.StereoRig(best.rig.left, best.rig.right, best.rig.R @ sc.rotation_matrix([0, 0.003, 0]), best.rig.T)
    judged = judge_given(X, views, off, "mm")
    assert not judged.agrees
    assert judged.figures["given_rms_px"] > best.rms
    assert judged.figures["gradient_cosine"] > 0.1
    assert judged.figures["median_shift"] > 1  # 3 mrad at half a metre
    assert "not at an optimum" in judged.finding


def test_exchanged_cameras_and_lengths_in_another_unit_are_named() -> None:
    X, (left, right) = simulated_views(make_rig())
    views = (left[:5], right[:5])
    best = sc.calibrate_stereo(X, *views, SIZE).rig
    exchanged = sc.StereoRig(best.right, best.left, best.R.T, -best.R.T @ best.T)
    judged = judge_given(X, views, exchanged, "mm")
    assert "swapped" in judged.finding
    assert not judged.agrees
    judged = judge_given(X, views, sc.StereoRig(best.left, best.right, best.R, best.T / 1000), "mm")  # metres
    assert "1000 times as long" in judged.finding, judged.finding
    assert not judged.agrees


def test_pairs_that_opencv_numbers_from_two_ends_are_named() -> None:
    """OpenCV does not look whether left and right count from the same end; the step says which pair, and the harm."""
    board = sc.Chessboard((8, 6), 25.0)  # the same after half a turn
    left, right = simulated_views(make_rig(), inner_corners=(8, 6))[1]
    names = [f"{k:02d}.png" for k in range(len(left))]
    turned = [view[::-1] if k == 4 else view for k, view in enumerate(right)]
    step = compare_chain(board, (left, right), (left, turned), SIZE, "brown", "mm", names, "unknown")
    assert step.nearer == "stereocal"
    assert "opposite ends in 04.png" in step.finding
    assert step.figures["flipped_pairs"] == 1
    assert step.figures["opencv_rms_px"] > 10 * step.figures["ours_rms_px"]
    assert step.figures["opencv_rms_unflipped_px"] == pytest.approx(step.figures["ours_rms_px"], abs=0.02)
    same = compare_chain(board, (left, right), (left, right), SIZE, "brown", "mm", names, "unknown")
    assert "opposite ends" not in same.finding


def test_only_differences_beyond_the_scatter_of_views_rank_the_corners() -> None:
    rng = np.random.default_rng(0)
    base = rng.uniform(0.01, 0.05, 20)
    noise = rng.normal(0, 0.005, 20)
    assert _smaller_beyond_noise(base, base + noise - noise.mean()) == "unknown"
    assert _smaller_beyond_noise(base, base + 0.02 + noise) == "stereocal"
    assert _smaller_beyond_noise(base + 0.02 + noise, base) == "opencv"


def test_joint_optimum_is_never_above_opencv() -> None:
    X, views = simulated_views(make_rig())
    mono = []
    for side in views:
        _, K, dist = calibrate_camera(X, side, SIZE, "brown")
        mono.append((K, dist))
    step = compare_stereo(X, views, SIZE, "brown", (mono[0], mono[1]))
    assert step.figures["ours_rms_px"] <= step.figures["opencv_rms_px"] + 1e-7
    assert step.nearer in ("equal", "stereocal")


def test_projection_difference_ignores_what_a_rotation_explains() -> None:
    a = sc.Camera([[430, 0, 322], [0, 430, 244], [0, 0, 1]], None, SIZE)
    moved_centre = sc.Camera([[430, 0, 323], [0, 430, 244], [0, 0, 1]], None, SIZE)
    longer = sc.Camera([[435, 0, 322], [0, 435, 244], [0, 0, 1]], None, SIZE)
    assert projection_difference(a, a) < 1e-9
    assert projection_difference(a, moved_centre) < 1
    assert projection_difference(a, longer) > 2


def test_photographs_need_a_board_and_pairs() -> None:
    image = np.zeros((480, 640), np.uint8)
    with pytest.raises(sc.InputError, match="inner corners"):
        crosscheck(make_rig(), left_images=[image], right_images=[image])
    with pytest.raises(sc.InputError, match="2 left and 1 right"):
        crosscheck(make_rig(), board=sc.Chessboard((9, 6)), left_images=[image] * 2, right_images=[image])
    with pytest.raises(sc.InputError, match="found in both images of 0 pairs"):
        crosscheck(make_rig(), board=sc.Chessboard((9, 6)), left_images=[image], right_images=[image])


def test_summary_counts_who_is_nearer() -> None:
    def step(difference: float, nearer: str) -> StepComparison:
        return StepComparison("s", difference, "px", 1.0, "a source", nearer, "a finding")

    report = CrosscheckReport(
        "5.0.0", (step(0, "equal"), step(2, "stereocal"), step(3, "unknown"), not_compared("x", "why"))
    )
    assert report.summary() == (
        "1 of 3 steps agree with OpenCV 5.0.0 within their tolerance; "
        "nearer the truth where they part: stereocal 1, cannot be known here 1."
    )
    assert report.to_document()["steps"][3]["difference"] is None


def test_real_photographs(data: Path) -> None:
    """The flips that OpenCV lets pass are named, and our corners are the better ones on views held out."""
    from stereocal.store.images import read_image

    images = [
        [read_image(path) for path in sorted((data / "bumblebee2_chess" / side).glob("*.jpg"))]
        for side in ("left", "right")
    ]
    board = sc.Chessboard((6, 4), 30.0)
    corners = [[sc.detect_chessboard(image, board) for image in side] for side in images]
    from stereocal.pair.corner_order import repair_corner_order

    left, right, _ = repair_corner_order(board, *corners, SIZE)
    rig = sc.calibrate_stereo(board.object_points, left, right, SIZE).rig
    report = crosscheck(rig, board=board, left_images=images[0], right_images=images[1], unit="mm")
    steps = {step.step: step for step in report.steps}
    assert steps["the given calibration"].agrees
    for side in ("left", "right"):
        against_sb = steps[f"corners {side}, SB"]
        assert against_sb.nearer == "stereocal"
        assert steps[f"intrinsics, {side}"].figures["ours_rms_px"] < 0.08
