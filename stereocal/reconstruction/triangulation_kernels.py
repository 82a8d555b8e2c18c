# mypy: allow-untyped-defs
"""Linear triangulation, compiled: the smallest singular vector of a 4 × 4 matrix for each pair of points.

``triangulation`` takes it from a library's singular value decomposition. Here it is found by Hestenes' one-sided Jacobi
rotations: columns of A and of V = 1 are turned in pairs until all columns of A V are orthogonal to one another; their
lengths are the singular values, and V's columns the right singular vectors. For a matrix this small four or five rounds
over the six pairs do, and no accuracy is lost to forming AᵀA.

Sources: M. Hestenes, *Inversion of matrices by biorthogonalization*, J. SIAM 6 (1958).
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

ROUNDS = 30
ORTHOGONAL = 1e-15


@njit(cache=True, nogil=True, error_model="numpy")
def smallest_singular_vectors(P1, P2, left, right, out):
    """Write the homogeneous points (N, 4) that the projections P1, P2 (3, 4) see at left, right (N, 2) into `out`."""
    A, V = np.empty((4, 4)), np.empty((4, 4))  # by columns: A[j] is column j
    for n in range(len(left)):
        for j in range(4):
            A[j, 0] = left[n, 0] * P1[2, j] - P1[0, j]
            A[j, 1] = left[n, 1] * P1[2, j] - P1[1, j]
            A[j, 2] = right[n, 0] * P2[2, j] - P2[0, j]
            A[j, 3] = right[n, 1] * P2[2, j] - P2[1, j]
            for k in range(4):
                V[j, k] = 1.0 if j == k else 0.0
        for _ in range(ROUNDS):
            turned = False
            for p in range(3):
                for q in range(p + 1, 4):
                    pp, qq, pq = 0.0, 0.0, 0.0
                    for k in range(4):
                        pp += A[p, k] * A[p, k]
                        qq += A[q, k] * A[q, k]
                        pq += A[p, k] * A[q, k]
                    if abs(pq) <= ORTHOGONAL * math.sqrt(pp * qq):
                        continue
                    turned = True
                    zeta = (qq - pp) / (2 * pq)
                    tangent = math.copysign(1.0, zeta) / (abs(zeta) + math.sqrt(1 + zeta * zeta))
                    c = 1 / math.sqrt(1 + tangent * tangent)
                    s = c * tangent
                    for k in range(4):
                        A[p, k], A[q, k] = c * A[p, k] - s * A[q, k], s * A[p, k] + c * A[q, k]
                        V[p, k], V[q, k] = c * V[p, k] - s * V[q, k], s * V[p, k] + c * V[q, k]
            if not turned:
                break
        least, smallest = 0, np.inf
        for j in range(4):
            length = 0.0
            for k in range(4):
                length += A[j, k] * A[j, k]
            if length < smallest:
                least, smallest = j, length
        for k in range(4):
            out[n, k] = V[least, k]
