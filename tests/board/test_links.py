"""Links, cells and coordinates: reference = kernel; neighbours against scipy; a board's corners get its coordinates."""

from __future__ import annotations

import numpy as np
from board_renders import render
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from strategies import seeds

import stereocal as sc
from stereocal.board.link_kernels import nearest_others
from stereocal.board.links import link_corners, nearest_reference
from stereocal.board.saddle import saddle_candidates, saddle_response


@settings(max_examples=40)
@given(
    seed=seeds, n=st.integers(2, 90), k=st.integers(1, 20), kind=st.sampled_from(["spread", "grid", "line", "heaps"])
)
def test_nearest_others_are_the_nearest(seed, n, k, kind):
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, 300, (n, 2))
    if kind == "grid":  # equal distances: the lower number first
        points = np.floor(points / 40)
    elif kind == "line":
        points[:, 1] = 7.0
    elif kind == "heaps":
        points = points.round(-2) + rng.normal(0, 0.3, (n, 2))
    k = min(k, n - 1)
    near = np.empty((n, k), np.int64)
    nearest_others(points, near)
    np.testing.assert_array_equal(near, nearest_reference(points, k))
    distance, _ = cKDTree(points).query(points, k + 1)
    own = np.linalg.norm(points[near] - points[:, None], axis=-1)
    np.testing.assert_allclose(np.sort(own, axis=1), distance[:, 1:], atol=1e-12)


def scattered(seed, size=(7, 6)):
    """Candidates of a board with covered corners, in noise."""
    rng = np.random.default_rng(seed)
    turn, tilt = float(rng.uniform(-180, 180)), float(rng.uniform(0, 45))
    image, truth = render(sc.Chessboard(size), turn=turn, tilt=tilt, fill=0.6, seed=seed % 1000, noise=4)
    for x, y in truth[rng.choice(len(truth), 3, replace=False)].astype(int):
        image[y - 9 : y + 10, x - 9 : x + 10] = 100
    G, S = saddle_response(np.ascontiguousarray(image[::2, ::2]))
    return G, saddle_candidates(G, S)[0], truth / 2


@settings(max_examples=10)
@given(seed=seeds)
def test_kernels_are_the_references(seed):
    G, candidates, _ = scattered(seed)
    ours, reference = link_corners(G, candidates), link_corners(G, candidates, backend="numpy")
    for name in ("link", "trusted", "component", "count"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(reference, name), err_msg=name)
    linked, placed = ours.link >= 0, ours.component >= 0
    np.testing.assert_array_equal(ours.back[linked], reference.back[linked])
    np.testing.assert_array_equal(ours.place[placed], reference.place[placed])
    np.testing.assert_array_equal(ours.turned[placed], reference.turned[placed])


@settings(max_examples=10)
@given(seed=seeds)
def test_places_are_the_boards_own_up_to_a_turn(seed):
    G, candidates, truth = scattered(seed)
    links = link_corners(G, candidates)
    largest = np.bincount(links.component[links.component >= 0]).argmax()
    members = np.nonzero(links.component == largest)[0]
    distance = np.linalg.norm(candidates[members, None, :2] - truth, axis=-1)
    assert distance.min(axis=1).max() < 2
    j, i = np.divmod(distance.argmin(axis=1), 7)
    place = links.place[members]
    # an affine map with a matrix of whole numbers takes one to the other
    design = np.column_stack([place, np.ones(len(place))])
    A, *_ = np.linalg.lstsq(design, np.column_stack([i, j]), rcond=None)
    np.testing.assert_allclose(design @ A, np.column_stack([i, j]), atol=1e-9)
    np.testing.assert_allclose(abs(np.linalg.det(A[:2])), 1, atol=1e-9)
