"""Input validation, done once, at the public boundary.

A public function calls these on what it is given; inside, arrays are trusted and kernels check nothing. Each check
returns the array in the library's one layout (float64, contiguous, points as (N, 2)) or raises
:class:`~stereocal.base.errors.InputError`, which says what was given, what is needed and what to do.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.errors import InputError

Float = NDArray[np.float64]
"""An array of float64: every geometric quantity of the library."""

_FEW = 16
IMAGE_DTYPES = (np.uint8, np.uint16, np.float32, np.float64)


def as_array(value: ArrayLike, shape: tuple[int | None, ...], name: str, *, finite: bool = True) -> Float:
    """Return `value` as a contiguous float64 array of `shape`, where None stands for any length.

    Raises
    ------
    InputError
        If it is not numeric, has another shape, or holds NaN or infinity while `finite`.
    """
    try:
        array = np.ascontiguousarray(_real(value), dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be real numbers of shape {_spelt(shape)}, not {type(value).__name__}") from error
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape, strict=True)):
        raise InputError(f"{name} must have shape {_spelt(shape)}, but has {array.shape}")
    if finite:
        require_finite(array, name)
    return array


def as_points(points: ArrayLike, dimension: int, name: str, *, minimum: int = 0, finite: bool = True) -> Float:
    """Return points as an (N, dimension) float64 array.

    Parameters
    ----------
    points : array_like of shape (N, d), (N, 1, d), (1, N, d) or (d,)
        The shapes that OpenCV users pass.
    dimension : int
        d, 2 or 3.
    name : str
        The argument's name, for the message.
    minimum : int
        The least number of points that the caller can work with.
    finite : bool
        Whether NaN and infinity are refused.
    """
    try:
        array = np.asarray(_real(points), dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be an (N, {dimension}) array of real numbers") from error
    given = array.shape
    if array.ndim == 1 and array.size == dimension:
        array = array[None, :]
    elif array.ndim == 3 and 1 in array.shape[:2]:
        array = array.reshape(-1, array.shape[2])
    if array.ndim != 2 or array.shape[1] != dimension:
        raise InputError(f"{name} must have shape (N, {dimension}), but has {given}")
    if len(array) < minimum:
        raise InputError(f"{name} holds {len(array)} points, but at least {minimum} are needed")
    if finite:
        require_finite(array, name)
    return np.ascontiguousarray(array)


def as_camera_matrix(K: ArrayLike, name: str = "K") -> Float:
    """Return a 3x3 camera matrix [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with positive focal lengths."""
    matrix = as_array(K, (3, 3), name)
    (fx, _, _), (below, fy, _), last = rows = matrix.tolist()
    if below != 0 or max(abs(last[0]), abs(last[1]), abs(last[2] - 1)) > 1e-8:
        raise InputError(f"{name} must be upper triangular with a last row of 0 0 1, but is {rows}")
    if fx <= 0 or fy <= 0:
        raise InputError(f"{name} must have positive focal lengths, but has {fx:g} and {fy:g}")
    return matrix


def as_rotation(R: ArrayLike, name: str = "R") -> Float:
    """Return a 3x3 rotation matrix: orthonormal to 1e-6, determinant +1."""
    matrix = as_array(R, (3, 3), name)
    # Python's floats, one by one: numpy would take ten times as long here, longer than some functions that call this.
    # Entries near 1e308 make the first three infinite, not NaN, which would pass for a rotation.
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    lengths = a * a + b * b + c * c - 1, d * d + e * e + f * f - 1, g * g + h * h + i * i - 1
    products = a * d + b * e + c * f, a * g + b * h + c * i, d * g + e * h + f * i
    determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
    if not max(map(abs, lengths + products)) <= 1e-6 or determinant < 0:
        raise InputError(f"{name} must be a rotation matrix (orthonormal, determinant +1)")
    return matrix


def as_image_size(image_size: Any, name: str = "image_size") -> tuple[int, int]:
    """Return (width, height) as two positive ints."""
    try:
        width, height = (int(side) for side in image_size)
        whole = (width, height) == tuple(image_size)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name} must be (width, height), not {image_size!r}") from error
    if not whole:
        raise InputError(f"{name} must be whole numbers of pixels, not {tuple(image_size)}")
    if width <= 0 or height <= 0:
        raise InputError(f"{name} must be positive, but is {width}x{height}")
    return width, height


def as_image(image: ArrayLike, name: str = "image", *, channels: tuple[int, ...] = (1, 3)) -> NDArray[Any]:
    """Return an image (H, W) or (H, W, C), contiguous, of uint8, uint16, float32 or float64.

    Parameters
    ----------
    image : array_like of shape (H, W) or (H, W, C)
        An (H, W, 1) image comes back as (H, W).
    name : str
        The argument's name, for the message.
    channels : tuple of int
        The numbers of channels that the caller can work with.
    """
    array = np.asarray(image)
    if array.dtype not in IMAGE_DTYPES:
        raise InputError(f"{name} must be uint8, uint16, float32 or float64, not {array.dtype}")
    if array.ndim == 3 and array.shape[2] == 1:
        array = array[:, :, 0]
    found = 1 if array.ndim == 2 else array.shape[-1]
    if array.ndim not in (2, 3) or found not in channels:
        raise InputError(f"{name} must be (H, W) with {' or '.join(map(str, channels))} channels, but is {array.shape}")
    if array.size == 0:
        raise InputError(f"{name} is empty: its shape is {array.shape}")
    if array.dtype.kind == "f":
        require_finite(array, name)
    return np.ascontiguousarray(array)


def require_finite(array: NDArray[Any], name: str) -> None:
    """Refuse NaN and infinity."""
    if array.size <= _FEW and all(map(isfinite, array.ravel().tolist())):
        return  # matrices and coefficients, which are checked often: a third of numpy's time
    bad = array.size - int(np.count_nonzero(np.isfinite(array)))
    if bad:
        raise InputError(f"{name} holds {bad} values that are NaN or infinite; remove them first")


def require_positive(value: float, name: str) -> float:
    """Return `value` as a float if it is finite and above 0."""
    try:
        number = float(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be a number above 0, not {value!r}") from error
    if not np.isfinite(number) or number <= 0:
        raise InputError(f"{name} must be above 0, but is {number:g}")
    return number


def require_integer(value: Any, name: str, *, minimum: int, maximum: int | None = None, odd: bool = False) -> int:
    """Return `value` as an int within [minimum, maximum], odd if asked for."""
    try:
        number = int(value)
        whole = number == float(value) and not isinstance(value, bool)
    except (TypeError, ValueError, OverflowError):
        whole = False
    if not whole:
        raise InputError(f"{name} must be a whole number, not {value!r}")
    if number < minimum or (maximum is not None and number > maximum):
        limit = f"at least {minimum}" if maximum is None else f"from {minimum} to {maximum}"
        raise InputError(f"{name} must be {limit}, but is {number}")
    if odd and number % 2 == 0:
        raise InputError(f"{name} must be odd (the window has a centre pixel), but is {number}")
    return number


def require_choice(value: str, choices: tuple[str, ...], name: str) -> str:
    """Return `value` if it is one of `choices`."""
    if value not in choices:
        raise InputError(f"{name} must be one of {', '.join(choices)}, not {value!r}")
    return value


def _real(value: ArrayLike) -> NDArray[Any]:
    """Return an array that is not of complex numbers: numpy would drop their imaginary parts."""
    array = np.asarray(value)
    if array.dtype.kind == "c":
        raise TypeError("complex numbers")
    return array


def _spelt(shape: tuple[int | None, ...]) -> str:
    if shape == (None, None):
        return "(H, W)"  # a map: "(N, N)" would ask for a square one
    return (
        "(" + ", ".join("N" if side is None else str(side) for side in shape) + ("," if len(shape) == 1 else "") + ")"
    )
