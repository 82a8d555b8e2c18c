"""Fitting the board's shape together with cameras and poses, and asking held-out views whether it is real.

See ``board_shape`` for the shapes and the gauge. The flat fit comes first and is the start; the shape is then one
more block of shared unknowns in the bundle. The same functions serve one camera and a rig. A view need not hold the
whole board: points are told apart by where they stand on it, so corners may be missing or left out as outliers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from stereocal.base.checks import Float
from stereocal.base.errors import InputError
from stereocal.camera.board_shape import KINDS, BoardShape, choose_kind, folds, requested_kind, shape_basis
from stereocal.camera.bundle import Bundle, BundleState, residuals
from stereocal.camera.bundle_solver import BundleSolution, solve_bundle
from stereocal.camera.covariance import BundleCovariance

# Two views give four equations for the three coordinates of a point; the third makes a check of it.
_LEAST_VIEWS = 3
# Fits that begin at an optimum nearby, and what they are allowed.
_NEARBY, _FOLD_STEPS = 1e-6, 60


def fit_shape(
    bundle: Bundle, solution: BundleSolution, board_warp: bool | str, board: Float, *, max_iterations: int,
    backend: str = "numba",
) -> tuple[Bundle, BundleSolution, str, dict[str, float]]:  # fmt: skip
    """Go on from a flat fit to the shape that the user asks for.

    Parameters
    ----------
    bundle : Bundle
        Measurements, numbered; every block holds points of one board.
    solution : BundleSolution
        The flat fit.
    board_warp : bool or str
        See ``board_shape.requested_kind``.
    board : ndarray of shape (P, 3)
        The flat board, of all corners, of which some may have been left out of the bundle.
    max_iterations : int
        Limit on steps.
    backend : {"numba", "numpy"}
        See ``bundle_solver``.

    Returns
    -------
    bundle, solution
        With the shape among the unknowns.
    kind : str
        The shape's kind.
    held_out_rms : dict of str to float
        By kind, where it was asked for.

    Raises
    ------
    InputError
        If the views do not hold points of the same board.
    """
    kind = requested_kind(board_warp)
    if kind == "flat":
        return bundle, solution, kind, {}
    _require_one_board(bundle, board)
    fits = {"flat": (bundle, solution)}
    for richer in KINDS[1:] if kind == "auto" else (kind,):
        fits[richer] = release(bundle, solution.state, board, richer, max_iterations=max_iterations, backend=backend)
    held_out: dict[str, float] = {}
    if kind == "auto":
        held_out = {kind: held_out_rms(part, fit.state, backend=backend) for kind, (part, fit) in fits.items()}
        kind = choose_kind(held_out)
    return *fits[kind], kind, held_out


def numbered(bundle: Bundle, board_warp: bool | str) -> Bundle:
    """Return the bundle with the number of each measurement's point in the board, if a shape is asked for.

    To be done before corners are left out, so that the board keeps the points of them all. The order is that of the
    first block that holds the whole board, or row by row where none does.

    Parameters
    ----------
    bundle : Bundle
        Measurements.
    board_warp : bool or str
        See ``board_shape.requested_kind``.

    Returns
    -------
    Bundle
    """
    if requested_kind(board_warp) == "flat" or bundle.shape_index is not None:
        return bundle
    points, index = np.unique(bundle.points, axis=0, return_inverse=True)
    index = index.ravel()
    whole = np.flatnonzero(np.diff(bundle.offsets) == len(points))
    if len(whole):
        order = index[bundle.offsets[whole[0]] : bundle.offsets[whole[0] + 1]]
    else:
        order = np.lexsort((points[:, 0], points[:, 1]))
    place = np.empty(len(points), dtype=np.int64)
    place[order] = np.arange(len(points))
    return replace(bundle, shape_index=place[index])


def board_of(bundle: Bundle) -> Float:
    """Return the flat board, (P, 3), of a numbered bundle; of another one the first view's part of it."""
    if bundle.shape_index is None:
        return bundle.points[: bundle.offsets[1]].copy()
    board = np.full((bundle.shape_index.max() + 1, 3), np.nan)
    board[bundle.shape_index] = bundle.points
    return board


def _require_one_board(bundle: Bundle, board: Float) -> None:
    seen = np.bincount(np.asarray(bundle.shape_index), minlength=len(board))
    rare = int(np.count_nonzero(seen < _LEAST_VIEWS))
    if rare:
        raise InputError(
            f"board_warp needs one board in all views, but {rare} of {len(board)} board points are seen fewer than "
            f"{_LEAST_VIEWS} times; pass object_points as one (N, 3) array, or leave these points out"
        )


def release(
    bundle: Bundle, state: BundleState, board: Float, kind: str, *, max_iterations: int = 200, backend: str = "numba"
) -> tuple[Bundle, BundleSolution]:
    """Solve with a shape of the given kind among the unknowns, from a flat fit; `shape_index` numbers its points."""
    basis = shape_basis(kind, board)
    if basis is None:
        return bundle, solve_bundle(bundle, state, max_iterations=max_iterations, backend=backend)
    unknowns = basis.shape[2]
    bundle = replace(bundle, shape_basis=basis, G=np.asarray(block_diag(bundle.G, np.eye(unknowns))))
    start = replace(state, shape=np.zeros(unknowns))
    return bundle, solve_bundle(bundle, start, max_iterations=max_iterations, initial_damping=_NEARBY, backend=backend)


def held_out_rms(bundle: Bundle, state: BundleState, *, backend: str = "numba") -> float:
    """Return the RMS, pixels, of views that did not take part: cameras and shape from the others, only poses from them.

    Parameters
    ----------
    bundle : Bundle
        Measurements, with `shape_index`, and with `shape_basis` unless the board is flat.
    state : BundleState
        The fit of all views, where each fit of a part begins. That saves steps, no more: it goes on to its own optimum.
    backend : {"numba", "numpy"}
        See ``bundle_solver``.

    Returns
    -------
    float
    """
    total, count = 0.0, 0
    for out in folds(bundle.view_count):
        kept = np.setdiff1d(np.arange(bundle.view_count), out)
        training, start = of_views(bundle, state, kept)
        fit = solve_bundle(training, start, max_iterations=_FOLD_STEPS, initial_damping=_NEARBY, backend=backend).state
        test, poses = of_views(bundle, state, out)
        if bundle.shape_basis is not None:
            test.points = test.points + (bundle.shape_basis @ fit.shape)[test.shape_index]
            test.shape_basis = None
        test.G = np.zeros((bundle.shape_slice.start, 0))
        known = replace(fit, R_views=poses.R_views, t_views=poses.t_views, shape=np.zeros(0))
        d = residuals(test, solve_bundle(test, known, initial_damping=_NEARBY, backend=backend).state)
        total += float(np.vdot(d, d))
        count += len(d)
    return float(np.sqrt(total / count))


def of_views(bundle: Bundle, state: BundleState, views: np.ndarray) -> tuple[Bundle, BundleState]:
    """Return the measurements and the state of some views only."""
    blocks = np.flatnonzero(np.isin(bundle.view_of_block, views))
    rows = np.concatenate([np.arange(bundle.offsets[b], bundle.offsets[b + 1]) for b in blocks])
    sizes = np.diff(bundle.offsets)[blocks]
    part = replace(
        bundle,
        points=bundle.points[rows],
        measured=bundle.measured[rows],
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        camera_of_block=bundle.camera_of_block[blocks],
        view_of_block=np.searchsorted(views, bundle.view_of_block[blocks]),
        view_count=len(views),
        whitening=None if bundle.whitening is None else bundle.whitening[rows],
        shape_index=None if bundle.shape_index is None else bundle.shape_index[rows],
    )
    return part, replace(state, R_views=state.R_views[views], t_views=state.t_views[views])


def board_shape_of(
    bundle: Bundle, state: BundleState, kind: str, held_out: dict[str, float], joint: BundleCovariance
) -> BoardShape:
    """Return the shape that a solution holds, with standard deviations."""
    board = board_of(bundle)
    if bundle.shape_basis is None:
        return BoardShape("flat", board, np.zeros_like(board), np.zeros_like(board), held_out)
    offsets = bundle.shape_basis @ state.shape
    of_beta = joint.shared[bundle.shape_slice, bundle.shape_slice]
    variance = np.einsum("pam,mn,pan->pa", bundle.shape_basis, of_beta, bundle.shape_basis, optimize=True)
    return BoardShape(kind, board + offsets, offsets, np.sqrt(variance), held_out)
