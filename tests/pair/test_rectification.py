"""Rectification: equal to cv2.stereoRectify, rows that match, depth that is right, and words for what is odd."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from strategies import seeds

from stereocal.base.errors import DegenerateGeometryError, InputError
from stereocal.base.rotations import rotation_matrix
from stereocal.camera.model import Camera
from stereocal.pair.rectification import rectify
from stereocal.pair.rig import StereoRig

COEFFICIENTS = {"pinhole": 0, "polynomial": 2, "brown": 5, "rational": 8, "thin_prism": 12, "tilted": 14}
# gentle enough that OpenCV's five steps of undistortion do not run away at the corners
SPREAD = np.array([0.1, 0.02, 0.002, 0.002, 0.002] + 3 * [0.004] + 4 * [0.002] + 2 * [0.01])


def draw_rig(seed: int, *, vertical: bool = False, turn: float = 0.05) -> StereoRig:
    random = np.random.default_rng(seed)
    model = str(random.choice(list(COEFFICIENTS)))
    size = (640, 480) if random.random() < 0.5 else (641, 479)

    def camera() -> Camera:
        f = random.uniform(350, 900)
        K = [
            [f, 0, 320 + 15 * random.normal()],
            [0, f * random.uniform(0.97, 1.03), 240 + 15 * random.normal()],
            [0, 0, 1],
        ]
        return Camera(K, (random.normal(size=14) * SPREAD)[: COEFFICIENTS[model]], size, model)

    T = random.choice([-1, 1]) * np.array([3.0, 0, 0]) + 0.2 * random.normal(size=3)
    return StereoRig(camera(), camera(), rotation_matrix(random.normal(size=3) * turn), T[[1, 0, 2]] if vertical else T)


def _border(camera: Camera) -> np.ndarray:
    width, height = camera.image_size
    x, y = np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 9)
    return np.concatenate([np.column_stack([x, 0 * x + v]) for v in (0, height - 1)] + [
        np.column_stack([0 * y + u, y]) for u in (0, width - 1)
    ])  # fmt: skip


def opencv(rig: StereoRig, alpha: float | None, zero_disparity: bool, size: tuple[int, int] | None):
    def dist(camera: Camera) -> np.ndarray:
        return camera.dist if len(camera.dist) >= 4 else np.pad(camera.dist, (0, 4 - len(camera.dist)))

    return cv2.stereoRectify(
        np.array(rig.left.K),
        dist(rig.left),
        np.array(rig.right.K),
        dist(rig.right),
        rig.left.image_size,
        np.array(rig.R),
        np.array(rig.T).reshape(3, 1),
        flags=cv2.CALIB_ZERO_DISPARITY if zero_disparity else 0,
        alpha=-1 if alpha is None else alpha,
        newImageSize=size or (0, 0),
    )


@pytest.mark.parametrize("alpha", [None, 0, 0.5, 1])
@pytest.mark.parametrize("vertical", [False, True])
@given(seed=seeds, zero_disparity=st.booleans(), size=st.sampled_from([None, (800, 500), (320, 241)]))
@settings(max_examples=20)
def test_equals_opencv(alpha, vertical, seed, zero_disparity, size) -> None:
    rig = draw_rig(seed, vertical=vertical)
    # Where the lens folds over inside the picture OpenCV's five undistortion steps diverge, and the frame with them:
    # its stereoRectify then contradicts its own undistortPoints (f = 167 instead of 72 px in one such rig at alpha 1).
    assume(all(np.isfinite(camera.undistort_points(_border(camera))).all() for camera in (rig.left, rig.right)))
    ours = rectify(rig, alpha=alpha, zero_disparity=zero_disparity, image_size=size)
    theirs = opencv(rig, alpha, zero_disparity, size)
    for name, matrix in zip(("R1", "R2", "P1", "P2", "Q"), theirs[:5], strict=True):
        np.testing.assert_allclose(getattr(ours, name), matrix, rtol=1e-9, atol=1e-9, err_msg=name)
    for roi, other in ((ours.roi1, theirs[5]), (ours.roi2, theirs[6])):
        if alpha != 0:
            assert roi == tuple(other)
        else:
            # the sides that decide the zoom fall on the picture's edge: rounding may start a ROI one pixel further in
            assert np.abs(np.array(roi) - other).max() <= 1


@given(seed=seeds, vertical=st.booleans(), view=st.sampled_from(["opencv", "common"]))
@settings(max_examples=40)
def test_rows_match_and_Q_gives_the_point_back(seed, vertical, view) -> None:
    rig = draw_rig(seed, vertical=vertical)
    result = rectify(rig, view=view, zero_disparity=bool(seed % 2))
    random = np.random.default_rng(seed)
    X = np.column_stack([random.uniform(-2, 2, (20, 2)), random.uniform(8, 30, 20)])
    left = result.rectify_points(rig.left.project(X), "left")
    right = result.rectify_points(rig.right.project(X @ rig.R.T + rig.T), "right")
    across = 1 - result.axis
    np.testing.assert_allclose(left[:, across], right[:, across], atol=1e-6)
    d = (left - right)[:, result.axis]
    homogeneous = np.column_stack([left, d, np.ones(20)]) @ result.Q.T
    np.testing.assert_allclose(homogeneous[:, :3] / homogeneous[:, 3:], X @ result.R1.T, rtol=1e-6, atol=1e-6)
    assert np.all(homogeneous[:, 2] / homogeneous[:, 3] > 0)


def simple_rig(R=(0.01, -0.02, 0.01), T=(-3, 0.05, 0.02), dist=(-0.3, 0.1), model="brown", f=400.0) -> StereoRig:
    camera = Camera([[f, 0, 320], [0, f, 240], [0, 0, 1]], dist, (640, 480), model)
    return StereoRig(camera, camera, rotation_matrix(R), T)


def test_a_healthy_rig_has_no_warnings() -> None:
    assert rectify(simple_rig()).warnings == []


@pytest.mark.parametrize(
    ("rig", "said"),
    [
        (simple_rig(T=(3, 0.05, 0.02)), r"swapped.*T_x > 0.*--swap"),
        (simple_rig(R=(0.02, 0.01, np.pi - 0.05)), r"upside down.*180°.*calibrate again"),
        (simple_rig(R=(0.02, 0.01, np.pi / 2)), r"on its side.*rot90"),
        (simple_rig(T=(0.05, -3, 0.02)), r"baseline is vertical.*first camera is above.*rot90"),
        (simple_rig(T=(0.05, 3, 0.02)), r"first camera is below"),
        (simple_rig(R=(0.02, 0.9, 0)), r"optical axes differ by 52°.*alpha=1"),
        (simple_rig(T=(-1, 0, 3)), r"along the view"),
        (simple_rig(R=(0.0, 1.3, 0)), r"nearly empty: both cameras fill only"),
    ],
)
def test_odd_rigs_are_told_in_words(rig, said) -> None:
    assert any(re.search(said, warning) for warning in rectify(rig).warnings)


def test_swapped_cameras_still_give_positive_depth() -> None:
    rig = simple_rig()
    swapped = StereoRig(rig.right, rig.left, rig.R.T, -rig.R.T @ rig.T)
    X = np.array([[0.5, 0.2, 9.0], [-1, 0.4, 14]])
    result = rectify(swapped)
    first = result.rectify_points(rig.right.project(X @ rig.R.T + rig.T), "left")
    second = result.rectify_points(rig.left.project(X), "right")
    d = (first - second)[:, 0]
    assert np.all(d < 0)
    point = np.column_stack([first, d, [1, 1]]) @ result.Q.T
    depth = point[:, 2] / point[:, 3]
    assert np.all(depth > 0)
    np.testing.assert_allclose(
        np.linalg.norm(point[:, :3] / point[:, 3:], axis=1), np.linalg.norm(X @ rig.R.T + rig.T, axis=1)
    )


@pytest.mark.parametrize(
    ("model", "dist", "f"), [("fisheye", (0.02, -0.01, 0.002, 0), 200.0), ("division", (-0.2,), 400.0)]
)
def test_lenses_that_opencv_cannot_rectify_together(model, dist, f) -> None:
    """A fisheye of 180° across and a division model: rows match and the pictures are filled."""
    rig = simple_rig(model=model, dist=dist, f=f)
    result = rectify(rig, view="common")
    assert result.warnings == []
    X = np.column_stack([np.random.default_rng(0).uniform(-3, 3, (30, 2)), np.full(30, 8.0)])
    left = result.rectify_points(rig.left.project(X), "left")
    right = result.rectify_points(rig.right.project(X @ rig.R.T + rig.T), "right")
    np.testing.assert_allclose(left[:, 1], right[:, 1], atol=1e-6)
    assert result.valid_mask().mean() > 0.6


@given(seed=seeds)
@settings(max_examples=10)
def test_common_view_keeps_more_of_what_both_see(seed) -> None:
    """No frame by alpha that holds as few black pixels shows more of the common view."""
    rig = draw_rig(seed, turn=0.08)
    common = rectify(rig, view="common")
    x, y, width, height = common.roi1
    X, Y, W, H = common.roi2
    # the rectangles that both fill lie in the picture, and reach its edge in at least one direction
    for a, b, w, h in ((x, y, width, height), (X, Y, W, H)):
        assert min(a, b) >= 0
        assert a + w <= common.image_size[0]
        assert b + h <= common.image_size[1]
    shared = min(x + width, X + W) - max(x, X), min(y + height, Y + H) - max(y, Y)
    size = common.image_size
    assert shared[0] >= size[0] - 3 or shared[1] >= size[1] - 3


def test_valid_mask_is_where_a_white_picture_stays_white() -> None:
    result = rectify(simple_rig(), alpha=1)
    white = np.full((480, 640), 255, np.uint8)
    left, right = result.apply(white, white)
    mask = result.valid_mask()
    assert 0.3 < mask.mean() < 0.99
    assert (left[mask] == 255).all()
    assert (right[mask] == 255).all()
    assert (left[~result.valid_mask("left")] < 255).mean() > 0.95


def test_ghosts_are_told_and_blanked() -> None:
    """k3 < 0: far out the formula comes back and shows the middle again."""
    result = rectify(simple_rig(dist=(-0.4, 0.17, 0, 0, -0.045), f=430.0), alpha=1)
    assert any("folds over" in warning for warning in result.warnings)
    white = np.full((480, 640), 255, np.uint8)
    plain, _ = result.apply(white, white)
    clean, _ = result.apply(white, white, only_valid=True)
    mask = result.valid_mask("left")
    assert (clean[~mask] == 0).all()
    np.testing.assert_array_equal(clean[mask], plain[mask])
    assert (plain[~mask] > 0).mean() > 0.02


def test_roi_holds_no_black_pixel() -> None:
    result = rectify(simple_rig(), alpha=0.5)
    for roi, which in ((result.roi1, "left"), (result.roi2, "right")):
        x, y, w, h = roi
        assert w > 0
        assert result.valid_mask(which)[y : y + h, x : x + w].mean() > 0.999


def test_bad_input_is_refused_in_words() -> None:
    rig = simple_rig()
    with pytest.raises(InputError, match="alpha must be from 0"):
        rectify(rig, alpha=2)
    with pytest.raises(InputError, match="same image size"):
        rectify(StereoRig(rig.left, Camera(rig.left.K, None, (320, 240)), rig.R, rig.T))
    with pytest.raises(DegenerateGeometryError, match="same point"):
        rectify(simple_rig(T=(0, 0, 0)))
    with pytest.raises(InputError, match=r"right image is 10x10.*640x480"):
        rectify(rig).apply(np.zeros((480, 640), np.uint8), np.zeros((10, 10), np.uint8))
    no_lens = {"dist": (), "model": "pinhole"}
    for R, said in (((0, 1.5, 0), "optical axes differ by 86°"), ((0, 0, 3.1), "upside down"), ((0, 0, 1.6), "side")):
        with pytest.raises(DegenerateGeometryError, match=f"cannot be rectified such that.*{said}"):
            rectify(simple_rig(R=R, T=(-1, 3, 0) if said == "side" else (-3, 0, 0), **no_lens), view="common")


@settings(max_examples=25)
@given(st.floats(-12, -1), seeds)
def test_a_nearly_rectified_rig_loses_no_digits(exponent: float, seed: int) -> None:
    """However small the turn, both cameras end in one orientation with the baseline on the axis, to rounding.

    An arccosine near 0, or a rotation vector cut to 0 below 1e-5 rad as ``cv2.Rodrigues`` does, would not do that.
    """
    rng = np.random.default_rng(seed)
    small = 10**exponent
    rig = simple_rig(R=rng.normal(0, small, 3), T=(-60, *rng.normal(0, 60 * small, 2)))
    result = rectify(rig, alpha=0)
    np.testing.assert_allclose(result.R2 @ rig.R @ result.R1.T, np.eye(3), atol=2e-15)
    np.testing.assert_allclose((result.R2 @ rig.T)[1:] / 60, 0, atol=1e-15)


def test_opencv_drops_a_rotation_below_1e_5() -> None:
    """Turned by 8e-6 rad against each other, OpenCV leaves the cameras so: rows are off by f · 8e-6."""
    rig = simple_rig(R=(8e-6, 0, 0), T=(-60, 0, 0))
    K, k = rig.left.K, rig.left.dist
    R1, R2, *_ = cv2.stereoRectify(K, k, K, k, (640, 480), rig.R, rig.T.reshape(3, 1), alpha=0)
    theirs = np.abs(R2 @ rig.R @ R1.T - np.eye(3)).max()
    result = rectify(rig, alpha=0)
    assert np.abs(result.R2 @ rig.R @ result.R1.T - np.eye(3)).max() < 1e-15 < 7e-6 < theirs
