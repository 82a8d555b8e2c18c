"""Epipolar geometry: what one picture says about where to look in the other.

A point x of the left picture is a ray in space; seen by the right camera, that ray is a line, l' = F x. A match x' lies
on it: x'ᵀ F x = 0. All epipolar lines of a picture meet in its epipole, the other camera's image: F e = 0, Fᵀ e' = 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_array, as_points, require_choice
from stereocal.base.errors import InputError
from stereocal.base.homogeneous import to_homogeneous


def point_pairs(left: ArrayLike, right: ArrayLike, minimum: int = 0) -> tuple[Float, Float]:
    """Return two (N, 2) arrays of matching points, or refuse them.

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
        Which picture the points are of: l = F x for the left one, Fᵀ x for the right one.

    Returns
    -------
    ndarray of shape (N, 3)

    Notes
    -----
    Paper: [eq 20]. Answers to ``cv2.computeCorrespondEpilines``.
    """
    matrix = as_array(F, (3, 3), "F")
    require_choice(of, ("left", "right"), "of")
    lines = to_homogeneous(as_points(points, 2, "points")) @ (matrix.T if of == "left" else matrix)
    length = np.hypot(lines[:, 0], lines[:, 1])[:, None]
    return np.asarray(lines / np.where(length > 0, length, 1.0))


def sampson_distance(left_points: ArrayLike, right_points: ArrayLike, F: ArrayLike) -> Float:
    """Return the squared Sampson distance of each pair, (x'ᵀFx)² / ((Fx)₁² + (Fx)₂² + (Fᵀx')₁² + (Fᵀx')₂²).

    Parameters
    ----------
    left_points, right_points : array_like of shape (N, 2)
        Matching pixels.
    F : array_like of shape (3, 3)
        The fundamental matrix.

    Returns
    -------
    ndarray of shape (N,)
        Squared pixels.

    Notes
    -----
    Answers to ``cv2.sampsonDistance``.
    """
    left, right = point_pairs(left_points, right_points)
    matrix = as_array(F, (3, 3), "F")
    x, xp = to_homogeneous(left), to_homogeneous(right)
    lines_right, lines_left = x @ matrix.T, xp @ matrix
    error = np.sum(xp * lines_right, axis=1)
    return np.asarray(
        error**2 / (lines_right[:, 0] ** 2 + lines_right[:, 1] ** 2 + lines_left[:, 0] ** 2 + lines_left[:, 1] ** 2)
    )
