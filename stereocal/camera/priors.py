"""What is known of a camera beforehand: a data sheet's focal length, last year's calibration.

A prior says that a parameter s is m, give or take σ_s (one standard deviation). In the sum of squares it is one more
residual,

    F = Σ ‖p̃ − y‖² + Σ (σ / σ_s)² (s − m)²,

σ being the standard deviation of a corner's coordinate: residuals are weighed against each other by their own
uncertainty. σ is not known beforehand; it is estimated from what the fit leaves over, and the fit is repeated with it
until it stands still.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.bundle import Bundle, residuals
from stereocal.camera.bundle_solver import BundleSolution, solve_bundle

_ROUNDS = 5


def solve_with_priors(
    bundle: Bundle, solution: BundleSolution, means: Float, sigmas: Float, *, max_iterations: int
) -> tuple[Bundle, BundleSolution]:
    """Go on from a fit without priors to one with them.

    Parameters
    ----------
    bundle : Bundle
        The measurements.
    solution : BundleSolution
        Their fit.
    means, sigmas : ndarray of shape (n_shared,)
        m and σ_s of every shared parameter but the board's shape; σ_s infinite where nothing is known.
    max_iterations : int
        Limit on steps of each fit.

    Returns
    -------
    bundle, solution
        With the priors.
    """
    shape = bundle.G.shape[0] - len(means)  # of the board: nothing is known of it
    means, sigmas = np.append(means, np.zeros(shape)), np.append(sigmas, np.full(shape, np.inf))
    freedom = max(1, 2 * len(bundle.points) - bundle.G.shape[1] - 6 * bundle.view_count)
    for _ in range(_ROUNDS):
        r = residuals(bundle, solution.state)
        if bundle.whitening is not None:
            r = np.einsum("nij,nj->ni", bundle.whitening, r)
        sigma = float(np.sqrt(np.sum(r * r) / freedom))
        bundle = replace(bundle, prior_weights=sigma / sigmas, prior_means=means)
        before = solution.state.shared_vector()
        solution = solve_bundle(bundle, solution.state, max_iterations=max_iterations)
        if np.allclose(solution.state.shared_vector(), before, rtol=1e-9, atol=0):
            break
    return bundle, solution
