"""The paper's SAD: equation = kernels = absdiff with a box filter, and what a shifted texture must give."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from strategies import seeds

from stereocal.base.errors import InputError
from stereocal.reconstruction import sliding_window
from stereocal.reconstruction.sad import match_sad, matched_region, sad_volume


def sad_by_opencv(left: np.ndarray, right: np.ndarray, count: int, first: int, block_size: int) -> np.ndarray:
    """cv2.absdiff and an unnormalised box at every disparity, the smallest; the larger disparity wins a tie."""
    columns, rows = matched_region(left.shape, count, first, block_size // 2)
    found = np.full(left.shape, np.nan, np.float32)
    if not len(columns) or not len(rows):
        return found
    sums = []
    for d in range(first + count - 1, first - 1, -1):
        moved = np.zeros_like(right)
        moved[:, max(d, 0) : right.shape[1] + min(d, 0)] = right[:, max(-d, 0) : right.shape[1] - max(d, 0)]
        sums.append(cv2.boxFilter(cv2.absdiff(left, moved), cv2.CV_32S, (block_size, block_size), normalize=False))
    best = first + count - 1 - np.argmin(sums, axis=0)
    inner = np.s_[rows.start : rows.stop, columns.start : columns.stop]
    found[inner] = best[inner]
    return found


searches = st.fixed_dictionaries(
    {
        "num_disparities": st.integers(1, 40),
        "min_disparity": st.integers(-30, 30),
        "block_size": st.integers(0, 7).map(lambda r: 2 * r + 1),
    }
)


@settings(max_examples=60)
@given(
    seed=seeds,
    levels=st.sampled_from([4, 256]),
    size=st.tuples(st.integers(15, 40), st.integers(15, 90)),
    search=searches,
)
def test_equation_equals_kernel_equals_opencv(seed, levels, size, search) -> None:
    left, right = np.random.default_rng(seed).integers(0, levels, (2, *size)).astype(np.uint8)
    ours = match_sad(left, right, **search)
    np.testing.assert_array_equal(ours, match_sad(left, right, backend="numpy", **search))
    theirs = sad_by_opencv(left, right, search["num_disparities"], search["min_disparity"], search["block_size"])
    np.testing.assert_array_equal(ours, theirs)


@settings(max_examples=40)
@given(
    seed=seeds,
    search=searches,
    subpixel=st.booleans(),
    check=st.sampled_from([None, 0, 1, 5]),
    threads=st.integers(1, 3),
)
def test_options_equal_the_reference(seed, search, subpixel, check, threads) -> None:
    left, right = np.random.default_rng(seed).integers(0, 20, (2, 24, 80)).astype(np.uint8)
    options = search | {"subpixel": subpixel, "left_right_check": check}
    np.testing.assert_array_equal(
        match_sad(left, right, threads=threads, **options), match_sad(left, right, backend="numpy", **options)
    )


@pytest.mark.parametrize("check", [None, 1])
def test_plain_loops_equal_vectors(check, monkeypatch) -> None:
    left, right = np.random.default_rng(3).integers(0, 256, (2, 60, 150)).astype(np.uint8)
    cases = [{"num_disparities": d, "block_size": b} for d, b in [(1, 1), (37, 15), (37, 17), (64, 31)]]
    by_vectors = [match_sad(left, right, left_right_check=check, subpixel=True, **case) for case in cases]
    monkeypatch.setattr(sliding_window, "MOST_LANES", 0)
    for case, expected in zip(cases, by_vectors, strict=True):
        np.testing.assert_array_equal(match_sad(left, right, left_right_check=check, subpixel=True, **case), expected)


def test_sums_down_a_column_that_outgrow_16_bits() -> None:
    left, right = np.full((310, 330), 255, np.uint8), np.zeros((310, 330), np.uint8)
    left[:, ::7], right[:, ::5] = 3, 200  # 301 rows of nearly 255
    options = {"num_disparities": 4, "block_size": 301}
    np.testing.assert_array_equal(match_sad(left, right, **options), match_sad(left, right, backend="numpy", **options))


def test_volume_is_the_equation() -> None:
    """[eq 22] with its sums written out, at one pixel and one disparity."""
    left, right = np.random.default_rng(0).integers(0, 256, (2, 20, 40)).astype(np.uint8)
    columns, rows = matched_region(left.shape, 8, -3, 2)
    x, y, d = columns.start + 4, rows.start + 2, -1
    expected = sum(
        abs(int(left[y + j, x + i]) - int(right[y + j, x + i - d])) for i in range(-2, 3) for j in range(-2, 3)
    )
    volume = sad_volume(left, right, 8, -3, 5)
    assert volume[d + 3, y - rows.start, x - columns.start] == expected


@pytest.mark.parametrize("shift", [-6, 0, 9])
def test_finds_a_shift_of_either_sign(shift) -> None:
    rng = np.random.default_rng(1)
    texture = rng.integers(0, 256, (40, 140)).astype(np.uint8)
    left, right = texture[:, 20:120], texture[:, 20 + shift : 120 + shift]
    found = match_sad(left, right, num_disparities=24, min_disparity=-10, block_size=7, left_right_check=0)
    columns, rows = matched_region(left.shape, 24, -10, 3)
    assert np.all(found[rows.start : rows.stop, columns.start : columns.stop] == shift)
    assert np.isfinite(found).sum() == len(rows) * len(columns)


def test_parabola_halves_the_error_of_a_fractional_shift() -> None:
    wide = gaussian_filter(np.random.default_rng(2).standard_normal((60, 300)), 2)
    x = np.arange(30, 270)
    left = np.stack([np.interp(x, np.arange(300), row) for row in wide])
    right = np.stack([np.interp(x + 5.3, np.arange(300), row) for row in wide])  # seen 5.3 px further left
    low, high = wide.min(), wide.max()
    pair = [np.round(255 * (image - low) / (high - low)).astype(np.uint8) for image in (left, right)]
    whole = match_sad(*pair, num_disparities=16, block_size=11)
    fine = match_sad(*pair, num_disparities=16, block_size=11, subpixel=True)
    assert np.nanmedian(np.abs(fine - 5.3)) < 0.5 * np.nanmedian(np.abs(whole - 5.3))


def test_left_right_check_removes_what_one_camera_sees() -> None:
    """A strip in front hides background beside it: without the check those pixels get an answer, with it few do."""
    rng = np.random.default_rng(4)
    texture = rng.integers(0, 256, (60, 200)).astype(np.uint8)
    strip = rng.integers(0, 256, (60, 30)).astype(np.uint8)
    left, right = texture.copy(), texture.copy()
    left[:, 100:130] = strip  # disparity 12 in front of a background at 0
    right[:, 88:118] = strip
    hidden = np.s_[8:-8, 92:97]  # of the left image: behind the strip in the right one
    free = match_sad(left, right, num_disparities=16, block_size=5)
    checked = match_sad(left, right, num_disparities=16, block_size=5, left_right_check=1)
    assert np.isfinite(free[hidden]).all()
    assert np.isfinite(checked[hidden]).mean() < 0.1
    assert np.all(checked[8:-8, 40:80] == 0)


def test_bad_input_has_its_sentence() -> None:
    image = np.zeros((20, 30), np.uint8)
    with pytest.raises(InputError, match="must fit"):
        match_sad(image, image, block_size=21)
    with pytest.raises(InputError, match="odd"):
        match_sad(image, image, block_size=4)
    with pytest.raises(InputError, match="one size"):
        match_sad(image, image[:-1], block_size=5)
    with pytest.raises(InputError, match="8 bits"):
        match_sad(image.astype(np.float64), image, block_size=5)
    with pytest.raises(InputError, match=r"right must be a uint8 image .* read_image"):
        match_sad(image, "right.png", block_size=5)
