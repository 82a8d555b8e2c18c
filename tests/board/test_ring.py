"""The ring test: reference = kernel, on noise, on texture and at the border; what it keeps is in test_saddle."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from strategies import seeds

from stereocal.board.ring import ring_test
from stereocal.board.saddle import saddle_candidates, saddle_response


def texture(seed, shape, blur):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).standard_normal(shape), blur)
    return np.clip(128 + 60 * noise / noise.std(), 0, 255).astype(np.uint8)


@settings(max_examples=20)
@given(seed=seeds, shape=st.tuples(st.integers(20, 50), st.integers(20, 60)), blur=st.floats(0.3, 3))
def test_kernels_are_the_references(seed, shape, blur):
    G, S = saddle_response(texture(seed, shape, blur))
    candidates, maxima = saddle_candidates(G, S)
    candidates2, maxima2 = saddle_candidates(G, S, backend="numpy")
    np.testing.assert_array_equal(maxima, maxima2)
    np.testing.assert_allclose(candidates, candidates2, rtol=1e-12, atol=1e-12)


@settings(max_examples=10)
@given(seed=seeds)
def test_pixels_anywhere_get_the_same_answer(seed):
    G, _ = saddle_response(texture(seed, (16, 18), 1.5))
    y, x = np.mgrid[2:14, 2:16]
    pixels = np.column_stack([x.ravel(), y.ravel()])
    kept = ring_test(G, pixels)
    np.testing.assert_allclose(kept, ring_test(G, pixels, backend="numpy"), rtol=1e-12, atol=1e-12)
    if len(kept):
        assert np.all(np.diff(kept[:, 2:5], axis=1) < np.pi)
        assert np.all(kept[:, 6] >= 2.0)


def test_a_fainter_crossing_than_asked_for_is_left_out():
    image = np.kron(np.array([[0, 1], [1, 0]]), np.ones((12, 12))).astype(np.float32) * 10 + 100
    G, S = saddle_response(image)
    assert len(saddle_candidates(G, S)[0]) == 1
    assert len(saddle_candidates(G, S, least_amplitude=6.0)[0]) == 0
