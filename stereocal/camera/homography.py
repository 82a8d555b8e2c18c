"""The homography between a plane and its image, by the normalised direct linear transform.

A point (X, Y) of a plane and its image (u, v) in a pinhole camera satisfy ŝ (u, v, 1)ᵀ = H (X, Y, 1)ᵀ. Eliminating ŝ
gives two equations that are linear in h, the nine entries of H row by row,

    [ X̂ᵀ   0ᵀ   −u X̂ᵀ ]
    [ 0ᵀ   X̂ᵀ   −v X̂ᵀ ] h = 0,        X̂ = (X, Y, 1)ᵀ,

two rows a point, nine unknowns up to scale: four points suffice. h is the right singular vector of the stacked matrix A
that belongs to the smallest singular value.

As they stand the columns of A differ by factors of a million, and the answer is at the mercy of rounding and of where
the origin lies. So both point sets are first moved to their centroid and scaled to a mean distance of √2, the H between
those is found, and the two similarities are undone (Hartley, *In defense of the eight-point algorithm*, 1997).

That h makes ‖A h‖ least, an algebraic error. What measurements obey is the distance in the image, Σ ‖(u, v) − π(H
X̂)‖² with π(q) = (q₁, q₂)/q₃, which Levenberg–Marquardt lowers from there. With w = 1/q₃ and (û, v̂) = π(q), the
derivatives are ∂û/∂h₁ = w X̂ᵀ, ∂v̂/∂h₂ = w X̂ᵀ, ∂û/∂h₃ = −w û X̂ᵀ, ∂v̂/∂h₃ = −w v̂ X̂ᵀ. H has nine entries and eight
degrees of freedom: the largest entry is held.

If the points of either side lie on one line, a whole family of H fits: the second smallest singular value of A vanishes
with the smallest, and that is how it is recognised.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_points
from stereocal.base.errors import DegenerateGeometryError, InputError
from stereocal.base.least_squares import minimize_least_squares

# Second smallest singular value of A over the largest, below which the points are taken to be collinear.
_COLLINEAR = 1e-8


def fit_homography(src: ArrayLike, dst: ArrayLike, *, refine: bool = True) -> Float:
    """Fit H with ŝ (u, v, 1)ᵀ = H (X, Y, 1)ᵀ: normalised direct linear transform, then least distance in `dst`.

    Parameters
    ----------
    src : array_like of shape (N, 2) or (N, 3)
        Points (X, Y) of the plane, N ≥ 4; of (N, 3) board points the Z, which must be 0, is dropped.
    dst : array_like of shape (N, 2)
        Their images (u, v).
    refine : bool
        Whether to go on from the algebraic error of the linear solution to the distance in `dst`.

    Returns
    -------
    ndarray of shape (3, 3)
        H, scaled to H[2, 2] = 1 (to unit norm if that entry vanishes).

    Raises
    ------
    InputError
        If there are fewer than four points, or the two lists differ in length.
    DegenerateGeometryError
        If the points of one side lie on one line.

    Notes
    -----
    Answers to ``cv2.findHomography(src, dst, 0)``: equal to 1e-5 relative, all that OpenCV has, which takes the points
    as float32.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    >>> sc.fit_homography(square, 10 * square + [3, 4]).round(6) + 0.0
    array([[10.,  0.,  3.],
           [ 0., 10.,  4.],
           [ 0.,  0.,  1.]])
    """
    plane = np.asarray(src, dtype=np.float64)
    if plane.ndim >= 2 and plane.shape[-1] == 3:
        board = as_points(src, 3, "src", minimum=4)
        if np.ptp(board[:, 2]) > 1e-12 * np.ptp(board[:, :2]):
            raise InputError("src holds points with different Z; a homography needs the points of a plane, Z = 0")
        a = np.ascontiguousarray(board[:, :2])
    else:
        a = as_points(src, 2, "src", minimum=4)
    b = as_points(dst, 2, "dst", minimum=4)
    if len(a) != len(b):
        raise InputError(f"src holds {len(a)} points and dst {len(b)}; they must be pairs")
    Ta, Tb = _normalization(a), _normalization(b)
    a_n, b_n = a * Ta[0, 0] + Ta[:2, 2], b * Tb[0, 0] + Tb[:2, 2]

    X = np.column_stack([a_n, np.ones(len(a))])
    A = np.zeros((max(2 * len(a), 9), 9))  # of four points the ninth row stays 0
    u, v = A[0 : 2 * len(a) : 2], A[1 : 2 * len(a) : 2]
    u[:, 0:3] = v[:, 3:6] = X
    u[:, 6:9] = -b_n[:, :1] * X
    v[:, 6:9] = -b_n[:, 1:] * X
    singular_values, Vt = np.linalg.svd(A, full_matrices=False)[1:]
    if singular_values[7] <= _COLLINEAR * singular_values[0]:
        raise DegenerateGeometryError("the points lie on one line: a homography needs four of which no three do")
    H_n = Vt[8].reshape(3, 3)
    if refine and len(a) > 4:
        H_n = _refine(H_n, X, b_n)
    H = np.linalg.inv(Tb) @ H_n @ Ta
    return np.asarray(H / H[2, 2] if abs(H[2, 2]) > 1e-12 * np.abs(H).max() else H / np.linalg.norm(H))


def _refine(H: Float, X: Float, target: Float) -> Float:
    """Minimise Σ ‖target − π(H X̂)‖² from H; X (N, 3) homogeneous, all in normalised coordinates."""
    held = int(np.argmax(np.abs(H)))
    free = np.delete(np.arange(9), held)

    def matrix(h: Float) -> Float:
        full = np.empty(9)
        full[free], full[held] = h, H.flat[held]
        return full.reshape(3, 3)

    def residuals(h: Float) -> Float:
        q = X @ matrix(h).T
        return (q[:, :2] / q[:, 2:] - target).ravel()

    def jacobian(h: Float) -> Float:
        q = X @ matrix(h).T
        wX, uv = X / q[:, 2:], q[:, :2] / q[:, 2:]
        J = np.zeros((len(X), 2, 9))
        J[:, 0, 0:3] = J[:, 1, 3:6] = wX
        J[:, :, 6:9] = -uv[:, :, None] * wX[:, None, :]
        return J.reshape(-1, 9)[:, free]

    return matrix(minimize_least_squares(residuals, H.flat[free], jacobian=jacobian).x)


def _normalization(points: Float) -> Float:
    """The similarity that moves points to their centroid and to a mean distance of √2 from it."""
    centre = points.mean(axis=0)
    spread = float(np.mean(np.hypot(*(points - centre).T)))
    if spread == 0:
        raise DegenerateGeometryError("all points are the same: a homography needs four, no three on a line")
    scale = np.sqrt(2) / spread
    return np.array([[scale, 0, -scale * centre[0]], [0, scale, -scale * centre[1]], [0, 0, 1.0]])
