"""remap: reference = kernel = OpenCV 5.0, and what interpolation must do without any oracle."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

from stereocal.base.errors import InputError
from stereocal.camera.resampling import keys_weights, remap

EXACT_OPENCV = int(cv2.__version__.split(".")[0]) >= 5
TOP = {np.uint8: 255, np.uint16: 65535, np.float32: 1.0}


def channels_of(dtype: type, channels: int) -> int:
    """Each dtype and number of channels is compiled anew, a second each: two and four stand for all in uint8."""
    return channels if dtype == np.uint8 else min(channels, 3) | 1


def draw(seed: int, dtype: type, channels: int, *, grid: int | None = None):
    """Return an image and maps that leave it on all sides, with whole and half pixels among them."""
    random = np.random.default_rng(seed)
    height, width = random.integers(2, 40, 2)
    shape = (height, width) if channels == 1 else (height, width, channels)
    image = (random.random(shape) * TOP[dtype]).astype(dtype)
    size = tuple(random.integers(1, 50, 2))
    maps = [(random.random(size) * (side + 8) - 4).astype(np.float32) for side in (width, height)]
    for m in maps:
        m[::3] = np.round(2 * m[::3]) / 2
        if grid:
            m[...] = np.round(grid * m) / grid
    border = random.random() * TOP[dtype]
    return image, *maps, float(border if dtype is np.float32 else int(border))


@pytest.mark.parametrize("dtype", TOP)
@pytest.mark.parametrize("method", ["bilinear", "nearest"])
@given(seed=seeds, channels=st.sampled_from([1, 2, 3, 4]))
@settings(max_examples=40)
def test_kernel_equals_reference_to_the_last_bit(dtype, method, seed, channels) -> None:
    image, mx, my, border = draw(seed, dtype, channels_of(dtype, channels))
    kernel = remap(image, mx, my, interpolation=method, border_value=border)
    reference = remap(image, mx, my, interpolation=method, border_value=border, backend="numpy")
    assert kernel.dtype == image.dtype
    np.testing.assert_array_equal(kernel, reference)


@pytest.mark.skipif(not EXACT_OPENCV, reason="OpenCV 4 rounds maps to 1/32 pixel")
@pytest.mark.parametrize("dtype", TOP)
@given(seed=seeds, channels=st.sampled_from([1, 3, 4]))
@settings(max_examples=40)
def test_bilinear_equals_opencv_5_to_the_last_bit(dtype, seed, channels) -> None:
    image, mx, my, border = draw(seed, dtype, channels_of(dtype, channels))
    theirs = cv2.remap(image, mx, my, cv2.INTER_LINEAR, borderValue=(border,) * 4)
    np.testing.assert_array_equal(remap(image, mx, my, border_value=border), theirs.reshape(mx.shape + image.shape[2:]))


@pytest.mark.parametrize("dtype", TOP)
@given(seed=seeds, channels=st.sampled_from([1, 2, 3, 4]))
@settings(max_examples=30)
def test_nearest_equals_opencv(dtype, seed, channels) -> None:
    image, mx, my, border = draw(seed, dtype, channels_of(dtype, channels))
    theirs = cv2.remap(image, mx, my, cv2.INTER_NEAREST, borderValue=(border,) * 4)
    ours = remap(image, mx, my, interpolation="nearest", border_value=border)
    np.testing.assert_array_equal(ours, theirs.reshape(ours.shape))


@pytest.mark.parametrize(("method", "flag"), [("bilinear", cv2.INTER_LINEAR), ("bicubic", cv2.INTER_CUBIC)])
@given(seed=seeds, channels=st.sampled_from([1, 3]))
@settings(max_examples=30)
def test_on_multiples_of_1_32_every_opencv_agrees_within_a_grey_value(method, flag, seed, channels) -> None:
    image, mx, my, border = draw(seed, np.uint8, channels, grid=32)
    theirs = cv2.remap(image, mx, my, flag, borderValue=(border,) * 4).astype(int)
    ours = remap(image, mx, my, interpolation=method, border_value=border)
    assert np.abs(ours - theirs.reshape(ours.shape)).max() <= 1


@given(seed=seeds, channels=st.sampled_from([1, 3]))
@settings(max_examples=30)
def test_bicubic_kernel_equals_reference(seed, channels) -> None:
    image, mx, my, border = draw(seed, np.float32, channels)
    ours = remap(image, mx, my, interpolation="bicubic", border_value=border)
    reference = remap(image, mx, my, interpolation="bicubic", border_value=border, backend="numpy")
    np.testing.assert_allclose(ours, reference, atol=2e-6)


def test_identity_map_gives_the_image_back() -> None:
    image = np.random.default_rng(0).integers(0, 255, (20, 30, 3)).astype(np.uint8)
    mx, my = np.meshgrid(np.arange(30.0), np.arange(20.0))
    for method in ("bilinear", "nearest", "bicubic"):
        np.testing.assert_array_equal(remap(image, mx, my, interpolation=method), image)


@given(seed=seeds)
@settings(max_examples=30)
def test_bilinear_reproduces_a_plane_and_bicubic_too(seed) -> None:
    random = np.random.default_rng(seed)
    a, b, c = random.normal(size=3)
    x, y = np.meshgrid(np.arange(24.0), np.arange(18.0))
    mx, my = random.uniform(2, 20, (9, 7)).astype(np.float32), random.uniform(2, 14, (9, 7)).astype(np.float32)
    for method in ("bilinear", "bicubic"):
        got = remap(a * x + b * y + c, mx, my, interpolation=method)
        # Keys' kernel with c = -0.75 does not reproduce a ramp exactly: its first moment is off by up to 0.024 px
        slack = 1e-9 if method == "bilinear" else 0.05 * (abs(a) + abs(b))
        np.testing.assert_allclose(got, a * mx.astype(float) + b * my + c, atol=slack)


@given(t=st.floats(0, 1, exclude_max=True))
def test_keys_weights_sum_to_one(t) -> None:
    assert sum(keys_weights(np.array(t))) == pytest.approx(1, abs=1e-12)


def test_nan_is_outside() -> None:
    image = np.full((8, 8), 200, np.uint8)
    m = np.full((2, 2), np.nan, np.float32)
    for method in ("bilinear", "nearest", "bicubic"):
        for backend in ("numba", "numpy"):
            assert (remap(image, m, m, interpolation=method, border_value=7, backend=backend) == 7).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"map_y": np.zeros((3, 3), np.float32)}, "one shape"),
        ({"interpolation": "lanczos"}, "interpolation must be one of"),
        ({"border_value": 300}, "fit the image's dtype"),
        ({"border_value": (1, 2)}, "1 or 1"),
        ({"image": np.zeros((4, 4), np.int64)}, "must be uint8"),
    ],
)
def test_bad_input_is_refused_in_words(change, said) -> None:
    good = {"image": np.zeros((4, 4), np.uint8), "map_x": np.zeros((2, 2)), "map_y": np.zeros((2, 2))}
    with pytest.raises(InputError, match=said):
        remap(**{**good, **change})


@pytest.mark.parametrize("method", ["bilinear", "nearest", "bicubic"])
def test_an_image_that_outgrows_the_caches_gives_the_same(method) -> None:
    """Above half a megabyte the kernels ask for memory ahead, also where the map points outside of the image."""
    random = np.random.default_rng(0)
    image = random.integers(0, 256, (800, 700), dtype=np.uint8)
    assert image.nbytes > 2**19
    mx, my = (random.uniform(-50, size + 50, (40, 60)).astype(np.float32) for size in (700, 800))
    mx[3, 16], my[5, 32] = np.nan, np.inf
    kernel = remap(image, mx, my, interpolation=method)
    np.testing.assert_array_equal(kernel, remap(image, mx, my, interpolation=method, backend="numpy"))
