"""Triangulation: the point in space that two cameras see at two pixels.

With noise the two rays miss one another, and "the" point is a choice.

**Linear** (DLT). A camera P with rows p₁ᵀ, p₂ᵀ, p₃ᵀ sees X at x = p₁ᵀX / p₃ᵀX, so (x p₃ − p₁)ᵀ X = 0, and likewise for
y. Two views give four equations A X = 0 in the four homogeneous unknowns; X is the right singular vector of A's
smallest singular value. Simple, works for points at infinity, and minimises nothing that has a meaning.

**Midpoint.** The middle of the shortest segment between the two rays C + λ r and C' + λ' r'. It minimises distances in
space, where errors do not arise: it is biased for small angles between the rays.

**Optimal.** The nearest pair of pixels x̂, x̂' whose rays do meet (``correct_matches``, Lindstrom's iteration), and
then the point where they meet. It minimises ‖x − x̂‖² + ‖x' − x̂'‖², so it is the maximum-likelihood point for equal
noise in both pictures.

**How sure?** Near the solution the four pixel coordinates depend on X by the Jacobian J (4 × 3). Noise of σ pixels in
each gives Cov(X) = σ² (JᵀJ)⁻¹, long along the line of sight: σ_Z ≈ Z² σ_d / (f b), the square of the distance.

**Behind a camera.** The depth of X before camera P = [M | p₄] is sign(det M) p₃ᵀX / ‖m₃‖, m₃ the third row of M. A
negative depth is a wrong match, or cameras that were swapped.

Sources: R. Hartley, A. Zisserman, *Multiple View Geometry* (2004), chapter 12; R. Hartley, P. Sturm, *Triangulation*,
CVIU 68 (1997); P. Lindstrom, *Triangulation made easy*, CVPR 2010.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float, as_array, require_choice, require_positive
from stereocal.base.errors import DegenerateGeometryError
from stereocal.base.homogeneous import cross_matrix, from_homogeneous, to_homogeneous
from stereocal.pair.epipolar import correct_matches, point_pairs

METHODS = ("linear", "midpoint", "optimal")


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Points in space and how sure they are.

    Attributes
    ----------
    points : ndarray of shape (N, 3)
        In the frame and units of the projection matrices; infinite for parallel rays.
    covariances : ndarray of shape (N, 3, 3)
        For independent noise of `sigma` pixels per coordinate; infinite for parallel rays.
    in_front : ndarray of shape (N,), bool
        Whether the point lies before both cameras.
    errors : ndarray of shape (N,)
        Reprojection distance √(‖x − x̂‖² + ‖x' − x̂'‖²), pixels.
    """

    points: Float
    covariances: Float
    in_front: NDArray[np.bool_]
    errors: Float


def triangulate_points(
    P1: ArrayLike,
    P2: ArrayLike,
    left_points: ArrayLike,
    right_points: ArrayLike,
    *,
    method: str = "linear",
    backend: str = "numba",
) -> Float:
    """Triangulate matching points: the X with x ~ P₁ X and x' ~ P₂ X.

    Parameters
    ----------
    P1, P2 : array_like of shape (3, 4)
        Projection matrices of the two cameras.
    left_points, right_points : array_like of shape (N, 2)
        Undistorted pixels (or normalised coordinates, if P1 and P2 are poses).
    method : {"linear", "midpoint", "optimal"}
        See the module.
    backend : {"numba", "numpy"}
        The compiled kernels, or their readable twins (one for ``midpoint``).

    Returns
    -------
    ndarray of shape (N, 3), float64
        Infinite (linear) or NaN where the rays are parallel.

    Raises
    ------
    DegenerateGeometryError
        If the cameras stand at the same point.

    Notes
    -----
    ``linear`` answers to ``cv2.triangulatePoints`` after division by the fourth coordinate (agreement 1e-9, relative).

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> P1, P2 = K @ np.eye(3, 4), K @ np.c_[rig.R, rig.T]
    >>> bool(np.allclose(sc.triangulate_points(P1, P2, left, right), X))
    True
    """
    first, second = as_array(P1, (3, 4), "P1"), as_array(P2, (3, 4), "P2")
    left, right = point_pairs(left_points, right_points)
    require_choice(method, METHODS, "method")
    require_choice(backend, ("numba", "numpy"), "backend")
    if method == "midpoint":
        return _midpoint(first, second, left, right)
    if method == "optimal":
        left, right = correct_matches(left, right, fundamental_of_projections(first, second), backend=backend)
    return _linear(first, second, left, right, backend)


def triangulate_points_detailed(
    P1: ArrayLike,
    P2: ArrayLike,
    left_points: ArrayLike,
    right_points: ArrayLike,
    *,
    method: str = "optimal",
    sigma: float = 1.0,
    backend: str = "numba",
) -> Triangulation:
    """Triangulate as :func:`triangulate_points` does, and tell covariances, errors and which points are in front.

    Parameters
    ----------
    P1, P2, left_points, right_points, method, backend
        See :func:`triangulate_points`.
    sigma : float
        Standard deviation of each pixel coordinate.

    Returns
    -------
    Triangulation

    Raises
    ------
    DegenerateGeometryError
        If the cameras stand at the same point.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> P1, P2 = K @ np.eye(3, 4), K @ np.c_[rig.R, rig.T]
    >>> result = sc.triangulate_points_detailed(P1, P2, left, right, sigma=0.1)
    >>> bool(np.allclose(result.points, X)), result.covariances.shape
    (True, (20, 3, 3))
    """
    first, second = as_array(P1, (3, 4), "P1"), as_array(P2, (3, 4), "P2")
    left, right = point_pairs(left_points, right_points)
    require_positive(sigma, "sigma")
    points = triangulate_points(first, second, left, right, method=method, backend=backend)
    with np.errstate(invalid="ignore", divide="ignore"):
        seen = [from_homogeneous(to_homogeneous(points) @ P.T) for P in (first, second)]
        J = np.concatenate([_pixel_jacobian(P, points, x) for P, x in zip((first, second), seen, strict=True)], axis=1)
        information = np.swapaxes(J, 1, 2) @ J
        errors = np.sqrt(np.sum((seen[0] - left) ** 2, axis=1) + np.sum((seen[1] - right) ** 2, axis=1))
        ahead = (depths(first, points) > 0) & (depths(second, points) > 0)
    covariances = np.full((len(points), 3, 3), np.inf)
    known = np.all(np.isfinite(information), axis=(1, 2))
    known[known] = np.linalg.det(information[known]) > 0
    covariances[known] = sigma**2 * np.linalg.inv(information[known])
    return Triangulation(points, covariances, ahead & np.isfinite(points).all(axis=1), errors)


def depths(P: Float, points: Float) -> Float:
    """Return the points' depths before a camera, sign(det M) p₃ᵀX / ‖m₃‖: negative behind it.

    Parameters
    ----------
    P : ndarray of shape (3, 4)
        [M | p₄].
    points : ndarray of shape (N, 3)

    Returns
    -------
    ndarray of shape (N,)
    """
    M = P[:, :3]
    return np.asarray(np.sign(np.linalg.det(M)) * (to_homogeneous(points) @ P[2]) / np.linalg.norm(M[2]))


def fundamental_of_projections(P1: Float, P2: Float) -> Float:
    """Return F = [e']ₓ P₂ P₁⁺ of two cameras, e' = P₂ C the image of the first one's centre.

    Parameters
    ----------
    P1, P2 : ndarray of shape (3, 4)

    Returns
    -------
    ndarray of shape (3, 3)
        ‖F‖ = 1.

    Raises
    ------
    DegenerateGeometryError
        If both cameras have the same centre.
    """
    centre = np.linalg.svd(P1)[2][3]
    e = P2 @ centre
    F = cross_matrix(e) @ P2 @ np.linalg.pinv(P1)
    size = np.linalg.norm(F)
    if size <= 1e-12 * np.linalg.norm(P2):
        raise DegenerateGeometryError("both cameras stand at the same point: there is nothing to triangulate with")
    return np.asarray(F / size)


def _linear(P1: Float, P2: Float, left: Float, right: Float, backend: str) -> Float:
    """The right singular vector of the smallest singular value of (x p₃ − p₁, y p₃ − p₂) of both views."""
    if backend == "numba":
        from stereocal.reconstruction.triangulation_kernels import smallest_singular_vectors

        X = np.empty((len(left), 4))
        smallest_singular_vectors(P1, P2, left, right, X)
        return from_homogeneous(X)
    A = np.concatenate([points[:, :, None] * P[2] - P[None, :2] for points, P in ((left, P1), (right, P2))], axis=1)
    return from_homogeneous(np.linalg.svd(A)[2][:, 3])


def _midpoint(P1: Float, P2: Float, left: Float, right: Float) -> Float:
    """Half way between the nearest points C + λ r and C' + λ' r' of the two rays."""
    centres = [-np.linalg.solve(P[:, :3], P[:, 3]) for P in (P1, P2)]
    if np.allclose(centres[0], centres[1], rtol=1e-12, atol=0):
        raise DegenerateGeometryError("both cameras stand at the same point: there is nothing to triangulate with")
    rays = [to_homogeneous(points) @ np.linalg.inv(P[:, :3]).T for points, P in ((left, P1), (right, P2))]
    r, q = (ray / np.linalg.norm(ray, axis=1, keepdims=True) for ray in rays)
    base = centres[1] - centres[0]
    cosine = np.sum(r * q, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        sine2 = np.sum(np.cross(r, q) ** 2, axis=1)
        along_r = (r @ base - cosine * (q @ base)) / sine2
        along_q = (cosine * (r @ base) - q @ base) / sine2
        return np.asarray((centres[0] + along_r[:, None] * r + centres[1] + along_q[:, None] * q) / 2)


def _pixel_jacobian(P: Float, points: Float, seen: Float) -> Float:
    """Return ∂(x, y)/∂X = (m₁ − x m₃, m₂ − y m₃) / p₃ᵀX, of shape (N, 2, 3)."""
    w = to_homogeneous(points) @ P[2]
    return np.asarray((P[None, :2, :3] - seen[:, :, None] * P[2, :3]) / w[:, None, None])
