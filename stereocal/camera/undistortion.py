"""Undistortion maps: for every pixel of the new picture, where to look in the photograph.

A new picture is made by *inverse* mapping. A pixel (u, v) of the new pinhole camera P, turned by R, is the ray

    (x, y, w)ᵀ = (P R)⁻¹ (u, v, 1)ᵀ,     (x, y) ← (x/w, y/w),

which the real camera distorts to (x_d, y_d) and sees at (f_x x_d + c_x, f_y y_d + c_y). Distortion in this direction is a
closed formula: no iteration is needed for a map.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import Float, as_camera_matrix, as_image_size, as_rotation

if TYPE_CHECKING:
    from stereocal.camera.model import Camera

OPENCV_FAMILY = ("pinhole", "polynomial", "brown", "rational", "thin_prism", "tilted")


def opencv_coefficients(dist: ArrayLike, model: str) -> Float | None:
    """Return k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 τx τy, or None for a model outside of OpenCV's family."""
    if model not in OPENCV_FAMILY:
        return None
    given = np.ravel(np.asarray(dist, dtype=np.float64))
    padded = np.zeros(14)
    padded[: len(given)] = given
    return padded


def tilt_matrix(tau_x: float, tau_y: float) -> Float:
    """Return the homography of a sensor tilted by τx and τy (radians) against the lens."""
    cx, sx, cy, sy = np.cos(tau_x), np.sin(tau_x), np.cos(tau_y), np.sin(tau_y)
    R = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    projection = np.array([[R[2, 2], 0, -R[0, 2]], [0, R[2, 2], -R[1, 2]], [0, 0, 1]])
    return np.asarray(projection @ R)


def undistortion_maps(
    K: ArrayLike,
    dist: ArrayLike,
    image_size: Any,
    *,
    R: ArrayLike | None = None,
    P: ArrayLike | None = None,
    model: str = "brown",
    out_size: Any = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """For each pixel of the undistorted picture, its place in the photograph: (map_x, map_y).

    Parameters
    ----------
    K : array_like of shape (3, 3)
        Camera matrix of the photograph.
    dist : array_like
        Distortion coefficients of `model`.
    image_size : (int, int)
        Width and height of the photograph, and of the new picture if `out_size` is not given.
    R : array_like of shape (3, 3), optional
        Rotation from the camera's frame into the new one; identity if not given.
    P : array_like of shape (3, 3) or (3, 4), optional
        The new camera; K if not given.
    model : str
        The distortion model, see :class:`stereocal.Camera`.
    out_size : (int, int), optional
        Width and height of the new picture.

    Returns
    -------
    map_x, map_y : ndarray of shape (height, width), float32
        Pixels of the photograph.

    Notes
    -----
    Answers to ``cv2.initUndistortRectifyMap`` with ``m1type=CV_32FC1``.
    """
    K = as_camera_matrix(K)
    width, height = as_image_size(image_size if out_size is None else out_size)
    rotation = np.eye(3) if R is None else as_rotation(R)
    new = K if P is None else np.asarray(P, dtype=np.float64)[:, :3]
    inverse = np.linalg.inv(new @ rotation)
    u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ inverse.T
    points = (rays[..., :2] / rays[..., 2:]).reshape(-1, 2)
    k = opencv_coefficients(dist, model)
    if k is None:
        from stereocal.camera.distortion import distort_normalized

        seen = distort_normalized(points, np.asarray(dist, dtype=float), model)
    else:
        x, y = points.T
        r2 = x * x + y * y
        radial = (1 + ((k[4] * r2 + k[1]) * r2 + k[0]) * r2) / (1 + ((k[7] * r2 + k[6]) * r2 + k[5]) * r2)
        xd = x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x) + (k[8] + k[9] * r2) * r2
        yd = y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y + (k[10] + k[11] * r2) * r2
        tilted = np.stack([xd, yd, np.ones_like(xd)], axis=1) @ tilt_matrix(k[12], k[13]).T
        seen = tilted[:, :2] / tilted[:, 2:]
    map_x = (K[0, 0] * seen[:, 0] + K[0, 1] * seen[:, 1] + K[0, 2]).astype(np.float32).reshape(height, width)
    map_y = (K[1, 1] * seen[:, 1] + K[1, 2]).astype(np.float32).reshape(height, width)
    return map_x, map_y


def undistort_image(
    image: ArrayLike, camera: Camera, *, P: ArrayLike | None = None, interpolation: str = "bilinear"
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

    Returns
    -------
    ndarray
        The undistorted image, of the same shape and dtype.

    Notes
    -----
    Answers to ``cv2.undistort``.
    """
    from stereocal.camera.resampling import remap

    maps = undistortion_maps(camera.K, camera.dist, camera.image_size, P=P, model=camera.model)
    return remap(image, *maps, interpolation=interpolation)
