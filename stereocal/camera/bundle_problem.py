"""From lists of views to the flat arrays of a ``bundle.Bundle``, and from its θ back to cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float
from stereocal.base.errors import ConvergenceError, InputError
from stereocal.camera.bundle import Bundle
from stereocal.camera.distortion_base import DistortionModel
from stereocal.camera.model import Camera


def make_bundle(
    models: list[DistortionModel], objects: list[list[Float]], images: list[list[Float]], G: Float
) -> Bundle:
    """Return the measurements of cameras (outer list) in views (inner list) as one :class:`Bundle`."""
    points, measured, cameras, views = [], [], [], []
    for camera, (boards, corners) in enumerate(zip(objects, images, strict=True)):
        for view, (X, y) in enumerate(zip(boards, corners, strict=True)):
            if len(y):
                points.append(X)
                measured.append(y)
                cameras.append(camera)
                views.append(view)
    offsets = np.cumsum([0, *map(len, measured)])
    return Bundle(
        models, np.concatenate(points), np.concatenate(measured), offsets, np.array(cameras), np.array(views), G,
        len(objects[0]),
    )  # fmt: skip


def whitening_of(covariances: Sequence[Sequence[ArrayLike] | None], images: list[list[Float]]) -> Float | None:
    """Return the inverse square roots of all corner covariances, (M, 2, 2), or None where there are none."""
    if all(item is None for item in covariances):
        return None
    parts = []
    for per_view, corners in zip(covariances, images, strict=True):
        if per_view is None or len(per_view) != len(corners):
            raise InputError("covariances must hold one (N, 2, 2) array a view, for every camera")
        for C, y in zip(per_view, corners, strict=True):
            if len(y) == 0:
                continue
            C = np.asarray(C, dtype=np.float64)
            if C.shape != (len(y), 2, 2) or not np.all(np.isfinite(C)) or np.any(np.linalg.eigvalsh(C) <= 0):
                raise InputError(
                    "covariances must be (N, 2, 2) arrays of finite, positive definite matrices, one a view"
                )
            parts.append(np.linalg.inv(np.linalg.cholesky(C)))
    return np.concatenate(parts)


def camera_of(theta: Float, size: tuple[int, int], lens: DistortionModel) -> Camera:
    """Return the camera of θ = (fx, fy, cx, cy, s, k…)."""
    fx, fy, cx, cy, s = theta[:5]
    if fx <= 0 or fy <= 0:
        raise ConvergenceError(
            "the solver ended at a negative focal length: check the order of corners and board points"
        )
    return Camera(np.array([[fx, s, cx], [0, fy, cy], [0, 0, 1]]), theta[5:], size, lens.name)


def intrinsics_of(camera: Camera) -> Float:
    """Return θ = (fx, fy, cx, cy, s, k…) of a camera."""
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.skew, *camera.dist])
