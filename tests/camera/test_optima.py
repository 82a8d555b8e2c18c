"""Coefficients that grow without end are no optimum, and a lens that goes adrift is found or refused by its reason."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from camera_rigs import SIZE, board, camera, mono_views

import stereocal as sc
from stereocal.base.rotations import rotation_matrix
from stereocal.camera import initialisation
from stereocal.camera.bundle import BundleState, normal_equations
from stereocal.camera.bundle_problem import make_bundle
from stereocal.camera.bundle_solver import schur_complement
from stereocal.camera.covariance import bundle_covariance
from stereocal.camera.degeneracy import refuse_degenerate
from stereocal.camera.distortion import MODELS
from stereocal.camera.lens_doubts import drawn_scale
from stereocal.camera.parameters import fixed_names, free_columns, intrinsic_names

X = board(7, 5)


def mild_lens(seed: int) -> list[np.ndarray]:
    """A few views through a mild Brown lens: they say nothing about poles."""
    cam = camera(f=900.0, dist=(-0.25, 0.05, 0.001, -0.0005, 0.0))
    views = int(np.random.default_rng(seed).integers(5, 9))
    corners = mono_views(cam, X, views, seed=seed, noise=0.4)[0]
    return [y.astype(np.float32).astype(np.float64) for y in corners]


def opencv_rms(corners: list[np.ndarray], flags: int) -> float:
    """The lower RMS of OpenCV's default and patient run."""
    objects, images = [X.astype(np.float32)] * len(corners), [y.astype(np.float32)[:, None] for y in corners]
    patient = {"criteria": (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 300, 1e-15)}
    return float(
        min(cv2.calibrateCamera(objects, images, SIZE, None, None, flags=flags, **more)[0] for more in ({}, patient))
    )


@pytest.mark.parametrize("seed", [32, 40, 41, 56])
def test_a_mild_lens_ends_in_an_optimum_not_above_opencv(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 32 and 41 F ended higher; 40 and 56 ran to a focal length of 10⁵ widths and were called parallel boards."""
    corners = mild_lens(seed)
    found = sc.calibrate_camera(X, corners, SIZE, model="rational")
    assert found.converged
    assert 0.8 < found.camera.fx / 900 < 1.25
    assert found.rms <= opencv_rms(corners, cv2.CALIB_RATIONAL_MODEL) * (1 + 1e-9)
    monkeypatch.setattr(initialisation, "pole_starts", lambda *options: [])
    if seed in (40, 56):
        with pytest.raises(sc.DegenerateGeometryError, match="do not determine the 8 coefficients of model 'rational'"):
            sc.calibrate_camera(X, corners, SIZE, model="rational")
    else:
        assert sc.calibrate_camera(X, corners, SIZE, model="rational").rms > found.rms * (1 + 1e-5)


def test_tilted_boards_before_a_lens_that_ran_away_are_not_called_parallel() -> None:
    """f·c/q with c = 1 + 10⁸s, q = 1 + 10¹⁴s draws as f/10⁶ does, at f = 9·10⁸ pixels."""
    lens, pinhole = MODELS["rational"], camera("pinhole", (), f=900.0)
    corners, where = mono_views(pinhole, X, 8, seed=1, noise=0.1)
    names = intrinsic_names(lens)
    bundle = make_bundle(
        [lens], [[X] * 8], [corners], free_columns(names, fixed_names(lens, (), skew=False), None)
    )  # fmt: skip
    theta = np.zeros(len(names))
    theta[:4], theta[5], theta[10] = [900e6, 903.6e6, 325, 236], 1e8, 1e14
    R, t = np.stack([rotation_matrix(r) for r, _ in where]), np.stack([t for _, t in where])
    state = BundleState([theta], np.eye(3)[None], np.zeros((1, 3)), R, t)
    equations = normal_equations(bundle, state)
    assert np.sqrt(equations.cost / len(bundle.points)) < 0.15
    assert drawn_scale(bundle, state, 0) == pytest.approx(1e-6, rel=0.1)
    with pytest.raises(sc.DegenerateGeometryError, match="do not determine the 8 coefficients of model 'rational'"):
        refuse_degenerate(bundle, state, equations, bundle_covariance(bundle, state, equations), SIZE[0])


def test_coefficients_that_trade_with_the_focal_length_are_returned_with_a_warning() -> None:
    """Rational function: fy ± 70 %, while every corner is drawn to the noise; it was refused as growing without end."""
    corners = mild_lens(23)
    found = sc.calibrate_camera(X, corners, SIZE, model="rational_function")
    assert found.converged
    assert found.std[1] > 0.5 * found.camera.fy
    assert any("the focal length is open along with the lens's coefficients" in w for w in found.warnings)
    assert found.rms < 1.02 * sc.calibrate_camera(X, corners, SIZE).rms


@pytest.mark.parametrize("seed", [11, 22])
def test_a_principal_point_that_runs_to_the_edge_is_refused_as_that(seed: int) -> None:
    """F falls until a corner is 90° off the axis. The reason holds: with the centre held there is an optimum.

    It has one direction that hardly counts, and the principal point, if it is let go, finds another.
    """
    corners = mild_lens(seed)
    with pytest.raises(sc.DegenerateGeometryError, match=r"do not determine the principal point .* 90 degrees off"):
        sc.calibrate_camera(X, corners, SIZE, model="rational_function")
    held = sc.calibrate_camera(X, corners, SIZE, model="rational_function", fix="principal_point")
    assert held.converged
    assert held.std[0] < 0.2 * held.camera.fx
    lens = MODELS["rational_function"]
    G = free_columns(intrinsic_names(lens), fixed_names(lens, (), skew=False), None)
    bundle = make_bundle([lens], [[X] * len(corners)], [corners], G)
    R = np.stack([rotation_matrix(r) for r in held.rvecs])
    theta = np.concatenate([[held.camera.fx, held.camera.fy, held.camera.cx, held.camera.cy, 0.0], held.camera.dist])
    here = BundleState([theta], np.eye(3)[None], np.zeros((1, 3)), R, held.tvecs)
    S = schur_complement(normal_equations(bundle, here))[0]
    scale = 1 / np.sqrt(np.diag(S))
    values, vectors = np.linalg.eigh(S * scale[:, None] * scale)
    assert values[0] < 1e-4 * values[-1]
    assert np.max(np.abs(vectors[2:4, 0])) > 0.1


@pytest.mark.parametrize("model", ["thin_prism", "tilted"])
def test_larger_models_end_in_an_optimum_too(model: str) -> None:
    found = sc.calibrate_camera(X, mild_lens(40), SIZE, model=model)
    assert found.converged
    assert 0.7 < found.camera.fx / 900 < 1.4
