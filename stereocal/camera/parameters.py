"""Which parameters a calibration frees, holds or ties, by name.

A camera's parameters are fx, fy, cx, cy, skew and those of its lens model. ``fix=`` takes their names, and these for
groups:

=====================  ===============
``"focal_length"``     fx, fy
``"principal_point"``  cx, cy
``"tangential"``       p1, p2
``"distortion"``       all of the lens
=====================  ===============

In a rig a name alone is meant for every camera; ``"left.k3"`` or ``"right.k3"`` for one. A tie fx = a·fy
(``aspect_ratio=a``) leaves one unknown of two, and so does a parameter that the two cameras of a rig share
(``share="focal_length"``: two cameras of one make, zoomed alike). All end up in one matrix G, δ(all) = G δ(free); see
``bundle``.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import InputError
from stereocal.camera.bundle import INTRINSIC_NAMES, BundleState
from stereocal.camera.distortion_base import DistortionModel

GROUPS = {
    "focal_length": ("fx", "fy"),
    "principal_point": ("cx", "cy"),
    "tangential": ("p1", "p2"),
}


def intrinsic_names(model: DistortionModel) -> tuple[str, ...]:
    """Return fx, fy, cx, cy, skew and the names of the model's own parameters."""
    return INTRINSIC_NAMES + model.parameter_names


def fixed_names(
    model: DistortionModel, fix: str | Collection[str], *, skew: bool, camera: str = "", cameras: Sequence[str] = ()
) -> set[str]:
    """Return the names of one camera's parameters that are held.

    Parameters
    ----------
    model : DistortionModel
        Its lens model.
    fix : str or collection of str
        Names and groups, with or without a camera's prefix.
    skew : bool
        Whether the skew is free.
    camera : str
        This camera's prefix, such as ``"left"``.
    cameras : sequence of str
        All prefixes there are.

    Returns
    -------
    set of str

    Raises
    ------
    InputError
        If a name is none of the model's; the message lists those that are.
    """
    known = intrinsic_names(model)
    held = set(model.fixed_by_default) | (set() if skew else {"skew"})
    for entry in [fix] if isinstance(fix, str) else list(fix):
        prefix, _, name = str(entry).rpartition(".")
        if prefix and prefix not in cameras:
            raise InputError(
                f"fix names {entry!r}, but there is no camera {prefix!r}; there is {', '.join(cameras) or 'one'}"
            )
        if prefix and prefix != camera:
            continue
        if name == "distortion":
            held |= set(model.parameter_names)
        elif name in GROUPS:
            held |= set(GROUPS[name]) & set(known)
        elif name in known:
            held.add(name)
        else:
            choices = ", ".join((*known, *GROUPS, "distortion"))
            raise InputError(f"fix names {entry!r}, which model {model.name!r} does not have; it has {choices}")
    return held


def free_columns(names: Sequence[str], held: Collection[str], aspect_ratio: float | None) -> Float:
    """Return G of one camera: (number of parameters, number of free ones).

    Parameters
    ----------
    names : sequence of str
        All parameters in order.
    held : collection of str
        Those that are held.
    aspect_ratio : float, optional
        Ties fx = a·fy.

    Returns
    -------
    ndarray
    """
    G = np.eye(len(names))
    keep = [i for i, name in enumerate(names) if name not in held]
    if aspect_ratio is not None and names.index("fy") in keep:
        G[names.index("fx"), names.index("fy")] = aspect_ratio
        keep = [i for i in keep if names[i] != "fx"]
    return np.ascontiguousarray(G[:, keep])


def _shared_rows(names: Sequence[Sequence[str]], share: str | Collection[str]) -> list[tuple[int, int]]:
    """Rows of G, first and second camera, of the parameters that are shared."""
    wanted: list[str] = []
    for entry in [share] if isinstance(share, str) else list(share):
        if entry == "distortion":
            group: tuple[str, ...] = tuple(names[0][len(INTRINSIC_NAMES) :])
        else:
            group = GROUPS.get(entry, (entry,))
        for name in group:
            if any(name not in of_camera for of_camera in names):
                raise InputError(
                    f"share names {entry!r}, which the cameras do not both have; there is "
                    f"{', '.join((*(n for n in names[0] if n in names[1]), *GROUPS, 'distortion'))}"
                )
            wanted.append(name)
    return [(names[0].index(name), len(names[0]) + names[1].index(name)) for name in dict.fromkeys(wanted)]


def share_columns(G: Float, names: Sequence[Sequence[str]], share: str | Collection[str]) -> Float:
    """Return G with one unknown for each parameter that two cameras share.

    Parameters
    ----------
    G : ndarray
        Of a rig of two cameras.
    names : two sequences of str
        Parameters of each camera, in order.
    share : str or collection of str
        Names and groups.

    Returns
    -------
    ndarray

    Raises
    ------
    InputError
        If a name is not a parameter of both cameras, or held in one of them only.
    """
    for a, b in _shared_rows(names, share):
        of_a, of_b = np.flatnonzero(G[a]), np.flatnonzero(G[b])
        if len(of_a) != len(of_b):
            raise InputError(f"share names {names[0][a]!r}, which is held in one of the cameras; hold it in both")
        if len(of_a) == 0 or of_a[0] == of_b[0]:
            continue  # held in both, or tied already by way of the aspect ratio
        i, j = int(of_a[0]), int(of_b[0])
        G = G.copy()
        G[:, i] += G[a, i] / G[b, j] * G[:, j]
        G = np.delete(G, j, axis=1)
    return np.ascontiguousarray(G)


def with_shared_values(state: BundleState, names: Sequence[Sequence[str]], share: str | Collection[str]) -> BundleState:
    """Return a rig's state in which shared parameters have their mean in both cameras.

    Parameters
    ----------
    state : BundleState
        Of two cameras.
    names, share
        See :func:`share_columns`.

    Returns
    -------
    BundleState
    """
    theta = np.concatenate(state.intrinsics)
    for a, b in _shared_rows(names, share):
        theta[a] = theta[b] = 0.5 * (theta[a] + theta[b])
    return replace(state, intrinsics=np.split(theta, [len(names[0])]))


def prior_arrays(names: Sequence[str], priors: Mapping[str, tuple[float, float]]) -> tuple[Float, Float]:
    """Return (mean, sigma) of every parameter, sigma infinite where there is no prior.

    Parameters
    ----------
    names : sequence of str
        All parameters in order.
    priors : mapping of str to (mean, sigma)
        What is known beforehand.

    Returns
    -------
    means, sigmas : ndarray

    Raises
    ------
    InputError
        If a name is unknown or a sigma is not above 0.
    """
    means, sigmas = np.zeros(len(names)), np.full(len(names), np.inf)
    for name, (mean, sigma) in priors.items():
        if name not in names:
            raise InputError(f"priors name {name!r}; there is {', '.join(names)}")
        if not sigma > 0:
            raise InputError(f"the prior of {name!r} needs a standard deviation above 0, not {sigma!r}")
        means[names.index(name)], sigmas[names.index(name)] = mean, sigma
    return means, sigmas
