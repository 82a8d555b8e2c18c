"""What is wrong with a set of stereo pairs: flips, mispairing, late shutters, a knocked camera, a bent board.

"Each camera calibrates well alone, together they have 30 px": the commonest question of all. The answer lies in what
should be constant and is not. Calibrate each camera alone; then view i gives the pose of the board in both cameras, and
from them the rig as that view sees it. In a healthy set all views see one rig. The deviations from it have a shape, and
the shape names the fault:

===================  ==============================================================================================
``corner_order``     the deviation is a turn by 180° about the board's normal: left and right count the corners
                     from opposite ends; undone, the view fits (``view_pairing``)
``pairing``          the view fits no rig, but with *another* view's right image it does: file lists are shifted
                     (``view_pairing``)
``knocked``          the views before some moment see one rig, those after it another: a camera moved
                     (``rig_motion``)
``synchronisation``  the board is elsewhere in the right image, by a step along the way it was moving (or, if its
                     way is not known, by one that changes from view to view): shutters did not open together
                     (``rig_motion``)
``bent_board``       each view fits, but the corners deviate by the same pattern in all views, and in both cameras:
                     the pattern of heights above a plane (``board_heights``)
``outlier``          a single view fits nothing: a detection gone wrong, or a board that was not held still
===================  ==============================================================================================

**In which order.** The poses come first, because a board counted from another end, or paired with another moment, says
nothing about the rig. Then the board's heights, which need no rig. A shifted list or a late shutter can look like a rig
that moves, so that knocks and shutters are looked for only when the pairs belong together: mend a shifted list first,
and ask again.

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
from stereocal.pair.board_heights import BoardHeights, board_heights
from stereocal.pair.corner_order import turned_orders
from stereocal.pair.findings import Finding
from stereocal.pair.rig_motion import disagreement_findings
from stereocal.pair.view_pairing import common_rig, corner_order_findings, pairing_findings
from stereocal.pair.view_rigs import average_rig, predicted_errors, view_poses

if TYPE_CHECKING:
    from stereocal.board.chessboard import Chessboard

_MIN_PAIRS = 5
# A board is called bent above this range of heights, in squares, if both cameras see it alike.
_BEND_SQUARES, _BEND_AGREEMENT, _BEND_SIGMAS = 0.02, 0.7, 6.0


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
    rig, partner, turns = common_rig(first, second, orders, noise)
    second = second.turned(turns, orders)
    here = np.arange(len(left))
    findings = pairing_findings(partner) + corner_order_findings(turns, partner)
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
        findings += disagreement_findings(first, second, rig, noise, len(bent) > 0)
    return PairDiagnosis(findings, errors, heights)


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
