"""Necker's reversal: each board tilted the other way.

Far off, a board and its mirror image in tilt look almost the same, as a wire cube may be seen in two ways, and a pose
that began on the wrong side stays there: between the two lies a ridge. The other one is known,

    R → Rot(d, π) R Rot(z, π),        d the line of sight to the middle of the corners,

which mirrors the tilt and keeps the rest, so it is tried: all views at once, each refined on its own, the better kept.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stereocal.camera.bundle import Bundle, BundleState, residuals
from stereocal.camera.bundle_solver import BundleSolution, solve_bundle

_STEPS = 60


def with_reversed_poses(bundle: Bundle, state: BundleState, backend: str) -> BundleState | None:
    """Return the state with the boards tilted the other way where that fits better; None where none does.

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    state : BundleState
        Whose camera is held.
    backend : {"numba", "numpy"}
        See ``bundle_solver``.

    Returns
    -------
    BundleState or None
    """
    counts = np.diff(bundle.offsets)
    middle = np.add.reduceat(bundle.points, bundle.offsets[:-1]) / counts[:, None]
    centre = np.einsum("vij,vj->vi", state.R_views, middle) + state.t_views
    d = centre / np.linalg.norm(centre, axis=1, keepdims=True)
    half_turn = 2 * d[:, :, None] * d[:, None, :] - np.eye(3)
    R = half_turn @ state.R_views @ np.diag([-1.0, -1.0, 1.0])
    t = centre - np.einsum("vij,vj->vi", R, middle)
    poses_only = replace(bundle, G=np.zeros((len(bundle.G), 0)))
    other = solve_bundle(poses_only, replace(state, R_views=R, t_views=t), max_iterations=_STEPS, backend=backend).state
    cost_here, cost_there = (
        np.add.reduceat(np.sum(residuals(bundle, s) ** 2, axis=1), bundle.offsets[:-1]) for s in (state, other)
    )
    better = cost_there < cost_here * (1 - 1e-9)
    if not better.any():
        return None
    return replace(
        state,
        R_views=np.where(better[:, None, None], other.R_views, state.R_views),
        t_views=np.where(better[:, None], other.t_views, state.t_views),
    )


def solve_with_reversals(
    bundle: Bundle, solution: BundleSolution, backend: str, *, rounds: int, steps: int
) -> BundleSolution:
    """Go on from a solution with better poses reversed, as long as that lowers the cost.

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    solution : BundleSolution
        Where to begin.
    backend : {"numba", "numpy"}
        See ``bundle_solver``.
    rounds : int
        How often at most.
    steps : int
        Limit on steps of each round.

    Returns
    -------
    BundleSolution
    """
    for _ in range(rounds):
        turned = with_reversed_poses(bundle, solution.state, backend)
        if turned is None:
            break
        further = solve_bundle(bundle, turned, max_iterations=steps, backend=backend)
        if not further.cost < solution.cost:
            break
        solution = further
    return solution
