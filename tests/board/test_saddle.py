"""Saddles: reference = kernel, maxima against their definition, what the ring test keeps."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from strategies import seeds

from stereocal.board.saddle import saddle_candidates, saddle_response
from stereocal.board.saddle_kernels import saddle_maxima


@settings(max_examples=20)
@given(seed=seeds, shape=st.tuples(st.integers(8, 40), st.integers(8, 60)))
def test_kernel_is_the_reference(seed, shape):
    image = np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8)
    G, S = saddle_response(image)
    G2, S2 = saddle_response(image, backend="numpy")
    np.testing.assert_allclose(G, G2, atol=1e-4)
    np.testing.assert_allclose(S, S2, atol=1e-5 * np.abs(S2).max())


@settings(max_examples=20)
@given(seed=seeds, levels=st.sampled_from([5, 1000]))
def test_maxima_are_the_largest_of_their_surroundings(seed, levels):
    S = np.random.default_rng(seed).integers(0, levels, (35, 46)).astype(np.float32)
    out = np.empty((500, 2), np.int64)
    listed = {tuple(p) for p in out[: saddle_maxima(S, np.float32(1), out)]}
    largest = ndimage.maximum_filter(S, 5)
    for x, y in listed:
        assert S[y, x] == largest[y, x] > 1
    if levels == 1000:  # without ties nothing may be missing, where the blocks of three reach
        y, x = np.nonzero((largest == S) & (S > 1))
        inside = (x >= 3) & (y >= 3) & (x < 3 + (46 - 8) // 3 * 3) & (y < 3 + (35 - 8) // 3 * 3)
        unique = [
            (a, b)
            for a, b in zip(x[inside], y[inside], strict=True)
            if (S[b - 2 : b + 3, a - 2 : a + 3] == S[b, a]).sum() == 1
        ]
        assert set(unique) <= listed


def crossing(angle1, angle2, center, invert=False):
    """A sharp saddle, 8x8 samples a pixel: dark from line 1 to line 2, growing angles."""
    y, x = (np.mgrid[: 41 * 8, : 41 * 8] + 0.5) / 8 - 0.5
    dx, dy = x - center[0], y - center[1]
    u = -np.sin(angle1) * dx + np.cos(angle1) * dy
    v = -np.sin(angle2) * dx + np.cos(angle2) * dy
    dark = (u * v < 0) != invert
    fine = np.where(dark, 40.0, 200.0)
    return fine.reshape(41, 8, 41, 8).mean(axis=(1, 3)).astype(np.float32)


@settings(max_examples=30)
@given(
    angle=st.floats(0, np.pi),
    opening=st.floats(0.8, np.pi - 0.8),
    x=st.floats(19, 21),
    y=st.floats(19, 21),
)
def test_a_crossing_is_seen_where_it_is_with_its_edges(angle, opening, x, y):
    image = crossing(angle, angle + opening, (x, y))
    candidates, _ = saddle_candidates(*saddle_response(image))
    assert len(candidates) == 1
    assert np.hypot(*(candidates[0, :2] - [x, y])) < 1.0
    # the first edge leads, with growing angle, from light into dark: that is line 1, in one of its directions
    off = (candidates[0, 2] - angle + np.pi / 2) % np.pi - np.pi / 2
    assert abs(off) < 0.25
    off = (candidates[0, 3] - angle - opening + np.pi / 2) % np.pi - np.pi / 2
    assert abs(off) < 0.25


def test_edges_corners_and_discs_are_not_crossings():
    y, x = np.mgrid[:60, :60].astype(np.float32)
    edge = np.where(x + 0.3 * y > 35, 200.0, 40.0)
    corner = np.where((x > 30) & (y > 25), 40.0, 200.0)
    disc = np.where(np.hypot(x - 30, y - 30) < 9, 40.0, 200.0)
    for image in (edge, corner, disc):
        assert len(saddle_candidates(*saddle_response(image.astype(np.float32)))[0]) == 0
