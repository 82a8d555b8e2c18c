"""The speckle filter: graph = runs = OpenCV, and what the paper's pseudo-code does instead."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

from stereocal.base.errors import InputError
from stereocal.reconstruction.speckles import filter_speckles, filter_speckles_as_printed, speckle_sizes

NONE = -16

maps = st.tuples(
    seeds, st.integers(1, 40), st.integers(1, 200), st.sampled_from([2, 3, 5, 30]), st.sampled_from([0.0, 0.2, 0.6])
)


def sixteenths(seed: int, height: int, width: int, levels: int, holes: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    disparity = (16 * rng.integers(0, levels, (height, width))).astype(np.int16)
    disparity[rng.random((height, width)) < holes] = NONE
    return disparity


def opencv_filter(disparity: np.ndarray, none: int, max_size: int, max_difference: float) -> np.ndarray:
    filtered = disparity.copy()
    cv2.filterSpeckles(filtered, none, max_size, max_difference)
    return filtered


@settings(max_examples=100)
@given(
    drawn=maps, max_size=st.sampled_from([0, 1, 2, 7, 40, 1000]), max_difference=st.sampled_from([0, 1, 16, 32, 500])
)
def test_equals_opencv_on_integers_and_floats(drawn, max_size, max_difference) -> None:
    disparity = sixteenths(*drawn)
    expected = opencv_filter(disparity, NONE, max_size, max_difference)
    for backend in ("numba", "numpy"):
        ours = filter_speckles(
            disparity, max_size=max_size, max_difference=max_difference, no_disparity=NONE, backend=backend
        )
        assert ours.dtype == np.int16
        np.testing.assert_array_equal(ours, expected)
        for kind in (np.float32, np.float64):
            pixels = np.where(disparity == NONE, np.nan, disparity / 16).astype(kind)
            ours = filter_speckles(pixels, max_size=max_size, max_difference=max_difference / 16, backend=backend)
            assert ours.dtype == kind
            np.testing.assert_array_equal(ours, np.where(expected == NONE, np.nan, expected / 16))


@settings(max_examples=30)
@given(seed=seeds, none=st.integers(0, 255), max_difference=st.integers(0, 255))
def test_bytes_and_extremes(seed, none, max_difference) -> None:
    rng = np.random.default_rng(seed)
    small = rng.integers(0, 256, (20, 70)).astype(np.uint8)
    np.testing.assert_array_equal(
        filter_speckles(small, max_size=5, max_difference=max_difference, no_disparity=none),
        opencv_filter(small, none, 5, max_difference),
    )
    large = rng.integers(-32768, 32768, (20, 70)).astype(np.int16)  # differences beyond 16 bits
    np.testing.assert_array_equal(
        filter_speckles(large, max_size=5, max_difference=30000, no_disparity=none),
        opencv_filter(large, none, 5, 30000),
    )


@settings(max_examples=20)
@given(drawn=maps, max_difference=st.sampled_from([0.5, 1.5, 1.9, 2.5, 16.4]))
def test_a_fraction_is_rounded_on_integer_maps_as_in_opencv(drawn, max_difference) -> None:
    disparity = sixteenths(*drawn)
    expected = opencv_filter(disparity, NONE, 7, max_difference)
    for backend in ("numba", "numpy"):
        ours = filter_speckles(disparity, max_size=7, max_difference=max_difference, no_disparity=NONE, backend=backend)
        np.testing.assert_array_equal(ours, expected)


@settings(max_examples=30)
@given(drawn=maps, max_difference=st.sampled_from([0, 16]))
def test_sizes_serve_every_threshold(drawn, max_difference) -> None:
    disparity = sixteenths(*drawn)
    sizes = speckle_sizes(disparity, max_difference, no_disparity=NONE)
    np.testing.assert_array_equal(sizes, speckle_sizes(disparity, max_difference, no_disparity=NONE, backend="numpy"))
    for max_size in (1, 5, 50):
        removed = np.where((sizes > 0) & (sizes <= max_size), NONE, disparity)
        np.testing.assert_array_equal(removed, opencv_filter(disparity, NONE, max_size, max_difference))


def test_plain_kernel_equals_runs() -> None:
    from stereocal.reconstruction import speckles_kernels as kernels

    disparity = sixteenths(7, 60, 300, 4, 0.3)
    plain = np.zeros(disparity.size, np.int32)
    kernels.component_sizes(disparity, disparity != NONE, 16, np.empty(disparity.size, np.int32), plain)
    np.testing.assert_array_equal(plain.reshape(disparity.shape), speckle_sizes(disparity, 16, no_disparity=NONE))


@pytest.mark.parametrize("width", [1, 63, 64, 65, 128, 130])
def test_one_component_across_words(width) -> None:
    """A serpent, joined to itself at alternating ends, is ONE component over all 64-bit words."""
    disparity = np.full((9, width), np.nan, np.float32)
    disparity[::2] = 5
    for i, row in enumerate(range(1, 9, 2)):
        disparity[row, 0 if i % 2 else -1] = 5
    length = int(np.isfinite(disparity).sum())
    assert np.isfinite(filter_speckles(disparity, max_size=length - 1, max_difference=0)).sum() == length
    assert np.isnan(filter_speckles(disparity, max_size=length, max_difference=0)).all()


def test_a_slope_is_one_component() -> None:
    slope = np.tile(np.arange(100, dtype=np.float32) / 2, (3, 1))
    assert np.all(speckle_sizes(slope, 0.5) == 300)
    assert np.all(speckle_sizes(slope, 0.49) == 3)


def test_input_is_left_alone() -> None:
    disparity = np.ones((3, 3), np.float32)
    filter_speckles(disparity, max_size=100, max_difference=1)
    assert np.all(disparity == 1)


@pytest.mark.parametrize("none", [NONE, 0])
def test_pseudo_code_as_printed_removes_nothing(none) -> None:
    """Isolated pixels, the noise the filter is for, stay; and two maps whose islands differ are treated alike."""
    disparity = np.full((20, 20), none, np.int16)
    disparity[2:12, 2:12] = 160  # an island of 100 pixels
    disparity[15, 15] = 400  # and a speckle
    printed = filter_speckles_as_printed(disparity, no_disparity=none, min_difference=16)
    np.testing.assert_array_equal(printed, disparity)
    corrected = filter_speckles(disparity, max_size=50, max_difference=16, no_disparity=none)
    assert corrected[15, 15] == none
    assert np.all(corrected[2:12, 2:12] == 160)


def test_pseudo_code_as_printed_depends_on_the_marker_alone() -> None:
    """Where it does remove, with nVal ABOVE the disparities, it takes whole surfaces and leaves speckles."""
    disparity = np.full((20, 20), 1000, np.int16)
    disparity[2:12, 2:12] = 160
    disparity[15, 15] = 400
    printed = filter_speckles_as_printed(disparity, no_disparity=1000, min_difference=16)
    assert np.mean(printed[2:12, 2:12] == 1000) > 0.5
    assert printed[15, 15] == 400


@pytest.mark.parametrize(
    ("disparity", "options", "message"),
    [
        (np.zeros((2, 2), np.int16), {}, "has no NaN"),
        (np.zeros((2, 2), np.int16), {"no_disparity": 70000}, "cannot hold"),
        (np.zeros((2, 2), np.int8), {}, "must be float32"),
        (np.zeros(4, np.float32), {}, "shape"),
        (np.zeros((2, 2), np.float32), {"max_difference": -1}, "0 or more"),
        (np.zeros((2, 2), np.float32), {"max_size": -1}, "max_size"),
    ],
)
def test_bad_input_has_its_sentence(disparity, options, message) -> None:
    with pytest.raises(InputError, match=message):
        filter_speckles(disparity, **({"max_size": 5, "max_difference": 1} | options))
