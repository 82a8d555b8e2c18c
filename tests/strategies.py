"""Hypothesis strategies that several rooms' tests draw from."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

seeds = st.integers(0, 2**32 - 1)
"""A seed for numpy.random.default_rng: big random inputs are drawn by their seed, so that they shrink."""

small_numbers = st.floats(-3, 3, allow_nan=False, allow_infinity=False, width=64)

rotation_vectors = st.one_of(
    arrays(np.float64, 3, elements=small_numbers),
    # near the identity and near a half turn, where formulas lose digits
    arrays(np.float64, 3, elements=st.floats(-1e-7, 1e-7)),
    arrays(np.float64, 3, elements=small_numbers)
    .filter(lambda v: np.linalg.norm(v) > 1e-3)
    .map(lambda v: v / np.linalg.norm(v) * (np.pi - 1e-9)),
)
