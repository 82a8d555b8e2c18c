"""What :func:`~stereocal.verify.function_checks.check_function` knows how to check.

A :class:`FunctionCase` draws an input, gives this library's answer and OpenCV's, says how far apart answers may be and
in what unit, and lists mistakes that are peculiar to the kernel (the paper's misprints, foremost).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import stereocal as sc
from stereocal.board.harris import image_gradient, structure_tensor

Array = NDArray[Any]


def largest_relative(found: Array, expected: Array) -> float:
    """Largest absolute difference, relative to the largest value expected; infinite where only one is NaN."""
    return largest_absolute(found, expected) / max(float(np.nanmax(np.abs(expected))), 1e-300)


def largest_absolute(found: Array, expected: Array) -> float:
    """Largest absolute difference; infinite where only one is NaN, 0 where both are."""
    if np.any(np.isnan(found) != np.isnan(expected)):
        return np.inf
    both = ~np.isnan(expected)
    return float(np.max(np.abs(found[both] - expected[both]), initial=0.0))


def largest_up_to_scale(found: Array, expected: Array) -> float:
    """Largest difference of two matrices that are defined up to a factor, after scaling both to unit norm."""
    a, b = found / np.linalg.norm(found), expected / np.linalg.norm(expected)
    return float(min(np.max(np.abs(a - b)), np.max(np.abs(a + b))))


_GRID = np.stack(np.meshgrid(np.arange(7.0), np.arange(6.0)), -1).reshape(-1, 2)


def largest_transfer(found: Array, expected: Array) -> float:
    """Largest distance between where two homographies take the points of the board, px."""
    one = np.column_stack([_GRID, np.ones(len(_GRID))])
    a, b = one @ found.T, one @ expected.T
    return float(np.max(np.linalg.norm(a[:, :2] / a[:, 2:] - b[:, :2] / b[:, 2:], axis=1)))


@dataclass(frozen=True)
class FunctionCase:
    """One kernel that a stranger's function can claim to be.

    Attributes
    ----------
    arguments : str
        How the function is called.
    draw : callable
        A random generator to one tuple of arguments.
    stereocal, opencv : callable
        The two oracles, called as the function is.
    tolerance : float
        The largest difference that counts as equal.
    unit : str
        Of the tolerance.
    measure : callable
        (found, expected) to their difference in `unit`.
    opencv_tolerance : float, optional
        The same against OpenCV, where OpenCV itself rounds.
    mistakes : sequence of (str, callable)
        A sentence, and a function that makes just that mistake.
    """

    arguments: str
    draw: Callable[[np.random.Generator], tuple[Any, ...]]
    stereocal: Callable[..., Any]
    opencv: Callable[..., Any]
    tolerance: float
    unit: str
    measure: Callable[[Array, Array], float] = largest_absolute
    mistakes: Sequence[tuple[str, Callable[..., Any]]] = ()
    opencv_tolerance: float | None = None


def _as_float32(points: Array) -> Array:
    """Round to what OpenCV's solvers keep: findHomography and findFundamentalMat convert points to float32."""
    return points.astype(np.float32).astype(np.float64)


def _photograph(rng: np.random.Generator) -> Array:
    """A picture with edges and corners: overlapping rectangles, slightly blurred, with noise."""
    height, width = (int(side) for side in rng.integers(40, 90, 2))
    picture = np.full((height, width), 90.0)
    for _ in range(12):
        y, x = rng.integers(0, height), rng.integers(0, width)
        picture[y : y + rng.integers(6, 30), x : x + rng.integers(6, 30)] = rng.uniform(20, 230)
    picture = cv2.GaussianBlur(picture, (0, 0), 0.8) + rng.normal(0, 2, picture.shape)
    return np.clip(picture, 0, 255).astype(np.uint8)


def _stereo_pair(rng: np.random.Generator) -> tuple[Array, Array, int, int]:
    height, width = int(rng.integers(30, 50)), int(rng.integers(60, 90))
    canvas = rng.integers(0, 256, (height, width + 20), dtype=np.uint8)
    shift = int(rng.integers(0, 15))
    left, right = canvas[:, :width], canvas[:, shift : shift + width]
    noise = rng.integers(0, 6, left.shape, dtype=np.uint8)
    return np.ascontiguousarray(left // 2 + noise), np.ascontiguousarray(right // 2), 16, int(rng.choice([3, 7, 11]))


def _sad_opencv(left: Array, right: Array, num_disparities: int, block_size: int) -> Array:
    """Block sums of absolute differences by cv2.absdiff and cv2.boxFilter, best disparity where all windows fit."""
    costs = []
    for d in range(num_disparities):
        difference = cv2.absdiff(left[:, d:], right[:, : right.shape[1] - d])
        summed = cv2.boxFilter(difference, cv2.CV_32S, (block_size, block_size), normalize=False)
        costs.append(np.pad(summed.astype(np.float64), ((0, 0), (d, 0)), constant_values=np.inf))
    volume = np.array(costs)
    r = block_size // 2
    best = np.full(left.shape, np.nan, np.float32)
    rows, columns = slice(r, left.shape[0] - r), slice(num_disparities - 1 + r, left.shape[1] - r)
    best[rows, columns] = volume[:, rows, columns].argmin(0)
    return best


def _sad_stereocal(left: Array, right: Array, num_disparities: int, block_size: int) -> Array:
    disparity = np.array(sc.match_sad(left, right, num_disparities=num_disparities, block_size=block_size))
    disparity[:, : num_disparities - 1 + block_size // 2] = np.nan  # compared where every disparity can be searched
    return disparity


def _harris_with(mistake: str) -> Callable[..., Array]:
    def response(image: Array, block_size: int, k: float) -> Array:
        scale = 1 / (4 * block_size * 255)
        Ix, Iy = image_gradient(image.astype(np.float64))
        A, B, C = structure_tensor(Ix * scale, Iy * scale, block_size=block_size)
        if mistake == "eq 4":
            C = structure_tensor(Ix * scale, Ix * scale, block_size=block_size)[2]
        if mistake == "trace":
            return (A * B - C * C) - k * (A + B)
        return (A * B - C * C) - k * (A * A + B * B)

    return response


def _camera(rng: np.random.Generator) -> tuple[Array, Array]:
    f = rng.uniform(380, 600)
    K = np.array([[f, 0, rng.uniform(300, 340)], [0, f * rng.uniform(0.99, 1.01), rng.uniform(220, 260)], [0, 0, 1]])
    return K, np.array([rng.uniform(-0.35, 0.1), rng.uniform(0, 0.12), *rng.normal(0, 1e-3, 2), 0.0])


def _draw_projection(rng: np.random.Generator) -> tuple[Any, ...]:
    K, dist = _camera(rng)
    X = rng.uniform([-2, -1.5, -0.5], [2, 1.5, 0.5], (30, 3))
    return X, rng.normal(0, 0.3, 3), np.array([0.1, -0.2, 6.0]), K, dist


def _project_backwards(X: Array, rvec: Array, tvec: Array, K: Array, dist: Array) -> Array:
    """The printed direction of [eq 18]: the polynomial taken for a map from distorted to ideal points."""
    ideal = sc.project_points(X, rvec, tvec, K, np.zeros(5))
    return np.asarray(2 * ideal - sc.project_points(X, rvec, tvec, K, dist))


def _draw_distorted(rng: np.random.Generator) -> tuple[Any, ...]:
    K, dist = _camera(rng)
    return rng.uniform([20, 20], [620, 460], (40, 2)), K, dist


def _undistort_opencv(points: Array, K: Array, dist: Array) -> Array:
    # Its default of five iterations is 0.1 px off. OpenCV 5 takes the criteria in undistortPoints itself.
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-14)
    if hasattr(cv2, "undistortPointsIter"):
        return np.asarray(cv2.undistortPointsIter(points[:, None], K, dist, np.eye(3), K, criteria))[:, 0]
    return np.asarray(cv2.undistortPoints(points[:, None], K, dist, P=K, criteria=criteria))[:, 0]


def _undistort_five_times(points: Array, K: Array, dist: Array) -> Array:
    return np.asarray(cv2.undistortPoints(points[:, None], K, dist, P=K))[:, 0]


def _draw_homography(rng: np.random.Generator) -> tuple[Any, ...]:
    H = np.array([[40.0, 3, 200], [-4, 38, 150], [0.01, -0.02, 1]]) + rng.normal(0, 1e-3, (3, 3))
    p = np.column_stack([_GRID, np.ones(len(_GRID))]) @ H.T
    return _GRID, _as_float32(p[:, :2] / p[:, 2:] + rng.normal(0, 0.2, _GRID.shape))


def _draw_two_views(rng: np.random.Generator) -> tuple[Any, ...]:
    K, _ = _camera(rng)
    X = rng.uniform([-2, -1.5, 4], [2, 1.5, 9], (25, 3))
    R, T = sc.rotation_matrix(rng.normal(0, 0.1, 3)), np.array([-1.0, *rng.normal(0, 0.1, 2)])
    left, right = X @ K.T, (X @ R.T + T) @ K.T
    noise = rng.normal(0, 0.3, (2, 25, 2))
    return _as_float32(left[:, :2] / left[:, 2:] + noise[0]), _as_float32(right[:, :2] / right[:, 2:] + noise[1])


def _draw_remap(rng: np.random.Generator) -> tuple[Any, ...]:
    image = _photograph(rng)
    height, width = image.shape
    x = rng.uniform(1, width - 2, (33, 47)).astype(np.float32)
    return image, x, rng.uniform(1, height - 2, (33, 47)).astype(np.float32)


def _draw_speckles(rng: np.random.Generator) -> tuple[Any, ...]:
    patches = rng.integers(0, 12, (12, 16)).repeat(5, 0).repeat(5, 1).astype(np.float32)
    patches += rng.integers(0, 2, patches.shape).astype(np.float32)
    return patches, 25 * int(rng.integers(1, 5)), 1.0  # sizes that components do have


def _speckles_opencv(disparity: Array, max_size: int, max_difference: float) -> Array:
    fixed = (disparity * 16).astype(np.int16)
    cv2.filterSpeckles(fixed, -16, max_size, int(max_difference * 16))
    return np.where(fixed == -16, np.nan, fixed / 16).astype(np.float32)


CASES: dict[str, FunctionCase] = {
    "harris_response": FunctionCase(
        "image uint8 (H, W), block_size, k",
        lambda rng: (_photograph(rng), 3, 0.04),
        lambda image, block_size, k: sc.harris_response(image, block_size=block_size, k=k),
        lambda image, block_size, k: cv2.cornerHarris(image, block_size, 3, k),
        1e-5,
        "of the largest response",
        largest_relative,
        (
            ("C is I_x² · I_x², as the paper misprints [eq 4]; it must be I_x · I_y.", _harris_with("eq 4")),
            ("The trace is not squared: Q = det M − k·trace² [eq 8].", _harris_with("trace")),
            ("k multiplies A² + B² instead of (A + B)² [eq 8].", _harris_with("squares")),
        ),
    ),
    "rotation_matrix": FunctionCase(
        "rvec (3,)",
        lambda rng: (rng.normal(0, 1, 3),),
        sc.rotation_matrix,
        lambda rvec: cv2.Rodrigues(rvec)[0],
        1e-10,
        "per entry",
    ),
    "project_points": FunctionCase(
        "X (N, 3), rvec (3,), tvec (3,), K (3, 3), dist (5,)",
        _draw_projection,
        sc.project_points,
        lambda X, rvec, tvec, K, dist: cv2.projectPoints(X, rvec, tvec, K, dist)[0][:, 0],
        1e-8,
        "px",
        mistakes=(
            (
                "The distortion is left out: apply the polynomial between X/Z and K [eq 18].",
                lambda X, rvec, tvec, K, dist: sc.project_points(X, rvec, tvec, K, np.zeros(5)),
            ),
            (
                "The rotation is inverted: X_camera = R X + t.",
                lambda X, rvec, tvec, K, dist: sc.project_points(X, -rvec, tvec, K, dist),
            ),
        ),
    ),
    "undistort_points": FunctionCase(
        "points (N, 2), K (3, 3), dist (5,)",
        _draw_distorted,
        sc.undistort_points,
        _undistort_opencv,
        1e-6,
        "px",
        mistakes=(
            (
                "It stops after five iterations, as cv2.undistortPoints does: iterate to a tolerance.",
                _undistort_five_times,
            ),
            (
                "The polynomial is applied to the distorted point, as the paper prints [eq 18]; it has to be undone.",
                sc.distort_points,
            ),
        ),
    ),
    "fit_homography": FunctionCase(
        "src (N, 2), dst (N, 2)",
        _draw_homography,
        sc.fit_homography,
        lambda src, dst: cv2.findHomography(src, dst)[0],
        1e-4,
        "px",
        largest_transfer,
        (("It is the inverse: src must go to dst.", lambda src, dst: np.linalg.inv(sc.fit_homography(src, dst))),),
        opencv_tolerance=1e-3,  # cv2.findHomography works in float32 and stops after ten iterations
    ),
    "fit_fundamental": FunctionCase(
        "left (N, 2), right (N, 2)",
        _draw_two_views,
        sc.fit_fundamental,
        lambda left, right: cv2.findFundamentalMat(left, right, cv2.FM_8POINT)[0],
        1e-6,
        "of the unit matrix",
        largest_up_to_scale,
        (
            (
                "It is transposed: x_rightᵀ F x_left = 0; the paper prints the other order [eq 20].",
                lambda left, right: np.transpose(sc.fit_fundamental(left, right)),
            ),
        ),
    ),
    "remap": FunctionCase(
        "image uint8 (H, W), map_x float32 (h, w), map_y float32 (h, w)",
        _draw_remap,
        sc.remap,
        lambda image, x, y: cv2.remap(image, x, y, cv2.INTER_LINEAR),
        1.0,
        "grey levels",
        mistakes=(("map_x and map_y are swapped.", lambda image, x, y: sc.remap(image, y, x)),),
        opencv_tolerance=8.0 if cv2.__version__ < "5" else 1.0,  # OpenCV 4 rounds map coordinates to 1/32 pixel
    ),
    "match_sad": FunctionCase(
        "left uint8 (H, W), right uint8 (H, W), num_disparities, block_size",
        _stereo_pair,
        _sad_stereocal,
        _sad_opencv,
        0.0,
        "px",
        mistakes=(
            (
                "The search runs the wrong way: the match of left x is right x − d [eq 22].",
                lambda left, right, n, b: _sad_stereocal(right, left, n, b),
            ),
        ),
    ),
    "filter_speckles": FunctionCase(
        "disparity float32 (H, W), NaN for none, max_size, max_difference",
        _draw_speckles,
        lambda disparity, size, difference: sc.filter_speckles(disparity, max_size=size, max_difference=difference),
        _speckles_opencv,
        0.0,
        "px",
        mistakes=(
            (
                "A component of exactly max_size pixels must go as well.",
                lambda d, size, difference: sc.filter_speckles(d, max_size=size - 1, max_difference=difference),
            ),
        ),
    ),
}
"""Every kernel that :func:`~stereocal.verify.function_checks.check_function` can check, by name."""
