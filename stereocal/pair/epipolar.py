"""Epipolar geometry: what a point in one picture says about where to look in the other.

A point x of the left picture is a ray in space; seen by the right camera, that ray is a line, l' = F x. A match x' lies
on it,

    x'ᵀ F x = 0,

which is the paper's [eq 20] in the field's usual order: F takes left points to right lines, Fᵀ right points to left
lines. The rays of all points pass through the left camera's centre, so all lines of the right picture meet in that
centre's image, the epipole e', and F e = 0, Fᵀ e' = 0: F has rank 2.

**How far is a pair from satisfying it?** With n = (F x)₁₂ and n' = (Fᵀ x')₁₂ the normals of the two lines, and
c = x'ᵀ F x:

- *algebraic*: c itself; cheap, and without meaning in pixels;
- *epipolar*: the distances of each point from the other's line, |c|/‖n‖ in the right and |c|/‖n'‖ in the left picture;
- *Sampson*: c² / (‖n‖² + ‖n'‖²), the first-order estimate of the next;
- *reprojection*: the smallest ‖x − x̂‖² + ‖x' − x̂'‖² with x̂'ᵀ F x̂ = 0. This is what maximum likelihood asks for.

The last one is a small problem of its own, :func:`correct_matches`. At the solution x̂ = x − λ n', x̂' = x' − λ n, the
normals taken *at the solution*. Lindstrom's iteration takes them at the last estimate, and solves the constraint
x̂'ᵀ F x̂ = 0 for λ. With n₀, n'₀ the normals at the measured points and F̃ the upper left 2 × 2 of F it is a quadratic,

    a λ² − 2 b λ + c = 0,      a = nᵀ F̃ n',      b = ½ (n·n₀ + n'·n'₀),      λ = c / (b + √(b² − a c)),

so that every round ends with a pair that satisfies F exactly, and it converges quadratically: after two rounds it is at
the optimum to all digits that a camera can use. Hartley and Sturm's classical solution needs the roots of a polynomial
of degree six for each point.

Sources: R. Hartley, A. Zisserman, *Multiple View Geometry* (2004), chapters 9, 11 and 12; P. Lindstrom, *Triangulation
made easy*, CVPR 2010.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_array, as_points, require_choice
from stereocal.base.errors import InputError
from stereocal.base.homogeneous import to_homogeneous

_LINDSTROM_ROUNDS = 6


def point_pairs(left: ArrayLike, right: ArrayLike, minimum: int = 0) -> tuple[Float, Float]:
    """Return two (N, 2) arrays of matching points, or refuse them.

    Parameters
    ----------
    left, right : array_like of shape (N, 2), (N, 1, 2) or (1, N, 2)
        Point i of one belongs to point i of the other.
    minimum : int
        The least number of pairs that the caller can work with.

    Returns
    -------
    left, right : ndarray of shape (N, 2)

    Raises
    ------
    InputError
        If the shapes are not (N, 2), the counts differ, or there are fewer than `minimum` pairs.
    """
    first = as_points(left, 2, "left_points", minimum=minimum)
    second = as_points(right, 2, "right_points", minimum=minimum)
    if len(first) != len(second):
        raise InputError(f"left_points holds {len(first)} points and right_points {len(second)}; they must be pairs")
    return first, second


def epipolar_lines(points: ArrayLike, F: ArrayLike, *, of: str = "left") -> Float:
    """Return the epipolar lines (a, b, c), a x + b y + c = 0 with a² + b² = 1, in the other picture.

    Parameters
    ----------
    points : array_like of shape (N, 2)
        Pixels of one picture.
    F : array_like of shape (3, 3)
        The fundamental matrix, x_rightᵀ F x_left = 0.
    of : {"left", "right"}
        Which picture the points are of: l' = F x for the left one, l = Fᵀ x' for the right one.

    Returns
    -------
    ndarray of shape (N, 3)
        (0, 0, 0) for an epipole, whose line is not determined.

    Notes
    -----
    Paper: [eq 20]. Answers to ``cv2.computeCorrespondEpilines`` (agreement 1e-12 up to sign).

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> a, b, c = sc.epipolar_lines([[100.0, 50.0]], rig.F)[0]  # in the right picture: y = 50
    >>> round(float(-c / b), 6)
    50.0
    """
    matrix = as_array(F, (3, 3), "F")
    require_choice(of, ("left", "right"), "of")
    lines = to_homogeneous(as_points(points, 2, "points")) @ (matrix.T if of == "left" else matrix)
    length = np.hypot(lines[:, 0], lines[:, 1])[:, None]
    return np.asarray(np.divide(lines, length, out=np.zeros_like(lines), where=length > 0))


def epipoles(F: ArrayLike) -> tuple[Float, Float]:
    """Return the epipoles e and e' as unit vectors of homogeneous pixels: F e = 0, Fᵀ e' = 0.

    Parameters
    ----------
    F : array_like of shape (3, 3)
        The fundamental matrix.

    Returns
    -------
    left, right : ndarray of shape (3,)
        Divide by the last entry for pixels; it is 0 for an epipole at infinity, as in a rectified pair. The sign is
        such that the largest entry is positive.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> e_left, e_right = sc.epipoles(rig.F)
    >>> e_left.round(6) + 0.0  # at infinity along x: the pair is rectified
    array([1., 0., 0.])
    """
    U, _, Vt = np.linalg.svd(as_array(F, (3, 3), "F"))
    left, right = Vt[2], U[:, 2]
    return left * np.sign(left[np.argmax(np.abs(left))]), right * np.sign(right[np.argmax(np.abs(right))])


def _constraint(left: Float, right: Float, F: Float) -> tuple[Float, Float, Float]:
    """Return c = x'ᵀFx and the normals n = (Fx)₁₂ of the right line and n' = (Fᵀx')₁₂ of the left one."""
    x, xp = to_homogeneous(left), to_homogeneous(right)
    right_lines, left_lines = x @ F.T, xp @ F
    return np.sum(xp * right_lines, axis=1), right_lines[:, :2], left_lines[:, :2]


def sampson_distance(left_points: ArrayLike, right_points: ArrayLike, F: ArrayLike) -> Float:
    """Return the squared Sampson distance of each pair, (x'ᵀFx)² / (‖(Fx)₁₂‖² + ‖(Fᵀx')₁₂‖²).

    Parameters
    ----------
    left_points, right_points : array_like of shape (N, 2)
        Matching pixels.
    F : array_like of shape (3, 3)
        The fundamental matrix.

    Returns
    -------
    ndarray of shape (N,)
        Squared pixels; 0 for a pair of epipoles.

    Notes
    -----
    First order in the error, about the squared reprojection error of :func:`correct_matches`. Answers to
    ``cv2.sampsonDistance`` (agreement 1e-12).

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> sc.sampson_distance(left, right + [0.0, 1.0], rig.F)[:3].round(6)
    array([0.5, 0.5, 0.5])
    """
    left, right = point_pairs(left_points, right_points)
    c, n, n_left = _constraint(left, right, as_array(F, (3, 3), "F"))
    weight = np.sum(n**2, axis=1) + np.sum(n_left**2, axis=1)
    return np.asarray(np.divide(c**2, weight, out=np.zeros_like(c), where=weight > 0))


def symmetric_epipolar_distance(left_points: ArrayLike, right_points: ArrayLike, F: ArrayLike) -> Float:
    """Return the sum of squared distances from both epipolar lines, (x'ᵀFx)² (1/‖(Fx)₁₂‖² + 1/‖(Fᵀx')₁₂‖²).

    Parameters
    ----------
    left_points, right_points : array_like of shape (N, 2)
        Matching pixels.
    F : array_like of shape (3, 3)
        The fundamental matrix.

    Returns
    -------
    ndarray of shape (N,)
        Squared pixels; infinite where a point is an epipole and its pair is not on a line.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> sc.symmetric_epipolar_distance(left, right + [0.0, 1.0], rig.F)[:3].round(6)
    array([2., 2., 2.])
    """
    left, right = point_pairs(left_points, right_points)
    c, n, n_left = _constraint(left, right, as_array(F, (3, 3), "F"))
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = c**2 * (1 / np.sum(n**2, axis=1) + 1 / np.sum(n_left**2, axis=1))
    return np.asarray(np.where(c == 0, 0.0, distance))


def correct_matches(
    left_points: ArrayLike, right_points: ArrayLike, F: ArrayLike, *, backend: str = "numba"
) -> tuple[Float, Float]:
    """Move each pair to the nearest pair that satisfies x'ᵀ F x = 0: min ‖x − x̂‖² + ‖x' − x̂'‖².

    Parameters
    ----------
    left_points, right_points : array_like of shape (N, 2)
        Matching pixels.
    F : array_like of shape (3, 3)
        The fundamental matrix.
    backend : {"numba", "numpy"}
        The compiled kernel, or its readable twin.

    Returns
    -------
    left, right : ndarray of shape (N, 2)
        Their rays meet in a point of space.

    Notes
    -----
    Lindstrom's iteration. Answers to ``cv2.correctMatches``, which solves a polynomial of degree six (agreement
    1e-6 px, and never a larger cost).

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> rig = sc.StereoRig(sc.Camera(K, None, (640, 480)), sc.Camera(K, None, (640, 480)), np.eye(3), [-60.0, 0, 0])
    >>> X = np.random.default_rng(0).uniform([-200, -150, 500], [200, 150, 900], (20, 3))
    >>> left, right = rig.left.project(X), rig.right.project(X, [0, 0, 0], rig.T)
    >>> noisy = right + [0.0, 0.5]
    >>> new_left, new_right = sc.correct_matches(left, noisy, rig.F)
    >>> (new_right - noisy)[0].round(3) + 0.0  # each side takes half of it
    array([ 0.  , -0.25])
    """
    left, right = point_pairs(left_points, right_points)
    matrix = as_array(F, (3, 3), "F")
    matrix = matrix / np.linalg.norm(matrix)
    if require_choice(backend, ("numba", "numpy"), "backend") == "numba":
        from stereocal.pair.epipolar_kernels import nearest_pairs

        new_left, new_right = np.empty_like(left), np.empty_like(right)
        nearest_pairs(matrix, left, right, _LINDSTROM_ROUNDS, new_left, new_right)
        return new_left, new_right
    c, n, n_left = _constraint(left, right, matrix)
    n0, n0_left, corner = n, n_left, matrix[:2, :2]
    move_left, move_right = np.zeros_like(left), np.zeros_like(right)
    for _ in range(_LINDSTROM_ROUNDS):
        a = np.einsum("ni,ij,nj->n", n, corner, n_left)
        b = 0.5 * (np.sum(n * n0, axis=1) + np.sum(n_left * n0_left, axis=1))
        below = b + np.sqrt(np.maximum(b * b - a * c, 0.0))
        # where no near pair satisfies F to second order (matches that are grossly wrong) the last estimate stays
        found = (below > 0)[:, None]
        step = np.divide(c, below, out=np.zeros_like(c), where=below > 0)[:, None]
        move_left, move_right = np.where(found, step * n_left, move_left), np.where(found, step * n, move_right)
        _, n, n_left = _constraint(left - move_left, right - move_right, matrix)
    return left - move_left, right - move_right
