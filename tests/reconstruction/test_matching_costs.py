"""Matching costs and the census transform: the kernels are the formulas, the formulas are what the papers say."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

from stereocal.base.errors import InputError
from stereocal.reconstruction.census import census_transform, match_census, neighbours
from stereocal.reconstruction.matching_costs import (
    COST_MAX,
    RECIPES,
    PixelCost,
    cost_rows,
    cost_volume,
    lanes_for,
    prepare_pair,
)

cv2 = pytest.importorskip("cv2")


@settings(max_examples=25)
@given(
    seed=seeds,
    height=st.integers(1, 12),
    width=st.integers(1, 80),
    window=st.sampled_from([(3, 3), (5, 5), (7, 5), (1, 3), (9, 7), (5, 13)]),
    threshold=st.integers(0, 40),
    sparse=st.booleans(),
)
def test_census_kernel_is_its_reference(seed, height, width, window, threshold, sparse) -> None:
    image = np.random.default_rng(seed).integers(0, 256, (height, width)).astype(np.uint8)
    options = {"window": window, "threshold": threshold, "sparse": sparse and window != (1, 3)}
    expected = census_transform(image, **options, backend="numpy")
    assert expected.dtype == np.uint64
    np.testing.assert_array_equal(census_transform(image, **options), expected)


def test_census_by_hand() -> None:
    image = np.array([[9, 1, 5], [7, 5, 4], [6, 5, 0]], np.uint8)
    #                 bit 0..7:  9<5 1<5 5<5 7<5 4<5 6<5 5<5 0<5
    assert census_transform(image, window=(3, 3))[1, 1] == 0b10010010
    assert census_transform(image, window=(3, 3), threshold=1)[1, 1] == 0b10000010


def test_a_sparse_code_takes_the_black_squares() -> None:
    places = neighbours((9, 5), sparse=True)
    assert len(places) == 22
    assert all((v + u) % 2 == 0 for v, u in places)
    image = np.zeros((5, 9), np.uint8)
    image[2, 4] = 9  # brighter than all its neighbours
    assert int(np.bitwise_count(census_transform(image, window=(9, 5), sparse=True))[2, 4]) == 22
    image[2, 3] = 9  # a white square: not looked at
    assert int(np.bitwise_count(census_transform(image, window=(9, 5), sparse=True))[2, 4]) == 22


@settings(max_examples=15)
@given(seed=seeds)
def test_census_does_not_see_exposure(seed) -> None:
    """Any map of grey values that keeps their order leaves the codes as they are."""
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 100, (12, 17)).astype(np.uint8)
    curve = np.sort(rng.choice(256, 100, replace=False)).astype(np.uint8)
    np.testing.assert_array_equal(census_transform(curve[image]), census_transform(image))


@settings(max_examples=60)
@given(
    seed=seeds,
    shape=st.tuples(st.integers(1, 12), st.integers(1, 70)),
    count=st.integers(1, 70),
    lowest=st.integers(-20, 20),
    block_size=st.sampled_from([1, 3, 5, 9]),
    cost=st.sampled_from(list(RECIPES)),
    scaled=st.booleans(),
)
def test_cost_kernel_is_its_reference(seed, shape, count, lowest, block_size, cost, scaled) -> None:
    rng = np.random.default_rng(seed)
    left, right = rng.integers(0, 256, (2, *shape)).astype(np.uint8)
    recipe = RECIPES[cost]
    search = {"num_disparities": count, "recipe": recipe}
    pair = prepare_pair(left, right, min_disparity=lowest, **search)
    first, last = sorted(rng.integers(0, shape[0] + 1, 2))
    kind = np.uint8 if scaled else np.uint16
    out = np.zeros((last - first, shape[1], pair.lanes), kind)
    cost_rows(pair, (first, last), out, block_size=block_size, **search)
    expected = cost_volume(left, right, min_disparity=lowest, block_size=block_size, scaled=scaled, **search)
    np.testing.assert_array_equal(out[..., :count], expected[first:last])
    assert np.all(out[..., count:] == np.iinfo(kind).max)
    if scaled:
        assert out[..., :count].size == 0 or out[..., :count].max() <= COST_MAX


@settings(max_examples=10)
@given(seed=seeds, block_size=st.sampled_from([3, 5]))
def test_plain_differences_are_opencvs(seed, block_size) -> None:
    """The oracle: absdiff cut off at the cap, then an unnormalised box filter, where all candidates exist."""
    rng = np.random.default_rng(seed)
    left, right = rng.integers(0, 256, (2, 20, 40)).astype(np.uint8)
    recipe, D, r = RECIPES["sad"], 8, block_size // 2
    sums = cost_volume(
        left, right, num_disparities=D, min_disparity=0, recipe=recipe, block_size=block_size, scaled=False
    )
    for d in range(D):
        difference = np.minimum(cv2.absdiff(left[:, d:], right[:, : 40 - d]), recipe.cap)
        box = cv2.boxFilter(
            difference, cv2.CV_32S, (block_size, block_size), normalize=False, borderType=cv2.BORDER_REPLICATE
        )
        np.testing.assert_array_equal(sums[:, d + r :, d], box[:, r:])


def test_birchfield_tomasi_forgives_half_a_pixel() -> None:
    """A ramp seen half a pixel further on costs nothing; its plain difference is half the ramp's slope."""
    x = np.arange(40.0)
    left = np.tile(4 * x, (5, 1)).astype(np.uint8)
    right = np.tile(4 * (x + 0.5), (5, 1)).astype(np.uint8)
    volumes = [
        cost_volume(left, right, num_disparities=1, min_disparity=0, recipe=recipe, block_size=1, scaled=False)
        for recipe in (PixelCost(False, 40, True), PixelCost(False, 40, False))
    ]
    assert np.all(volumes[0][:, 1:-1] == 0)
    assert np.all(volumes[1] == 2)


def test_lanes_hold_all_disparities() -> None:
    for count in range(1, 300):
        assert lanes_for(count) >= count
        assert lanes_for(count) % 16 == 0


@settings(max_examples=40)
@given(
    seed=seeds,
    shape=st.tuples(st.integers(1, 12), st.integers(1, 40)),
    count=st.integers(1, 40),
    lowest=st.integers(-12, 12),
    block_size=st.sampled_from([1, 5, 9]),
    tolerance=st.sampled_from([None, 0, 1, 3]),
    uniqueness=st.sampled_from([0, 5, 40]),
    subpixel=st.booleans(),
    coarse=st.booleans(),
)
def test_match_census_kernel_is_its_reference(
    seed, shape, count, lowest, block_size, tolerance, uniqueness, subpixel, coarse
) -> None:
    rng = np.random.default_rng(seed)
    scene = rng.integers(0, 256, (shape[0], shape[1] + 9)).astype(np.uint8)
    if coarse:  # many ties
        scene = scene // 100 * 100
    left, right = scene[:, : shape[1]], scene[:, 4 : 4 + shape[1]]
    options = {
        "num_disparities": count,
        "min_disparity": lowest,
        "block_size": block_size,
        "left_right_check": tolerance,
        "uniqueness_ratio": uniqueness,
        "subpixel": subpixel,
    }
    expected = match_census(left, right, **options, backend="numpy")
    result = match_census(left, right, **options, threads=int(rng.integers(1, 4)))
    assert result.dtype == np.float32
    np.testing.assert_array_equal(result, expected)


@pytest.mark.parametrize("shift", [-6, 0, 11])
def test_a_constant_shift_is_found_through_another_exposure(shift) -> None:
    rng = np.random.default_rng(2)
    scene = rng.integers(0, 200, (40, 160)).astype(np.uint8)
    left, right = scene[:, 20:140], (scene[:, 20 + shift : 140 + shift] * 0.6 + 30).astype(np.uint8)
    d = match_census(left, right, num_disparities=32, min_disparity=-10, subpixel=False)
    known = np.isfinite(d)
    seen = np.zeros(d.shape, bool)
    seen[:, max(shift, 0) + 6 : 120 + min(shift, 0) - 6] = True
    assert known[seen].mean() > 0.999
    assert np.all(d[seen & known] == shift)


def test_bad_input_is_named() -> None:
    image = np.zeros((20, 20), np.uint8)
    with pytest.raises(InputError, match="uint8"):
        census_transform(image.astype(np.float32))
    with pytest.raises(InputError, match="window must hold 2 to 65"):
        census_transform(image, window=(9, 9))
    with pytest.raises(InputError, match="odd"):
        match_census(image, image, window=(4, 5))
    with pytest.raises(InputError, match="width, height"):
        match_census(image, image, window=5)
    with pytest.raises(InputError, match="one size"):
        match_census(image, image[:, :5])
    with pytest.raises(InputError, match="smaller block"):
        match_census(image, image, block_size=75)
    with pytest.raises(InputError, match="uniqueness_ratio"):
        match_census(image, image, uniqueness_ratio=100)
