"""The tiles of JᵀJ: explicit vectors against the matrix product."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from stereocal.camera.tile_products import LANES, add_tile


@njit
def add_tiles(J, rows, count, second, A):
    for i in range(0, len(rows), 4):
        for k in range(0, i + 4, 4):
            add_tile(J, rows, i, k, count, second, A)


@settings(deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1), tiles=st.integers(1, 5), vectors=st.integers(1, 8), beyond=st.integers(0, 9),
    wider=st.integers(0, 6),
)  # fmt: skip
def test_the_lower_triangle_of_tiles_is_the_matrix_product(
    seed: int, tiles: int, vectors: int, beyond: int, wider: int
) -> None:
    rng = np.random.default_rng(seed)
    count, n = LANES * vectors, 4 * tiles
    second = count + beyond  # where the second part of a row begins; what lies between counts for nothing
    length = second + count
    J = rng.normal(size=(n + 2) * length)
    rows = rng.permutation(n + 2)[:n] * length
    before = rng.normal(size=(n, n + wider))
    A = before.copy()
    add_tiles(J, rows, count, second, A)
    parts = np.array([np.concatenate([J[r : r + count], J[r + second : r + length]]) for r in rows])
    lower = np.kron(np.tril(np.ones((tiles, tiles))), np.ones((4, 4))) > 0
    expected = before.copy()
    expected[:, :n] += np.where(lower, parts @ parts.T, 0.0)
    np.testing.assert_allclose(A, expected, rtol=1e-13, atol=1e-13 * 2 * count)
