"""Each picture draws what it is given, on input that is whole, empty or odd."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure
from report_cases import SIZE, Case

from stereocal.report import (
    figures_board,
    figures_curves,
    figures_detection,
    figures_geometry,
    figures_images,
    figures_residuals,
)
from stereocal.report.style import to_png

RANDOM = np.random.default_rng(0)
IMAGE = RANDOM.integers(0, 256, (48, 64, 3)).astype(np.uint8)
CORNERS = np.mgrid[0:7, 0:6].T.reshape(-1, 2) * 5.0 + 8


def pixels(figure: Figure) -> np.ndarray:
    import io

    from PIL import Image

    assert isinstance(figure, Figure)
    return np.asarray(Image.open(io.BytesIO(to_png(figure, 60))).convert("RGB"))


@pytest.mark.parametrize("image", [IMAGE, IMAGE[..., 0], IMAGE[..., 0].astype(np.uint16) * 200, IMAGE / 255.0])
def test_corners_on_any_image(image: np.ndarray) -> None:
    plain = pixels(figures_images.draw_corners(image, None, 7))
    drawn = pixels(figures_images.draw_corners(image, CORNERS, 7))
    assert plain.shape == drawn.shape
    assert (plain != drawn).any()


def test_detection_stages_when_nothing_was_found_and_when_all_was() -> None:
    nothing = SimpleNamespace(stages={}, corners=None, covariances=None, message="no corner passed the saddle test")
    pixels(figures_detection.draw_detection_stages(IMAGE, nothing, (7, 6)))
    everything = SimpleNamespace(
        stages={"response": RANDOM.random((48, 64)), "candidates": CORNERS, "grid": CORNERS.reshape(6, 7, 2)},
        corners=CORNERS,
        covariances=np.tile(1e-4 * np.eye(2), (42, 1, 1)),
        message="",
    )
    pixels(figures_detection.draw_detection_stages(IMAGE, everything, (7, 6)))


def test_detection_stages_are_drawn_where_they_are_in_the_image() -> None:
    """Candidates are in the pixels of a level: at scale 4, level pixel (5, 2) is image pixel (21.5, 9.5)."""
    stages = {"scale": 4.0, "candidates": np.array([[5.0, 2.0, 1.0]]), "response": RANDOM.random((12, 16))}
    seen = SimpleNamespace(stages=stages, corners=None, covariances=None, message="one corner was seen")
    panel = figures_detection.draw_detection_stages(IMAGE, seen, (7, 6)).axes[1]
    crosses = next(line for line in panel.lines if line.get_marker() == "+")
    np.testing.assert_allclose(crosses.get_xydata(), [[21.5, 9.5]])


def test_detection_stages_of_a_board_refused() -> None:
    lattice = CORNERS.reshape(6, 7, 2).transpose(1, 0, 2).copy()
    lattice[3, 2] = np.nan
    fit = SimpleNamespace(corners=CORNERS, converged=np.arange(42) % 5 > 0)
    grid = lattice[np.isfinite(lattice[..., 0])]
    refused = SimpleNamespace(
        stages={"grid": grid, "lattice": lattice, "fit": fit, "candidates": grid},
        corners=None,
        covariances=None,
        message="9 of the 42 corners could not be measured",
    )
    figure = figures_detection.draw_detection_stages(IMAGE, refused, (7, 6), title="view")
    assert "stage 4" in figure.get_suptitle()
    assert "41 corners" in figure.axes[2].get_title(loc="left")
    assert any("could not be measured" in text.get_text() for text in figure.axes[3].texts)
    pixels(figure)


def test_disparity_without_a_single_answer() -> None:
    pixels(figures_images.draw_disparity(np.full((48, 64), np.nan)))
    pixels(figures_images.draw_disparity(RANDOM.random((48, 64)), image=IMAGE))


def test_rectified_pair() -> None:
    corners = {"left_corners": CORNERS, "right_corners": CORNERS}
    beside = pixels(figures_images.draw_rectified_pair(IMAGE, IMAGE, **corners))
    above = pixels(figures_images.draw_rectified_pair(IMAGE, IMAGE, axis=1, **corners))
    assert beside.shape[1] > beside.shape[0]
    assert above.shape[0] > above.shape[1]


def test_large_images_are_thinned_by_whole_steps() -> None:
    shown = figures_images.to_display(np.zeros((3000, 4000), np.uint8), longest=1280)
    assert shown.shape == (750, 1000)


def test_residuals() -> None:
    d = RANDOM.normal(size=(42, 2))
    pixels(figures_residuals.draw_residual_scatter(d, d))
    pixels(figures_residuals.draw_residual_vectors(CORNERS, d, (64, 48)))
    pixels(figures_residuals.draw_residual_radius([CORNERS[:, 0]] * 2, [d[:, 0]] * 2))
    pixels(figures_residuals.draw_view_errors([0.1, 0.2], [0.1, 0.9], names=["a", "b"], outliers=[1], joint_rms=0.2))


def test_cell_means() -> None:
    points = np.array([[1.0, 1], [2, 2], [3, 3], [4, 4], [5, 5], [60, 40]])
    centres, means = figures_residuals.cell_means(points, points * 0 + [[1.0, 2.0]], (64, 48))
    np.testing.assert_allclose(centres, [[4, 4]])
    np.testing.assert_allclose(means, [[1, 2]])


def test_geometry(healthy: Case) -> None:
    c = healthy.calibration
    pixels(figures_geometry.draw_rig(c.rig, c.rvecs, c.tvecs, healthy.board.object_points, 8, unit="mm"))
    pixels(figures_geometry.draw_coverage(np.zeros((0, 2)), SIZE))
    pixels(figures_geometry.draw_coverage(healthy.left[0], SIZE, border=[True] * 30 + [False] * 30))
    pixels(figures_geometry.draw_signed_map(CORNERS, CORNERS[:, 0] * 0, SIZE, title="t", label="l"))
    pixels(figures_geometry.draw_field(np.full((4, 5), np.nan), SIZE, title="t", label="l"))


def test_board_shape() -> None:
    pixels(figures_board.draw_board_shape(np.zeros((6, 7))))
    columns = np.mgrid[:6, :7][1].astype(float)
    hinge = 0.02 * np.abs(columns - 4)
    noisy = hinge + RANDOM.normal(0, 0.001, hinge.shape)
    figure = figures_board.draw_board_shape(noisy, unit="squares", sigma=0.001)
    pixels(figure)
    upper, lower = figure.axes[:2]
    assert (upper.get_xlabel(), upper.get_ylabel(), lower.get_xlabel()) == ("column", "row", "column")
    assert lower.get_ylabel() == "off the plane, squares"
    assert "sharpest bend, column 4" in [text.get_text() for text in lower.get_legend().get_texts()]


def test_a_hinge_is_found_where_it_is_certain() -> None:
    rows, columns = np.mgrid[:6, :9].astype(float)
    assert figures_board.sharpest_bend(0.02 * np.abs(rows - 1), 0.001) == (0, 1)
    assert figures_board.sharpest_bend(0.02 * np.abs(columns - 5), 0.001) == (1, 5)
    assert figures_board.sharpest_bend(RANDOM.normal(0, 0.001, (6, 9)), 0.001)[1] is None
    assert figures_board.sharpest_bend(0.02 * np.abs(rows - 1), np.inf) == (0, None)
    assert figures_board.sharpest_bend(np.ones((2, 9)), 0.001)[1] is None


def test_heights_are_those_over_the_best_plane() -> None:
    points = np.column_stack([RANDOM.uniform(0, 9, (30, 2)), np.zeros(30)])
    tilted = points + np.column_stack([np.zeros((30, 2)), 0.3 + 0.02 * points[:, 0] - 0.01 * points[:, 1]])
    np.testing.assert_allclose(figures_board.heights_over_plane(tilted), 0, atol=1e-12)
    tilted[7, 2] += 1
    assert figures_board.heights_over_plane(tilted)[7] > 0.7


def test_curves() -> None:
    z = np.linspace(1, 9, 5)
    pixels(figures_curves.draw_depth_uncertainty(z, z**2, z, board_range=(2, 4)))
    pixels(figures_curves.draw_sweep_windows([5, 7, 9], {0: [1, 2, 1], 50: [1, 1, 1]}, computable=[3, 2, 1]))
    pixels(figures_curves.draw_sweep_speckles([50, 60], {5: [2, 1]}))
    pixels(figures_curves.draw_sweep_maps({7: np.eye(9), 29: np.full((9, 9), np.nan)}, limits=(0, 1)))
