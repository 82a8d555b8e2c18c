"""Rays, blur and boards: optics that need no oracle, and the twins."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter1d, map_coordinates
from scipy.optimize import minimize
from strategies import seeds

from stereocal.base.errors import InputError
from stereocal.base.rotations import rotation_matrix
from stereocal.board.chessboard import Chessboard
from stereocal.camera.distortion import undistort_normalized
from stereocal.camera.model import Camera
from stereocal.synthetic.board_view import bent_points, meet_board, render_board, true_corners
from stereocal.synthetic.exposure import aperture_kernel, blur_pad, develop, gather, vignette
from stereocal.synthetic.rays import ray_table, sample_offsets

LENS = [-0.38, 0.15, 4e-4, -3e-4, -0.02]
SMALL = Camera([[110.0, 0, 79.3], [0, 111.0, 60.7], [0, 0, 1]], LENS, (160, 120))
BOARD = Chessboard((5, 4), 10.0)
QUIET = {"noise": 0.0, "vignetting": 0.0}


def test_rays_between_the_nodes_are_the_undone_lens():
    camera = Camera([[430.4, 0.3, 318.6], [0, 430.9, 243.2], [0, 0, 1]], LENS, (640, 480))
    table = ray_table(camera, supersampling=4, pad=3)
    rays = table.rays()
    assert rays.shape[:2] == table.raster_shape
    random = np.random.default_rng(0)
    rows, columns = random.integers(0, rays.shape[0], 3000), random.integers(0, rays.shape[1], 3000)
    offsets = sample_offsets(4)
    u, v = columns // 4 - 3 + offsets[columns % 4], rows // 4 - 3 + offsets[rows % 4]
    y = (v - camera.cy) / camera.fy
    x = (u - camera.cx - camera.skew * y) / camera.fx
    exact = undistort_normalized(np.stack([x, y], 1), camera.dist, "brown")
    # in pixels: the claim of the module is 1e-8
    assert np.abs(rays[rows, columns] - exact).max() * camera.fx < 1e-8


@settings(max_examples=10)
@given(st.floats(0, 2.5), st.integers(4, 8), seeds)
@example(3e-159, 4, 0)  # its square is no number
def test_blur_keeps_light_and_its_twins_agree(blur, s, seed):
    pad = blur_pad(blur)
    kernel = aperture_kernel(blur, s, pad)
    assert kernel.sum() == pytest.approx(1, abs=1e-14)
    np.testing.assert_allclose(kernel, kernel[::-1], atol=1e-15)
    raster = np.random.default_rng(seed).random((s * (9 + 2 * pad), s * (7 + 2 * pad))).astype(np.float32) * 255
    ours, reference = (gather(raster, kernel, s, backend=backend) for backend in ("numba", "numpy"))
    np.testing.assert_allclose(ours, reference, rtol=2e-6)
    flat = gather(np.full_like(raster, 77), kernel, s)
    np.testing.assert_allclose(flat, 77, rtol=1e-5)


def test_blur_is_a_gaussian_convolved_with_the_pixel():
    s, blur = 8, 0.9
    pad = blur_pad(blur)
    line = np.zeros(s * (21 + 2 * pad))
    line[len(line) // 2 + 3] = 1.0
    raster = np.tile(line.astype(np.float32), (s * (1 + 2 * pad), 1))
    ours = gather(raster, aperture_kernel(blur, s, pad), s)[0]
    smooth = gaussian_filter1d(line, blur * s, truncate=6)
    expected = smooth[s * pad : -s * pad].reshape(21, s).mean(axis=1)
    np.testing.assert_allclose(ours, expected, atol=2e-5)
    # the variance of the whole spot: σ² + 1/12 of the pixel's square
    positions = np.arange(21.0)
    mean = (positions * ours).sum() / ours.sum()
    variance = ((positions - mean) ** 2 * ours).sum() / ours.sum()
    assert variance == pytest.approx(blur**2 + 1 / 12, rel=0.01)


def test_noise_is_seeded_gaussian_and_quantised():
    light = np.full((300, 300), 100.0, np.float32)
    first, again, other = (develop(light, noise=3, random=np.random.default_rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    assert first.mean() == pytest.approx(100, abs=0.05)
    assert first.std() == pytest.approx(np.hypot(3, 1 / np.sqrt(12)), rel=0.01)
    assert develop(light + 500, noise=0, random=np.random.default_rng(0)).max() == 255


def test_vignetting_falls_to_its_strength_in_the_corner():
    shade = vignette(SMALL, 0.3)
    assert shade.min() == pytest.approx(0.7)
    assert shade[61, 79] == pytest.approx(1, abs=1e-3)


@settings(max_examples=8)
@given(
    st.floats(-0.5, 0.5),
    st.floats(-0.5, 0.5),
    st.floats(-3, 3),
    st.floats(0, 3),
    st.sampled_from([0.0, 0.7]),
    st.integers(4, 5),
)
def test_board_twins_agree(ax, ay, az, bow, blur, s):
    R = rotation_matrix([ax, 0, 0]) @ rotation_matrix([0, ay, 0]) @ rotation_matrix([0, 0, az])
    t = np.array([0, 0, 90.0]) - R @ [20, 15, 0]
    images = [
        render_board(SMALL, R, t, BOARD, blur=blur, bow=bow, supersampling=s, backend=backend, **QUIET)[0].astype(int)
        for backend in ("numba", "numpy")
    ]
    assert np.abs(images[0] - images[1]).max() <= 1  # a rounding at ….5
    assert (images[0] != images[1]).mean() < 1e-3


@settings(max_examples=30)
@given(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.floats(-8, 8))
def test_a_ray_through_a_bent_boards_corner_meets_that_corner(ax, ay, bow):
    R = rotation_matrix([ax, ay, 0.2])
    t = np.array([0, 0, 120.0]) - R @ [20, 15, 0]
    points = bent_points(BOARD, bow)
    local = points @ R.T + t
    origin = -R.T @ t / BOARD.square_size
    length = BOARD.columns + 1.0
    met = meet_board(local[:, :2] / local[:, 2:], R, origin, bow / 10, (BOARD.columns - 1) / 2, length)
    np.testing.assert_allclose(met, points[:, :2] / BOARD.square_size, atol=1e-9)


def _saddle_by_symmetry(image: np.ndarray, start: np.ndarray, radius: int = 6) -> np.ndarray:
    """The point c about which a corner's neighbourhood is symmetric, I(c + d) = I(c − d).

    An independent corner finder: no gradients, no model of an edge; a saddle looks the same after half a turn.
    """
    grid = np.mgrid[-radius : radius + 1, -radius : radius + 1].reshape(2, -1)
    weight = np.exp(-0.5 * (grid**2).sum(0) / (radius / 2) ** 2)

    def asymmetry(c: np.ndarray) -> float:
        one = map_coordinates(image, grid + c[::-1, None], order=3)
        other = map_coordinates(image, c[::-1, None] - grid, order=3)
        return float((weight * (one - other) ** 2).sum())

    # a small simplex: the inside of a square is symmetric too
    simplex = start + np.array([[0.0, 0.0], [0.3, 0.0], [0.0, 0.3]])
    options = {"xatol": 1e-5, "fatol": 1e-9, "initial_simplex": simplex}
    return minimize(asymmetry, start, method="Nelder-Mead", options=options).x


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.13, 0.37), (0.5, 0.125), (0.81, 0.66)])
def test_true_corners_are_where_an_upright_board_is_symmetric(shift):
    # edges along the pixel rows: point sampling at 4x would misplace them by up to 1/8 px
    camera = Camera([[200.0, 0, 80], [0, 200.0, 60], [0, 0, 1]], None, (160, 120), model="pinhole")
    t = np.array([-20 + shift[0] / 2, -15 + shift[1] / 2, 100.0])
    image, corners = render_board(camera, np.eye(3), t, BOARD, noise=0, vignetting=0, blur=0.8, supersampling=4)
    found = np.array([_saddle_by_symmetry(image.astype(float), corner + 0.2) for corner in corners[[6, 8, 13]]])
    assert np.abs(found - corners[[6, 8, 13]]).max() < 0.004


def test_true_corners_under_tilt_and_distortion():
    camera = Camera([[430.0, 0, 318], [0, 431.0, 243], [0, 0, 1]], LENS, (640, 480))
    board = Chessboard((9, 6), 25.0)
    R = rotation_matrix([0.3, -0.4, 0.1])
    image, corners = render_board(camera, R, [-110, -50, 330], board, noise=0, vignetting=0)
    chosen = [10, 22, 31, 43]
    found = np.array([_saddle_by_symmetry(image.astype(float), corners[k] + 0.1, radius=4) for k in chosen])
    # perspective and lens bend the neighbourhood a little, so the symmetry itself is true to some 1/100 px
    assert np.abs(found - corners[chosen]).max() < 0.02


def test_the_square_outside_the_first_corner_is_dark():
    camera = Camera([[200.0, 0, 80], [0, 200.0, 60], [0, 0, 1]], None, (160, 120), model="pinhole")
    image, corners = render_board(camera, np.eye(3), [-20, -15, 100], BOARD, noise=0, vignetting=0)
    x, y = np.rint(corners[0]).astype(int)
    assert image[y - 8, x - 8] == 40
    assert image[y + 8, x + 8] == 40
    assert image[y - 8, x + 8] == image[y + 8, x - 8] == 200
    # the bright margin has no seam where it meets a bright square
    assert (image[y - 27 : y - 13, x + 5 : x + 15] == 200).all()


def test_anti_aliasing_keeps_the_mean_of_squares_below_a_pixel():
    # a board so far that a square is 0.4 px: all that remains is its mean
    camera = Camera([[20.0, 0, 79.5], [0, 20.0, 59.5], [0, 0, 1]], None, (160, 120), model="pinhole")
    board = Chessboard((101, 81), 1.0)
    image, _ = render_board(camera, np.eye(3), [-50, -40, 50.0], board, noise=0, vignetting=0, blur=0.5)
    middle = image[52:68, 70:90].astype(float)
    assert middle.mean() == pytest.approx(120, abs=0.5)
    assert middle.std() < 2


def test_more_samples_change_little():
    R, t = rotation_matrix([0.2, 0.3, 0.1]), [-20, -15, 90]
    four, twelve = (render_board(SMALL, R, t, BOARD, supersampling=s, **QUIET)[0].astype(float) for s in (4, 12))
    assert np.abs(four - twelve).max() < 2.0
    assert np.sqrt(np.mean((four - twelve) ** 2)) < 0.15


def test_a_bow_moves_the_middle_of_the_board_only():
    flat = true_corners(SMALL, np.eye(3), np.array([-20.0, -15, 100]), BOARD)
    bent = true_corners(SMALL, np.eye(3), np.array([-20.0, -15, 100]), BOARD, bow=-5.0)
    # the middle column stands 5 units nearer: seen larger, farther from the image's centre
    assert np.linalg.norm(bent - flat, axis=1).max() > 0.3
    np.testing.assert_allclose(bent_points(BOARD, 0.0), BOARD.object_points)


def test_the_back_of_a_board_is_refused():
    with pytest.raises(InputError, match="behind"):
        render_board(SMALL, rotation_matrix([0, np.pi, 0]), [20, -15, 100], BOARD)
    with pytest.raises(InputError, match="supersampling"):
        render_board(SMALL, np.eye(3), [-20, -15, 100], BOARD, supersampling=3)
