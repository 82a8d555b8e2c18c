"""Where a lens starts: by stages where it cannot begin at none, from a smaller model where it grew from one.

**By stages.** A model whose parameters do not begin at zero, or that undoes badly, is given the lens that k1, k2 find:
a fit of that polynomial, and then the model's own k, and a scale a of the focal length, that draw the corners seen
where the polynomial draws them,

    min over a, k of  Σ ‖a·x_d(x; k) − x_d(x; k1, k2)‖²,

or, for models that give the ideal point x_u(x_d; k) explicitly, Σ ‖x_u(x_d(x; k1, k2) / a; k) − x‖², which needs no
inversion.

**From a smaller model.** OpenCV's models contain each other: rational is Brown's with k4, k5, k6, and so on. The
optimum of the smaller one, the further coefficients 0, is a start that a fit can only improve on. For a tilted sensor
the prism that was found without tilt is a poor guide (p1, p2, s1 … s4 and τ draw nearly the same picture), so it has a
second start from which the prism is left out at first.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import ConvergenceError
from stereocal.base.least_squares import minimize_least_squares
from stereocal.camera.bundle import Bundle, BundleState
from stereocal.camera.bundle_solver import BundleSolution, solve_bundle
from stereocal.camera.distortion import distortion_model
from stereocal.camera.distortion_base import BackwardModel, DistortionModel
from stereocal.camera.distortion_polynomial import Polynomial
from stereocal.camera.parameters import free_columns, intrinsic_names

# The model whose coefficients are the first ones of another.
SMALLER = {"rational": "brown", "thin_prism": "rational", "tilted": "thin_prism"}

_PRISM = {"s1", "s2", "s3", "s4"}

# Points at which two lenses' curves are compared: a few hundred tell as much as all.
_ENOUGH_POINTS = 300


def state_of(K: Float, R: Float, t: Float, k: Float) -> BundleState:
    """Return the state of one camera: K, lens k, and poses R (V, 3, 3), t (V, 3)."""
    theta = np.concatenate([[K[0, 0], K[1, 1], K[0, 2], K[1, 2], K[0, 1]], k])
    return BundleState([theta], np.eye(3)[None], np.zeros((1, 3)), R, t)


def staged_start(
    bundle: Bundle, camera: tuple[Float, Float, Float], lens: DistortionModel, held: set[str], backend: str, *,
    hold_centre: bool,
) -> BundleState:  # fmt: skip
    """Return a fit with k1, k2 alone, its curve taken over by the model.

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    camera : (K, R, t)
        Where the fit starts.
    lens : DistortionModel
        The model.
    held : set of str
        Names of parameters that are held.
    backend : {"numba", "numpy"}
        See ``bundle_solver``.
    hold_centre : bool
        Whether the principal point is held meanwhile.

    Returns
    -------
    BundleState
    """
    hold = {"skew"} | (held & {"cx", "cy", "fx", "fy"}) | ({"cx", "cy"} if hold_centre else set())
    start = state_of(*camera, np.zeros(2))
    first = solve_bundle(with_polynomial(bundle, hold), start, max_iterations=50, backend=backend)
    if not np.isfinite(first.cost):
        return state_of(*camera, first_lens(lens, held))
    return with_lens(bundle, first.state, lens, held)


def with_polynomial(bundle: Bundle, held: Collection[str]) -> Bundle:
    """Return the bundle of one camera with the lens k1, k2 in place of its own.

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    held : collection of str
        Names of parameters that are held.

    Returns
    -------
    Bundle
    """
    simple = Polynomial()
    G = free_columns(intrinsic_names(simple), set(held), None)
    return replace(bundle, models=[simple], G=G, prior_weights=None, shape_basis=None)


def with_lens(bundle: Bundle, state: BundleState, lens: DistortionModel, held: set[str]) -> BundleState:
    """Return a state with the lens k1, k2 as one of another lens that draws the corners in the same places.

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    state : BundleState
        With the lens k1, k2.
    lens : DistortionModel
        The model to go over to.
    held : set of str
        Names of parameters that are held.

    Returns
    -------
    BundleState
    """
    theta = state.intrinsics[0]
    view = np.repeat(bundle.view_of_block, np.diff(bundle.offsets))
    X_c = np.einsum("nij,nj->ni", state.R_views[view], bundle.points) + state.t_views[view]
    k, scale = convert_lens(lens, theta[5:], X_c[:, :2] / X_c[:, 2:], held)
    K = np.array([[theta[0] * scale, 0, theta[2]], [0, theta[1] * scale, theta[3]], [0, 0, 1.0]])
    return state_of(K, state.R_views, state.t_views, k)


def first_lens(lens: DistortionModel, held: Collection[str]) -> Float:
    """Return the k that a lens starts with: what is held has the value of no lens.

    Parameters
    ----------
    lens : DistortionModel
        The model.
    held : collection of str
        Names of parameters that are held.

    Returns
    -------
    ndarray
    """
    hold = np.array([name in held for name in lens.parameter_names], dtype=bool)
    return np.where(hold, lens.neutral(), lens.start())


def convert_lens(target: DistortionModel, k12: Float, x: Float, held: Collection[str] = ()) -> tuple[Float, float]:
    """Return the k of `target`, and a scale a of the focal length, with a·x_d(x; k) = the curve of k1, k2.

    Parameters
    ----------
    target : DistortionModel
        The model wanted.
    k12 : ndarray of shape (2,)
        k1, k2.
    x : ndarray of shape (N, 2)
        Points of the normalised plane at which the curves are to meet.
    held : collection of str
        Names of parameters that are held, besides those that the model holds itself.

    Returns
    -------
    k : ndarray
    a : float
    """
    held = {*held, *target.fixed_by_default}
    free = np.array([name not in held for name in target.parameter_names], dtype=bool)
    k = first_lens(target, held)
    if not free.any():
        return k, 1.0
    x = x[:: max(1, len(x) // _ENOUGH_POINTS)]
    wanted = Polynomial().distort(x, k12)

    def curve(p: Float) -> Float:
        trial = k.copy()
        trial[free] = p[1:]
        if isinstance(target, BackwardModel):
            return np.asarray((target.undistort_compiled(wanted / p[0], trial) - x).ravel())
        return np.asarray((p[0] * target.distort(x, trial) - wanted).ravel())

    fit = minimize_least_squares(curve, np.concatenate([[1.0], k[free]]), max_iterations=60)
    k[free] = fit.x[1:]
    return k, float(fit.x[0])


def start_from_smaller(
    bundle: Bundle, lens: DistortionModel, held: set[str], aspect_ratio: float | None,
    solve: Callable[[Bundle, DistortionModel, set[str]], BundleSolution],
) -> BundleState | None:  # fmt: skip
    """Return the optimum of the next smaller model, the further coefficients 0; None where it has none.

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    lens : DistortionModel
        A model that has a smaller one, see :data:`SMALLER`.
    held : set of str
        Names of parameters that are held.
    aspect_ratio : float, optional
        fx / fy where it is known.
    solve : callable
        Solves a bundle of the smaller model from nothing.

    Returns
    -------
    BundleState or None
    """
    smaller = distortion_model(SMALLER[lens.name])
    names = intrinsic_names(smaller)
    G = free_columns(names, held & set(names), aspect_ratio)
    part = replace(bundle, models=[smaller], G=G, prior_weights=None, shape_basis=None)
    try:
        state = solve(part, smaller, held & set(names)).state
    except ConvergenceError:
        return None
    more = np.zeros(lens.parameter_count - smaller.parameter_count)
    return replace(state, intrinsics=[np.concatenate([state.intrinsics[0], more])])


def start_without_prism(
    bundle: Bundle, lens: DistortionModel, start: BundleState, held: set[str], aspect_ratio: float | None, steps: int
) -> BundleState:
    """Return the tilted sensor's fit without thin prism, from a start with one.

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    lens : DistortionModel
        The tilted sensor's.
    start : BundleState
        Where the fit starts.
    held : set of str
        Names of parameters that are held.
    aspect_ratio : float, optional
        fx / fy where it is known.
    steps : int
        Limit on steps.

    Returns
    -------
    BundleState
    """
    names = intrinsic_names(lens)
    theta = start.intrinsics[0].copy()
    theta[[names.index(name) for name in _PRISM - held]] = 0.0
    part = replace(bundle, G=free_columns(names, held | _PRISM, aspect_ratio), prior_weights=None, shape_basis=None)
    return solve_bundle(part, replace(start, intrinsics=[theta]), max_iterations=steps).state
