"""Views that do not belong: corners in another order than the board's points, told from the others and named.

Corners of one view listed in another order are no small error that a least-squares fit could average away. What they do
depends on the order.

**An order that no pose explains** (shuffled, rows for columns, points of another board). The best pose leaves residuals
of the size of a square, which the fit of all views spreads over the camera: other views look bad too, focal lengths run
away, and the views are even refused for lack of tilt. So the view is judged by a camera that never saw it: suspects are
left out, the camera is found from the rest, and of a suspect only the pose is fitted,

    e_v = min over R, t of the RMS of p̃(K, k, R, t, P_j) − y_vj.

It is odd if e_v is many times the median of the others and a fair part of a square. Whom to suspect is a question
that a spoilt camera must not answer: before it is asked, views are compared by how well a homography fits them, which
needs no camera. Distortion bends every view's homography somewhat; a wrong order by far more.

**A mirrored order** (rows or columns reversed, a mirrored image) is a board seen from its back, and fits like others:
(r1, −r2, −r3) is a rotation too. One camera of a flat board takes no harm, a rig or a bent board does. The side is the
sign of n·t, with n the board's normal and t the way to it; the sides of a board are not photographed in turn, so the
smaller party is named. A board seen edge-on shows no side. (Half a turn in the plane is no fault that one camera's
views could tell, see ``pair.corner_order``.)

The usual set of views pays for two comparisons: no view's RMS is several times the median's, and all show one side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import DegenerateGeometryError, StereocalError
from stereocal.camera.board_shape_fit import of_views
from stereocal.camera.bundle import Bundle, BundleState, residuals
from stereocal.camera.bundle_solver import BundleSolution, solve_bundle
from stereocal.camera.pose_reversal import with_reversed_poses
from stereocal.camera.seen_boards import seen_boards

# Suspects: a view's RMS, in medians of all, and in pixels; or its homography's, where the RMS of all is no good fit's.
_SUSPECT, _SUSPECT_PIXELS = 3.0, 0.5
_SUSPECT_HOMOGRAPHY, _BAD_PIXELS = 5.0, 2.0
# Odd: the RMS of the best pose, in medians of the others and in squares.
_ODD, _ODD_SQUARES, _BLAMED_SQUARES = 6.0, 0.1, 0.5
# Sine of the angle to the board's plane below which noise decides which side of it is seen.
_GRAZING = 0.1
_ROUNDS = 3
_LEAST_VIEWS = 3


class OddViewsError(DegenerateGeometryError):
    """The views do not determine the camera, and some of them are to blame, which the message names."""


@dataclass(frozen=True)
class OddView:
    """A view that does not belong to the others.

    Attributes
    ----------
    view : int
        Its number.
    from_behind : bool
        Whether it is odd for showing the board's other side; else no pose of the board fits it.
    rms : float
        Of its best pose, by the camera that the other views give, pixels.
    typical_rms : float
        Median of the others, pixels.
    squares : float
        `rms` in squares of the board as that view shows them.
    """

    view: int
    from_behind: bool
    rms: float
    typical_rms: float
    squares: float


def odd_views(
    bundle: Bundle, solution: BundleSolution, solve: Callable[[Bundle], BundleSolution] | None
) -> tuple[OddView, ...]:
    """Return the views of one camera that do not belong to the others.

    Parameters
    ----------
    bundle : Bundle
        Of one camera and a flat board.
    solution : BundleSolution
        Its fit.
    solve : callable, optional
        Finds the camera of a part of the views; without it their fit begins at `solution`.

    Returns
    -------
    tuple of OddView
        Ordered by view; empty for a healthy set.
    """
    d, counts = solution.equations.residuals, np.diff(bundle.offsets)
    squares = np.add.reduceat(d[:, 0] ** 2 + d[:, 1] ** 2, bundle.offsets[:-1]) / counts
    worst, middle = squares.max(), np.partition(squares, len(squares) // 2)[len(squares) // 2]
    found: list[OddView] = []
    if worst > max(_SUSPECT**2 * middle, _SUSPECT_PIXELS**2) or squares.mean() > _BAD_PIXELS**2:
        found = _views_that_no_pose_fits(bundle, solution, np.sqrt(squares), solve)
    state = solution.state
    height = np.einsum("vi,vi->v", state.R_views[:, :, 2], state.t_views)
    if height.min() * height.max() < 0:
        grazing = np.abs(height) < _GRAZING * np.linalg.norm(state.t_views, axis=1)
        front, back = (height > 0) & ~grazing, (height < 0) & ~grazing
        few = (front if height[0] < 0 else back) if front.sum() == back.sum() else min(front, back, key=np.sum)
        known, rms = {odd.view for odd in found}, np.sqrt(squares)
        in_squares = rms / _square_sizes(bundle)
        found += [
            OddView(int(v), True, float(rms[v]), float(np.sqrt(middle)), float(in_squares[v]))
            for v in np.flatnonzero(few)
            if v not in known
        ]
    return tuple(sorted(found, key=lambda odd: odd.view))


def odd_view_warnings(odd: Sequence[OddView], numbers: Sequence[int] | None = None) -> tuple[str, ...]:
    """Return a sentence for each kind of odd views.

    Parameters
    ----------
    odd : sequence of OddView
        What was found.
    numbers : sequence of int, optional
        What the views are called, if not by their place.

    Returns
    -------
    tuple of str
    """
    sentences = []
    for kind in (False, True):
        views = [o for o in odd if o.from_behind == kind]
        if not views:
            continue
        names = ", ".join(str(o.view if numbers is None else numbers[o.view]) for o in views)
        one = len(views) == 1
        them, its = ("it", "its") if one else ("them", "their")
        if kind:
            sentences.append(
                f"view {names} {'shows' if one else 'show'} the board from the other side than the rest: {its} corners "
                f"are counted in mirrored order, or the image is mirrored; put {them} right or leave {them} out"
            )
        else:
            rms = ", ".join(f"{o.rms:.{0 if o.rms > 10 else 1}f}" for o in views)
            sentences.append(
                f"view {names} {'fits' if one else 'fit'} no pose of the board (RMS {rms} px, the median of the others "
                f"is {views[0].typical_rms:.2g} px): {its} corners are in another order than the board's points, or of "
                f"another board; the whole fit suffers, leave {them} out or put {them} right"
            )
    return tuple(sentences)


def blame_odd_views(odd: Sequence[OddView], error: DegenerateGeometryError) -> None:
    """Raise what refuses the views with those named that spoil them; return where none is in another order.

    A lens that the model cannot draw (which may be why the views are refused) leaves residuals too, but not of half a
    square.
    """
    to_blame = [view for view in odd if not view.from_behind and view.squares > _BLAMED_SQUARES]
    if to_blame:
        raise OddViewsError(f"{odd_view_warnings(to_blame)[0]}; with all views, {error}") from error


def _views_that_no_pose_fits(
    bundle: Bundle, solution: BundleSolution, rms: Float, solve: Callable[[Bundle], BundleSolution] | None
) -> list[OddView]:
    """Suspects that the camera of the others cannot draw either."""
    bundle = replace(bundle, loss="linear")
    good, fit = np.ones(len(rms), dtype=bool), solution.state
    of_homography = _homography_rms(bundle)
    suspects = of_homography > _SUSPECT_HOMOGRAPHY * np.median(of_homography)
    if not suspects.any():
        suspects = rms > max(_SUSPECT * np.median(rms), _SUSPECT_PIXELS)
    for _ in range(_ROUNDS):
        left = np.count_nonzero(good & ~suspects)
        if not suspects.any() or left < max(_LEAST_VIEWS, len(good) / 2):
            break
        good &= ~suspects
        part, start = of_views(bundle, solution.state, np.flatnonzero(good))
        try:
            of_part = solve_bundle(part, start) if solve is None else solve(part)
        except StereocalError:
            return []  # the others do not give a camera: nothing is known of any view
        fit = replace(of_part.state, R_views=solution.state.R_views.copy(), t_views=solution.state.t_views.copy())
        fit.R_views[good], fit.t_views[good] = of_part.state.R_views, of_part.state.t_views
        rms = _view_rms(bundle, fit)
        for view in np.flatnonzero(~good):
            rms[view] = min(rms[view], _best_pose_rms(*of_views(bundle, fit, np.array([view]))))
        suspects = good & (rms > max(_SUSPECT * np.median(rms[good]), _SUSPECT_PIXELS))
    typical = float(np.median(rms[good]))
    squares = rms / _square_sizes(bundle)
    odd = ~good & (rms > _ODD * typical) & (squares > _ODD_SQUARES)
    return [OddView(int(v), False, float(rms[v]), typical, float(squares[v])) for v in np.flatnonzero(odd)]


def _view_rms(bundle: Bundle, state: BundleState) -> Float:
    """RMS of each view, pixels; infinite where a corner cannot be drawn."""
    squares = np.nan_to_num(np.sum(residuals(bundle, state) ** 2, axis=1), nan=np.inf)
    return np.asarray(np.sqrt(np.add.reduceat(squares, bundle.offsets[:-1]) / np.diff(bundle.offsets)))


def _best_pose_rms(view: Bundle, state: BundleState) -> float:
    """RMS of one view, the camera held: from the pose of its homography, and from that tilted the other way."""
    theta = state.intrinsics[0]
    K = np.array([[theta[0], theta[4], theta[2]], [0, theta[1], theta[3]], [0, 0, 1]])
    R, t = seen_boards(view).poses(K)
    held = replace(view, G=np.zeros((len(view.G), 0)))
    fit = solve_bundle(held, replace(state, R_views=R, t_views=t)).state
    other = with_reversed_poses(view, fit, "numba")
    return float(_view_rms(view, fit if other is None else other)[0])


def _homography_rms(bundle: Bundle) -> Float:
    """How far corners are from where each view's homography takes the board's points, pixels, (V,)."""
    boards = seen_boards(bundle)
    view = np.repeat(np.arange(bundle.view_count), np.diff(bundle.offsets))
    X = np.column_stack([bundle.points[:, :2] - boards.middle[view], np.ones(len(view))])
    u = np.einsum("nij,nj->ni", boards.H[view], X)
    squares = np.sum((u[:, :2] / u[:, 2:] - bundle.measured) ** 2, axis=1)
    return np.asarray(np.sqrt(np.add.reduceat(squares, bundle.offsets[:-1]) / np.diff(bundle.offsets)))


def _square_sizes(bundle: Bundle) -> Float:
    """The size of a square in each view, pixels, from the area that the corners take up, whatever their order."""
    low, high = (f.reduceat(bundle.measured, bundle.offsets[:-1]) for f in (np.minimum, np.maximum))
    return np.asarray(np.sqrt(np.prod(high - low, axis=1) / np.diff(bundle.offsets)))
