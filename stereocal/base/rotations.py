"""Rotations as vectors and matrices: Rodrigues' formula, its inverse and its derivative.

A rotation vector r = θ·a turns by the angle θ about the unit axis a. With [a]ₓ the cross-product matrix,

    R(r) = I + sin θ [a]ₓ + (1 − cos θ) [a]ₓ².

Written with s = sin θ / θ and c = (1 − cos θ) / θ² it reads R = I + s [r]ₓ + c [r]ₓ², which has no division left that
fails at θ = 0 once s and c are taken from their series there.

The derivative follows from the exponential map: ∂R/∂rᵢ = [J_l(r) eᵢ]ₓ R, J_l the left Jacobian of SO(3),

    J_l(r) = I + c [r]ₓ + d [r]ₓ²,   d = (θ − sin θ) / θ³.

Sources: Rodrigues (1840); Gallego and Yezzi, *A compact formula for the derivative of a 3-D rotation in exponential
coordinates*, JMIV 51 (2015); Barfoot, *State Estimation for Robotics* (2017), section 7.1.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_array, as_rotation
from stereocal.base.homogeneous import cross_matrix

# Below this angle the series, cut after the θ⁴ term, is exact to the last bit and the closed forms are not.
_SMALL_ANGLE = 1e-2
# r @ this is ½[r]ₓ, its nine entries in a row.
_HALF_CROSS = 0.5 * np.array([[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]])


def _coefficients(theta: float) -> tuple[float, float, float]:
    """Return s = sin θ/θ, c = (1 − cos θ)/θ², d = (θ − sin θ)/θ³."""
    if theta < _SMALL_ANGLE:
        t2 = theta * theta
        return 1 - t2 / 6 + t2 * t2 / 120, 0.5 - t2 / 24 + t2 * t2 / 720, 1 / 6 - t2 / 120 + t2 * t2 / 5040
    return np.sin(theta) / theta, (1 - np.cos(theta)) / theta**2, (theta - np.sin(theta)) / theta**3


def rotation_matrix(rvec: ArrayLike) -> Float:
    """Rodrigues' formula: R = I + sin θ [a]ₓ + (1 − cos θ) [a]ₓ².

    Parameters
    ----------
    rvec : array_like of 3 numbers
        Axis times angle, radians.

    Returns
    -------
    ndarray of shape (3, 3), float64

    Notes
    -----
    Answers to ``cv2.Rodrigues`` (agreement 1e-14).

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> sc.rotation_matrix([0, 0, np.pi / 2]).round(6) + 0.0
    array([[ 0., -1.,  0.],
           [ 1.,  0.,  0.],
           [ 0.,  0.,  1.]])
    """
    r = as_array(np.ravel(np.asarray(rvec)), (3,), "rvec")
    s, c, _ = _coefficients(float(np.linalg.norm(r)))
    rx = cross_matrix(r)
    return np.eye(3) + s * rx + c * (rx @ rx)


def rotation_matrix_jacobian(rvec: ArrayLike) -> Float:
    """Derivative of Rodrigues' formula, ∂R/∂rᵢ = [J_l(r) eᵢ]ₓ R.

    Parameters
    ----------
    rvec : array_like of 3 numbers
        Axis times angle, radians.

    Returns
    -------
    ndarray of shape (3, 3, 3), float64
        Entry [i] is the 3x3 matrix ∂R/∂rᵢ.
    """
    r = as_array(np.ravel(np.asarray(rvec)), (3,), "rvec")
    s, c, d = _coefficients(float(np.linalg.norm(r)))
    rx = cross_matrix(r)
    R = np.eye(3) + s * rx + c * (rx @ rx)
    J_left = np.eye(3) + c * rx + d * (rx @ rx)
    return np.stack([cross_matrix(J_left[:, i]) @ R for i in range(3)])


def rotation_vector(R: ArrayLike) -> Float:
    """Inverse of Rodrigues' formula: the rotation vector of R, angle in [0, π].

    Parameters
    ----------
    R : array_like of shape (3, 3)
        A rotation matrix, orthonormal to 1e-6.

    Returns
    -------
    ndarray of shape (3,), float64

    Raises
    ------
    InputError
        If R is not a rotation.

    Notes
    -----
    By way of the unit quaternion, computed from its largest component (Shepperd, 1978): exact near θ = 0 and near
    θ = π, where the textbook's arccos((trace R − 1)/2) loses half the digits.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> R = sc.rotation_matrix([0.1, -0.2, 0.3])
    >>> sc.rotation_vector(R).round(6)
    array([ 0.1, -0.2,  0.3])
    """
    m = as_rotation(R)
    trace = float(np.trace(m))
    squares = np.array([trace, m[0, 0], m[1, 1], m[2, 2]])
    largest = int(np.argmax(squares))
    if largest == 0:
        q = np.array([1 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    else:
        i = largest - 1
        j, k = (i + 1) % 3, (i + 2) % 3
        q = np.empty(4)
        q[0] = m[k, j] - m[j, k]
        q[1 + i] = 1 + 2 * m[i, i] - trace
        q[1 + j] = m[j, i] + m[i, j]
        q[1 + k] = m[k, i] + m[i, k]
    q /= np.linalg.norm(q)
    if q[0] < 0:
        q = -q
    length = float(np.linalg.norm(q[1:]))
    if length < 1e-300:
        return np.zeros(3)
    return np.asarray(2 * np.arctan2(length, q[0]) / length * q[1:])


def rotation_matrices(rvecs: Float) -> Float:
    """Rodrigues' formula for many vectors at once: (V, 3) to (V, 3, 3); see :func:`rotation_matrix`."""
    theta2 = np.sum(rvecs * rvecs, axis=1)
    theta = np.sqrt(theta2)
    small = theta < _SMALL_ANGLE
    safe = np.where(small, 1.0, theta)
    s = np.where(small, 1 - theta2 / 6 + theta2**2 / 120, np.sin(safe) / safe)
    c = np.where(small, 0.5 - theta2 / 24 + theta2**2 / 720, (1 - np.cos(safe)) / safe**2)
    rx = cross_matrices(rvecs)
    return np.asarray(np.eye(3) + s[:, None, None] * rx + c[:, None, None] * (rx @ rx))


def rotation_vectors(R: Float) -> Float:
    """Inverse of Rodrigues' formula for many rotations at once: (V, 3, 3) to (V, 3); see :func:`rotation_vector`.

    The unit quaternion is a column of qqᵀ, of which each rotation gives all entries (times 4); the column with the
    largest diagonal loses no digits.
    """
    d0, d1, d2 = R[:, 0, 0], R[:, 1, 1], R[:, 2, 2]
    a, b, c = R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]
    w = 1 + d0 + d1 + d2
    if len(R) and w.min() > 1:  # none turns by more than 120 degrees: the first column is as good as any
        q = np.array([w, a, b, c])
    else:
        xy, xz, yz = R[:, 0, 1] + R[:, 1, 0], R[:, 0, 2] + R[:, 2, 0], R[:, 1, 2] + R[:, 2, 1]
        columns = np.array([
            [w, a, b, c],
            [a, 1 + d0 - d1 - d2, xy, xz],
            [b, xy, 1 - d0 + d1 - d2, yz],
            [c, xz, yz, 1 - d0 - d1 + d2],
        ])  # fmt: skip
        best = np.argmax(columns[range(4), range(4)], axis=0)
        q = columns[best, :, np.arange(len(R))].T
        q = np.where(q[0] < 0, -q, q)
    length = np.sqrt(q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
    factor = 2 * np.arctan2(length, q[0]) / np.where(length > 1e-300, length, 1.0)
    return np.ascontiguousarray((factor * q[1:]).T)


def left_jacobian_inverse(rvecs: Float) -> Float:
    """Return J_l(r)⁻¹ = I − ½[r]ₓ + d [r]ₓ² = a I − ½[r]ₓ + d r rᵀ of vectors (V, 3): (V, 3, 3).

    A small turn ω on the left of exp([r]ₓ) changes r by J_l(r)⁻¹ ω. a = (θ/2) cot(θ/2) and d = (1 − a) / θ². Where θ is
    small, 1 − a is little more than rounding, but then it counts no more than that in J_l⁻¹ either.
    """
    theta = np.maximum(np.sqrt(np.einsum("vi,vi->v", rvecs, rvecs)), 1e-8)
    half = 0.5 * theta
    a = half / np.tan(half)
    J = (rvecs * ((1 - a) / (theta * theta))[:, None])[:, :, None] * rvecs[:, None, :]
    rows = J.reshape(len(J), 9)
    rows -= rvecs @ _HALF_CROSS
    rows[:, ::4] += a[:, None]
    return np.asarray(J)


def cross_matrices(vectors: Float) -> Float:
    """Return [v]ₓ of vectors (V, 3): (V, 3, 3)."""
    out = np.zeros((len(vectors), 3, 3))
    out[:, 2, 1], out[:, 0, 2], out[:, 1, 0] = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    out[:, 1, 2], out[:, 2, 0], out[:, 0, 1] = -vectors[:, 0], -vectors[:, 1], -vectors[:, 2]
    return out
