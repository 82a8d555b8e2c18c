"""Options of the stereo calibration, each by what it must do: shared parameters, priors, outliers, losses, weights."""

from __future__ import annotations

import numpy as np
import pytest
from camera_rigs import SIZE, board, camera, rig, stereo_views

import stereocal as sc
from stereocal.base.rotations import rotation_matrix

X = board()


def twin_rig() -> sc.StereoRig:
    """Two cameras of one make: the same focal length and lens, other principal points."""
    left = camera()
    K = left.K.copy()
    K[:2, 2] = 318, 243
    return sc.StereoRig(
        left, sc.Camera(K, left.dist, SIZE), rotation_matrix([0.006, 0.012, -0.004]), [-3.3, 0.03, 0.02]
    )


def index(found: sc.StereoCalibration, *names: str) -> list[int]:
    """Places of parameters in `std`."""
    return [found.parameter_names.index(name) for name in names]


def test_shared_parameters_are_equal_and_surer() -> None:
    left, right, _ = stereo_views(twin_rig(), X, 6, seed=1, noise=0.3)
    apart = sc.calibrate_stereo(X, left, right, SIZE, fix="k3")
    shared = sc.calibrate_stereo(X, left, right, SIZE, fix="k3", share=("focal_length", "distortion"))
    a, b = shared.rig.left, shared.rig.right
    assert (a.fx, a.fy) == (b.fx, b.fy)
    np.testing.assert_array_equal(a.dist, b.dist)
    assert a.cx != b.cx
    assert shared.converged
    # six unknowns less: a little worse a fit, by about six parts of all degrees of freedom, and a surer answer
    assert apart.rms < shared.rms < apart.rms * (1 + 20 / (4 * 6 * 54))
    assert shared.joint.degrees_of_freedom == apart.joint.degrees_of_freedom + 6
    assert (shared.std[index(shared, "left.k1", "left.k2")] < apart.std[index(apart, "left.k1", "left.k2")]).all()
    assert abs(a.fx - 530) < 4 * shared.std[0]
    assert shared.std[index(shared, "left.fx")] == shared.std[index(shared, "right.fx")]


@pytest.mark.parametrize("aspect_ratio", [None, 1 / 1.004])
def test_shared_focal_length_in_both_engines(aspect_ratio: float | None) -> None:
    left, right, _ = stereo_views(twin_rig(), X, 6, seed=2, noise=0.3)
    fast, slow = (
        sc.calibrate_stereo(X, left, right, SIZE, share="focal_length", aspect_ratio=aspect_ratio, backend=backend)
        for backend in ("numba", "numpy")
    )
    np.testing.assert_allclose(fast.rms, slow.rms, rtol=1e-10)
    np.testing.assert_allclose(fast.rig.T, slow.rig.T, atol=1e-6)
    assert fast.rig.left.fx == pytest.approx(fast.rig.right.fx, rel=1e-12)
    if aspect_ratio is not None:
        np.testing.assert_allclose(fast.rig.right.fx, aspect_ratio * fast.rig.right.fy, rtol=1e-12)


def test_what_cannot_be_shared_is_named() -> None:
    left, right, _ = stereo_views(twin_rig(), X, 4, seed=3)
    with pytest.raises(sc.InputError, match="share names 'k9'"):
        sc.calibrate_stereo(X, left, right, SIZE, share="k9")
    with pytest.raises(sc.InputError, match="held in one of the cameras"):
        sc.calibrate_stereo(X, left, right, SIZE, share="k2", fix="left.k2")


def test_priors_of_one_camera_of_both_and_of_the_translation() -> None:
    left, right, _ = stereo_views(rig(), X, 5, seed=4, noise=0.4)
    free = sc.calibrate_stereo(X, left, right, SIZE)
    fx, s_left = free.rig.left.fx, free.std[0]
    half = sc.calibrate_stereo(X, left, right, SIZE, priors={"left.fx": (fx + s_left, s_left)})
    np.testing.assert_allclose(half.rig.left.fx, fx + s_left / 2, atol=0.1 * s_left)
    np.testing.assert_allclose(half.std[0], s_left / np.sqrt(2), rtol=0.1)
    both = sc.calibrate_stereo(X, left, right, SIZE, priors={"fx": (533.0, 1e-6)})
    np.testing.assert_allclose([both.rig.left.fx, both.rig.right.fx], 533, atol=1e-4)
    known = sc.calibrate_stereo(X, left, right, SIZE, priors={"T_x": (-3.3, 1e-7)})
    np.testing.assert_allclose(known.rig.T[0], -3.3, atol=1e-5)
    assert known.std[index(known, "T_x")] < 1e-6
    for name, message in (("rvec_x", "a rotation takes none"), ("f", "priors name 'f'")):
        with pytest.raises(sc.InputError, match=message):
            sc.calibrate_stereo(X, left, right, SIZE, priors={name: (0, 1)})


def test_outliers_of_either_camera_are_left_out_and_named() -> None:
    left, right, _ = stereo_views(rig(), X, 8, seed=5, noise=0.1)
    clean = sc.calibrate_stereo(X, left, right, SIZE)
    left[2][7] += (9, -6)
    right[5][30] += (-7, 8)
    spoilt = sc.calibrate_stereo(X, left, right, SIZE)
    found = sc.calibrate_stereo(X, left, right, SIZE, reject_outliers=True)
    assert {(c.camera, c.view, c.point) for c in found.rejected} == {(0, 2, 7), (1, 5, 30)}
    assert "left out: right view 5, corner 30" in found.summary()
    assert found.rms < 1.02 * clean.rms < spoilt.rms
    assert [len(d) for side in found.residuals for d in side] == [54] * 16
    assert np.hypot(*found.residuals[1][5][30]) == pytest.approx(np.hypot(7, 8), abs=1)
    np.testing.assert_allclose(found.rig.T, clean.rig.T, atol=3 * clean.std[-3:].max())
    assert clean.rejected == spoilt.rejected == []


def test_a_whole_view_in_another_order_is_named_as_such() -> None:
    left, right, _ = stereo_views(rig(), X, 10, seed=6, noise=0.1)
    right[3] = right[3][::-1]
    found = sc.calibrate_stereo(X, left, right, SIZE, reject_outliers=True)
    of_view = [c for c in found.rejected if c.view == 3]
    assert len({c.camera for c in of_view}) == 1
    assert len(of_view) == 54
    assert "another order" in of_view[0].reason
    np.testing.assert_allclose(found.rig.T, rig().T, atol=0.05)


def test_robust_losses_forgive_gross_errors() -> None:
    left, right, _ = stereo_views(rig(), X, 8, seed=7, noise=0.1)
    for i in range(0, 8, 2):
        right[i][11] += (25, -18)
    plain, robust = (
        sc.calibrate_stereo(X, left, right, SIZE, loss=loss, loss_scale=0.3) for loss in ("linear", "cauchy")
    )
    assert np.linalg.norm(robust.rig.T - rig().T) < 0.3 * np.linalg.norm(plain.rig.T - rig().T)


def test_weights_of_corners_make_the_answer_surer() -> None:
    """Half of the corners have ten times the noise: with their covariances given, they spoil nothing."""
    rng = np.random.default_rng(8)
    left, right, _ = stereo_views(rig(), X, 6, seed=8)
    sigma = [[np.where(rng.random(54) < 0.5, 0.05, 0.5) for _ in side] for side in (left, right)]
    noisy = [[y + rng.normal(size=y.shape) * s[:, None] for y, s in zip(side, of, strict=True)]
             for side, of in zip((left, right), sigma, strict=True)]  # fmt: skip
    C = [[s[:, None, None] ** 2 * np.eye(2) for s in of] for of in sigma]
    plain = sc.calibrate_stereo(X, *noisy, SIZE)
    weighted = sc.calibrate_stereo(X, *noisy, SIZE, left_covariances=C[0], right_covariances=C[1])
    np.testing.assert_allclose(weighted.joint.variance, 1, atol=0.15)
    assert (weighted.std[-3:] < 0.4 * plain.std[-3:]).all()
    assert (np.abs(weighted.rig.T - rig().T) < 4 * weighted.std[-3:]).all()


@pytest.mark.parametrize("kind", ["bow", "released"])
def test_the_board_s_shape_is_found_with_both_cameras(kind: str) -> None:
    flat = board(7, 5)
    bent = flat.copy()
    bent[:, 2] = 0.06 * (flat[:, 0] / 3 - 1) ** 2
    left, right, _ = stereo_views(rig(), bent, 8, seed=9, noise=0.05)
    plain = sc.calibrate_stereo(flat, left, right, SIZE)
    found = sc.calibrate_stereo(flat, left, right, SIZE, board_warp=kind)
    assert found.rms < 0.8 * plain.rms
    assert found.rms < 0.075
    apart = found.board.points[:, 2] - bent[:, 2]
    plane = np.column_stack([flat[:, :2], np.ones(len(flat))])
    apart -= plane @ np.linalg.lstsq(plane, apart)[0]
    assert np.abs(apart).max() < 0.015


def test_false_corners_of_a_bent_board_are_left_out_and_the_rest_told_apart() -> None:
    flat = board(7, 5)
    bent = flat.copy()
    bent[:, 2] = 0.06 * (flat[:, 0] / 3 - 1) ** 2
    left, right, _ = stereo_views(rig(), bent, 8, seed=9, noise=0.05)
    left[2][7] += (15, -9)
    right[4][3] += (-8, 12)
    found = sc.calibrate_stereo(flat, left, right, SIZE, board_warp="bow", reject_outliers=True)
    assert {(r.camera, r.view, r.point) for r in found.rejected} == {(0, 2, 7), (1, 4, 3)}
    assert found.rms < 0.075
    np.testing.assert_allclose(found.residuals[0][2][7], (15, -9), atol=0.5)
    assert np.median(np.abs(found.residuals[1][4])) < 0.08
