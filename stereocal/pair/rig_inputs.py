"""What the user of a rig's calibration passes, sorted by camera: views, and parameters by name.

A name alone is meant for every camera, ``"left.fx"`` (of a pair) or ``"camera2.fx"`` (of more) for one. A view that a
camera missed is None there. Where the cameras stand to each other is told by views that several of them saw: from each
camera to the first there must be a way over such views.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float
from stereocal.base.errors import DegenerateGeometryError, InputError
from stereocal.camera.views import as_views

SIDES = ("left", "right")
MOTION_NAMES = ("rvec_x", "rvec_y", "rvec_z", "T_x", "T_y", "T_z")

Views = tuple[list[list[Float]], list[list[Float]]]


def paired_views(
    object_points: ArrayLike | Sequence[ArrayLike], left_points: Sequence[ArrayLike], right_points: Sequence[ArrayLike]
) -> Views:
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


def rig_views(
    object_points: ArrayLike | Sequence[ArrayLike], image_points: Sequence[Sequence[ArrayLike | None]]
) -> Views:
    """Return boards and corners of any number of cameras; a view that a camera missed has no rows there.

    Parameters
    ----------
    object_points, image_points
        As the user passes them.

    Returns
    -------
    objects, images : list of lists of ndarray
        One list a camera.

    Raises
    ------
    InputError
        If there are fewer than two cameras, the lists differ in length, or no camera saw a view.
    DegenerateGeometryError
        If no chain of views that two cameras saw leads from a camera to the first.
    """
    cameras = list(image_points)
    if len(cameras) < 2:
        raise InputError(
            f"image_points holds {len(cameras)} camera{'s' * (len(cameras) != 1)}; a rig has at least two (one list of "
            "views each); calibrate_camera takes one"
        )
    counts = [len(views) for views in cameras]
    if len(set(counts)) > 1:
        raise InputError(
            f"image_points has {', '.join(map(str, counts))} views of the cameras; each camera needs one entry a view, "
            "None where it missed the board"
        )
    sorted_out = [as_views(object_points, views, f"image_points[{c}]") for c, views in enumerate(cameras)]  # type: ignore[arg-type]
    objects, images = [o for o, _ in sorted_out], [y for _, y in sorted_out]
    seen = np.array([[len(y) > 0 for y in views] for views in images])
    empty = np.flatnonzero(~seen.any(axis=0))
    if len(empty):
        raise InputError(f"view {', '.join(map(str, empty))} has corners in no image; leave it out")
    reached = seen[0].copy()
    inside = {0}
    while further := {c for c in range(len(seen)) if c not in inside and (seen[c] & reached).any()}:
        inside |= further
        reached |= seen[sorted(further)].any(axis=0)
    outside = [c for c in range(len(seen)) if c not in inside]
    if outside:
        raise DegenerateGeometryError(
            f"camera {', '.join(map(str, outside))} shares no view with camera {', '.join(map(str, sorted(inside)))}, "
            "so that where it stands to them is unknown; photograph the board where cameras of both groups see it"
        )
    return objects, images


def spread_priors(
    priors: Mapping[str, tuple[float, float]], names: Sequence[str], cameras: Sequence[str]
) -> dict[str, tuple[float, float]]:
    """Return priors with a camera's prefix each.

    Parameters
    ----------
    priors : mapping of str to (mean, sigma)
        As the user passes them.
    names : sequence of str
        All parameters of the rig.
    cameras : sequence of str
        Prefixes.

    Returns
    -------
    dict
    """
    spread: dict[str, tuple[float, float]] = {}
    # one that names its camera is written last, over one that is meant for all
    for name, known in sorted(priors.items(), key=lambda item: "." in item[0]):
        if name.rpartition(".")[2] in MOTION_NAMES[:3]:
            raise InputError(f"priors name {name!r}; a rotation takes none, T_x, T_y and T_z do")
        every = [f"{camera}.{name}" for camera in cameras if f"{camera}.{name}" in names]
        spread |= dict.fromkeys(every or [name], known)
    return spread


def fix_of_camera(fix: str | Collection[str], camera: str, parameters: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the names of `fix` that hold for one camera, without its prefix.

    Parameters
    ----------
    fix : str or collection of str
        As the user passes it.
    camera : str
        This camera's prefix.
    parameters : mapping of str to sequence of str
        By each camera's prefix, the names of its parameters.

    Returns
    -------
    list of str
        A name alone, of a lens that others have and this one has not, is not among them.

    Raises
    ------
    InputError
        If a prefix is no camera's.
    """
    entries = [str(entry) for entry in ([fix] if isinstance(fix, str) else fix)]
    unknown = [e for e in entries if "." in e and e.split(".")[0] not in parameters]
    if unknown:
        *names, last = parameters
        raise InputError(f"fix names {unknown[0]!r}, but the cameras are called {', '.join(names)} and {last}")
    elsewhere = {name for names in parameters.values() for name in names} - set(parameters[camera])
    return [
        entry.removeprefix(camera + ".")
        for entry in entries
        if entry.startswith(camera + ".") or ("." not in entry and entry not in elsewhere)
    ]
