"""Views that do not determine a camera are refused by name; views that do, are not."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from camera_rigs import SIZE, board, camera
from hypothesis import given, settings
from strategies import seeds

import stereocal as sc
from stereocal.base.rotations import rotation_matrix, rotation_vector
from stereocal.camera.degeneracy import slopes_chi2

X = board()
LENSES = {"ideal": (0, 0, 0, 0, 0), "distorted": (-0.28, 0.09, 0.001, -0.0005, 0)}
FRONTAL = [([0, 0, a], [x, -2, z]) for a, x, z in ((0, -3, 9), (0.1, -2, 11), (0.2, -4, 13), (0.3, -3.5, 15))]
TILTED = [([0.4, 0.2, 0], [x, -2, z]) for _, (x, _, z) in FRONTAL]
SPUN = [
    (rotation_vector(rotation_matrix([0.4, 0.2, 0]) @ rotation_matrix([0, 0, a])), [x, -2, z])
    for a, x, z in ((0, -3, 11), (0.5, -2, 11), (-0.5, -4, 13), (0.2, -2.5, 15))
]
GOOD = [([0.4, 0, 0], [-4, -2, 12]), ([-0.4, 0.1, 0], [-4, -2, 12]), ([0, 0.4, 0], [-4, -2, 12])]


def views(lens: str, poses: list, noise: float, seed: int = 0) -> list[np.ndarray]:
    """Corners of boards at given poses."""
    rng, cam = np.random.default_rng(seed), camera(dist=LENSES[lens])
    return [cam.project(X, r, t) + rng.normal(0, 1, (len(X), 2)) * noise for r, t in poses]


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("noise", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("poses", [FRONTAL, TILTED, SPUN], ids=["frontal", "shifted", "spun"])
def test_parallel_boards_are_called_parallel(lens: str, noise: float, poses: list) -> None:
    with pytest.raises(sc.DegenerateGeometryError, match=r"all 4 views are parallel.*photograph the board tilted"):
        sc.calibrate_camera(X, views(lens, poses, noise), SIZE)


def test_copies_of_a_view_are_named() -> None:
    corners = views("distorted", GOOD[:1], 0.2)
    with pytest.raises(sc.DegenerateGeometryError, match="views 0, 1, 2, 3 hold the very same corners"):
        sc.calibrate_camera(X, corners * 4, SIZE)


@settings(max_examples=8)
@given(seeds)
def test_three_tilted_views_are_enough(seed: int) -> None:
    found = sc.calibrate_camera(X, views("distorted", GOOD, 0.3, seed), SIZE)
    assert abs(found.camera.fx - 530) < 6 * found.std[0]


def test_parallel_tilted_boards_are_enough_where_the_principal_point_is_known() -> None:
    """Two equations, two unknowns: fx and fy."""
    cam = camera(dist=LENSES["ideal"])
    tilted = [(rotation_vector(rotation_matrix([0.5, 0.4, 0])), [x, -2, z]) for _, (x, _, z) in FRONTAL]
    start = sc.Camera(cam.K * [[0.9, 1, 1], [1, 0.9, 1], [1, 1, 1]], None, SIZE)
    held = ("principal_point", "distortion")
    found = sc.calibrate_camera(X, views("ideal", tilted, 0.02), SIZE, fix=held, initial=start)
    assert abs(found.camera.fx - 530) < 6 * found.std[0]


def test_a_model_with_too_many_coefficients_is_blamed_and_not_the_tilts() -> None:
    """Rational coefficients on a mild lens seen from afar: numerator and denominator grow together without end."""
    rng = np.random.default_rng(4)
    cam = camera(dist=(-0.1, 0, 0, 0, 0), f=2200)
    poses = [([0.5 * np.cos(a), 0.5 * np.sin(a), a], [-4, -2.5, 45]) for a in np.linspace(0, 6, 12)]
    corners = [cam.project(X, r, np.array(t)) + rng.normal(0, 0.8, (54, 2)) for r, t in poses]
    try:
        found = sc.calibrate_camera(X, corners, SIZE, model="rational")
    except sc.DegenerateGeometryError as error:
        assert "coefficients of model 'rational'" in str(error)  # noqa: PT017
    else:
        assert abs(found.camera.fx - 2200) < 6 * found.std[0]


def test_the_statistic_of_parallel_boards_is_chi_squared() -> None:
    """Normals scattered with their own covariance: mean 2(V − 1), variance twice that."""
    rng = np.random.default_rng(0)
    common, V = rotation_matrix([0.3, -0.2, 0.1]), 6
    A = rng.normal(0, 0.004, (V, 3, 3))
    C = A @ A.transpose(0, 2, 1) + 1e-6 * np.eye(3)
    half = np.linalg.cholesky(C)
    values = [
        slopes_chi2(np.array([(rotation_matrix(h @ rng.normal(size=3)) @ common)[:, 2] for h in half]), C)
        for _ in range(400)
    ]
    np.testing.assert_allclose(np.mean(values), 10, atol=4 * np.sqrt(20 / 400))
    np.testing.assert_allclose(np.var(values), 20, rtol=0.35)


def test_opencv_answers_where_there_is_no_answer() -> None:
    """Why this module is there: cv2 returns a camera from parallel boards, far off, without a word."""
    corners = views("ideal", TILTED, 0.2)
    rms, K, *_ = cv2.calibrateCamera(
        [X.astype(np.float32)] * 4, [y.astype(np.float32) for y in corners], SIZE, None, None
    )
    assert rms < 0.5
    assert abs(K[0, 0] - 530) > 50


# seeds at which the focal length runs away to where noise looks like tilt, well beyond its own uncertainty
@pytest.mark.parametrize("seed", [2, 3, 9])
def test_a_focal_length_that_ran_away_does_not_make_parallel_boards_tilted(seed: int) -> None:
    """Eight boards square to the camera: χ² at the focal length that was found takes their noise for tilt."""
    rng = np.random.default_rng(seed)
    cam, flat = sc.Camera([[520, 0, 330], [0, 515, 250], [0, 0, 1]], (-0.2, 0.05, 0.001, -0.001, 0), SIZE), 25.0 * X
    flat = flat - flat.mean(axis=0)
    spin, where = rng.uniform(-1, 1, 8), rng.uniform([-80, -60, 420], [80, 60, 640], (8, 3))
    corners = [
        cam.project(flat, (0, 0, a), t) + rng.normal(0, 0.5, (len(flat), 2)) for a, t in zip(spin, where, strict=True)
    ]
    with pytest.raises(sc.DegenerateGeometryError, match="parallel"):
        sc.calibrate_camera(flat, corners, SIZE)


def test_a_prior_on_the_focal_length_closes_what_parallel_boards_leave_open() -> None:
    rng = np.random.default_rng(0)
    poses = [(rotation_vector(rotation_matrix([0.4, 0.2, 0]) @ rotation_matrix([0, 0, a])), [x, -2, z])
             for a, x, z in ((0, -3, 9), (0.5, -2, 11), (-0.5, -4, 13), (0.2, -2.5, 15), (1, -2, 10))]  # fmt: skip
    corners = [camera().project(X, r, t) + rng.normal(0, 0.1, (len(X), 2)) for r, t in poses]
    f = (camera().fx, camera().fy)
    known = {"fx": (f[0], 1.0), "fy": (f[1], 1.0)}
    found = sc.calibrate_camera(X, corners, SIZE, priors=known)
    assert abs(found.camera.fx - f[0]) < 5
    with pytest.raises(sc.DegenerateGeometryError, match="parallel"):
        sc.calibrate_camera(X, corners, SIZE, priors={"fx": (f[0], 2000.0), "fy": (f[1], 2000.0)})


def test_a_lens_that_does_not_fit_is_blamed_and_not_the_views() -> None:
    """A wide angle taken for a pinhole: residuals of pixels hide the tilts, which are fine."""
    rng = np.random.default_rng(0)
    cam = sc.Camera([[330, 0, 320], [0, 330, 240], [0, 0, 1]], (-0.2, 0.02, 0, 0, 0), SIZE)
    poses = [([0.2 * np.cos(a), 0.2 * np.sin(a), a / 3], [-4 + 2 * np.cos(a), -2.5, 6.5]) for a in np.arange(5)]
    corners = [cam.project(X, r, np.array(t)) + rng.normal(0, 0.05, (54, 2)) for r, t in poses]
    assert abs(sc.calibrate_camera(X, corners, SIZE).camera.fx - 330) < 3
    with pytest.raises(sc.DegenerateGeometryError, match=r"lens of model 'pinhole' does not fit.*'brown' leaves"):
        sc.calibrate_camera(X, corners, SIZE, model="pinhole")
