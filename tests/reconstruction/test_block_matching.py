"""StereoBM's recipe: reference = kernels = OpenCV, bit for bit; and where OpenCV is at fault, who is right."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from strategies import seeds

from stereocal.base.errors import InputError
from stereocal.reconstruction import sliding_window
from stereocal.reconstruction.block_matching import match_bm, prefilter_image, valid_region


def make_pair(seed: int, height: int, width: int, kind: str = "texture", shift: int = 7) -> tuple[Any, Any]:
    """A pair: pure noise, texture shifted with noise, the same in few grey values (ties), or half of it blank."""
    rng = np.random.default_rng(seed)
    if kind == "noise":
        return tuple(rng.integers(0, 256, (2, height, width)).astype(np.uint8))
    texture = gaussian_filter(rng.standard_normal((height, width + shift)), 1.2)
    texture = 255 * (texture - texture.min()) / np.ptp(texture)
    left, right = texture[:, :width], texture[:, shift:] + rng.normal(0, 2, (height, width))
    pair = [np.clip(image, 0, 255).astype(np.uint8) for image in (left, right)]
    if kind == "ties":
        pair = [image // 40 * 40 for image in pair]
    if kind == "blank":
        pair[0][:, : width // 2] = 17
    return pair[0], pair[1]


def opencv_bm(left: Any, right: Any, options: dict[str, Any], *, mend: bool = True) -> np.ndarray:
    """cv2.StereoBM on a buffer of "none", with NaN for none; `mend` undoes the overrun of min_disparity > 0."""
    matcher = cv2.StereoBM.create(options["num_disparities"], options["block_size"])
    first = options.get("min_disparity", 0)
    matcher.setMinDisparity(first)
    matcher.setPreFilterType(1 if options.get("prefilter", "xsobel") == "xsobel" else 0)
    matcher.setPreFilterSize(options.get("prefilter_size", 9))
    matcher.setPreFilterCap(options.get("prefilter_cap", 31))
    matcher.setTextureThreshold(options.get("texture_threshold", 10))
    matcher.setUniquenessRatio(options.get("uniqueness_ratio", 15))
    matcher.setDisp12MaxDiff(options.get("disp12_max_diff", -1))
    speckles = options.get("speckle_size", 0), options.get("speckle_range", 0)
    overrun = mend and first > 0
    if not overrun:
        matcher.setSpeckleWindowSize(speckles[0])
        matcher.setSpeckleRange(speckles[1])
    for name in ("roi1", "roi2"):
        if options.get(name) is not None:
            getattr(matcher, f"set{name.upper()}")(options[name])
    none = (first - 1) * 16
    found = np.full(left.shape, none, np.int16)
    matcher.compute(left, right, found)
    if overrun:
        columns, rows = valid_region(
            left.shape,
            options["num_disparities"],
            first,
            options["block_size"],
            options.get("roi1"),
            options.get("roi2"),
        )
        if len(columns) and len(rows):
            found[rows.stop, :first] = none
        if speckles[0] > 0 and speckles[1] >= 0:
            cv2.filterSpeckles(found, none, *speckles)
    return np.where(found == none, np.nan, found / 16).astype(np.float32)


regions = st.one_of(
    st.none(), st.tuples(st.integers(0, 60), st.integers(0, 20), st.integers(1, 200), st.integers(1, 60))
)
options_of_bm = st.fixed_dictionaries(
    {
        "num_disparities": st.one_of(st.sampled_from([16, 32, 48, 64]), st.integers(1, 16).map(lambda n: 16 * n)),
        "min_disparity": st.one_of(st.just(0), st.integers(-70, 40)),
        "block_size": st.integers(2, 40).map(lambda r: 2 * r + 1),
        "prefilter": st.sampled_from(["xsobel", "normalized_response"]),
        "prefilter_size": st.integers(2, 15).map(lambda r: 2 * r + 1),
        "prefilter_cap": st.integers(1, 63),
        "texture_threshold": st.sampled_from([0, 10, 400, 5000]),
        "uniqueness_ratio": st.sampled_from([0, 1, 5, 15, 60, 300]),
        "speckle_size": st.sampled_from([0, 5, 50]),
        "speckle_range": st.sampled_from([-1, 0, 1, 16, 32]),
        "roi1": regions,
        "roi2": regions,
    }
)


@settings(max_examples=120, suppress_health_check=[HealthCheck.filter_too_much])
@given(
    seed=seeds,
    kind=st.sampled_from(["noise", "texture", "ties", "blank"]),
    size=st.tuples(st.integers(16, 90), st.integers(40, 330)),
    options=options_of_bm,
    threads=st.integers(1, 3),
)
def test_equals_opencv_bit_for_bit(seed, kind, size, options, threads) -> None:
    assume(options["block_size"] < min(size))
    for name in ("roi1", "roi2"):  # OpenCV does not check that a region lies in the image
        if options[name] is not None:
            x, y, w, h = options[name]
            assume(x + w <= size[1] and y + h <= size[0])
    left, right = make_pair(seed, *size, kind)
    np.testing.assert_array_equal(match_bm(left, right, threads=threads, **options), opencv_bm(left, right, options))


@settings(max_examples=25)
@given(
    seed=seeds,
    kind=st.sampled_from(["noise", "texture", "ties", "blank"]),
    size=st.tuples(st.integers(20, 40), st.integers(40, 120)),
    options=options_of_bm,
    cross_check=st.integers(-1, 3),
)
def test_reference_equals_kernels(seed, kind, size, options, cross_check) -> None:
    options = options | {"block_size": min(options["block_size"], 15), "disp12_max_diff": cross_check}
    left, right = make_pair(seed, *size, kind)
    np.testing.assert_array_equal(match_bm(left, right, **options), match_bm(left, right, backend="numpy", **options))


@pytest.mark.parametrize("block_size", [101, 255])
@pytest.mark.parametrize("num_disparities", [16, 80, 256])
def test_large_windows_and_wide_searches(block_size, num_disparities) -> None:
    left, right = make_pair(3, 270, 600)
    options = {"num_disparities": num_disparities, "block_size": block_size, "prefilter_cap": 63}
    np.testing.assert_array_equal(match_bm(left, right, **options), opencv_bm(left, right, options))


@settings(max_examples=25)
@given(
    seed=seeds, cross_check=st.integers(0, 4), block_size=st.sampled_from([5, 9, 15, 21]), first=st.integers(-40, 20)
)
def test_cross_check_equals_opencv_where_opencv_repeats_itself(seed, cross_check, block_size, first) -> None:
    left, right = make_pair(seed, 50, 160, "ties")
    options = {
        "num_disparities": 32, "block_size": block_size, "disp12_max_diff": cross_check, "min_disparity": first,
        "uniqueness_ratio": 0,
    }  # fmt: skip
    np.testing.assert_array_equal(match_bm(left, right, **options), opencv_bm(left, right, options))


def test_plain_loops_equal_vectors(monkeypatch) -> None:
    cases = [
        {"num_disparities": d, "block_size": b, "prefilter_cap": c, "disp12_max_diff": x}
        for d, b, c, x in [(16, 5, 31, -1), (80, 21, 31, 1), (64, 47, 63, -1), (256, 9, 63, 0)]
    ]
    left, right = make_pair(5, 70, 400)
    by_vectors = [match_bm(left, right, **options) for options in cases]
    monkeypatch.setattr(sliding_window, "MOST_LANES", 0)
    for options, expected in zip(cases, by_vectors, strict=True):
        np.testing.assert_array_equal(match_bm(left, right, **options), expected)


def test_sums_that_outgrow_16_bits_midway() -> None:
    """The kernel tries 16 bits, sees a sum come near their end in the lower part, and hands the rest over to 32."""
    calm = gaussian_filter(np.random.default_rng(0).standard_normal((240, 300)), 4)
    left = np.clip(128 + 6 * calm / calm.std(), 0, 255).astype(np.uint8)
    right = np.roll(left, -7, axis=1)
    left[150:] = np.where(np.arange(300) % 4 < 2, 0, 255)  # of period 4, and the right image by half of that apart
    right[150:] = np.roll(left[150:], 2, axis=1)
    filtered = [prefilter_image(image) for image in (left, right)]
    assert sliding_window._sums_may_fit(filtered[0], 62, 41)
    differences = np.abs(np.diff([image[160:201, 100:141].astype(int) for image in filtered], axis=0))
    assert differences.sum() > 65535
    options = {"num_disparities": 32, "block_size": 41, "uniqueness_ratio": 0}
    np.testing.assert_array_equal(match_bm(left, right, threads=1, **options), opencv_bm(left, right, options))


@settings(max_examples=200)
@given(
    least=st.integers(0, 65534), beside=st.tuples(st.integers(0, 65534), st.integers(0, 65534)),
    k=st.integers(-1, 63), d_max=st.integers(-2100, 2600),
)  # fmt: skip
def test_refinement_in_float32_equals_that_in_float64(least, beside, k, d_max) -> None:
    from stereocal.reconstruction.sliding_window_kernels import refined_opencv

    below, above = (max(least, value) for value in beside)
    exact = refined_opencv(k, float(below), float(least), float(above), d_max, 64)
    narrow = refined_opencv(k, np.float32(below), np.float32(least), np.float32(above), d_max, 64)
    np.testing.assert_array_equal(narrow, exact)


def test_readable_path_without_numba() -> None:
    """NUMBA_DISABLE_JIT=1 runs the loops as Python, for coverage, with the same answer."""
    script = (
        "import numpy as np, stereocal as sc;"
        "rng = np.random.default_rng(0); left, right = rng.integers(0, 256, (2, 16, 40)).astype(np.uint8);"
        "found = sc.match_bm(left, right, num_disparities=16, block_size=5, uniqueness_ratio=0, speckle_size=3,"
        " speckle_range=16, disp12_max_diff=2);"
        "print(np.nansum(found), np.isfinite(found).sum(), np.nansum(sc.match_sad(left, right, num_disparities=9,"
        " block_size=3, left_right_check=1)))"
    )
    printed = [
        subprocess.run(
            [sys.executable, "-c", script], env=os.environ | extra, capture_output=True, text=True, check=True
        ).stdout
        for extra in ({"NUMBA_DISABLE_JIT": "1"}, {"NUMBA_DISABLE_JIT": "0"})
    ]
    assert printed[0] == printed[1]
    assert "nan" not in printed[0]


def test_result_does_not_depend_on_threads() -> None:
    left, right = make_pair(8, 200, 300)
    one = match_bm(left, right, num_disparities=64, block_size=11, disp12_max_diff=1, threads=1)
    for threads in (2, 3, 7):
        many = match_bm(left, right, num_disparities=64, block_size=11, disp12_max_diff=1, threads=threads)
        np.testing.assert_array_equal(one, many)


def test_shift_is_found() -> None:
    """Physics, without an oracle: a texture moved by 7 pixels has disparity 7 everywhere in the region."""
    left, right = make_pair(9, 60, 200, shift=7)
    found = match_bm(left, right, num_disparities=16, block_size=15)
    columns, rows = valid_region(left.shape, 16, 0, 15)
    inner = found[rows.start : rows.stop, columns.start : columns.stop]
    # not all: the uniqueness test may reject; what is there is right
    assert np.isfinite(inner).mean() > 0.99
    assert np.nanmax(np.abs(inner - 7)) < 0.5
    assert np.isfinite(found).sum() == np.isfinite(inner).sum()


# Where OpenCV is at fault


def test_opencv_disagrees_with_itself_in_the_cross_check() -> None:
    """32-bit costs are stored in a matrix of 16-bit numbers: with cap > 31 (or a window above 21) what was matched
    BEFORE changes the answer. Ours repeats itself."""

    def smooth(seed: int) -> np.ndarray:
        image = gaussian_filter(np.random.default_rng(seed).standard_normal((480, 640)), 3)
        return (255 * (image - image.min()) / np.ptp(image)).astype(np.uint8)

    left = smooth(1)
    noise = np.random.default_rng(5).integers(-20, 20, left.shape)
    right = np.clip(np.roll(left, -7, axis=1) + noise, 0, 255).astype(np.uint8)
    options = {"num_disparities": 64, "block_size": 5, "prefilter_cap": 63, "uniqueness_ratio": 5, "disp12_max_diff": 1}

    def after(others: list[tuple[Any, Any]]) -> np.ndarray:
        matcher = cv2.StereoBM.create(64, 5)
        matcher.setPreFilterCap(63)
        matcher.setUniquenessRatio(5)
        matcher.setDisp12MaxDiff(1)
        for other in others:
            matcher.compute(*other)
        return matcher.compute(left, right).copy()

    others = [(smooth(3), smooth(4)), (smooth(5), smooth(6))]
    theirs = [after([(left, right)]), after(others), after([])]
    assert any(np.any(theirs[0] != other) for other in theirs[1:])
    ours = []
    for other in others:
        match_bm(*other, **options)
        ours.append(match_bm(left, right, **options))
    np.testing.assert_array_equal(ours[0], ours[1])


def test_opencv_overruns_its_rows_when_the_least_disparity_is_positive() -> None:
    """The first min_disparity pixels of the row below the region hold disparities. They cannot be: each candidate
    x − d of those pixels lies left of the right image."""
    left, right = make_pair(4, 60, 200, "noise")
    options = {"num_disparities": 16, "min_disparity": 8, "block_size": 5, "uniqueness_ratio": 0}
    raw = opencv_bm(left, right, options, mend=False)
    ours = match_bm(left, right, **options)
    differ = np.argwhere(~((raw == ours) | (np.isnan(raw) & np.isnan(ours))))
    _, rows = valid_region(left.shape, 16, 8, 5)
    assert len(differ) > 0
    assert set(differ[:, 0]) == {rows.stop}
    assert differ[:, 1].max() < 8  # x < min_disparity: x − d < 0 for every d
    assert np.isnan(ours[rows.stop]).all()


def test_opencv_leaves_its_output_unwritten_where_no_pixel_can_be_matched() -> None:
    left, right = make_pair(5, 60, 270, "noise")
    untouched = np.full(left.shape, 7777, np.int16)
    cv2.StereoBM.create(256, 21).compute(left, right, untouched)  # 255 + 10 columns on the left, 10 on the right
    assert (untouched == 7777).all()
    assert np.isnan(match_bm(left, right, num_disparities=256, block_size=21)).all()


def test_normalized_response_is_blank_from_size_91_on() -> None:
    image = make_pair(6, 120, 160, "noise")[0]
    assert np.ptp(prefilter_image(image, "normalized_response", size=89)) > 0
    assert np.ptp(prefilter_image(image, "normalized_response", size=91)) == 0


# Bad input


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_disparities": 20}, "multiple of 16"),
        ({"block_size": 8}, "odd"),
        ({"block_size": 3}, "from 5 to 255"),
        ({"block_size": 61}, "block_size is 61, .* smaller than both sides"),
        ({"roi1": (1, 2)}, "roi1 must be"),
        ({"roi2": 7}, "roi2 must be"),
        ({"roi1": (0.5, 0, 90, 50)}, "roi1 must be a whole number"),
        ({"prefilter": "sobel"}, "one of xsobel"),
        ({"prefilter_cap": 64}, "prefilter_cap"),
        ({"texture_threshold": -1}, "texture_threshold"),
    ],
)
def test_bad_options_have_their_sentence(options, message) -> None:
    left, right = make_pair(0, 60, 100)
    with pytest.raises(InputError, match=message):
        match_bm(left, right, **options)


def test_bad_images_have_their_sentence() -> None:
    left, right = make_pair(0, 60, 100)
    with pytest.raises(InputError, match="one size"):
        match_bm(left, right[:, 1:])
    with pytest.raises(InputError, match="uint8"):
        match_bm(left.astype(np.uint16), right)


def test_colour_is_turned_to_grey() -> None:
    left, right = make_pair(0, 60, 200)
    colour = [np.repeat(image[..., None], 3, axis=2) for image in (left, right)]
    np.testing.assert_array_equal(match_bm(*colour), match_bm(left, right))


@pytest.mark.parametrize(("num_disparities", "block_size"), [(64, 9), (64, 21), (112, 51)])
def test_equals_opencv_on_photographs(data, num_disparities, block_size) -> None:
    pair = [cv2.imread(str(data / "motorcycle" / f"motorcycle_{side}.png"), 0) for side in ("left", "right")]
    options = {"num_disparities": num_disparities, "block_size": block_size, "speckle_size": 100, "speckle_range": 32}
    np.testing.assert_array_equal(match_bm(*pair, **options), opencv_bm(*pair, options))
