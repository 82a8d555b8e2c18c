"""Every lens model: derivatives, round trip, domain; and OpenCV where it has the model."""

from __future__ import annotations

import warnings

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

import stereocal as sc
from stereocal.base.least_squares import central_differences
from stereocal.camera.distortion import (
    MODELS,
    as_distortion,
    distort_normalized,
    undistort_normalized,
)
from stereocal.camera.distortion_brown import radial_limit

OPENCV = ("brown", "rational", "thin_prism", "tilted")


def random_lens(name: str, rng: np.random.Generator) -> np.ndarray:
    """Coefficients of a lens that is monotonic out to r = 0.6 or so."""
    u = rng.uniform
    family = [u(-0.35, 0.2), u(0, 0.15), u(-0.002, 0.002), u(-0.002, 0.002), u(-0.03, 0.03), u(-0.05, 0.1),
              u(-0.02, 0.05), u(-0.01, 0.02), *u(-0.003, 0.003, 4), *u(-0.05, 0.05, 2)]  # fmt: skip
    return {
        "pinhole": np.zeros(0),
        "polynomial": np.array([u(-0.35, 0.2), u(0, 0.15)]),
        "polynomial_printed": np.array([u(-0.2, 0.35), u(0, 0.1)]),
        "fisheye": np.array([u(-0.1, 0.1), u(-0.03, 0.03), u(-0.01, 0.01), u(-0.005, 0.005)]),
        "fov": np.array([rng.choice([u(0.05, 1.2), u(1e-5, 2e-3)])]),
        "division": np.array([u(-0.5, 0.3)]),
        "rational_function": MODELS["rational_function"].neutral() + rng.normal(0, 0.02, 18),
    }.get(name, np.array(family[: MODELS[name].parameter_count]))


@pytest.mark.parametrize("name", MODELS)
@settings(max_examples=8)
@given(seeds)
def test_derivatives_equal_central_differences(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    model, k = MODELS[name], random_lens(name, rng)
    x = rng.uniform(-0.5, 0.5, (6, 2))
    value, by_x, by_k = model.jacobians(x, k)
    np.testing.assert_allclose(value, model.distort(x, k), atol=1e-13)
    numeric = np.stack([central_differences(lambda z: model.distort(z[None], k)[0], p) for p in x])
    np.testing.assert_allclose(by_x, numeric, atol=1e-8)
    assert by_k.shape == (6, 2, len(k))
    if len(k):
        np.testing.assert_allclose(by_k, central_differences(lambda z: model.distort(x, z), k), atol=1e-8)


@pytest.mark.parametrize("name", MODELS)
@settings(max_examples=8)
@given(seeds)
def test_undistort_inverts_distort(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    k = random_lens(name, rng)
    x = rng.uniform(-0.42, 0.42, (40, 2))
    x[0] = 0
    x_d = distort_normalized(x, k, name)
    np.testing.assert_allclose(undistort_normalized(x_d, k, name), x, atol=1e-11)


@pytest.mark.parametrize("name", ["fisheye", "fov", "polynomial", "brown"])
@given(seeds)
@settings(max_examples=15)
def test_derivatives_at_the_centre_are_finite(name: str, seed: int) -> None:
    k = random_lens(name, np.random.default_rng(seed))
    x = np.array([[0.0, 0.0], [1e-9, -1e-9], [1e-5, 2e-5]])
    value, by_x, by_k = MODELS[name].jacobians(x, k)
    assert np.isfinite(value).all()
    assert np.isfinite(by_k).all()
    # around the centre the map is linear to second order
    np.testing.assert_allclose(by_x, by_x[:1].repeat(3, axis=0), atol=1e-4)


@pytest.mark.parametrize("name", OPENCV)
@settings(max_examples=15)
@given(seeds)
def test_projection_and_its_derivatives_equal_opencv(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    k = random_lens(name, rng)
    K = np.array(
        [
            [rng.uniform(200, 2000), 0, rng.uniform(200, 400)],
            [0, rng.uniform(200, 2000), rng.uniform(200, 300)],
            [0, 0, 1],
        ]
    )
    rvec, tvec = rng.uniform(-1, 1, 3), np.array([*rng.uniform(-1, 1, 2), rng.uniform(6, 12)])
    X = rng.uniform(-2, 2, (20, 3))
    points, jacobian = sc.project_points(X, rvec, tvec, K, k, model=name, jacobian=True)
    theirs, their_jacobian = cv2.projectPoints(X, rvec, tvec, K, k)
    np.testing.assert_allclose(points, theirs.reshape(-1, 2), rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(jacobian, their_jacobian, rtol=1e-10, atol=1e-9)


@settings(max_examples=15)
@given(seeds)
def test_fisheye_equals_opencv(seed: int) -> None:
    rng = np.random.default_rng(seed)
    k = random_lens("fisheye", rng)
    K = np.array([[400.0, 0, 320], [0, 405.0, 240], [0, 0, 1]])
    X = np.column_stack([rng.uniform(-2, 2, (30, 2)), rng.uniform(1, 3, 30)])
    ours = sc.project_points(X, np.zeros(3), np.zeros(3), K, k, model="fisheye")
    theirs, _ = cv2.fisheye.projectPoints(X[None], np.zeros(3), np.zeros(3), K, k)
    np.testing.assert_allclose(ours, theirs.reshape(-1, 2), atol=1e-9)


@settings(max_examples=30)
@given(st.floats(-0.45, -0.05), st.floats(0, 2 * np.pi), st.floats(0.2, 1.6))
def test_beyond_the_turning_point_there_is_no_answer(k1: float, angle: float, r_d: float) -> None:
    """x_d = x (1 + k1 r²) reaches at most r_d = ⅔ / √(3|k1|): a point inside has its answer, one outside has NaN."""
    reach = 2 / 3 / np.sqrt(-3 * k1)
    x_d = r_d * np.array([[np.cos(angle), np.sin(angle)]])
    for name, k in (("polynomial", [k1, 0]), ("brown", [k1, 0, 0, 0, 0]), ("brown", [k1, 0, 1e-9, 0, 0])):
        x = undistort_normalized(x_d, k, name)
        if r_d > reach * (1 + 1e-6):
            assert np.isnan(x).all()
        elif r_d < reach * (1 - 1e-6):
            np.testing.assert_allclose(distort_normalized(x, k, name), x_d, atol=1e-11)
            assert np.hypot(*x[0]) < radial_limit(np.array([k1]))


@pytest.mark.parametrize("name", ["pinhole", "polynomial", "brown", "rational", "thin_prism", "tilted", "fisheye"])
@settings(max_examples=12)
@given(seeds, st.booleans())
def test_inverse_kernel_equals_its_reference(name: str, seed: int, radial: bool) -> None:
    """The same answers, and the same points without one, well beyond the turning point of most lenses."""
    rng = np.random.default_rng(seed)
    k = random_lens(name, rng)
    if radial and name in OPENCV:
        k[2:4], k[8:] = 0, 0
    y = rng.uniform(-1.3, 1.3, (60, 2))
    y[:3] = [[0, 0], [np.nan, 0.1], [np.inf, 0.1]]
    if name == "pinhole":
        y = y[:1]
    x = undistort_normalized(y, k, name)
    reference = undistort_normalized(y, k, name, backend="numpy")
    answered = ~np.isnan(reference[:, 0])
    assert not answered[1:3].any()
    np.testing.assert_array_equal(~np.isnan(x), np.column_stack([answered, answered]))
    value, J, _ = MODELS[name].jacobians(x[answered], k)
    np.testing.assert_allclose(value, y[answered], rtol=0, atol=3e-12)
    # both end within 1e-12 of y: near the turning point that is more in x, by the inverse of the smallest stretch
    slack = 1e-12 * np.maximum(1, 1 / np.linalg.svd(J, compute_uv=False)[:, 1:])
    assert np.all(np.abs(x[answered] - reference[answered]) <= slack)


@settings(max_examples=12)
@given(seeds)
def test_rational_function_s_kernel_equals_its_reference(seed: int) -> None:
    """Distorting is what iterates in this model; far out its curves fold, and both say so of the same points."""
    rng, model = np.random.default_rng(seed), MODELS["rational_function"]
    k = random_lens("rational_function", rng) + rng.normal(0, 0.3, 18) * (model.neutral() == 0)
    x = rng.uniform(-1.5, 1.5, (60, 2))
    x[:3] = [[0, 0], [np.nan, 0.1], [np.inf, 0.1]]
    x_d, reference = model.distort_compiled(x, k), model.distort(x, k)
    np.testing.assert_array_equal(np.isnan(x_d), np.isnan(reference))
    answered = ~np.isnan(reference[:, 0])
    J = model.undistort_jacobians(reference[answered], k)[1]
    slack = 1e-12 * np.maximum(1, 1 / np.linalg.svd(J, compute_uv=False)[:, 1:])
    assert np.all(np.abs(x_d[answered] - reference[answered]) <= 2 * slack)
    well = np.flatnonzero(answered)[np.abs(np.linalg.det(J)) > 0.1]
    for value, expected in zip(model.jacobians_compiled(x[well], k), model.jacobians(x[well], k), strict=True):
        np.testing.assert_allclose(value, expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("backend", ["numba", "numpy"])
@pytest.mark.parametrize("k4", [-0.1, -0.3, -0.5, -0.7, -0.9])
def test_up_to_a_pole_every_radius_has_its_answer(k4: float, backend: str) -> None:
    """r / (1 + k4 r²) rises to infinity at r = 1/√−k4: there is no radius without an answer."""
    y = np.array([[0.1, 0.2], [3.0, 4.0], [300.0, 400.0]])
    x = undistort_normalized(y, [0, 0, 0, 0, 0, k4], "rational", backend=backend)
    r_d = np.hypot(*y.T)
    r = (np.sqrt(1 - 4 * k4 * r_d**2) - 1) / (-2 * k4 * r_d)
    np.testing.assert_allclose(x, y * (r / r_d)[:, None], rtol=1e-11)


@pytest.mark.parametrize("backend", ["numba", "numpy"])
@pytest.mark.parametrize("tiny", [7e-151, -7e-151, 1e-312, -1e-312, 3e-17, -3e-17])
def test_a_tiny_coefficient_is_no_coefficient(tiny: float, backend: str) -> None:
    y = np.array([[0.3, -0.4], [3.0, 4.0], [0.0, 0.0]])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for name, count in (("polynomial", 2), ("brown", 5), ("rational", 8), ("fisheye", 4)):
            for i in set(range(count)) - ({2, 3} if name in OPENCV else set()):
                k = np.zeros(count)
                k[i] = tiny
                want = np.tan(np.hypot(*y[0])) / 0.5 * y[0] if name == "fisheye" else y[0]
                x = undistort_normalized(y, k, name, backend=backend)
                np.testing.assert_allclose(x[0], want, rtol=1e-13)
                np.testing.assert_array_equal(x[2], 0)
                if name != "fisheye":
                    np.testing.assert_allclose(x[1], y[1], rtol=1e-9)


def test_opencv_returns_a_wrong_point_where_there_is_none() -> None:
    """With k1 = −0.3 nothing is drawn at r_d = 0.9. OpenCV names a point all the same; it does not project there."""
    K, k = np.eye(3), np.array([-0.3, 0, 0, 0, 0.0])
    theirs = cv2.undistortPoints(np.array([[[0.9, 0.0]]]), K, k).reshape(1, 2)
    back = distort_normalized(theirs, k, "brown")
    assert not np.allclose(back, [[0.9, 0.0]], atol=1e-3)
    assert np.isnan(undistort_normalized([[0.9, 0.0]], k, "brown")).all()


def test_the_paper_s_two_directions_are_not_the_same_lens() -> None:
    """[eq 18] as printed takes distorted to ideal: with the usual direction's coefficients it bends the wrong way."""
    x_d = np.array([[0.5, 0.1]])
    usual = undistort_normalized(x_d, [-0.3, 0.1], "polynomial")
    printed = undistort_normalized(x_d, [-0.3, 0.1], "polynomial_printed")
    assert np.hypot(*usual[0]) > np.hypot(*x_d[0]) > np.hypot(*printed[0])
    s = float((x_d**2).sum())
    np.testing.assert_allclose(printed, x_d * (1 - 0.3 * s + 0.1 * s * s), atol=1e-15)


def test_the_printed_fourth_row_of_eq_17_is_not_a_lens() -> None:
    """With one denominator a straight line becomes a conic; with a second one, as printed, it does not."""
    rng = np.random.default_rng(0)
    W = MODELS["rational_function"].neutral().reshape(3, 6) + rng.normal(0, 0.05, (3, 6))
    t = np.linspace(-0.4, 0.4, 9)
    ideal = np.column_stack([t, 0.3 * t + 0.1])
    x_d = distort_normalized(ideal, W.ravel(), "rational_function")
    np.testing.assert_allclose(undistort_normalized(x_d, W.ravel(), "rational_function"), ideal, atol=1e-11)

    def misfit_of_a_conic(points: np.ndarray) -> float:
        x, y = points.T
        return np.linalg.svd(np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], 1), compute_uv=False)[-1]

    chi = np.stack([x_d[:, 0] ** 2, x_d[:, 0] * x_d[:, 1], x_d[:, 1] ** 2, x_d[:, 0], x_d[:, 1], np.ones(9)], 1)
    fourth = W[2] + rng.normal(0, 0.05, 6)
    printed = np.column_stack([chi @ W[0] / (chi @ W[2]), chi @ W[1] / (chi @ fourth)])
    assert misfit_of_a_conic(x_d) < 1e-12
    line = np.column_stack([printed, np.ones(9)])
    assert np.linalg.svd(line, compute_uv=False)[-1] > 1e-4  # the same points no longer come back to a line


@pytest.mark.parametrize("shape", [(5,), (1, 5), (5, 1)])
def test_every_shape_of_coefficients_is_accepted(shape: tuple[int, ...]) -> None:
    k = np.array([-0.3, 0.1, 0.001, 0.002, 0.0]).reshape(shape)
    np.testing.assert_array_equal(as_distortion(k), k.ravel())
    np.testing.assert_array_equal(as_distortion(k.ravel()[:4]), k.ravel())


def test_wrong_coefficients_are_named() -> None:
    with pytest.raises(sc.InputError, match="model 'polynomial' has 2"):
        as_distortion([0.1, 0.2, 0.3], "polynomial")
    with pytest.raises(sc.InputError, match="model must be one of pinhole"):
        as_distortion([0.1], "fish")
    with pytest.raises(sc.InputError, match="NaN"):
        as_distortion([np.nan])


@settings(max_examples=20)
@given(seeds)
def test_pixels_go_there_and_back_with_skew(seed: int) -> None:
    rng = np.random.default_rng(seed)
    K = np.array([[500, rng.uniform(-5, 5), 320], [0, 510, 240], [0, 0, 1]])
    points = rng.uniform(60, 420, (20, 2))
    there = sc.undistort_points(points, K, [-0.25, 0.08, 0.001, 0.0, 0.0])
    np.testing.assert_allclose(sc.distort_points(there, K, [-0.25, 0.08, 0.001, 0.0, 0.0]), points, atol=1e-9)


@settings(max_examples=20)
@given(seeds)
def test_undistorted_pixels_equal_opencv_iterated(seed: int) -> None:
    rng = np.random.default_rng(seed)
    K = np.array([[500.0, 0, 320], [0, 510.0, 240], [0, 0, 1]])
    k = np.array([rng.uniform(-0.3, 0.1), 0.05, 1e-3, -1e-3, 0.0])
    R, _ = cv2.Rodrigues(rng.uniform(-0.1, 0.1, 3))
    P = np.array([[450.0, 0, 300, 0], [0, 450, 250, 0], [0, 0, 1, 0]])
    points = rng.uniform(60, 420, (20, 2))
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    theirs = (
        cv2.undistortPointsIter(points[:, None], K, k, R, P, criteria) if hasattr(cv2, "undistortPointsIter") else None
    )
    ours = sc.undistort_points(points, K, k, R=R, P=P)
    if theirs is None:
        theirs = cv2.undistortPoints(points[:, None], K, k, R=R, P=P, criteria=criteria)
    np.testing.assert_allclose(ours, theirs.reshape(-1, 2), atol=1e-7)
