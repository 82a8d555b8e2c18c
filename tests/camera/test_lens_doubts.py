"""What a fit leaves open is said by name, and what it does not name is honest."""

from __future__ import annotations

import numpy as np
import pytest
from camera_rigs import SIZE, board, camera, mono_views

import stereocal as sc
from stereocal.base.rotations import rotation_matrix
from stereocal.camera import initialisation
from stereocal.camera.lens_doubts import kink_radius
from stereocal.camera.propagation import pixel_covariance

X = board()
# a lens that needs its denominator: its poles are at r² = −1 and −2.5, and it is seen up to r = 1.3
WIDE = (0.9, 0.15, 0.0008, -0.0005, 0.001, 1.4, 0.4, 0.0)


def wide_views(count: int, seed: int) -> tuple[sc.Camera, list[np.ndarray]]:
    """Corners all over the image of a lens of about 110°."""
    cam, rng, corners = camera("rational", WIDE, f=330.0), np.random.default_rng(seed), []
    middle = X.mean(axis=0)
    while len(corners) < count:
        R = rotation_matrix(rng.uniform(-0.5, 0.5, 3))
        ray = cam.undistort_points([rng.uniform(0.1, 0.9, 2) * SIZE], P=np.eye(3))[0]
        t = rng.uniform(5, 9) * np.array([*ray, 1.0]) - R @ middle
        y = cam.project((X @ R.T + t)[(X @ R.T + t)[:, 2] > 0])
        if len(y) == len(X) and np.all((y >= 0) & (y <= np.array(SIZE) - 1)):
            corners.append(y)
    return cam, corners


def test_healthy_fits_leave_nothing_open() -> None:
    for model in ("pinhole", "polynomial", "brown", "fisheye", "fov", "division"):
        corners, _ = mono_views(camera(), X, 12, seed=5, noise=0.2)
        assert sc.calibrate_camera(X, corners, SIZE, model=model).warnings == ()


def test_coefficients_that_trade_are_named_and_their_pixels_are_honest() -> None:
    """k1 ± 30 %, next to −1 and 1 all correlations, and pixels scatter in 36 repetitions as each covariance says."""
    truth, clean = wide_views(25, seed=3)
    rng = np.random.default_rng(0)
    y = np.stack(np.meshgrid(np.linspace(60, 580, 5), np.linspace(50, 430, 4)), -1).reshape(-1, 2)
    rays = truth.undistort_points(y, P=np.eye(3))
    targets = np.column_stack([rays, np.ones(len(rays))])
    inside, loose, chi2 = [], [], []
    for _ in range(36):
        found = sc.calibrate_camera(X, [c + rng.normal(0, 0.03, c.shape) for c in clean], SIZE, model="rational")
        assert found.converged
        assert any("are not determined apart" in warning for warning in found.warnings)
        if any("kink" in warning for warning in found.warnings):
            continue
        loose.append(found.std[5] / abs(found.camera.dist[0]))
        C = pixel_covariance(targets, found.camera, found.covariance)
        delta = found.camera.project(targets) - truth.project(targets)
        inside.append(np.abs(delta) < 1.96 * np.sqrt(np.diagonal(C, axis1=1, axis2=2)))
        chi2.append(np.einsum("ni,nij,nj->n", delta, np.linalg.inv(C), delta))
    assert len(chi2) > 18
    assert np.median(loose) > 0.15
    # pixels of one fit belong together: the mean of χ²₂ of n fits is known to 2/√n at worst
    assert np.mean(inside) == pytest.approx(0.95, abs=0.035)
    assert np.mean(chi2) == pytest.approx(2, abs=0.6)


def test_a_lens_that_shows_its_poles_is_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a kink its poles are not searched for, where a kink would come cheap: F is that from the true camera."""
    truth, clean = wide_views(25, seed=3)
    rng = np.random.default_rng(2)
    corners = [c + rng.normal(0, 0.03, c.shape) for c in clean]
    monkeypatch.setattr(initialisation, "pole_starts", lambda *options: pytest.fail("poles were searched for"))
    found = sc.calibrate_camera(X, corners, SIZE, model="rational")
    warm = sc.calibrate_camera(X, corners, SIZE, model="rational", initial=truth)
    assert found.rms == pytest.approx(warm.rms, rel=1e-9)
    assert not any("kink" in warning for warning in found.warnings)


@pytest.mark.parametrize(
    ("k", "radius"),
    [
        ((0, 0, 0, 0, 0, 0, 0, 0), None),
        ((0, 0, 0, 0, 0, 0.3, 0.02, 0.001), None),  # poles at negative s and far off
        ((0, 0, 0, 0, 0, -1 / 0.09, 0, 0), 0.3),  # q = 1 − s/0.09: a pole among the corners
        ((0, 0, 0, 0, 0, 300.0, 0, 0), 0.0),  # s = −1/300: next to the centre
        ((0, 0, 0, 0, 0, -1 / 0.9, 0, 0), None),
        ((0, 0, 0, 0, 0, 0, 0, -1e-9), None),
    ],
)
def test_a_kink_is_where_a_pole_is_next_to_the_corners(k: tuple, radius: float | None) -> None:
    found = kink_radius(np.array(k), 0.25)
    assert found == (None if radius is None else pytest.approx(radius, abs=1e-12))


def test_a_principal_point_adrift_is_named() -> None:
    rng = np.random.default_rng(0)
    poses = [([0.5 * np.cos(a), 0.5 * np.sin(a), a], [-4, -2.5, 45]) for a in np.linspace(0, 6, 12)]
    corners = [camera(f=2200).project(X, r, np.array(t)) + rng.normal(0, 0.5, (54, 2)) for r, t in poses]
    found = sc.calibrate_camera(X, corners, SIZE)
    assert len(found.warnings) == 1
    assert "warning: the principal point is not determined well (± " in found.summary()
    assert sc.calibrate_camera(X, corners, SIZE, fix=("principal_point", "tangential")).warnings == ()


def test_a_pair_says_which_camera() -> None:
    _, corners = wide_views(10, seed=3)
    rng = np.random.default_rng(1)
    noisy = [[c + rng.normal(0, 0.2, c.shape) for c in corners] for _ in range(2)]
    found = sc.calibrate_stereo(X, *noisy, SIZE, model="rational")
    assert {warning.split(":")[0] for warning in found.warnings} == {"left", "right"}
    assert found.warnings[0] in found.summary()
