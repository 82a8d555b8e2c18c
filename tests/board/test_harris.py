"""Harris: reference = kernel = OpenCV, and the paper's errata."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import ndimage
from strategies import seeds

import stereocal as sc
from stereocal.board.harris import harris_response, image_gradient, structure_tensor, tensor_eigenvalues


def picture(seed, shape=(37, 50), dtype=np.uint8):
    rng = np.random.default_rng(seed)
    image = ndimage.gaussian_filter(rng.uniform(0, 255, shape), rng.uniform(0, 2))
    image = (image - image.min()) / np.ptp(image) * 255
    return image.astype(dtype)


@settings(max_examples=25)
@given(
    seed=seeds,
    block=st.sampled_from([1, 3, 5, 9]),
    aperture=st.sampled_from([3, 5, 7]),
    k=st.sampled_from([0.0, 0.04, 0.06]),
    dtype=st.sampled_from([np.uint8, np.float32]),
    shape=st.tuples(st.integers(12, 40), st.integers(12, 70)),
)
def test_three_witnesses_agree(seed, block, aperture, k, dtype, shape):
    image = picture(seed, shape, dtype)
    assume(block > 1 or k > 0)  # of a single pixel det M = 0: Q would be rounding alone
    opencv = cv2.cornerHarris(image, block, aperture, k)
    size = np.abs(opencv).max()
    for backend in ("numpy", "numba"):
        ours = harris_response(image, block_size=block, aperture=aperture, k=k, backend=backend)
        assert np.abs(ours - opencv).max() <= 1e-6 * size, backend


def test_wide_windows_stay_exact():
    image = picture(5, (120, 160))
    for block in (45, 47):
        opencv = cv2.cornerHarris(image, block, 3, 0.04)
        assert np.abs(harris_response(image, block_size=block) - opencv).max() <= 2e-6 * np.abs(opencv).max()


def test_sixteen_bits_are_eight_bits_finer():
    image = picture(3)
    finer = harris_response(image.astype(np.uint16) * 257)
    np.testing.assert_allclose(finer, harris_response(image), atol=1e-6 * np.abs(finer).max())


@pytest.mark.parametrize("aperture", [3, 5, 7])
def test_gradient_is_sobel(aperture):
    image = picture(7).astype(np.float64)
    Ix, Iy = image_gradient(image, aperture)
    np.testing.assert_array_equal(Ix, cv2.Sobel(image, cv2.CV_64F, 1, 0, ksize=aperture))
    np.testing.assert_array_equal(Iy, cv2.Sobel(image, cv2.CV_64F, 0, 1, ksize=aperture))


@given(seed=seeds)
@settings(max_examples=20)
def test_eigenvalues_are_those_of_the_matrix_and_the_print_is_wrong(seed):
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((2, 2))
    M = root @ root.T + 0.5 * np.eye(2)
    A, B, C = (np.array([v]) for v in (M[0, 0], M[1, 1], M[0, 1]))
    smaller, larger = tensor_eigenvalues(A, B, C)
    np.testing.assert_allclose([smaller[0], larger[0]], np.linalg.eigvalsh(M), rtol=1e-9)
    printed = (A + B + np.sqrt(A**2 + 2 * A * B + B + 4 * C**2)) / 2
    assert not np.isclose(printed[0], larger[0], rtol=1e-3)


def test_response_is_the_product_of_the_eigenvalues_less_the_trace():
    Ix, Iy = image_gradient(picture(1).astype(np.float64))
    A, B, C = structure_tensor(Ix, Iy)
    smaller, larger = tensor_eigenvalues(A, B, C)
    np.testing.assert_allclose(
        (A * B - C * C) - 0.04 * (A + B) ** 2, smaller * larger - 0.04 * (smaller + larger) ** 2, rtol=1e-6, atol=1e-3
    )


def test_printed_c_does_not_see_the_direction_of_an_edge():
    # [eq 4] as printed, C = Ix² Ix², is the same for an edge and its mirror image; Ix Iy changes its sign.
    y, x = np.mgrid[:21, :21]
    edge = np.clip((x + y - 20) / 4.0, -1, 1)
    (Ix, Iy), (Mx, My) = image_gradient(edge), image_gradient(edge[:, ::-1].copy())
    C, mirrored = structure_tensor(Ix, Iy)[2][10, 10], structure_tensor(Mx, My)[2][10, 10]
    assert C > 1
    assert mirrored == pytest.approx(-C)
    assert (Ix**4)[10, 10] == pytest.approx((Mx**4)[10, 10])


def test_gaussian_window_is_the_papers():
    image = picture(2)
    scale = 1 / (4 * 3 * 255)
    Ix, Iy = (g * scale for g in image_gradient(image.astype(np.float64)))
    blur = lambda e: cv2.GaussianBlur(e, (0, 0), 1.5, borderType=cv2.BORDER_REFLECT_101)  # noqa: E731
    A, B, C = blur(Ix * Ix), blur(Iy * Iy), blur(Ix * Iy)
    expected = (A * B - C * C) - 0.05 * (A + B) ** 2
    ours = harris_response(image, k=0.05, window="gaussian", sigma=1.5)
    # the two cut the Gaussian's tails at different distances
    np.testing.assert_allclose(ours, expected, atol=2e-3 * np.abs(expected).max())


def test_corners_are_the_peaks_strongest_first():
    image = np.kron([[0, 255, 0], [255, 0, 255], [0, 255, 0]], np.ones((12, 12))).astype(np.uint8)
    corners = sc.harris_corners(image, threshold=1e-4, min_distance=3)
    assert np.all(np.diff(corners[:, 2]) <= 0)
    near = np.abs(corners[:, None, :2] - np.array([[x, y] for x in (11.5, 23.5) for y in (11.5, 23.5)])).max(axis=2)
    assert np.all(near.min(axis=0) <= 0.5), "each of the four crossings is listed"
    Q = harris_response(image)
    assert np.all(corners[:, 2] > 1e-4)
    for u, v, q in corners:
        patch = Q[max(0, int(v) - 3) : int(v) + 4, max(0, int(u) - 3) : int(u) + 4]
        assert patch.max() == pytest.approx(q)
    assert len(sc.harris_corners(image, threshold=1e-4, min_distance=3, max_corners=2)) == 2


@pytest.mark.parametrize(
    "options", [{"block_size": 2}, {"aperture": 4}, {"window": "hann"}, {"sigma": 0}, {"backend": "cuda"}]
)
def test_bad_options_are_named(options):
    with pytest.raises(sc.InputError, match=next(iter(options))):
        harris_response(picture(0), **options)


def test_image_smaller_than_the_window_is_refused():
    with pytest.raises(sc.InputError, match="smaller"):
        harris_response(np.zeros((4, 4), np.uint8), block_size=5)
