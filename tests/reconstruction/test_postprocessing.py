"""Post-processing: twins equal to the bit, edges kept, holes filled from behind, confidence that ranks errors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

from stereocal.base.errors import InputError
from stereocal.reconstruction.census import match_census
from stereocal.reconstruction.postprocessing import confidence_map, fill_holes, median_of_nine, weighted_median

cv2 = pytest.importorskip("cv2")


def _random_map(rng, shape, missing):
    d = rng.uniform(0, 60, shape).round(1).astype(np.float32)
    d[rng.random(shape) < missing] = np.nan
    return d


@settings(max_examples=25)
@given(
    seed=seeds, height=st.integers(1, 15), width=st.integers(1, 20), radius=st.integers(1, 4), missing=st.floats(0, 1)
)
def test_weighted_median_kernel_is_its_reference(seed, height, width, radius, missing) -> None:
    rng = np.random.default_rng(seed)
    d = _random_map(rng, (height, width), missing)
    image = rng.integers(0, 256, d.shape).astype(np.uint8)
    options = {"radius": radius, "sigma_color": rng.uniform(1, 40), "sigma_space": rng.uniform(0.5, 9)}
    kernel = weighted_median(d, image, **options, threads=int(rng.integers(1, 4)))
    np.testing.assert_array_equal(kernel, weighted_median(d, image, **options, backend="numpy"))
    np.testing.assert_array_equal(np.isnan(kernel), np.isnan(d))


def test_weighted_median_of_a_flat_image_is_a_median() -> None:
    """With equal weights it is NumPy's median of the valid pixels, wherever their number is odd."""
    rng = np.random.default_rng(3)
    d = _random_map(rng, (20, 30), 0.2)
    result = weighted_median(d, np.full(d.shape, 90, np.uint8), radius=1, sigma_color=1.0, sigma_space=1e9)
    odd = 0
    for y in range(1, 19):
        for x in range(1, 29):
            window = d[y - 1 : y + 2, x - 1 : x + 2]
            if not np.isnan(d[y, x]) and np.count_nonzero(~np.isnan(window)) % 2:
                assert result[y, x] == np.nanmedian(window)
                odd += 1
    assert odd > 100


def test_weighted_median_cleans_a_surface_and_keeps_its_edge() -> None:
    rng = np.random.default_rng(0)
    truth = np.where(np.arange(60) < 30, 10.0, 40.0) * np.ones((40, 1))
    image = np.where(truth > 20, 180, 60).astype(np.uint8)
    noisy = truth.astype(np.float32)
    wrong = rng.random(truth.shape) < 0.2
    noisy[wrong] = rng.uniform(0, 60, wrong.sum())
    assert np.mean(np.abs(weighted_median(noisy, image) - truth) < 0.01) > 0.995


@settings(max_examples=30)
@given(seed=seeds, missing=st.floats(0, 1), limit=st.one_of(st.none(), st.integers(1, 9)))
def test_holes_are_filled_with_the_smaller_end(seed, missing, limit) -> None:
    rng = np.random.default_rng(seed)
    d = _random_map(rng, (5, 17), missing)
    expected = d.copy()
    for row, given_row in zip(expected, d, strict=True):
        x = 0
        while x < len(row):
            if not np.isnan(given_row[x]):
                x += 1
                continue
            end = x
            while end < len(row) and np.isnan(given_row[end]):
                end += 1
            ends = [given_row[i] for i in (x - 1, end) if 0 <= i < len(row)]
            if ends and (limit is None or end - x <= limit):
                row[x:end] = min(ends)
            x = end
    np.testing.assert_array_equal(fill_holes(d, max_width=limit), expected)


def test_an_empty_row_stays_empty() -> None:
    assert np.isnan(fill_holes(np.full((2, 5), np.nan))).all()


@settings(max_examples=15)
@given(seed=seeds, cost=st.sampled_from(["census+bt", "census", "bt", "sad"]), lowest=st.integers(-3, 3))
def test_confidence_by_kernel_is_by_reference(seed, cost, lowest) -> None:
    rng = np.random.default_rng(seed)
    left, right = rng.integers(0, 256, (2, 12, 24)).astype(np.uint8)
    d = _random_map(rng, left.shape, 0.2) / 4
    options = {"num_disparities": 9, "min_disparity": lowest, "cost": cost, "block_size": 3}
    result = confidence_map(d, left, right, **options)
    np.testing.assert_array_equal(result, confidence_map(d, left, right, **options, backend="numpy"))
    known = ~np.isnan(result)
    assert np.all((result[known] >= 0) & (result[known] <= 1))
    assert not np.any(known & np.isnan(d))


def test_confidence_ranks_right_above_wrong() -> None:
    """On a noisy pair of known shift, the most trusted half of the matches has far fewer errors than the other."""
    rng = np.random.default_rng(5)
    scene = rng.integers(0, 256, (80, 140)).astype(np.float64)
    left, right = scene[:, :120], scene[:, 7:127]
    pair = [np.clip(view + rng.normal(scale=70, size=view.shape), 0, 255).astype(np.uint8) for view in (left, right)]
    d = match_census(*pair, num_disparities=32, block_size=5, left_right_check=None)
    confidence = confidence_map(d, *pair, num_disparities=32)
    known = ~np.isnan(confidence)
    wrong = np.abs(d - 7) > 1
    trusted = confidence > np.median(confidence[known])
    assert wrong[known & ~trusted].mean() > 3 * wrong[known & trusted].mean() > 0


def test_bad_input_is_named() -> None:
    d, image = np.ones((4, 5), np.float32), np.ones((4, 6), np.uint8)
    with pytest.raises(InputError, match="image must be uint8 of shape"):
        weighted_median(d, image)
    with pytest.raises(InputError, match="radius"):
        weighted_median(d, image[:, :5], radius=0)
    with pytest.raises(InputError, match="max_width"):
        fill_holes(d, max_width=0)
    with pytest.raises(InputError, match="map's shape"):
        confidence_map(d, image, image)


@settings(max_examples=25)
@given(seed=seeds, height=st.integers(1, 12), width=st.integers(1, 40), holes=st.sampled_from([0.0, 0.3, 0.8]))
def test_median_of_nine_kernel_is_its_reference(seed, height, width, holes) -> None:
    rng = np.random.default_rng(seed)
    disparity = rng.integers(0, 12, (height, width)).astype(np.float32) / 4
    disparity[rng.random((height, width)) < holes] = np.nan
    expected = median_of_nine(disparity, backend="numpy")
    assert expected.dtype == np.float32
    np.testing.assert_array_equal(median_of_nine(disparity), expected)
    assert not np.any(np.isnan(expected) & ~np.isnan(disparity))


def test_median_of_nine_closes_a_hole_of_one_pixel_from_behind() -> None:
    disparity = np.array([[9, 9, 2], [9, np.nan, 2], [9, np.nan, 2]], np.float32)
    assert median_of_nine(disparity)[1, 1] == 2  # seven neighbours, four of them near
    disparity[:, 0] = np.nan
    assert np.isnan(median_of_nine(disparity)[1, 1])  # four neighbours


def test_median_of_nine_is_opencvs_where_there_are_no_holes() -> None:
    disparity = np.random.default_rng(0).random((20, 30)).astype(np.float32)
    np.testing.assert_array_equal(median_of_nine(disparity)[1:-1, 1:-1], cv2.medianBlur(disparity, 3)[1:-1, 1:-1])
