"""Pairs that do not belong together, and views that determine a rig or do not: named, and not fitted in silence."""

from __future__ import annotations

import numpy as np
import pytest
from camera_rigs import SIZE, board, rig, stereo_views

import stereocal as sc
from stereocal.base.rotations import rotation_matrix, rotation_vector

X = board()
LEFT, RIGHT, _ = stereo_views(rig(), X, 9, seed=3, noise=0.2)
ROWS_REVERSED = np.arange(54).reshape(6, 9)[::-1].ravel()


def parallel_pairs(noise: float, count: int = 6) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Boards shifted, brought nearer and turned in their plane, all parallel."""
    rng, truth = np.random.default_rng(1), rig()
    left, right = [], []
    for a in np.linspace(-0.5, 0.5, count):
        R, t = rotation_matrix([0.3, 0.1, 0]) @ rotation_matrix([0, 0, a]), rng.uniform([-4, -3, 10], [-2, -1, 15])
        views = (truth.left, R, t), (truth.right, truth.R @ R, truth.R @ t + truth.T)
        for into, (camera, turn, shift) in zip((left, right), views, strict=True):
            into.append(camera.project(X, rotation_vector(turn), shift) + rng.normal(0, noise, (len(X), 2)))
    return left, right


def weak_pairs(seed: int) -> tuple[sc.StereoRig, np.ndarray, list[np.ndarray], list[np.ndarray]]:
    """Few views, little tilt, much noise: one camera by itself is refused, both together are not."""
    rng, small = np.random.default_rng(seed), board(6, 5)
    cams = [sc.Camera([[f, 0, 320], [0, f, 240], [0, 0, 1]], None, SIZE) for f in (1000, 950)]
    truth = sc.StereoRig(*cams, rotation_matrix([0.02, 0.25, 0.01]), [-5.0, 0.1, 0.5])
    left, right = [], []
    while len(left) < 6:
        R = rotation_matrix([*rng.uniform(-0.1, 0.1, 2), rng.uniform(-1, 1)])
        X_0 = small @ R.T + [rng.uniform(-3, 3), rng.uniform(-2, 2), rng.uniform(16, 24)] - R @ small.mean(axis=0)
        left.append(truth.left.project(X_0) + rng.normal(0, 0.7, (30, 2)))
        right.append(truth.right.project(X_0 @ truth.R.T + truth.T) + rng.normal(0, 0.7, (30, 2)))
    return truth, small, left, right


@pytest.mark.parametrize(
    ("right", "message"),
    [
        ([y * [-1, 1] + [SIZE[0] - 1, 0] for y in RIGHT], "mirrored"),
        ([y[ROWS_REVERSED] for y in RIGHT], "mirrored"),
        ([y[::-1] for y in RIGHT], "counted from the same end"),
        ([*RIGHT[1:], RIGHT[0]], "views of the same moment"),
    ],
    ids=["mirrored image", "mirrored order", "turned", "shifted"],
)
def test_pairs_of_which_none_agree_are_an_error(right: list, message: str) -> None:
    with pytest.raises(sc.ConvergenceError, match=f"no common rig.*{message}"):
        sc.calibrate_stereo(X, LEFT, right, SIZE)


def test_the_pairs_that_do_not_fit_are_named() -> None:
    turned = [y[::-1] if i == 3 else y for i, y in enumerate(RIGHT)]
    found = sc.calibrate_stereo(X, LEFT, turned, SIZE)
    assert found.warnings[0].startswith("view 3 does not fit the rig that the others see")
    assert "view 3 does not fit" in found.summary()
    swapped = [RIGHT[{2: 5, 5: 2}.get(i, i)] for i in range(9)]
    assert sc.calibrate_stereo(X, LEFT, swapped, SIZE).warnings[0].startswith("view 2, 5 do not fit")


@pytest.mark.parametrize("side", [0, 1])
@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        (lambda y: y[ROWS_REVERSED], "view 3 shows the board from the other side than the rest"),
        (lambda y: y * [-1, 1] + [SIZE[0] - 1, 0], "view 3 shows the board from the other side than the rest"),
        (lambda y: y[np.arange(54).reshape(6, 9).T.ravel()], "view 3 fits no pose of the board"),
        (lambda y: y[np.random.default_rng(0).permutation(54)], "view 3 fits no pose of the board"),
    ],
    ids=["rows reversed", "image mirrored", "columns first", "shuffled"],
)
def test_one_camera_s_view_in_another_order_is_named(side: int, wrong, sentence: str) -> None:
    sides = [list(LEFT), list(RIGHT)]
    sides[side][3] = wrong(sides[side][3])
    try:
        said = sc.calibrate_stereo(X, *sides, SIZE).warnings
    except sc.StereocalError as error:
        said = (str(error),)
    assert any(f"{('left', 'right')[side]} camera" in text and sentence in text for text in said)
    assert not any(f"{('right', 'left')[side]} camera: view" in text for text in said)


def test_views_are_numbered_as_the_rig_has_them() -> None:
    """A camera that missed views counts those it saw, but the warning speaks of all."""
    right = [np.zeros((0, 2)) if i in (0, 2) else y for i, y in enumerate(RIGHT)]
    right[5] = right[5][ROWS_REVERSED]
    found = sc.calibrate_rig(X, [LEFT, right], SIZE)
    said = [text for text in found.warnings if "other side" in text]
    assert len(said) == 1
    assert "camera: view 5 shows the board" in said[0]


def test_what_is_refused_for_a_view_in_another_order_is_laid_to_it() -> None:
    refused = 0
    for seed in range(12):
        left, right, _ = stereo_views(rig(), X, 5, seed=seed, noise=0.2)
        right[1] = right[1][ROWS_REVERSED]
        try:
            said = "; ".join(sc.calibrate_stereo(X, left, right, SIZE).warnings)
        except sc.StereocalError as error:
            said, refused = str(error), refused + 1
        assert "view 1 shows the board from the other side" in said
    assert refused > 0


@pytest.mark.parametrize("noise", [0.0, 0.2, 1.0])
def test_pairs_that_belong_together_are_not_accused(noise: float) -> None:
    left, right, _ = stereo_views(rig(), X, 8, seed=5, noise=noise)
    found = sc.calibrate_stereo(X, left, right, SIZE)
    assert not any("view" in warning for warning in found.warnings)


def test_cameras_given_as_a_start_do_not_hide_degenerate_views() -> None:
    truth = rig()
    given = {"left": truth.left, "right": truth.right}
    with pytest.raises(sc.DegenerateGeometryError, match="the one view leaves the focal length open"):
        sc.calibrate_stereo(X, LEFT[:1], RIGHT[:1], SIZE, **given)
    left, right = parallel_pairs(0.1)
    with pytest.raises(sc.DegenerateGeometryError, match="boards of all 6 views are parallel"):
        sc.calibrate_stereo(X, left, right, SIZE, **given)
    with pytest.raises(sc.DegenerateGeometryError, match="parallel"):  # known twice, for cameras that look the same way
        sc.calibrate_stereo(X, left, right, SIZE, aspect_ratio=truth.left.fx / truth.left.fy)
    for options in ({"fix_intrinsics": True}, {"priors": {"fx": (530.0, 1.0), "fy": (530.0, 1.0)}}):
        found = sc.calibrate_stereo(X, left, right, SIZE, **given, **options)
        np.testing.assert_allclose(found.rig.T, truth.T, atol=0.1)


@pytest.mark.parametrize(("seed", "refused"), [(0, "right"), (7, "right"), (16, "left")])
def test_what_one_camera_leaves_open_both_may_determine(seed: int, refused: str) -> None:
    truth, small, left, right = weak_pairs(seed)
    with pytest.raises(sc.DegenerateGeometryError):
        sc.calibrate_camera(small, left if refused == "left" else right, SIZE)
    found = sc.calibrate_stereo(small, left, right, SIZE)
    assert getattr(found, refused) is None
    assert found.converged
    fx = found.parameter_names.index("left.fx")
    assert found.std[fx] < 0.2 * truth.left.fx
    assert abs(found.rig.left.fx - truth.left.fx) < 4 * found.std[fx]
    warm = sc.calibrate_stereo(small, left, right, SIZE, left=truth.left, right=truth.right)
    assert found.rms <= warm.rms * (1 + 1e-9)


def test_nothing_is_shared_of_cameras_that_are_held() -> None:
    with pytest.raises(sc.InputError, match=r"share names .*fix_intrinsics holds them"):
        sc.calibrate_stereo(X, LEFT, RIGHT, SIZE, share="distortion", fix_intrinsics=True)
