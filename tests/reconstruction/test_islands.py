"""Islands without evidence: the kernel is its reference, and what hangs in the air over a blank wall is taken away."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import seeds

from stereocal.reconstruction.islands import EVIDENCE, contrast, filter_islands, textured
from stereocal.reconstruction.speckles import filter_speckles


@settings(max_examples=40)
@given(
    seed=seeds,
    shape=st.tuples(st.integers(1, 30), st.integers(1, 90)),
    max_size=st.integers(1, 40),
    threshold=st.sampled_from([0, 3, 8, 200]),
    levels=st.integers(1, 60),
)
def test_kernel_is_its_reference(seed, shape, max_size, threshold, levels) -> None:
    rng = np.random.default_rng(seed)
    disparity = rng.integers(0, 4, shape).astype(np.float32)
    disparity[rng.random(shape) < 0.2] = np.nan
    image = rng.integers(0, levels, shape).astype(np.uint8)
    options = {"max_size": max_size, "max_difference": 1.0, "texture_threshold": threshold}
    expected = filter_islands(disparity, image, **options, backend="numpy")
    np.testing.assert_array_equal(filter_islands(disparity, image, **options), expected)


@settings(max_examples=10)
@given(seed=seeds, max_size=st.integers(1, 40))
def test_without_a_threshold_it_is_the_speckle_filter(seed, max_size) -> None:
    rng = np.random.default_rng(seed)
    disparity = rng.integers(0, 4, (30, 40)).astype(np.float32)
    image = np.zeros((30, 40), np.uint8)
    options = {"max_size": max_size, "max_difference": 1.0}
    np.testing.assert_array_equal(
        filter_islands(disparity, image, **options, texture_threshold=0), filter_speckles(disparity, **options)
    )


@pytest.mark.parametrize("backend", ["numba", "numpy"])
def test_a_blank_patch_goes_and_one_with_texture_stays(backend) -> None:
    rng = np.random.default_rng(3)
    image = rng.integers(0, 256, (60, 90)).astype(np.uint8)
    image[10:40, 10:40] = 100  # a blank wall
    disparity = np.full(image.shape, 5, np.float32)
    disparity[15:35, 15:35] = 30  # a false patch on it
    disparity[15:35, 55:75] = 30  # a thing in front of the texture
    found = filter_islands(disparity, image, max_size=100, max_difference=2, texture_threshold=8, backend=backend)
    assert np.isnan(found[15:35, 15:35]).all()
    assert np.isfinite(found).sum() == image.size - 400
    image[20, 20 : 20 + EVIDENCE] = 200 * (np.arange(EVIDENCE) // 2 % 2)  # a line of print on the wall
    assert textured(image, 8)[15:35, 15:35].sum() >= EVIDENCE
    found = filter_islands(disparity, image, max_size=100, max_difference=2, texture_threshold=8, backend=backend)
    assert np.isfinite(found).all()


def test_the_threshold_falls_with_the_contrast() -> None:
    """A photograph of 20 grey levels is matched as one of 200 is: its texture counts."""
    image = np.random.default_rng(1).integers(100, 120, (64, 64)).astype(np.uint8)
    assert contrast(image) < 20
    disparity = np.full(image.shape, 5, np.float32)
    assert np.isfinite(filter_islands(disparity, image, max_size=100, max_difference=2, texture_threshold=8)).all()
