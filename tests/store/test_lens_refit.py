"""A lens of fewer parameters: what it costs is said, and it is the least that it can be."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from scipy.optimize import least_squares

from stereocal.base.errors import InputError
from stereocal.camera.model import Camera
from stereocal.pair.rig import StereoRig
from stereocal.store.calibrations import convert_calibration, load_calibration, save_calibration
from stereocal.store.lens_refit import refit_lens

K = [[530.0, 0, 325], [0, 532, 236], [0, 0, 1]]
LENS = [-0.28, 0.09, 1e-3, -5e-4, 0.05]
CAMERA = Camera(K, LENS, (640, 480))


def _drawn_apart(first: Camera, second: Camera, columns: int = 40, rows: int = 30) -> np.ndarray:
    """Pixels of the image, seen by the first and drawn by the second."""
    width, height = first.image_size
    grid = np.stack(np.meshgrid(np.linspace(0, width - 1, columns), np.linspace(0, height - 1, rows)), -1)
    pixels = grid.reshape(-1, 2)
    rays = (first.undistort_points(pixels) - first.K[:2, 2]) / np.diag(first.K)[:2]
    return np.linalg.norm(second.project(np.column_stack([rays, np.ones(len(rays))])) - pixels, axis=1)


def test_a_lens_without_k3_is_found_again():
    found = refit_lens(Camera(K, LENS[:4], (640, 480)), 4)
    np.testing.assert_allclose(found.camera.K, K, atol=1e-9)
    np.testing.assert_allclose(found.camera.dist, [*LENS[:4], 0], atol=1e-12)
    assert found.largest < 1e-9
    assert found.seen == 1


def test_the_misfit_is_what_is_said_and_less_than_cutting_off():
    found = refit_lens(CAMERA, 4)
    assert found.camera.dist[4] == 0
    apart = _drawn_apart(CAMERA, found.camera)
    assert apart.max() <= found.largest * 1.0001
    assert apart.max() > 0.8 * found.largest  # corners of the image are on both grids
    assert np.sqrt(np.mean(apart**2)) == pytest.approx(found.rms, rel=0.1)
    assert found.largest < 0.1 * _drawn_apart(CAMERA, Camera(K, LENS[:4], (640, 480))).max()
    assert f"{found.largest:.2g} px at most" in found.sentence("camera", CAMERA)


def test_scipy_finds_no_better_lens():
    found = refit_lens(CAMERA, 4)
    grid = np.stack(np.meshgrid(np.linspace(0, 639, 24), np.linspace(0, 479, 18)), -1).reshape(-1, 2)
    rays = (CAMERA.undistort_points(grid) - CAMERA.K[:2, 2]) / np.diag(CAMERA.K)[:2]
    X = np.column_stack([rays, np.ones(len(rays))])

    def residuals(p):
        matrix = [[p[0], 0, p[2]], [0, p[1], p[3]], [0, 0, 1]]
        return (Camera(matrix, [*p[4:], 0], (640, 480)).project(X) - grid).ravel()

    best = least_squares(residuals, [530, 532, 325, 236, *LENS[:4]], x_scale="jac", xtol=1e-14, ftol=1e-14)
    x = [found.camera.fx, found.camera.fy, found.camera.cx, found.camera.cy, *found.camera.dist[:4]]
    assert np.sum(residuals(np.array(x)) ** 2) <= np.sum(best.fun**2) * (1 + 1e-9)


@pytest.mark.parametrize(
    ("model", "dist"), [("fov", [0.9]), ("division", [-0.2]), ("fisheye", [-0.01, 0.02, -0.01, 5e-3])]
)
def test_lenses_of_another_kind_are_fitted(model, dist):
    camera = Camera(K, dist, (640, 480), model=model)
    by_number = [refit_lens(camera, number).largest for number in (4, 5, 8)]
    assert by_number[0] > by_number[1] > by_number[2]
    assert by_number[2] < 0.01


def test_what_cannot_be_fitted_is_refused():
    with pytest.raises(InputError, match="skew"):
        refit_lens(Camera([[500, 1, 320], [0, 500, 240], [0, 0, 1]], LENS, (640, 480)), 4)


def test_kalibr_refuses_k3_unless_asked_and_says_the_error(tmp_path):
    rig = StereoRig(CAMERA, Camera(K, LENS[:4], (640, 480)), np.eye(3), [-60.0, 0.1, 0.2])
    save_calibration(rig, tmp_path / "c.json", unit="mm")
    with pytest.raises(InputError, match="refit"):
        convert_calibration(tmp_path / "c.json", tmp_path / "k.yaml", to="kalibr")
    assert not (tmp_path / "k.yaml").exists()
    sentences = convert_calibration(tmp_path / "c.json", tmp_path / "k.yaml", to="kalibr", refit=True)
    told = [sentence for sentence in sentences if "fitted anew" in sentence]
    assert len(told) == 1  # the right camera has no k3: it is written as it is
    assert told[0].startswith("The left camera's lens (brown) is fitted anew with 4 parameters")
    back = load_calibration(tmp_path / "k.yaml")
    assert _drawn_apart(CAMERA, back.left).max() <= refit_lens(CAMERA, 4).largest * 1.0001
    assert back.right == rig.right
    document = yaml.safe_load((tmp_path / "k.yaml").read_text())
    assert len(document["cam0"]["distortion_coeffs"]) == 4
    save_calibration(rig, tmp_path / "k2.yaml", format="kalibr", unit="mm", refit=True)
    assert (tmp_path / "k2.yaml").read_bytes() == (tmp_path / "k.yaml").read_bytes()


@pytest.mark.parametrize("name", ["boofcv", "matlab", "ros", "mrcal", "opencv"])
def test_every_format_takes_a_division_lens_when_asked(tmp_path, name):
    camera = Camera(K, [-0.2], (640, 480), model="division")
    with pytest.raises(InputError, match="refit"):
        save_calibration(camera, tmp_path / "out", format=name)
    save_calibration(camera, tmp_path / "out", format=name, refit=True)
    assert _drawn_apart(camera, load_calibration(tmp_path / "out", format=name)).max() < 0.2
