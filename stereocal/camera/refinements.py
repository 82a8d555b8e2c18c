"""From the plain optimum to the one that was asked for: the board's shape, outliers left out, priors.

The order is not free. A bent board puts good corners off the flat one by more than outliers are allowed, so its shape
goes first; and since that fit must not bend to the very outliers, it uses the Cauchy loss then. Outliers are judged by
the shape that was found, and fitted out together with it. Priors come last, because they are weighed by the noise that
is left over.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stereocal.base.checks import Float, require_positive
from stereocal.camera.board_shape_fit import board_of, fit_shape, numbered
from stereocal.camera.bundle import Bundle, residuals
from stereocal.camera.bundle_solver import BundleSolution
from stereocal.camera.outliers import RejectedCorner, report_rejected, solve_without_outliers
from stereocal.camera.priors import solve_with_priors

_FACTOR = 5.0


@dataclass
class Refined:
    """What is known in the end.

    Attributes
    ----------
    everything, bundle : Bundle
        All measurements, and those that were kept, both with the board's shape.
    solution : BundleSolution
        Of those kept.
    kind : str
        The shape's kind.
    held_out_rms : dict of str to float
        By kind, where it was asked for.
    kept : ndarray of bool, shape (M,)
        Which of all measurements.
    limit : float
        Distance, pixels, that was allowed.
    """

    everything: Bundle
    bundle: Bundle
    solution: BundleSolution
    kind: str
    held_out_rms: dict[str, float]
    kept: np.ndarray
    limit: float

    @property
    def residuals(self) -> Float:
        """Predicted minus measured of all corners, as they were passed in, (M, 2)."""
        return residuals(self.everything, self.solution.state)

    def rejected(self) -> list[RejectedCorner]:
        """The corners left out, with the reason in words."""
        return report_rejected(self.everything, self.solution, self.kept, self.limit)


def refine_optimum(
    bundle: Bundle, solution: BundleSolution, *, board_warp: bool | str, reject_outliers: bool | float,
    priors: tuple[Float, Float] | None, max_iterations: int, backend: str,
) -> Refined:  # fmt: skip
    """Go on from an optimum of all corners and a flat board.

    Parameters
    ----------
    bundle : Bundle
        Measurements.
    solution : BundleSolution
        Their fit.
    board_warp : bool or str
        See ``board_shape.requested_kind``.
    reject_outliers : bool or float
        Whether corners may be left out; a number says how many scales off they may be.
    priors : (means, sigmas) or None
        See ``priors``.
    max_iterations : int
        Limit on steps of each fit.
    backend : {"numba", "numpy"}
        See ``bundle_solver``.

    Returns
    -------
    Refined
    """
    loss, loss_scale = bundle.loss, bundle.loss_scale
    bundle = numbered(bundle, board_warp)
    if reject_outliers and bundle.shape_index is not None:
        typical = float(np.median(np.linalg.norm(residuals(bundle, solution.state), axis=1)))
        bundle = replace(bundle, loss="cauchy", loss_scale=max(typical, 1e-9))
    bundle, solution, kind, held_out = fit_shape(
        bundle, solution, board_warp, board_of(bundle), max_iterations=max_iterations, backend=backend
    )
    bundle = everything = replace(bundle, loss=loss, loss_scale=loss_scale)
    kept, limit = np.ones(len(bundle.points), dtype=bool), np.inf
    if reject_outliers:
        factor = _FACTOR if reject_outliers is True else require_positive(reject_outliers, "reject_outliers")
        bundle, solution, kept, limit = solve_without_outliers(
            bundle, solution, factor, max_iterations=max_iterations, backend=backend
        )
    if priors is not None:
        bundle, solution = solve_with_priors(bundle, solution, *priors, max_iterations=max_iterations)
    return Refined(everything, bundle, solution, kind, held_out, kept, limit)
