"""Undistortion maps: for every pixel of the new picture, where to look in the photograph.

A new picture is made by *inverse* mapping (see ``resampling``). A pixel (u, v) of the new pinhole camera P, turned by R
against the real one, is the ray

    (X, Y, W)ᵀ = (P R)⁻¹ (u, v, 1)ᵀ,     (x, y) = (X/W, Y/W),

which the lens bends to (x_d, y_d) = x_d(x, y; k) and the sensor sees at (f_x x_d + s y_d + c_x, f_y y_d + c_y). In this
direction the lens is a closed formula for the models of OpenCV's family: a map needs no iteration.

Two maps belong together. The **undistortion map** takes pixels of the new picture to the photograph; with it one
resamples the photograph into the new picture. The **distortion map** takes pixels of the photograph to the new picture;
with it one draws something made in the new picture (a depth map, epipolar lines) over the photograph. Each is the
other's inverse.

Where the new picture shows directions that the lens formula was never fitted to, the polynomial may turn back and show
the picture's middle once more beyond its edge. :func:`valid_pixels` tells the pixels that truly come from the camera:
those whose place in the photograph, undistorted again, is the pixel itself.
"""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float, as_camera_matrix, as_image_size, as_rotation, require_choice
from stereocal.base.errors import InputError

if TYPE_CHECKING:
    from stereocal.camera.model import Camera

OPENCV_FAMILY = ("pinhole", "polynomial", "brown", "rational", "thin_prism", "tilted")
Map = NDArray[np.float32]
# A pixel and the one that its place in the photograph comes back to: further apart than this, the lens formula folds.
_RETURN_TOLERANCE = 0.5
_IDENTITY = np.eye(3)
_NO_INVERSE = "the new camera matrix P has no inverse; its focal lengths must not be 0"


def opencv_coefficients(dist: ArrayLike | None, model: str) -> Float | None:
    """Return k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 τx τy, or None for a model outside of OpenCV's family.

    Parameters
    ----------
    dist : array_like or None
        Coefficients of `model`.
    model : str
        A name of :data:`stereocal.camera.distortion.MODELS`.

    Returns
    -------
    ndarray of shape (14,) or None
    """
    from stereocal.camera.distortion import as_distortion, model_meant

    model = model_meant(dist, model)
    given = as_distortion(dist, model)
    if model not in OPENCV_FAMILY:
        return None
    padded = np.zeros(14)
    padded[: len(given)] = given
    return padded


def tilt_matrix(tau_x: float, tau_y: float) -> Float:
    """Return the homography of a sensor tilted by τx about x, then τy about y, against the lens (Scheimpflug).

    Parameters
    ----------
    tau_x, tau_y : float
        Radians.

    Returns
    -------
    ndarray of shape (3, 3)
        [[R₃₃, 0, −R₁₃], [0, R₃₃, −R₂₃], [0, 0, 1]] R, R = R_y(τy) R_x(τx); the identity for no tilt.
    """
    cx, sx, cy, sy = np.cos(tau_x), np.sin(tau_x), np.cos(tau_y), np.sin(tau_y)
    R = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    projection = np.array([[R[2, 2], 0, -R[0, 2]], [0, R[2, 2], -R[1, 2]], [0, 0, 1]])
    return np.asarray(projection @ R)


def undistortion_maps(
    K: ArrayLike,
    dist: ArrayLike | None,
    image_size: Any,
    *,
    R: ArrayLike | None = None,
    P: ArrayLike | None = None,
    model: str = "brown",
    out_size: Any = None,
    backend: str = "numba",
    out: tuple[Map, Map] | None = None,
) -> tuple[Map, Map]:
    """For each pixel of the undistorted picture, its place in the photograph: K x_d((P R)⁻¹ (u, v, 1)ᵀ; k).

    Parameters
    ----------
    K : array_like of shape (3, 3)
        Camera matrix of the photograph.
    dist : array_like or None
        Distortion coefficients of `model`.
    image_size : (int, int)
        Width and height of the photograph, and of the new picture if `out_size` is not given.
    R : array_like of shape (3, 3), optional
        Rotation from the camera's frame into the new one; identity if not given.
    P : array_like of shape (3, 3) or (3, 4), optional
        The new camera; K if not given. A fourth column (a rectified camera's) is ignored.
    model : str
        The distortion model, see :class:`stereocal.Camera`.
    out_size : (int, int), optional
        Width and height of the new picture.
    backend : {"numba", "numpy"}
        The kernel (OpenCV's family of lenses and the fisheye, without skew), or the readable reference, which takes
        every model.
    out : tuple of two ndarrays of shape (height, width), float32, optional
        Where to write the maps: fresh memory costs more time than the maps themselves.

    Returns
    -------
    map_x, map_y : ndarray of shape (height, width), float32
        Pixels of the photograph; NaN where the model has no answer. Rays from behind the camera are NaN for the
        fisheye; OpenCV's family mirrors them, as OpenCV does.

    Raises
    ------
    InputError
        If an argument has the wrong shape.

    Notes
    -----
    Answers to ``cv2.initUndistortRectifyMap`` with ``m1type=CV_32FC1``: equal to the last bit, but for about one value
    in a hundred million, where rounding decides between two neighbouring float32 numbers. For the fisheye model
    ``cv2.fisheye.initUndistortRectifyMap`` (1e-4 px).

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> x, y = sc.undistortion_maps(K, [-0.3, 0.1, 0, 0], (640, 480))
    >>> x.shape, x.dtype
    ((480, 640), dtype('float32'))
    >>> x[240, [0, 320]].round(2)  # where the edge and the middle are fetched from
    array([ 33.95, 320.  ], dtype=float32)
    """
    K = as_camera_matrix(K)
    width, height = as_image_size(image_size if out_size is None else out_size)
    require_choice(backend, ("numba", "numpy"), "backend")
    k = opencv_coefficients(dist, model)
    new = K if P is None else _left_square(P)
    turn = _IDENTITY if R is None else as_rotation(R)
    if out is None:
        # one block for both: two blocks of a megabyte go back to the system when they are freed, and the next call
        # would wait for fresh pages longer than for the maps
        map_x, map_y = np.empty((2, height, width), np.float32)
        out = map_x, map_y
    elif any(m.shape != (height, width) or m.dtype != np.float32 or not m.flags.c_contiguous for m in out):
        raise InputError(f"out must be two contiguous float32 arrays of shape ({height}, {width})")
    if backend == "numba" and (k is not None or model == "fisheye") and K[0, 1] == 0:
        _run_kernel(new, turn, k, dist, K, out)
    else:
        _maps_by_reference(inverse_of_new_camera(new, turn), dist, model, K, out)
    return out


def _run_kernel(P: Float, R: Float, k: Float | None, dist: ArrayLike | None, K: Float, out: tuple[Map, Map]) -> None:
    """Fill the maps of OpenCV's family (k), or of the fisheye (dist, where k is None)."""
    from stereocal.camera import undistortion_kernels as kernels

    (fx, _, cx), (_, fy, cy), _ = K.tolist()
    if k is None:
        from stereocal.camera.distortion import as_distortion

        determinant = kernels.fisheye_maps(P, R, as_distortion(dist, "fisheye"), fx, fy, cx, cy, *out)
    else:
        listed = k.tolist()
        tilt = _IDENTITY
        if any(listed[12:]):
            pixels = np.array([fx, fy, 1.0])
            tilt = pixels[:, None] * tilt_matrix(*listed[12:]) / pixels
        # as many coefficients as count: five, eight, twelve, fourteen
        lens = (0,) * sum(any(listed[first:]) for first in (5, 8, 12))
        determinant = kernels.lens_maps(P, R, k, tilt, fx, fy, cx, cy, lens, *out)
    if determinant == 0 or not isfinite(determinant):
        raise InputError(_NO_INVERSE)


def _maps_by_reference(B: Float, dist: ArrayLike | None, model: str, K: Float, out: tuple[Map, Map]) -> None:
    from stereocal.camera.distortion import distort_normalized, to_pixels

    map_x, map_y = out
    height, width = map_x.shape
    u = np.arange(width, dtype=float)
    for v in range(height):
        rays = np.stack([u, np.full(width, float(v)), np.ones(width)]).T @ B.T
        if model == "fisheye":
            rays[rays[:, 2] <= 0] = np.nan
        seen = to_pixels(distort_normalized(rays[:, :2] / rays[:, 2:], dist, model), K)
        map_x[v], map_y[v] = seen.T


def distortion_maps(
    K: ArrayLike,
    dist: ArrayLike | None,
    image_size: Any,
    *,
    R: ArrayLike | None = None,
    P: ArrayLike | None = None,
    model: str = "brown",
) -> tuple[Map, Map]:
    """For each pixel of the photograph, its place in the undistorted picture: P R x(K⁻¹ (u, v, 1)ᵀ; k).

    Parameters
    ----------
    K : array_like of shape (3, 3)
        Camera matrix of the photograph.
    dist : array_like or None
        Distortion coefficients of `model`.
    image_size : (int, int)
        Width and height of the photograph.
    R : array_like of shape (3, 3), optional
        Rotation from the camera's frame into the new one.
    P : array_like of shape (3, 3) or (3, 4), optional
        The new camera; K if not given.
    model : str
        The distortion model.

    Returns
    -------
    map_x, map_y : ndarray of shape (height, width), float32
        Pixels of the undistorted picture; NaN for pixels that the model cannot undo.

    Notes
    -----
    The inverse of :func:`undistortion_maps` with the same arguments. Answers to ``cv2.initInverseRectificationMap``,
    which undoes the lens in five steps only.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> x, y = sc.distortion_maps(K, [-0.3, 0.1, 0, 0], (640, 480))
    >>> x.shape, x.dtype
    ((480, 640), dtype('float32'))
    >>> x[240, [0, 320]].round(2)  # where the picture's edge and middle come to lie
    array([-49.53, 320.  ], dtype=float32)
    """
    from stereocal.camera.distortion import undistort_points

    matrix = as_camera_matrix(K)
    width, height = as_image_size(image_size)
    new = matrix if P is None else _left_square(P)
    u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    seen = undistort_points(pixels, matrix, dist, model=model, R=R, P=new).astype(np.float32)
    return (
        np.ascontiguousarray(seen[:, 0]).reshape(height, width),
        np.ascontiguousarray(seen[:, 1]).reshape(height, width),
    )


def valid_pixels(
    maps: tuple[Map, Map], camera: Camera, *, R: ArrayLike | None = None, P: ArrayLike | None = None
) -> NDArray[np.bool_]:
    """Tell which pixels of an undistorted picture truly come from the photograph.

    Parameters
    ----------
    maps : tuple of two ndarrays of shape (h, w)
        As :func:`undistortion_maps` gives them.
    camera : Camera
        The camera that took the photograph.
    R, P : array_like, optional
        What the maps were made with.

    Returns
    -------
    ndarray of shape (h, w), bool
        True where the place lies within the photograph, and undistorting it leads back to the pixel (within 0.5 px), so
        that the lens formula has not folded over.
    """
    from stereocal.camera.distortion import undistort_points

    map_x, map_y = maps
    width, height = camera.image_size
    valid = (map_x >= 0) & (map_y >= 0) & (map_x <= width - 1) & (map_y <= height - 1)
    v, u = np.nonzero(valid)
    if len(u):
        places = np.stack([map_x[v, u], map_y[v, u]], axis=1).astype(float)
        back = undistort_points(
            places, camera.K, camera.dist, model=camera.model, R=R, P=camera.K if P is None else _left_square(P)
        )
        with np.errstate(invalid="ignore"):
            valid[v, u] = np.hypot(back[:, 0] - u, back[:, 1] - v) < _RETURN_TOLERANCE
    return np.asarray(valid)


def undistort_image(
    image: ArrayLike,
    camera: Camera,
    *,
    P: ArrayLike | None = None,
    interpolation: str = "bilinear",
    border_value: float = 0,
) -> NDArray[Any]:
    """Take the lens distortion out of an image.

    Parameters
    ----------
    image : array_like of shape (H, W) or (H, W, C)
        The photograph.
    camera : Camera
        Its camera.
    P : array_like of shape (3, 3), optional
        The new camera matrix; the camera's own K if not given.
    interpolation : {"bilinear", "nearest", "bicubic"}
        See :func:`stereocal.remap`.
    border_value : float
        What stands where the camera did not look.

    Returns
    -------
    ndarray
        The undistorted image, of the same shape and dtype.

    Raises
    ------
    InputError
        If the image has not the size that the camera was calibrated at.

    Notes
    -----
    Answers to ``cv2.undistort``.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> camera = sc.Camera(K, [-0.3, 0.1, 0, 0], (640, 480))
    >>> image = np.full((480, 640), 200, np.uint8)
    >>> straight = sc.undistort_image(image, camera)
    >>> straight.shape, int(straight[240, 320])
    ((480, 640), 200)
    """
    from stereocal.camera.resampling import remap

    require_size(image, camera, "image")
    maps = undistortion_maps(camera.K, camera.dist, camera.image_size, P=P, model=camera.model)
    return remap(image, *maps, interpolation=interpolation, border_value=border_value)


def require_size(image: ArrayLike, camera: Camera, name: str) -> None:
    """Refuse an image whose size is not the one that its camera was calibrated at.

    Raises
    ------
    InputError
        Which names both sizes.
    """
    shape = np.shape(image)
    width, height = camera.image_size
    if len(shape) < 2 or (shape[1], shape[0]) != (width, height):
        given = f"{shape[1]}x{shape[0]}" if len(shape) >= 2 else f"of shape {shape}"
        raise InputError(
            f"the {name} is {given}, but its camera was calibrated at {width}x{height}; "
            "give images of the calibrated size"
        )


def inverse_of_new_camera(P: Float, R: Float) -> Float:
    """Return (P R)⁻¹, which takes a pixel of the new camera to its ray in the old camera's frame.

    Parameters
    ----------
    P, R : ndarray of shape (3, 3)
        The new camera matrix and the rotation into its frame.

    Returns
    -------
    ndarray of shape (3, 3)

    Raises
    ------
    InputError
        If P has no inverse.
    """
    M = P @ R
    determinant = float(np.linalg.det(M))
    if determinant == 0 or not isfinite(determinant):
        raise InputError(_NO_INVERSE)
    return np.asarray(np.linalg.inv(M))


def _left_square(P: ArrayLike) -> Float:
    matrix = np.asarray(P, dtype=np.float64)
    if matrix.shape not in ((3, 3), (3, 4)):
        raise InputError(f"P must have shape (3, 3) or (3, 4), but has {matrix.shape}")
    return np.ascontiguousarray(matrix[:, :3])
