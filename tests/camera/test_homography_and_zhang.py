"""Homographies, Zhang's closed form, and what they refuse."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from camera_rigs import board, camera, mono_views
from hypothesis import given, settings
from strategies import seeds

import stereocal as sc
from stereocal.base.rotations import rotation_matrix, rotation_vector
from stereocal.camera.bundle_problem import make_bundle
from stereocal.camera.distortion import MODELS
from stereocal.camera.seen_boards import seen_boards


def random_homography(rng: np.random.Generator) -> np.ndarray:
    K = np.array([[rng.uniform(300, 3000), 0, 320], [0, rng.uniform(300, 3000), 240], [0, 0, 1]])
    R = rotation_matrix(rng.uniform(-0.7, 0.7, 3))
    return K @ np.column_stack([R[:, :2], [rng.uniform(-2, 2), rng.uniform(-2, 2), rng.uniform(8, 20)]])


def apply(H: np.ndarray, X: np.ndarray) -> np.ndarray:
    h = np.column_stack([X[:, :2], np.ones(len(X))]) @ H.T
    return h[:, :2] / h[:, 2:]


@settings(max_examples=40)
@given(seeds)
def test_exact_points_give_the_homography_and_opencv_s(seed: int) -> None:
    rng = np.random.default_rng(seed)
    H, X = random_homography(rng), board()
    y = apply(H, X)
    ours = sc.fit_homography(X, y)
    np.testing.assert_allclose(ours, H / H[2, 2], rtol=1e-8, atol=1e-8)
    # OpenCV takes the points as float32: its answer is off by that much, ours is the one that was put in
    np.testing.assert_allclose(ours, cv2.findHomography(X[:, :2], y, 0)[0], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(
        sc.fit_homography(X[[0, 8, 45, 53], None, :2], y[[0, 8, 45, 53]][None]), ours, rtol=1e-7, atol=1e-7
    )


@settings(max_examples=20)
@given(seeds)
def test_the_compiled_twin_equals_the_reference(seed: int) -> None:
    cam = camera()
    corners, _ = mono_views(cam, board(), 4, seed=seed, noise=0.5)
    bundle = make_bundle([MODELS["pinhole"]], [[board()] * 4], [corners], np.zeros((5, 0)))
    for compiled, H in zip(seen_boards(bundle).H, seen_boards(bundle, backend="numpy").H, strict=True):
        np.testing.assert_allclose(compiled / compiled[2, 2], H / H[2, 2], rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("skew", [0.0, 1.7])
@settings(max_examples=15)
@given(seeds)
def test_exact_homographies_give_the_camera(skew: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    K = np.array(
        [
            [rng.uniform(300, 2000), skew, rng.uniform(250, 400)],
            [0, rng.uniform(300, 2000), rng.uniform(200, 300)],
            [0, 0, 1],
        ]
    )
    H = []
    for around in rng.uniform(0, 2 * np.pi) + np.array([0, 2.1, 4.2, 5.5]):
        R = rotation_matrix(rng.uniform(0.3, 0.7) * np.array([np.cos(around), np.sin(around), 0.2]))
        H.append(K @ np.column_stack([R[:, :2], [rng.uniform(-2, 2), rng.uniform(-2, 2), rng.uniform(8, 20)]]))
    np.testing.assert_allclose(sc.zhang_intrinsics(H), K, rtol=1e-6, atol=1e-4)
    if skew == 0:
        np.testing.assert_allclose(sc.zhang_intrinsics(H[:2]), K, rtol=1e-5, atol=1e-2)
        np.testing.assert_allclose(sc.zhang_intrinsics(H[:1], principal_point=K[:2, 2]), K, rtol=1e-5, atol=1e-3)


@settings(max_examples=30)
@given(seeds)
def test_pose_of_an_exact_homography(seed: int) -> None:
    rng = np.random.default_rng(seed)
    K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
    R, t = rotation_matrix(rng.uniform(-0.9, 0.9, 3)), np.array([*rng.uniform(-2, 2, 2), rng.uniform(4, 20)])
    H = K @ np.column_stack([R[:, :2], t]) * rng.choice([-3.0, 0.2])
    found_R, found_t = sc.zhang_pose(K, H)
    np.testing.assert_allclose(found_R, R, atol=1e-10)
    np.testing.assert_allclose(found_t, t, rtol=1e-10, atol=1e-10)


@settings(max_examples=20)
@given(seeds)
def test_pose_of_a_noisy_homography_is_the_nearest_rotation(seed: int) -> None:
    """The closed form equals U Vᵀ of the singular value decomposition of [p q n], p, q and n of unit length."""
    rng = np.random.default_rng(seed)
    K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
    R = rotation_matrix(rng.uniform(-0.9, 0.9, 3))
    M = np.column_stack([R[:, :2], [0.3, 0.2, 9.0]]) + rng.normal(0, 0.02, (3, 3))
    found_R, _ = sc.zhang_pose(K, K @ M)
    p, q = (M[:, i] / np.linalg.norm(M[:, i]) for i in (0, 1))
    n = np.cross(p, q)
    U, _, Vt = np.linalg.svd(np.column_stack([p, q, n / np.linalg.norm(n)]))
    np.testing.assert_allclose(found_R, U @ Vt, atol=1e-10)


def test_parallel_boards_are_refused_by_name() -> None:
    K = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
    R = rotation_matrix([0.3, -0.2, 0.1])
    H = [
        K @ np.column_stack([(R @ rotation_matrix([0, 0, a]))[:, :2], t])
        for a, t in ((0, [0, 0, 9]), (0.5, [1, 2, 12]), (1, [2, -1, 8]))
    ]
    with pytest.raises(sc.DegenerateGeometryError, match="parallel planes"):
        sc.zhang_intrinsics(H)
    with pytest.raises(sc.DegenerateGeometryError, match="parallel planes"):
        sc.zhang_intrinsics(H, skew=False)


def test_too_few_views_are_refused_with_the_number_needed() -> None:
    rng = np.random.default_rng(0)
    H = [random_homography(rng) for _ in range(2)]
    with pytest.raises(sc.DegenerateGeometryError, match="needs 3"):
        sc.zhang_intrinsics(H, skew=True)
    with pytest.raises(sc.DegenerateGeometryError, match="needs 2"):
        sc.zhang_intrinsics(H[:1])


def test_collinear_points_are_refused() -> None:
    X = np.column_stack([np.arange(6.0), 2 * np.arange(6.0), np.zeros(6)])
    with pytest.raises(sc.DegenerateGeometryError, match="one line"):
        sc.fit_homography(X, X[:, :2] * 3 + 1)
    with pytest.raises(sc.InputError, match="at least 4"):
        sc.fit_homography(X[:3], X[:3, :2])
    with pytest.raises(sc.InputError, match="pairs"):
        sc.fit_homography(board(), X[:, :2])


def near_parts_of_a_board(views: int, seed: int) -> tuple[sc.Camera, list[np.ndarray], list[np.ndarray], np.ndarray]:
    """Parts of a large board seen from near: its origin lies behind the camera in every view."""
    rng = np.random.default_rng(seed)
    cam, X = camera(), sc.Chessboard((30, 20), 0.5).object_points
    objects, corners, t = [], [], []
    for _ in range(views):
        around, middle = rng.uniform(0, 2 * np.pi), X[rng.integers(len(X))]
        turned = rotation_matrix([0.0, 0.0, np.arctan2(middle[1], middle[0])]).T  # the origin towards −x
        R = rotation_matrix([0.0, -rng.uniform(0.7, 0.9), 0.0]) @ rotation_matrix([0.3 * np.cos(around), 0, 0]) @ turned
        t.append(np.array([0, 0, 2.0]) - R @ middle)
        y, ahead = cam.project(X, rotation_vector(R), t[-1]), (X @ R.T + t[-1])[:, 2] > 0.3
        seen = ahead & np.isfinite(y).all(axis=1) & (y > 0).all(axis=1) & (y < cam.image_size).all(axis=1)
        objects.append(X[seen])
        corners.append(y[seen])
    return cam, objects, corners, np.array(t)


@pytest.mark.parametrize("given", [False, True], ids=["from nothing", "from a given camera"])
def test_a_part_of_a_board_whose_origin_is_behind_the_camera(given: bool) -> None:
    cam, objects, corners, t = near_parts_of_a_board(12, seed=3)
    assert np.count_nonzero(t[:, 2] < 0) >= 3
    start = {"initial": sc.Camera(cam.K * [[1.02], [1.02], [1]], None, cam.image_size)} if given else {}
    found = sc.calibrate_camera(objects, corners, cam.image_size, model=cam.model, **start)
    assert found.rms < 1e-6
    np.testing.assert_allclose(found.camera.K, cam.K, atol=1e-3)
    np.testing.assert_allclose(found.tvecs, t, atol=1e-4)
