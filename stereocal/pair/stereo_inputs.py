"""What the user of a stereo calibration passes, sorted by camera: views, and parameters by name.

A name alone is meant for both cameras, ``"left.fx"`` for one. A view that one camera missed is None there; R and T
need at least one that both saw.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from numpy.typing import ArrayLike

from stereocal.base.checks import Float
from stereocal.base.errors import DegenerateGeometryError, InputError
from stereocal.camera.views import as_views

SIDES = ("left", "right")
RIG_NAMES = ("rvec_x", "rvec_y", "rvec_z", "T_x", "T_y", "T_z")


def paired_views(
    object_points: ArrayLike | Sequence[ArrayLike], left_points: Sequence[ArrayLike], right_points: Sequence[ArrayLike]
) -> tuple[list[list[Float]], list[list[Float]]]:
    """Return boards and corners of both sides; a view that one camera missed has no rows there.

    Parameters
    ----------
    object_points, left_points, right_points
        As the user passes them.

    Returns
    -------
    objects, images : list of two lists of ndarray

    Raises
    ------
    InputError
        If the lists differ in length, or neither camera saw a view.
    DegenerateGeometryError
        If no view was seen by both.
    """
    if len(left_points) != len(right_points):
        raise InputError(
            f"left_points has {len(left_points)} views and right_points {len(right_points)}; they must be pairs, with "
            "None where one camera missed the board"
        )
    left_objects, left_images = as_views(object_points, left_points, "left_points")
    right_objects, right_images = as_views(object_points, right_points, "right_points")
    both = [i for i, (a, b) in enumerate(zip(left_images, right_images, strict=True)) if len(a) and len(b)]
    if not both:
        raise DegenerateGeometryError(
            "no view shows the board to both cameras, so that R and T are unknown; photograph the board where both "
            "see it"
        )
    empty = [i for i, (a, b) in enumerate(zip(left_images, right_images, strict=True)) if not len(a) and not len(b)]
    if empty:
        raise InputError(f"view {', '.join(map(str, empty))} has corners in neither image; leave it out")
    return [left_objects, right_objects], [left_images, right_images]


def spread_priors(priors: Mapping[str, tuple[float, float]], names: list[str]) -> dict[str, tuple[float, float]]:
    """Return priors with a camera's prefix each.

    Parameters
    ----------
    priors : mapping of str to (mean, sigma)
        As the user passes them.
    names : list of str
        All parameters of the rig.

    Returns
    -------
    dict
    """
    spread: dict[str, tuple[float, float]] = {}
    for name, known in priors.items():
        if name in RIG_NAMES[:3]:
            raise InputError(f"priors name {name!r}; a rotation takes none, T_x, T_y and T_z do")
        both = [f"{side}.{name}" for side in SIDES if f"{side}.{name}" in names]
        spread |= dict.fromkeys([name] if "." in name or not both else both, known)
    return spread


def fix_of_side(fix: str | Collection[str], side: int) -> list[str]:
    """Return the names of `fix` that hold for one camera (0 left, 1 right), without its prefix."""
    entries = [fix] if isinstance(fix, str) else list(fix)
    unknown = [e for e in entries if "." in e and e.split(".")[0] not in SIDES]
    if unknown:
        raise InputError(f"fix names {unknown[0]!r}, but the cameras are called left and right")
    return [e.removeprefix(SIDES[side] + ".") for e in entries if "." not in e or e.startswith(SIDES[side] + ".")]
