"""What the user passes as points, in one layout, and what is wrong with it in a sentence.

Object points may be one (N, 3) array for all views or a list with one a view; image points are a list of (N, 2).
Every shape that OpenCV's functions accept is accepted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_points
from stereocal.base.errors import DegenerateGeometryError, InputError

MIN_POINTS = 4


def as_views(
    object_points: ArrayLike | Sequence[ArrayLike], image_points: Sequence[ArrayLike], *names: str
) -> tuple[list[Float], list[Float]]:
    """Return object points and image points as two lists, one array a view.

    Parameters
    ----------
    object_points : array_like of shape (N, 3), or sequence of them
        Board points, z = 0 for a flat board.
    image_points : sequence of array_like of shape (N, 2)
        Their images; None stands for a view that the camera missed.
    *names : str
        Name of the image points' argument, for messages.

    Returns
    -------
    object_points, image_points : list of ndarray
        A missed view has arrays of no rows.

    Raises
    ------
    InputError
        If the lists differ in length or the arrays in their number of points, or any is not finite.
    """
    name = names[0] if names else "image_points"
    views = list(image_points)
    boards = _boards(object_points, len(views))
    objects, images = [], []
    for i, (board, image) in enumerate(zip(boards, views, strict=True)):
        if image is None or np.size(image) == 0:
            objects.append(np.zeros((0, 3)))
            images.append(np.zeros((0, 2)))
            continue
        points = as_points(image, 2, f"{name}[{i}]", minimum=MIN_POINTS)
        if len(board) != len(points):
            raise InputError(
                f"{name}[{i}] holds {len(points)} points, but object_points has {len(board)} for that view; "
                "each board point needs its image"
            )
        objects.append(board)
        images.append(points)
    return objects, images


def _boards(object_points: ArrayLike | Sequence[ArrayLike], count: int) -> list[Float]:
    """One (N, 3) board a view."""
    if isinstance(object_points, np.ndarray) and (object_points.ndim == 2 or 1 in object_points.shape[:2]):
        one = object_points.ndim == 2 or object_points.shape[0] == 1 or count != object_points.shape[0]
        if one:
            return [as_points(object_points, 3, "object_points", minimum=MIN_POINTS)] * count
    items = list(object_points)  # type: ignore[arg-type]
    if items and np.ndim(items[0]) == 1:
        return [as_points(np.asarray(items), 3, "object_points", minimum=MIN_POINTS)] * count
    if len(items) != count:
        raise InputError(
            f"object_points has {len(items)} views, image points {count}; pass one (N, 3) board for all views, "
            "or one a view"
        )
    return [as_points(item, 3, f"object_points[{i}]", minimum=MIN_POINTS) for i, item in enumerate(items)]


def require_not_collinear(objects: list[Float], images: list[Float], name: str) -> None:
    """Refuse views whose points lie on one line, in the board or in the image.

    Raises
    ------
    DegenerateGeometryError
        Names the views.
    """
    bad = [i for i, (X, y) in enumerate(zip(objects, images, strict=True)) if len(y) and (_is_line(X) or _is_line(y))]
    if bad:
        raise DegenerateGeometryError(
            f"the points of {name} in view {', '.join(map(str, bad))} lie on one line, which fixes no pose; leave "
            "these views out, or photograph the board less edge-on"
        )


def _is_line(points: Float) -> bool:
    extent = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(extent[1] <= 1e-9 * extent[0])
