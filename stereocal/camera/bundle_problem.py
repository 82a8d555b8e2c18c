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
    counts = np.array([len(y) for corners in images for y in corners])
    seen = np.flatnonzero(counts)  # blocks in order: all views of the first camera, then of the next
    boards = [X for boards in objects for X in boards]
    points = np.concatenate(boards if counts.all() else [boards[block] for block in seen])
    measured = np.concatenate([y for corners in images for y in corners])
    offsets = np.concatenate([[0], counts[seen].cumsum()])
    views = len(objects[0])
    return Bundle(models, points, measured, offsets, seen // views, seen % views, G, views)


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
