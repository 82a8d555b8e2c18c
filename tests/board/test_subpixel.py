"""The saddle fit: reference = kernel, derivatives, truth on renders, honest covariance, beside cornerSubPix."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from board_renders import render
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

import stereocal as sc
from stereocal.board.saddle_model import fit_saddle, saddle_image
from stereocal.board.subpixel import fit_corner_grid
from stereocal.board.subpixel_geometry import grid_steps, light_slopes
from stereocal.board.subpixel_kernels import fit_saddles

BOARD = sc.Chessboard((7, 5), 1.0)


def random_saddle(seed, noise=2.0):
    """(image, theta, steps, bends) of one saddle."""
    rng = np.random.default_rng(seed)
    a1 = rng.uniform(0, np.pi)
    a2 = a1 + rng.uniform(1.0, 2.1)
    l1, l2 = rng.uniform(14, 24, 2)
    steps = np.array([l1 * np.cos(a1), l1 * np.sin(a1), l2 * np.cos(a2), l2 * np.sin(a2)])
    theta = np.array(
        [*rng.uniform(28, 32, 2), a1, a2, rng.uniform(1, 2.5), 120, rng.choice([-1, 1]) * rng.uniform(30, 80)]
    )
    bends = rng.uniform(-0.5, 0.5, 2)
    y, x = np.mgrid[:61, :61]
    pixels = np.column_stack([x.ravel(), y.ravel()]).astype(float)
    image = saddle_image(theta, pixels, steps, bends)[0].reshape(61, 61)
    return image + noise * rng.standard_normal(image.shape), theta, steps, bends


@settings(max_examples=15)
@given(seed=seeds)
def test_derivatives_are_those_of_the_model(seed):
    _, theta, steps, _ = random_saddle(seed)
    pixels = theta[:2] + np.random.default_rng(seed).uniform(-8, 8, (20, 2))
    _, J = saddle_image(theta, pixels, steps, np.zeros(2))
    for k in range(7):
        h = 1e-5
        up, down = theta.copy(), theta.copy()
        up[k] += h
        down[k] -= h
        numeric = (
            saddle_image(up, pixels, steps, np.zeros(2))[0] - saddle_image(down, pixels, steps, np.zeros(2))[0]
        ) / (2 * h)
        np.testing.assert_allclose(J[:, k], numeric, atol=1e-5 * max(1, np.abs(numeric).max()))


@settings(max_examples=15)
@given(seed=seeds, start=st.tuples(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7)))
def test_kernel_is_the_reference(seed, start):
    image, truth, steps, bends = random_saddle(seed)
    corner = truth[:2] + start
    expected, expected_covariance = fit_saddle(image, corner, steps, bends, 0.55, 5.0, 1.5)
    theta, covariance, info = np.empty((1, 7)), np.empty((1, 2, 2)), np.empty((1, 4))
    one = np.ones(1)
    fit_saddles(
        image,
        corner[None],
        steps[None],
        bends[None],
        0.55 * one,
        5 * one,
        np.zeros((1, 5)),
        1.5 * one,
        True,
        1e-5,
        50,
        np.zeros(1),
        np.ones(1, np.int64),
        theta,
        covariance,
        info,
    )
    assert info[0, 2] == 1
    np.testing.assert_allclose(theta[0, :2], expected[:2], atol=2e-4)
    np.testing.assert_allclose(theta[0, 2:5], expected[2:5], atol=1e-3)
    np.testing.assert_allclose(covariance[0], expected_covariance[:2, :2], rtol=5e-3)
    assert np.hypot(*(theta[0, :2] - truth[:2])) < 5 * np.sqrt(np.trace(covariance[0])) + 1e-3


def test_bends_are_second_differences_across_the_line():
    x, y = np.meshgrid(np.arange(6.0), np.arange(4.0))
    grid = np.stack([20 * x, 20 * y + 0.15 * x * x], axis=-1)
    steps, bends = grid_steps(grid)
    assert bends[2, 2, 0] == pytest.approx(0.3, abs=2e-3)  # 2 * 0.15, the line's normal being close to y
    assert np.abs(bends[..., 1]).max() < 1e-12
    np.testing.assert_allclose(steps[2, 2], [20, 0.6, 0, 20], atol=1e-12)


@given(seed=seeds, rows=st.integers(2, 8), columns=st.integers(2, 9))
def test_geometry_of_the_kernel_is_that_of_the_reference(seed, rows, columns):
    rng = np.random.default_rng(seed)
    grid = 20 * np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), -1) + rng.normal(0, 2, (rows, columns, 2))
    for ours, reference in zip(grid_steps(grid), grid_steps(grid, backend="numpy"), strict=True):
        np.testing.assert_allclose(ours, reference, atol=1e-12)
    levels = rng.uniform(20, 200, (rows, columns, 2))
    np.testing.assert_allclose(light_slopes(levels), light_slopes(levels, backend="numpy"), atol=1e-12)


def errors(count, **options):
    """Errors and covariances over renders."""
    e, c = [], []
    for seed in range(count):
        image, truth = render(BOARD, seed=seed, tilt=8 * seed % 40, turn=37 * seed, **options)
        rough = truth + np.random.default_rng(seed).uniform(-0.4, 0.4, truth.shape)
        fit = fit_corner_grid(image, rough.reshape(BOARD.rows, BOARD.columns, 2))
        assert fit.converged.all()
        e.append(fit.corners - truth)
        c.append(fit.covariances)
    return np.concatenate(e), np.concatenate(c)


@pytest.mark.parametrize(
    ("blur", "noise", "contrast", "limit"),
    [(0.5, 1, 1, 0.011), (1.2, 5, 1, 0.034), (0.8, 8, 0.5, 0.095), (2.0, 3, 1, 0.031)],
)
def test_corners_are_true_and_their_covariance_is_honest(blur, noise, contrast, limit):
    e, covariances = errors(16, blur=blur, noise=noise, contrast=contrast, vignetting=0.0)
    assert np.sqrt((e**2).sum(axis=1).mean()) < limit
    normalised = np.einsum("ni,nij,nj->n", e, np.linalg.inv(covariances), e)
    assert 1.6 < normalised.mean() < 2.4


def test_less_than_half_of_the_error_of_corner_subpix():
    ours, theirs = [], {w: [] for w in (3, 5, 8)}
    for seed in range(6):
        image, truth = render(BOARD, seed=seed, tilt=35, turn=50 * seed, blur=0.8, noise=3)
        ours.append(sc.refine_corners(image, truth + 0.3, BOARD) - truth)
        for w, found in theirs.items():
            criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)
            start = truth.astype(np.float32).reshape(-1, 1, 2)
            refined = cv2.cornerSubPix(image, start, (w, w), (-1, -1), criteria).reshape(-1, 2)
            found.append(refined - truth)
    rms = lambda e: np.sqrt((np.concatenate(e) ** 2).sum(axis=1).mean())  # noqa: E731
    assert rms(ours) < 0.5 * min(rms(found) for found in theirs.values())


def test_blur_is_measured():
    for blur in (0.8, 1.5, 2.5):
        image, truth = render(BOARD, tilt=0, turn=0, blur=blur, noise=1)
        fit = fit_corner_grid(image, truth.reshape(BOARD.rows, BOARD.columns, 2))
        # the pixel's own square adds 1/12 to the variance
        assert np.median(fit.edge_widths) == pytest.approx(np.sqrt(blur**2 + 1 / 12), rel=0.15)


def test_number_of_corners_is_checked():
    with pytest.raises(sc.InputError, match="35"):
        sc.refine_corners(np.zeros((50, 50), np.uint8), np.zeros((34, 2)), BOARD)


def disturbed(kind, seed):
    """A render with the edge of a shadow, a finger or strokes of ink over the board, as (image, true corners)."""
    image, truth = render(BOARD, seed=seed, tilt=25, turn=31 * seed, blur=0.8, noise=0.0, vignetting=0.0)
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    middle, a = truth.mean(axis=0), rng.uniform(0, 2 * np.pi)
    along = (x - middle[0]) * np.cos(a) + (y - middle[1]) * np.sin(a)
    across = (y - middle[1]) * np.cos(a) - (x - middle[0]) * np.sin(a)
    light = image.astype(np.float64)
    if kind == "shadow":
        light *= np.where(along > 3, 1.0, 0.45)
    elif kind == "finger":
        light = np.where((np.abs(across) < 4) & (along < 2), 150.0, light)
    else:
        for cx, cy in truth[rng.integers(0, len(truth), 6)] + rng.normal(0, 4, (6, 2)):
            light[int(cy) : int(cy) + 2, int(cx) : int(cx) + 6] = rng.choice([30, 130, 230])
    return np.clip(np.rint(light + rng.normal(0, 2, light.shape)), 0, 255).astype(np.uint8), truth


@pytest.mark.parametrize("kind", ["shadow", "finger", "ink"])
def test_shadows_fingers_and_ink_are_masked_or_owned_up_to(kind):
    e, claimed = [], []
    for seed in range(6):
        image, truth = disturbed(kind, seed)
        fit = fit_corner_grid(image, (truth + 0.3).reshape(BOARD.rows, BOARD.columns, 2))
        e.append(np.hypot(*(fit.corners - truth).T))
        claimed.append(np.sqrt(np.trace(fit.covariances, axis1=1, axis2=2)))
    e, claimed = np.concatenate(e), np.concatenate(claimed)
    assert np.median(e) < 0.03
    assert np.percentile(e, 95) < 0.25
    # what is far off says so
    assert (e < np.maximum(6 * claimed, 0.1)).mean() > 0.99
