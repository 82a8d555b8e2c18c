"""Which parameters a calibration frees, holds or ties, by name.

A camera's parameters are fx, fy, cx, cy, skew and those of its lens model. ``fix=`` takes their names, and these for
groups:

=====================  ===============
``"focal_length"``     fx, fy
``"principal_point"``  cx, cy
``"tangential"``       p1, p2
``"distortion"``       all of the lens
=====================  ===============

In a rig a name alone is meant for every camera; ``"left.k3"`` (of a pair) or ``"camera2.k3"`` (of more) for one. A tie
fx = a·fy (``aspect_ratio=a``) leaves one unknown of two, and a parameter that the cameras of a rig share leaves one of
all (``share="focal_length"``: cameras of one make, zoomed alike). All end up in one matrix G, δ(all) = G δ(free); see
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


def fixed_names(model: DistortionModel, fix: str | Collection[str], *, skew: bool) -> set[str]:
    """Return the names of one camera's parameters that are held.

    Parameters
    ----------
    model : DistortionModel
        Its lens model.
    fix : str or collection of str
        Names and groups.
    skew : bool
        Whether the skew is free.

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
    for name in [fix] if isinstance(fix, str) else list(fix):
        if name == "distortion":
            held |= set(model.parameter_names)
        elif name in GROUPS:
            held |= set(GROUPS[name]) & set(known)
        elif name in known:
            held.add(name)
        else:
            choices = ", ".join((*known, *GROUPS, "distortion"))
            raise InputError(f"fix names {name!r}, which model {model.name!r} does not have; it has {choices}")
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


def _shared_rows(names: Sequence[Sequence[str]], share: str | Collection[str]) -> list[list[int]]:
    """Rows of G, one a camera, of each parameter that is shared."""
    first = np.cumsum([0, *(len(of_camera) for of_camera in names)])
    common = [name for name in names[0] if all(name in of_camera for of_camera in names)]
    wanted: list[str] = []
    for entry in [share] if isinstance(share, str) else list(share):
        if entry == "distortion":
            group: tuple[str, ...] = tuple(names[0][len(INTRINSIC_NAMES) :])
        else:
            group = GROUPS.get(entry, (entry,))
        if any(name not in common for name in group):
            raise InputError(
                f"share names {entry!r}, which the cameras do not all have; there is "
                f"{', '.join((*common, *GROUPS, 'distortion'))}"
            )
        wanted += group
    return [
        [int(row) + list(of_camera).index(name) for row, of_camera in zip(first[:-1], names, strict=True)]
        for name in dict.fromkeys(wanted)
    ]


def share_columns(G: Float, names: Sequence[Sequence[str]], share: str | Collection[str]) -> Float:
    """Return G with one unknown for each parameter that the cameras of a rig share.

    Parameters
    ----------
    G : ndarray
        Of a rig.
    names : sequences of str
        Parameters of each camera, in order.
    share : str or collection of str
        Names and groups.

    Returns
    -------
    ndarray

    Raises
    ------
    InputError
        If a name is not a parameter of every camera, or held in some of them only.
    """
    for a, *others in _shared_rows(names, share):
        for b in others:
            of_a, of_b = np.flatnonzero(G[a]), np.flatnonzero(G[b])
            if len(of_a) != len(of_b):
                raise InputError(f"share names {names[0][a]!r}, which is held in one of the cameras; hold it in all")
            if len(of_a) == 0 or of_a[0] == of_b[0]:
                continue  # held in all, or tied already by way of the aspect ratio
            i, j = int(of_a[0]), int(of_b[0])
            G = G.copy()
            G[:, i] += G[a, i] / G[b, j] * G[:, j]
            G = np.delete(G, j, axis=1)
    return np.ascontiguousarray(G)


def with_shared_values(state: BundleState, names: Sequence[Sequence[str]], share: str | Collection[str]) -> BundleState:
    """Return a rig's state in which shared parameters have their mean in every camera.

    Parameters
    ----------
    state : BundleState
        Of a rig.
    names, share
        See :func:`share_columns`.

    Returns
    -------
    BundleState
    """
    theta = np.concatenate(state.intrinsics)
    for rows in _shared_rows(names, share):
        theta[rows] = np.mean(theta[rows])
    return replace(state, intrinsics=np.split(theta, np.cumsum([len(of_camera) for of_camera in names])[:-1]))


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
    for name, known in priors.items():
        if name not in names:
            raise InputError(f"priors name {name!r}; there is {', '.join(names)}")
        try:
            mean, sigma = (float(number) for number in known)
        except (TypeError, ValueError) as error:
            raise InputError(f"the prior of {name!r} must be (mean, standard deviation), not {known!r}") from error
        if not (sigma > 0 and np.isfinite(mean)):
            raise InputError(f"the prior of {name!r} needs a finite mean and a deviation above 0, not {known!r}")
        means[names.index(name)], sigmas[names.index(name)] = mean, sigma
    return means, sigmas
