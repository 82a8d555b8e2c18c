"""What the user passes as points, in one layout, and what is wrong with it in a sentence.

Object points may be one (N, 3) array for all views or a list with one a view; image points are a list of (N, 2).
Every shape that OpenCV's functions accept is accepted.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_points
from stereocal.base.errors import InputError

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
    try:
        views = list(image_points)
    except TypeError as error:
        kind = type(image_points).__name__
        raise InputError(f"{name} must be a list of (N, 2) arrays, one a view, not {kind}") from error
    fast = _alike(object_points, views)
    if fast is not None:
        return fast
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


def _alike(
    object_points: ArrayLike | Sequence[ArrayLike], views: list[ArrayLike]
) -> tuple[list[Float], list[Float]] | None:
    """The usual case at once: one board, and corners of equal shape in every view; None if it is not that."""
    one = object_points
    if isinstance(one, list) and len(one) == len(views) and all(board is one[0] for board in one):
        one = one[0]
    if not isinstance(one, np.ndarray) or one.ndim != 2 or one.shape[1:] != (3,) or not views:
        return None
    board = np.ascontiguousarray(one, dtype=np.float64)
    try:
        stacked = np.array(views)
        stacked = stacked.astype(np.float64, casting="same_kind" if stacked.dtype.kind == "c" else "unsafe")
    except (TypeError, ValueError):  # of several lengths, missed, or no real numbers: view by view, then
        return None
    if stacked.size != 2 * len(views) * len(board) or stacked.shape[-1] != 2 or len(board) < MIN_POINTS:
        return None
    if not (np.isfinite(stacked).all() and np.isfinite(board).all()):
        return None
    return [board] * len(views), list(stacked.reshape(len(views), -1, 2))


def _boards(object_points: ArrayLike | Sequence[ArrayLike], count: int) -> list[Float]:
    """One (N, 3) board a view."""
    if isinstance(object_points, np.ndarray) and (object_points.ndim == 2 or 1 in object_points.shape[:2]):
        one = object_points.ndim == 2 or object_points.shape[0] == 1 or count != object_points.shape[0]
        if one:
            return [as_points(object_points, 3, "object_points", minimum=MIN_POINTS)] * count
    if object_points is None:
        raise InputError("object_points must be an (N, 3) array of the board's points, or one a view, not None")
    items = list(object_points)  # type: ignore[arg-type]
    if items and np.ndim(items[0]) == 1:
        return [as_points(np.asarray(items), 3, "object_points", minimum=MIN_POINTS)] * count
    if len(items) != count:
        raise InputError(
            f"object_points has {len(items)} views, image points {count}; pass one (N, 3) board for all views, "
            "or one a view"
        )
    return [as_points(item, 3, f"object_points[{i}]", minimum=MIN_POINTS) for i, item in enumerate(items)]
