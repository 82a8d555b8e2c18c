"""What is wrong with a set of stereo pairs: flips, mispairing, late shutters, a knocked camera, a bent board.

"Each camera calibrates well alone, together they have 30 px": the commonest question of all. The answer lies in what
should be constant and is not. Calibrate each camera alone; then view i gives the pose of the board in both cameras, and
from them the rig as that view sees it. In a healthy set all views see one rig. The deviations from it have a shape, and
the shape names the fault:

===================  ==============================================================================================
``corner_order``     the deviation is a turn by 180° about the board's normal: left and right count the corners
                     from opposite ends; undone, the view fits
``pairing``          the view fits no rig, but with *another* view's right image it does: file lists are shifted
``knocked``          the views before some moment see one rig, those after it another: a camera moved
``synchronisation``  the board is elsewhere in the right image, by a step along the way it was moving (or, if its
                     way is not known, by one that changes from view to view): shutters did not open together
``bent_board``       each view fits, but the corners deviate by the same pattern in all views, and in both cameras:
                     the pattern of heights above a plane
``outlier``          a single view fits nothing: a detection gone wrong, or a board that was not held still
===================  ==============================================================================================

**The deviation as a motion.** Let the rig be R, T. The board's pose R_l, t_l in the left camera predicts the pose R
R_l, R t_l + T in the right one. What is measured there differs from it by a small turn ω and a displacement d of the
board's centre c (camera frame). The uncertainty Σ of (ω, d) follows from both poses' covariances, (JᵀJ)⁻¹ σ². A knock
turns the right camera by ω₀ and moves it by d₀, and shows as ω = ω₀, d = ω₀ × c + d₀, the same ω₀, d₀ in all later
views: six numbers and a moment explain everything. A late shutter shows as (ω, d) = δ · (the board's turn and way from
view to view), one number δ if the delay is constant. Both are linear least squares, and the F statistic compares them
with the noise that is left.

**The board's heights.** With z_j the height of corner j, the image moves by (∂p/∂Z)_ij z_j. All residuals of a camera
are fitted by heights, small changes of each view's pose and of the intrinsics at once; three heights' worth (a plane)
is taken up by the poses. A bent board shows as heights that are far above their uncertainty, matter against the square,
and agree between the two cameras.

The limits were set on synthetic rigs (``benchmarks/study_diagnosis.py``: 200 sets with each fault, and healthy ones),
and checked on the three sets of photographs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from stereocal.base.checks import Float, as_image_size, as_points
from stereocal.base.errors import InputError
from stereocal.base.rotations import rotation_vector
from stereocal.pair.board_heights import BoardHeights, board_heights
from stereocal.pair.corner_order import turned_orders
from stereocal.pair.view_rigs import (
    Rig,
    Turns,
    ViewPoses,
    average_rig,
    board_turn,
    common_motion,
    deviation,
    motion_design,
    predicted_errors,
    rough_errors,
    view_poses,
    whiten,
)

if TYPE_CHECKING:
    from stereocal.board.chessboard import Chessboard

_MIN_PAIRS = 5
# A right view belongs to a left one if the rig predicts it to about this (pixels, and times the cameras' own RMS).
_FIT_PIXELS, _FIT_FACTOR = 3.0, 5.0
# Partners are looked for this many places away in the list; fewer wrong pairs than this are not a shifted list.
_SHIFTS, _WRONG_PAIRS = 5, 3
# A single view that is predicted this far off fits nothing.
_GROSS_PIXELS, _GROSS_FACTOR = 4.0, 6.0
# A knock: F statistic, share of the deviations that it explains, size against the noise, least views on each side.
_STEP_F, _STEP_SHARE, _STEP_NOISE, _LEAST_SIDE = 15.0, 0.5, 3.0, 3
# Late shutters: F statistic, share, least lag in intervals; or scatter without a known way.
_LAG_F, _LAG_SHARE, _LEAST_LAG = 25.0, 0.25, 0.02
_SCATTER_PIXELS, _SCATTER = 3.0, 6.0
# A board is called bent above this range of heights, in squares, if both cameras see it alike.
_BEND_SQUARES, _BEND_AGREEMENT, _BEND_SIGMAS = 0.02, 0.7, 6.0


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes
    ----------
    kind : str
        ``corner_order``, ``pairing``, ``knocked``, ``synchronisation``, ``bent_board`` or ``outlier``.
    pairs : tuple of int
        Which pairs it concerns, counted from 0; all for a board.
    message : str
        What it is, how it shows, and what to do.
    strength : float
        The number that told it (degrees, pixels, F statistic or squares, as the message says).
    """

    kind: str
    pairs: tuple[int, ...]
    message: str
    strength: float


@dataclass(frozen=True)
class PairDiagnosis:
    """What is wrong with a set of pairs, and what it was told by.

    Attributes
    ----------
    findings : list of Finding
        Empty for a healthy set.
    pair_errors : ndarray of shape (n,)
        RMS distance in the right image between the corners that the left view predicts and those measured, pixels.
    heights : BoardHeights
        The board's shape.
    """

    findings: list[Finding]
    pair_errors: Float
    heights: BoardHeights = field(repr=False)

    @property
    def kinds(self) -> set[str]:
        """The kinds found."""
        return {finding.kind for finding in self.findings}


def diagnose_pairs(
    board: Chessboard,
    left_corners: Sequence[ArrayLike],
    right_corners: Sequence[ArrayLike],
    image_size: tuple[int, int],
    *,
    model: str = "brown",
) -> PairDiagnosis:
    """Tell what is wrong with a set of stereo pairs of a chessboard.

    Parameters
    ----------
    board : Chessboard
        The target.
    left_corners, right_corners : sequence of array_like of shape (N, 2)
        Detected corners, one array a pair, in the order in which the pairs were taken.
    image_size : (int, int)
        Width and height of the images.
    model : str
        Lens model of the cameras.

    Returns
    -------
    PairDiagnosis

    Raises
    ------
    InputError
        If there are fewer than 5 pairs, or their numbers of corners do not match the board.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    >>> board = sc.Chessboard((7, 6), 25.0)
    >>> tilts = [(0.4, 0, 0), (-0.4, 0.1, 0), (0, 0.4, 0.1), (0.1, -0.4, 0), (0.3, 0.3, 0.2), (-0.3, 0.3, 0)]
    >>> camera = sc.Camera(K, None, (640, 480))
    >>> left = [camera.project(board.object_points, tilt, [-75, -60, 400]).round(2) for tilt in tilts]
    >>> right = [camera.project(board.object_points, tilt, [-135, -60, 400]).round(2) for tilt in tilts]
    >>> diagnosis = sc.diagnose_pairs(board, left, right, (640, 480))
    >>> diagnosis.findings
    []
    >>> diagnosis.pair_errors.shape
    (6,)
    """
    size = as_image_size(image_size)
    left = [as_points(c, 2, "left_corners") for c in left_corners]
    right = [as_points(c, 2, "right_corners") for c in right_corners]
    if len(left) != len(right) or len(left) < _MIN_PAIRS:
        raise InputError(
            f"a diagnosis needs at least {_MIN_PAIRS} pairs, but {len(left)} left and {len(right)} right boards are "
            "given"
        )
    count = board.corner_count
    if any(len(c) != count for c in (*left, *right)):
        raise InputError(f"every view must list the board's {count} corners ({board.columns}x{board.rows})")
    first, second = (view_poses(board.object_points, views, size, model) for views in (left, right))
    noise = float(np.hypot(first.rms, second.rms))
    orders = turned_orders(board.columns, board.rows)
    rig, partner, turns = _common_rig(first, second, orders, max(_FIT_PIXELS, _FIT_FACTOR * noise))
    second = second.turned(turns, orders)
    here = np.arange(len(left))
    findings = _pairing(partner) + _corner_order(turns, partner)
    together = here[partner == here] if not findings or findings[0].kind != "pairing" else here[partner >= 0]
    if len(together):
        rig = average_rig(first, second, together, partner[together], rig)
    in_order = not any(finding.kind == "pairing" for finding in findings)
    paired = here if in_order else partner
    errors = predicted_errors(first, second, here, paired, rig)
    heights = board_heights(first, second)
    bent = _bent_board(heights, board.square_size, len(left))
    findings += bent
    if in_order:
        findings += _disagreement(first, second, rig, noise, len(bent) > 0)
    return PairDiagnosis(findings, errors, heights)


def _common_rig(first: ViewPoses, second: ViewPoses, orders: list[Turns], limit: float) -> tuple[Rig, Turns, Turns]:
    """Find the rig that most left views see with some right view, and which turn of the board each needs.

    Returns the rig, for each left view its right view (its own where that fits, or where none does), and for each RIGHT
    view the number of the turn.
    """
    count = len(first.R)
    here = np.arange(count)
    reach = min(_SHIFTS, count - 2)
    allowed = np.abs(here[:, None] - here[None]) <= reach
    turns = [board_turn(first.object_points, order) for order in orders]
    i, j = np.nonzero(allowed)
    candidates: list[Rig] = []
    for D in turns:
        R = second.R[j] @ D @ np.swapaxes(first.R[i], 1, 2)
        candidates += zip(R, second.centres[j] - np.einsum("nab,nb->na", R, first.centres[i]), strict=True)
    R, T = np.array([c[0] for c in candidates]), np.array([c[1] for c in candidates])
    errors = np.stack([rough_errors(first, second, R, T, D) for D in turns])
    errors = np.where(allowed, errors, np.inf)
    by_turn = errors.argmin(axis=0)
    nearest = errors.min(axis=0)
    own = nearest[:, here, here]
    fits_own = (own <= limit).sum(axis=1)
    fits_any = (nearest.min(axis=2) <= limit).sum(axis=1)
    mildness = np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1))
    # most views that fit at all, then most that fit with their own partner, then the tightest, milder rigs first
    tightness = np.minimum(np.sort(own, axis=1)[:, : max(count // 2, 1)].mean(axis=1), 1e3) / limit
    merit = fits_any + 1.5 * fits_own - 0.2 * np.minimum(tightness, 5) - 0.3 * mildness
    best = int(np.argmax(merit))
    partner = np.where(own[best] <= limit, here, nearest[best].argmin(axis=1))
    strays = nearest[best][here, partner] > limit
    partner = np.where(strays, here, partner)
    turn = np.zeros(count, dtype=np.int64)
    turn[partner] = by_turn[best][here, partner]
    return (R[best], T[best]), partner, turn


def _pairing(partner: Turns) -> list[Finding]:
    """Name a shifted list if several left views belong to other right views."""
    here = np.arange(len(partner))
    wrong = np.flatnonzero(partner != here)
    if len(wrong) < _WRONG_PAIRS:
        return []
    shifts, counts = np.unique(partner[wrong] - wrong, return_counts=True)
    shift = int(shifts[np.argmax(counts)])
    if counts.max() < 0.6 * len(wrong):
        return []
    first_wrong = int(wrong[partner[wrong] - wrong == shift][0])
    return [
        Finding(
            "pairing",
            tuple(int(i) for i in wrong),
            f"Left and right images are not paired as they were taken: from pair {first_wrong + 1} on, left image n "
            f"belongs to right image n{shift:+d} ({len(wrong)} of {len(here)} pairs). A picture is missing in one of "
            f"the "
            "lists, or one too many; pair the files by name.",
            float(shift),
        )
    ]


def _corner_order(turns: Turns, partner: Turns) -> list[Finding]:
    """Name the views whose right corners are counted from another end."""
    turned = np.flatnonzero(turns)
    if len(turned) == 0:
        return []
    return [
        Finding(
            "corner_order",
            tuple(int(i) for i in turned),
            f"The corners are counted from different ends of the board in left and right of {len(turned)} pairs "
            f"({_listed(turned)}): they fit only if the board is turned in one of the two. Turn the order of one "
            "(repair_corner_order does), and use one detector for both cameras.",
            180.0,
        )
    ]


def _bent_board(heights: BoardHeights, square_size: float, views: int) -> list[Finding]:
    """Name a board whose heights matter, are certain, and are seen alike by both cameras."""
    span = heights.range / square_size
    if span < _BEND_SQUARES or heights.agreement < _BEND_AGREEMENT or heights.range < _BEND_SIGMAS * heights.sigma:
        return []
    return [
        Finding(
            "bent_board",
            tuple(range(views)),
            f"The board is not flat: its corners stand {span:.3f} squares apart in height, and both cameras see the "
            f"same shape (correlation {heights.agreement:.2f}). Fix the sheet to a stiff plate, or calibrate with "
            "board_warp=True.",
            span,
        )
    ]


def _disagreement(first: ViewPoses, second: ViewPoses, rig: Rig, noise: float, bent: bool) -> list[Finding]:
    """Name what makes properly paired views disagree: a knock, late shutters, or single views gone wrong."""
    here = np.arange(len(first.R))
    # single views that fit nothing must not be taken for a movement of the camera
    errors = predicted_errors(first, second, here, here, rig)
    middle = float(np.median(errors))
    stray = np.flatnonzero(errors > max(_GROSS_PIXELS, _GROSS_FACTOR * max(middle, noise)))
    keep = np.setdiff1d(here, stray)
    found: list[Finding] = []
    knock = _knock(first, second, here, rig, noise)
    if knock is not None:
        return [knock]
    if len(stray) > 0.3 * len(here) or len(keep) < _MIN_PAIRS:
        keep, stray = here, stray[:0]
    late = _late_shutter(first, second, keep, rig, noise, bent)
    if len(stray):
        found.append(
            Finding(
                "outlier",
                tuple(int(i) for i in stray),
                f"{'One pair fits' if len(stray) == 1 else f'{len(stray)} pairs fit'} no common rig "
                f"({_listed(stray)}): the "
                "left view predicts the right corners "
                f"{float(errors[stray].max()):.1f} px away. Look at the detected corners, or leave them out.",
                float(errors[stray].max()),
            )
        )
    return found + ([late] if late is not None else [])


def _knock(first: ViewPoses, second: ViewPoses, here: Turns, rig: Rig, noise: float) -> Finding | None:
    """Compare one rig for all views with one before and another after each moment."""
    arms = first.centres @ rig[0].T
    xi, covariances = deviation(first, second, here, here, rig)
    _, whole = common_motion(xi, covariances, arms)
    splits = range(_LEAST_SIDE, len(here) - _LEAST_SIDE + 1)
    best, moment = np.inf, -1
    for s in splits:
        parts = [common_motion(xi[p], covariances[p], arms[p])[1] for p in (slice(0, s), slice(s, None))]
        if sum(parts) < best:
            best, moment = sum(parts), s
    if moment < 0:
        return None
    freedom = 6 * len(here) - 12
    strength = (whole - best) / 6 / max(best / freedom, 1.0)
    share = (whole - best) / max(whole, 1e-300)
    before = common_motion(xi[:moment], covariances[:moment], arms[:moment])[0]
    after = common_motion(xi[moment:], covariances[moment:], arms[moment:])[0]
    change = after - before
    f = float(second.camera.K[0, 0])
    depth = float(np.median(second.centres[:, 2]))
    pixels = f * float(np.hypot(np.linalg.norm(change[:3]), np.linalg.norm(change[3:]) / depth))
    if strength < _STEP_F or share < _STEP_SHARE or pixels < _STEP_NOISE * noise:
        return None
    return Finding(
        "knocked",
        tuple(range(moment, len(here))),
        f"A camera moved between pair {moment} and pair {moment + 1}: from there on the right camera stands turned "
        f"by {np.degrees(np.linalg.norm(change[:3])):.2f}° and shifted by {np.linalg.norm(change[3:]):.3g} against "
        f"before. "
        "Calibrate from the pairs after it (if the rig has not moved since), and fix the cameras to one another.",
        float(strength),
    )


def _late_shutter(
    first: ViewPoses, second: ViewPoses, keep: Turns, rig: Rig, noise: float, bent: bool
) -> Finding | None:
    """Compare the deviations with the board's way from view to view."""
    R = rig[0]
    xi, covariances = deviation(first, second, keep, keep, rig)
    arms = first.centres[keep] @ R.T
    design, b = whiten(motion_design(arms), xi, covariances)
    basis = np.linalg.qr(design.reshape(-1, 6))[0]
    way = _way(first, keep) @ np.kron(np.eye(2), R).T
    motion = whiten(np.zeros((len(keep), 6, 1)), way, covariances)[1].ravel()
    residual = b.ravel() - basis @ (basis.T @ b.ravel())
    motion = motion - basis @ (basis.T @ motion)
    before = float(residual @ residual)
    lag = float(motion @ residual) / max(float(motion @ motion), 1e-300)
    after = before - lag * float(motion @ residual)
    freedom = residual.size - 7
    strength = (before - after) / max(after / freedom, 1.0)
    if strength > _LAG_F and (before - after) / max(before, 1e-300) > _LAG_SHARE and abs(lag) > _LEAST_LAG:
        return Finding(
            "synchronisation",
            tuple(int(i) for i in keep),
            f"The two cameras did not expose at the same moment: the board is seen {abs(lag):.2f} of a picture's "
            f"interval {'further' if lag > 0 else 'back'} along its way in the right image. Trigger both cameras "
            f"together, or "
            "hold the board still for each pair.",
            float(strength),
        )
    errors = predicted_errors(first, second, keep, keep, rig)
    scatter = before / freedom
    if not bent and float(np.median(errors)) > _SCATTER_PIXELS * noise and scatter > _SCATTER:
        return Finding(
            "synchronisation",
            tuple(int(i) for i in keep),
            f"The pairs disagree about the rig, each in its own way: the left views predict the right corners "
            f"{float(np.median(errors)):.1f} px off, where the cameras alone leave {noise:.2f} px. Cameras that do "
            "not expose at the same moment do this (or a mount that is not stiff). Trigger both together, or hold "
            "the board "
            "still for each pair.",
            float(scatter),
        )
    return None


def _way(poses: ViewPoses, keep: Turns) -> Float:
    """Return the board's turn and way from view to view (half of that from the last to the next), per interval."""
    ways = np.zeros((len(keep), 6))
    last = len(poses.R) - 1
    for n, i in enumerate(keep):
        a, b = max(i - 1, 0), min(i + 1, last)
        turn = rotation_vector(poses.R[b] @ poses.R[a].T)
        ways[n] = np.concatenate([turn, poses.centres[b] - poses.centres[a]]) / (b - a)
    return ways


def _listed(indices: Turns) -> str:
    names = [str(int(i) + 1) for i in indices]
    return "pair " + ", ".join(names) if len(names) <= 8 else f"pairs {names[0]} … {names[-1]}"
