"""Homogeneous coordinates: x ↦ (x, 1), (x, w) ↦ x / w, and the cross product as a matrix.

The paper's hat [eq 11]: p̂ = [u, v, 1]ᵀ, P̂ = [X, Y, Z, 1]ᵀ.
"""

from __future__ import annotations

import numpy as np

from stereocal.base.checks import Float


def to_homogeneous(points: Float) -> Float:
    """Append a 1 to each point: (N, d) → (N, d + 1)."""
    return np.hstack([points, np.ones((len(points), 1))])


def from_homogeneous(points: Float) -> Float:
    """Divide by the last coordinate and drop it: (N, d + 1) → (N, d); infinite where it is 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(points[:, :-1] / points[:, -1:])


def cross_matrix(vector: Float) -> Float:
    """Return [v]ₓ, the skew-symmetric 3x3 matrix with [v]ₓ w = v × w."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
