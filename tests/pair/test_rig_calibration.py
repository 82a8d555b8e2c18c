"""Any number of cameras: the truth with missing views, two cameras as the stereo calibration has them, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from camera_rigs import SIZE, board, camera, poses, rig, stereo_views

import stereocal as sc
from stereocal.base.rotations import rotation_matrix, rotation_vectors

X = board()
CAMERAS = [camera(), camera("fisheye", (0.05, -0.02, 0.01, -0.003), f=420.0), camera("polynomial", (-0.2, 0.05), f=600)]
MODELS = [c.model for c in CAMERAS]
R = np.stack([np.eye(3), rotation_matrix([0.01, 0.05, -0.02]), rotation_matrix([-0.02, -0.04, 0.01])])
T = np.array([[0, 0, 0], [-2.0, 0.1, 0.05], [1.5, -0.2, 0.1]])
VIEWS = 12


def three_cameras(noise: float, seed: int = 0):
    """Corners [camera][view]: no view is seen by all, and the last three by one camera alone."""
    rng = np.random.default_rng(seed)
    corners: list[list[np.ndarray | None]] = [[None] * VIEWS for _ in CAMERAS]
    for v, (r, t) in enumerate(poses(VIEWS, rng, X, *zip(CAMERAS, R, T, strict=True))):
        X_0 = X @ rotation_matrix(r).T + t
        for c in {v % 3, (v + 1) % 3} if v < 9 else {v % 3}:
            corners[c][v] = CAMERAS[c].project(X_0 @ R[c].T + T[c]) + rng.normal(0, 1, (len(X), 2)) * noise
    return corners


def test_three_cameras_with_missing_views_give_the_truth() -> None:
    found = sc.calibrate_rig(X, three_cameras(0.0), SIZE, model=MODELS)
    assert found.converged
    assert found.rms < 1e-6
    np.testing.assert_allclose(found.R, R, atol=1e-6)
    np.testing.assert_allclose(found.T, T, atol=1e-5)
    for got, true in zip(found.cameras, CAMERAS, strict=True):
        np.testing.assert_allclose(got.K, true.K, atol=1e-3)
    two = found.pair(1, 2)
    np.testing.assert_allclose(two.R @ R[1], R[2], atol=1e-6)
    np.testing.assert_allclose(two.T, T[2] - two.R @ T[1], atol=1e-5)


def test_the_truth_is_within_its_standard_deviations() -> None:
    """Mahalanobis distance of all motions from the truth, over ten repetitions: χ² of 12 degrees of freedom each."""
    chi2 = []
    for seed in range(10):
        found = sc.calibrate_rig(X, three_cameras(0.2, seed), SIZE, model=MODELS, fix=("camera0.k3",))
        rows = [i for i, name in enumerate(found.parameter_names) if ".rvec_" in name or ".T_" in name]
        assert len(rows) == 12
        motions = np.hstack([rotation_vectors(found.R[1:]) - rotation_vectors(R[1:]), found.T[1:] - T[1:]]).ravel()
        chi2.append(motions @ np.linalg.solve(found.covariance[np.ix_(rows, rows)], motions))
        np.testing.assert_allclose(found.rms, 0.2 * np.sqrt(2), rtol=0.06)
    # the mean of ten is known to √(24/10) = 1.5
    assert abs(np.mean(chi2) - 12) < 4 * np.sqrt(24 / 10)


def test_two_cameras_are_a_stereo_rig() -> None:
    left, right, _ = stereo_views(rig(), X, 8, seed=5, noise=0.2)
    left[3], right[6] = None, None
    pair = sc.calibrate_stereo(X, left, right, SIZE, share="focal_length", priors={"k3": (0.0, 0.01)})
    found = sc.calibrate_rig(X, [left, right], SIZE, share="focal_length", priors={"k3": (0.0, 0.01)})
    np.testing.assert_allclose(found.rms, pair.rms, rtol=1e-9)
    np.testing.assert_allclose(found.pair(0, 1).T, pair.rig.T, rtol=1e-9)
    np.testing.assert_allclose(found.covariance, pair.covariance, rtol=1e-9, atol=1e-20)
    np.testing.assert_allclose(found.camera_rms, [pair.left_rms, pair.right_rms], rtol=1e-9)
    np.testing.assert_array_equal(np.isnan(found.view_rms), np.isnan(pair.view_rms))
    assert np.isnan(found.view_rms[3, 0])
    assert found.residuals[1][6].shape == (0, 2)


def test_options_reach_every_camera() -> None:
    corners = three_cameras(0.1)
    corners[2][4] = corners[2][4] + np.where(np.arange(54) == 7, 9.0, 0.0)[:, None]
    found = sc.calibrate_rig(
        X, corners, [SIZE] * 3, model=MODELS, fix=("k3", "camera1.k4"), reject_outliers=True, share="cx",
        priors={"cy": (240.0, 20.0), "camera1.T_x": (-2.0, 1e-6)}, aspect_ratio=1 / 1.004, backend="numpy",
    )  # fmt: skip
    assert found.converged
    assert [(c.camera, c.view, c.point) for c in found.rejected] == [(2, 4, 7)]
    assert "left out: camera 2 view 4, corner 7" in found.summary()
    assert len({c.cx for c in found.cameras}) == 1
    assert [c.dist[i] for c, i in ((found.cameras[0], 4), (found.cameras[1], 3))] == [0, 0]
    held = [name for name, std in zip(found.parameter_names, found.std, strict=True) if std == 0]
    assert held == ["camera0.skew", "camera0.k3", "camera1.skew", "camera1.k3", "camera1.k4", "camera2.skew"]
    np.testing.assert_allclose(found.T[1, 0], -2, atol=1e-4)
    again = sc.calibrate_rig(X, corners, SIZE, cameras=found.cameras, fix_intrinsics=True, loss="huber", loss_scale=0.2)
    assert again.cameras == found.cameras
    np.testing.assert_allclose(again.T, found.T, atol=0.02)


def without(corners: list, camera: int, views: range) -> list:
    """Corners of which a camera missed some views."""
    return [[None if c == camera and v in views else y for v, y in enumerate(of)] for c, of in enumerate(corners)]


@pytest.mark.parametrize(
    ("corners", "options", "error", "message"),
    [
        (lambda y: y[:1], {}, sc.InputError, "holds 1 camera; a rig has at least two"),
        (lambda y: [y[0], y[1][:5]], {}, sc.InputError, "has 12, 5 views"),
        (lambda y: [[None] * 12] * 2, {}, sc.InputError, "in no image"),
        (lambda y: without(y, 1, range(1, 9)), {"model": "pinhole", "skew": True},
         sc.DegenerateGeometryError, "camera1 camera by itself .*too few"),
        (lambda y: [[y[0][0], y[0][0], None], [None, None, y[1][0]]], {}, sc.DegenerateGeometryError,
         "camera 1 shares no view with camera 0"),
        (lambda y: y, {"model": ["brown"] * 2}, sc.InputError, "model holds 2 entries for 3 cameras"),
        (lambda y: y, {"fix": "camera3.k1"}, sc.InputError, "the cameras are called camera0, camera1 and camera2"),
        (lambda y: y, {"fix": "k9"}, sc.InputError, "fix names 'k9'"),
        (lambda y: y, {"fix_intrinsics": True, "cameras": [CAMERAS[0], None, None]}, sc.InputError, "every camera"),
        (lambda y: y, {"cameras": [1, 2, 3]}, sc.InputError, "a Camera or None"),
    ],
)  # fmt: skip
def test_bad_input_is_named(corners, options: dict, error, message: str) -> None:
    with pytest.raises(error, match=message):
        sc.calibrate_rig(X, corners(three_cameras(0.0)), SIZE, **options)


def test_the_pair_of_a_rig_is_of_two_cameras() -> None:
    found = sc.calibrate_rig(X, three_cameras(0.0), SIZE, model=MODELS, cameras=CAMERAS, fix_intrinsics=True)
    for wrong in ((1, 1), (0, 3), (-1, 0)):
        with pytest.raises(sc.InputError, match="two different cameras of 0 … 2"):
            found.pair(*wrong)
