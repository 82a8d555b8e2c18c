"""Distorting and undistorting points, with any of the library's models by name.

==================  =====  ===========================================================  =============================
model               k      what                                                         class
==================  =====  ===========================================================  =============================
pinhole             0      none (a skew may stand in K[0, 1])                           ``distortion_polynomial``
polynomial          2      k1 k2: the paper's, in the usual direction [eq 18]           ``distortion_polynomial``
polynomial_printed  2      k1 k2: the paper's as printed, distorted → ideal [eq 18]     ``distortion_polynomial``
brown               5      k1 k2 p1 p2 k3: OpenCV's default                             ``distortion_brown``
rational            8      … k4 k5 k6                                                   ``distortion_brown``
thin_prism          12     … s1 s2 s3 s4                                                ``distortion_brown``
tilted              14     … τx τy                                                      ``distortion_brown``
fisheye             4      k1 k2 k3 k4: Kannala–Brandt, as cv2.fisheye                  ``distortion_fisheye``
fov                 1      ω: field of view [eq 15]                                     ``distortion_fov``
division            1      k [eq 16]                                                    ``distortion_division``
rational_function   18     W, 3×6, row by row [eq 17]                                   ``distortion_rational_function``
==================  =====  ===========================================================  =============================

Where the model is not named, 8, 12 or 14 coefficients stand for rational, thin_prism or tilted, as in OpenCV.

Pixels and the normalised plane are joined by p = K (x, 1): [u, v] = [fx x + s y + cx, fy y + cy].
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import (
    Float,
    as_array,
    as_camera_matrix,
    as_points,
    as_rotation,
    require_choice,
    require_finite,
)
from stereocal.base.errors import InputError
from stereocal.camera.distortion_base import DistortionModel
from stereocal.camera.distortion_brown import Brown, Rational, ThinPrism, Tilted
from stereocal.camera.distortion_division import Division
from stereocal.camera.distortion_fisheye import Fisheye
from stereocal.camera.distortion_fov import FieldOfView
from stereocal.camera.distortion_polynomial import Pinhole, Polynomial, PolynomialPrinted
from stereocal.camera.distortion_rational_function import RationalFunction

_CLASSES: tuple[type[DistortionModel], ...] = (
    Pinhole, Polynomial, PolynomialPrinted, Brown, Rational, ThinPrism, Tilted,
    Fisheye, FieldOfView, Division, RationalFunction,
)  # fmt: skip
MODELS: dict[str, DistortionModel] = {model.name: model() for model in _CLASSES}
"""Every distortion model by its name."""

_FAMILY_BY_LENGTH = {8: "rational", 12: "thin_prism", 14: "tilted"}


def distortion_model(name: str) -> DistortionModel:
    """Return the model of that name.

    Parameters
    ----------
    name : str
        A key of :data:`MODELS`.

    Returns
    -------
    DistortionModel

    Raises
    ------
    InputError
        If there is none; the message lists those there are.
    """
    if not isinstance(name, str) or name not in MODELS:
        raise InputError(f"model must be one of {', '.join(MODELS)}, not {name!r}")
    return MODELS[name]


def model_meant(dist: ArrayLike | None, model: str) -> str:
    """Return the model that coefficients are of: OpenCV tells its models by their number, 5, 8, 12 or 14.

    Parameters
    ----------
    dist : array_like or None
        Coefficients.
    model : str
        What the caller says. Only ``"brown"``, the default everywhere, is open to correction, and only by 8, 12 or 14
        numbers of which one beyond the fifth is not 0.

    Returns
    -------
    str
    """
    longer = _FAMILY_BY_LENGTH.get(int(np.size(dist))) if model == "brown" and dist is not None else None
    return longer if longer is not None and np.any(np.ravel(np.asarray(dist))[5:]) else model


def as_distortion(dist: ArrayLike | None, model: str = "brown") -> Float:
    """Return the coefficients k of a model as a flat array of its full length.

    Parameters
    ----------
    dist : array_like or None
        In any shape that OpenCV uses, (n,), (1, n) or (n, 1). None is the lens without distortion; a list shorter
        than the model's is filled up with that lens's values, as OpenCV does; trailing zeros beyond the model's
        length are cut.
    model : str
        The model.

    Returns
    -------
    ndarray of shape (n,)

    Raises
    ------
    InputError
        If there are more coefficients than the model has, or any is not finite.
    """
    chosen = distortion_model(model)
    k = chosen.neutral()
    if dist is None:
        return k
    try:
        given = np.asarray(dist, dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise InputError("dist must be a list of numbers") from error
    require_finite(given, "dist")
    if len(given) > len(k) and given[len(k) :].any():
        names = " ".join(chosen.parameter_names) or "none"
        raise InputError(f"dist holds {len(given)} coefficients, but model {model!r} has {len(k)} ({names})")
    k[: min(len(given), len(k))] = given[: len(k)]
    return k


def distort_normalized(x: ArrayLike, dist: ArrayLike | None, model: str = "brown") -> Float:
    """Return x_d(x; k), the distorted place of points on the normalised plane z = 1.

    Parameters
    ----------
    x : array_like of shape (N, 2), (N, 1, 2) or (1, N, 2)
        Ideal points (X/Z, Y/Z).
    dist : array_like or None
        Coefficients k of the model.
    model : str
        A key of :data:`MODELS`.

    Returns
    -------
    ndarray of shape (N, 2)
        NaN where the model has no answer (backward models, outside of their domain).
    """
    model = model_meant(dist, model)
    return distortion_model(model).distort(as_points(x, 2, "x", finite=False), as_distortion(dist, model))


def undistort_normalized(
    x: ArrayLike, dist: ArrayLike | None, model: str = "brown", *, backend: str = "numba"
) -> Float:
    """Return the x with x_d(x; k) given, on the normalised plane z = 1.

    Parameters
    ----------
    x : array_like of shape (N, 2), (N, 1, 2) or (1, N, 2)
        Distorted points.
    dist : array_like or None
        Coefficients k of the model.
    model : str
        A key of :data:`MODELS`.
    backend : {"numba", "numpy"}
        The compiled kernel, where the model has one (OpenCV's family, fisheye, rational_function), or the reference in
        NumPy. They agree to 1e-12.

    Returns
    -------
    ndarray of shape (N, 2)
        Exact to 1e-12; NaN where the point is outside of the region in which the model can be undone (its domain, see
        ``distortion_inverse``): ``np.isnan(result[:, 0])`` is the mask.
    """
    require_choice(backend, ("numba", "numpy"), "backend")
    model = model_meant(dist, model)
    chosen = distortion_model(model)
    undistort = chosen.undistort_compiled if backend == "numba" else chosen.undistort
    return undistort(as_points(x, 2, "x", finite=False), as_distortion(dist, model))


def to_normalized(points: Float, K: Float) -> Float:
    """Return x = K⁻¹ p of pixels (N, 2): y = (v − cy)/fy, x = (u − cx − s y)/fx."""
    y = (points[:, 1] - K[1, 2]) / K[1, 1]
    return np.column_stack([(points[:, 0] - K[0, 2] - K[0, 1] * y) / K[0, 0], y])


def to_pixels(x: Float, K: Float) -> Float:
    """Return p = K x of normalised points (N, 2): u = fx x + s y + cx, v = fy y + cy."""
    return np.column_stack([K[0, 0] * x[:, 0] + K[0, 1] * x[:, 1] + K[0, 2], K[1, 1] * x[:, 1] + K[1, 2]])


def distort_points(points: ArrayLike, K: ArrayLike, dist: ArrayLike | None, *, model: str = "brown") -> Float:
    """Move ideal pixels to where the lens draws them: p ↦ K x_d(K⁻¹p; k).

    Parameters
    ----------
    points : array_like of shape (N, 2), (N, 1, 2) or (1, N, 2)
        Pixels of the ideal pinhole camera with matrix K.
    K : array_like of shape (3, 3)
        Camera matrix.
    dist : array_like or None
        Coefficients of the model.
    model : str
        A key of :data:`MODELS`.

    Returns
    -------
    ndarray of shape (N, 2)
        Pixels of the real camera; NaN where the model has no answer.

    Notes
    -----
    Inverse of :func:`undistort_points` with its default frame. OpenCV 5.0's ``cv2.distortPoints`` takes
    normalised points.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> sc.distort_points([[520.0, 240.0]], K, [-0.3, 0.1]).round(4)
    array([[510.912, 240.   ]])
    """
    matrix = as_camera_matrix(K)
    x = to_normalized(as_points(points, 2, "points", finite=False), matrix)
    return to_pixels(distort_normalized(x, dist, model), matrix)


def undistort_points(
    points: ArrayLike,
    K: ArrayLike,
    dist: ArrayLike | None,
    *,
    model: str = "brown",
    R: ArrayLike | None = None,
    P: ArrayLike | None = None,
) -> Float:
    """Move pixels of the real camera to where an ideal one would draw them: p ↦ P R x(K⁻¹p).

    Parameters
    ----------
    points : array_like of shape (N, 2), (N, 1, 2) or (1, N, 2)
        Pixels of the real camera.
    K : array_like of shape (3, 3)
        Camera matrix.
    dist : array_like or None
        Coefficients of the model.
    model : str
        A key of :data:`MODELS`.
    R : array_like of shape (3, 3), optional
        Rotation from the camera's frame to that of the answer (rectification's R1 or R2).
    P : array_like of shape (3, 3) or (3, 4), optional
        Camera matrix of the answer, K unless given. Use the identity for points on the normalised plane.

    Returns
    -------
    ndarray of shape (N, 2)
        Pixels of the camera P. NaN where the lens model cannot be undone (see ``distortion_inverse``), or where R
        turns the ray behind the camera.

    Notes
    -----
    Answers to ``cv2.undistortPoints``, with two differences: without P it returns pixels of K, OpenCV the
    normalised plane; and OpenCV stops after five iterations and returns a wrong point where there is none.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> sc.undistort_points([[517.632, 240.0]], K, [-0.3, 0.1, 0, 0]).round(2)
    array([[527.78, 240.  ]])
    """
    matrix = as_camera_matrix(K)
    x = undistort_normalized(to_normalized(as_points(points, 2, "points", finite=False), matrix), dist, model)
    if R is not None:
        rays = np.column_stack([x, np.ones(len(x))]) @ as_rotation(R).T
        front = rays[:, 2:] > 0
        x = np.where(front, rays[:, :2] / np.where(front, rays[:, 2:], 1.0), np.nan)
    return to_pixels(x, matrix if P is None else _left_3x3(P))


def _left_3x3(P: ArrayLike) -> Float:
    matrix = np.asarray(P, dtype=np.float64)
    return as_array(matrix[:, :3] if matrix.shape == (3, 4) else matrix, (3, 3), "P")
