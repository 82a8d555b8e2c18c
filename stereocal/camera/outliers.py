"""Corners that do not belong: found, left out, and reported with the reason.

One corner found on the wrong crossing spoils a least squares fit. A corner is rejected when its distance d from where
the calibration draws it is larger than k times the scale of all distances,

    d > k·s,        s = median(d) / 1.1774,

s being the standard deviation of a coordinate if errors are normal (the median of a Rayleigh distribution is √(2 ln
2) = 1.1774 of them), and the median, unlike the mean, hardly feels the outliers. The fit is repeated without them,
everything is judged anew, rejected corners too, until nothing changes. The rounds themselves use the Cauchy loss, so
that gross errors do not drag the first fit with them.

A view of which one camera of a rig sees most corners elsewhere than the other camera says (counted from the other end,
or taken when the board had moved) is left out of that camera altogether: what little of it seems to fit, fits by
chance. A view that no other camera vouches for keeps its best six corners; its pose takes up what is wrong with it.

With normal errors k = 5 rejects 4 corners in a million.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stereocal.base.checks import Float
from stereocal.camera.bundle import Bundle, residuals
from stereocal.camera.bundle_solver import BundleSolution, solve_bundle

_MEDIAN_OF_RAYLEIGH = 1.1774100225154747
_ROUNDS = 10
# Fewer corners than this do not hold a pose: a view is never thinned out further.
_LEAST_CORNERS = 6


@dataclass(frozen=True)
class RejectedCorner:
    """A corner that was left out.

    Attributes
    ----------
    camera, view, point : int
        Which: camera (0 left, 1 right), view, and number in the board.
    distance : float
        From where the calibration draws it, pixels.
    limit : float
        What was allowed, pixels.
    reason : str
        A sentence.
    """

    camera: int
    view: int
    point: int
    distance: float
    limit: float
    reason: str


def solve_without_outliers(
    bundle: Bundle, solution: BundleSolution, factor: float, *, max_iterations: int, backend: str
) -> tuple[Bundle, BundleSolution, np.ndarray, float]:
    """Repeat the fit without corners farther off than `factor` scales, until nothing changes.

    Parameters
    ----------
    bundle : Bundle
        All measurements.
    solution : BundleSolution
        Their fit.
    factor : float
        k.
    max_iterations : int
        Limit on steps of each fit.
    backend : {"numba", "numpy"}
        See ``bundle_solver``.

    Returns
    -------
    bundle, solution
        Of the corners kept.
    kept : ndarray of bool, shape (M,)
        Which of all measurements.
    limit : float
        k·s of the last round, pixels.
    """
    kept = np.ones(len(bundle.points), dtype=bool)
    limit = np.inf
    for _ in range(_ROUNDS):
        d = np.sqrt(np.sum(residuals(bundle, solution.state) ** 2, axis=1))
        scale = float(np.median(d)) / _MEDIAN_OF_RAYLEIGH
        limit = factor * scale
        now = _keep(bundle, d, limit)
        if np.array_equal(now, kept):
            break
        kept = now
        robust = replace(of_rows(bundle, kept), loss="cauchy", loss_scale=max(3 * scale, 1e-9))
        solution = solve_bundle(robust, solution.state, max_iterations=max_iterations, backend=backend)
    part = of_rows(bundle, kept)
    return part, solve_bundle(part, solution.state, max_iterations=max_iterations, backend=backend), kept, limit


def _keep(bundle: Bundle, d: Float, limit: float) -> np.ndarray:
    """Which corners are within the limit; of each view the best few at least, or none where another camera has it."""
    keep = d <= limit
    sizes = np.diff(bundle.offsets)
    good = np.add.reduceat(keep, bundle.offsets[:-1], dtype=np.int64) >= 0.5 * sizes
    vouched = np.bincount(bundle.view_of_block[good], minlength=bundle.view_count) > 0
    for block, (first, last) in enumerate(zip(bundle.offsets[:-1], bundle.offsets[1:], strict=True)):
        if not good[block] and vouched[bundle.view_of_block[block]]:
            keep[first:last] = False
        elif np.count_nonzero(keep[first:last]) < _LEAST_CORNERS:
            keep[first + np.argsort(d[first:last])[:_LEAST_CORNERS]] = True
    return np.asarray(keep)


def of_rows(bundle: Bundle, keep: np.ndarray) -> Bundle:
    """Return a bundle of some measurements only; a camera's view that keeps none is dropped."""
    block = np.repeat(np.arange(len(bundle.offsets) - 1), np.diff(bundle.offsets))
    counts = np.bincount(block[keep], minlength=len(bundle.offsets) - 1)
    some = counts > 0
    return replace(
        bundle,
        points=bundle.points[keep],
        measured=bundle.measured[keep],
        offsets=np.concatenate([[0], np.cumsum(counts[some])]),
        camera_of_block=bundle.camera_of_block[some],
        view_of_block=bundle.view_of_block[some],
        whitening=None if bundle.whitening is None else bundle.whitening[keep],
        shape_index=None if bundle.shape_index is None else bundle.shape_index[keep],
    )


def report_rejected(bundle: Bundle, solution: BundleSolution, kept: np.ndarray, limit: float) -> list[RejectedCorner]:
    """Return the corners left out, with the reason in words."""
    d = np.sqrt(np.sum(residuals(bundle, solution.state) ** 2, axis=1))
    block = np.repeat(np.arange(len(bundle.offsets) - 1), np.diff(bundle.offsets))
    lost = np.bincount(block[~kept], minlength=len(bundle.offsets) - 1) / np.diff(bundle.offsets)
    found = []
    for row in np.flatnonzero(~kept):
        b = block[row]
        reason = f"{d[row]:.2f} px from where the calibration draws it, more than {limit:.2f} px"
        if lost[b] > 0.5:
            reason += "; most corners of this view disagree: the board moved, or its corners are in another order"
        found.append(
            RejectedCorner(int(bundle.camera_of_block[b]), int(bundle.view_of_block[b]), int(row - bundle.offsets[b]),
                           float(d[row]), limit, reason)
        )  # fmt: skip
    return found
