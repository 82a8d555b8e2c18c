"""Semi-global matching: every pixel listens to what lies along straight lines through it.

The best disparity of a pixel alone is noise wherever the texture is poor. What is wanted is the map d that fits the
images AND is smooth but for the edges of things, the least of

    E(d) = Σ_p C(p, d_p) + Σ_{p,q neighbours} ( P1 [ |d_p − d_q| = 1 ] + P2 [ |d_p − d_q| > 1 ] ),

with C the matching cost (:mod:`stereocal.reconstruction.matching_costs`), a small penalty P1 for the steps of a slanted
surface and a large one P2 for a jump. Over the plane that is beyond reach; along ONE line it is dynamic programming.
So H. Hirschmüller (2008) solves it along several lines that end in p, each from one direction r,

    L_r(p, d) = C(p, d) + min( L_r(p−r, d),  L_r(p−r, d±1) + P1,  min_k L_r(p−r, k) + P2 ) − min_k L_r(p−r, k)

(the last term keeps the numbers small and changes no minimum; at the image's border L_r = C), adds them up,

    S(p, d) = Σ_r L_r(p, d),

and lets the winner take all (:mod:`stereocal.reconstruction.winner`).

**Paths.** 8: both ways along rows, columns and diagonals. 4: without the diagonals. 5: OpenCV's set, both ways
along the row and the three from above.

**P2 adapts to the image.** Depth jumps where brightness does, so a jump is made cheaper there:

    P2(p, q) = max( P1 + 1,  P2 / (1 + |I(p) − I(q)| / g) ),      g = `gradient_scale`, grey levels.

**Two threads.** A path from above needs the row above, so rows cannot simply be shared out. But one thread can go down
while another goes up: they meet in the middle, having left the sums of their own paths in the half they have crossed,
and go on into the other's half, add what they find there, and take the winners at once. Each does half of the work and
waits once; the sums are of whole numbers, and the same whoever adds first.

**Memory**: H·W·D bytes for C and twice that for S: 59 MB for 640x480 and D = 64. (OpenCV's MODE_HH takes four bytes
where this takes three.)

Source: H. Hirschmüller, *Stereo processing by semiglobal matching and mutual information* (2008).
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import require_choice, require_integer, require_positive
from stereocal.base.errors import InputError
from stereocal.reconstruction import matching_costs
from stereocal.reconstruction.matching_costs import COST_MAX, COSTS, RECIPES, Gray, PixelCost
from stereocal.reconstruction.sad import as_gray_pair
from stereocal.reconstruction.speckles import filter_speckles
from stereocal.reconstruction.winner import (
    Disparity,
    RowSelector,
    Search,
    bands,
    run_together,
    select,
    thread_count,
)

DIRECTIONS = {
    4: ((1, 0), (-1, 0), (0, 1), (0, -1)),
    5: ((1, 0), (-1, 0), (1, 1), (0, 1), (-1, 1)),
    8: ((1, 0), (-1, 0), (1, 1), (0, 1), (-1, 1), (1, -1), (0, -1), (-1, -1)),
}
"""The steps r = (x, y) of the paths, by their number."""


def match_sgm(
    left: ArrayLike,
    right: ArrayLike,
    *,
    num_disparities: int = 64,
    min_disparity: int = 0,
    cost: str = "census+bt",
    block_size: int = 3,
    paths: int = 8,
    P1: int = 34,
    P2: int = 142,
    gradient_scale: float | None = 20.0,
    subpixel: bool = True,
    left_right_check: int | None = 1,
    uniqueness_ratio: int = 0,
    speckle_size: int = 100,
    speckle_range: float = 2.0,
    threads: int | None = None,
    backend: str = "numba",
) -> Disparity:
    """Disparity by semi-global matching, argmin_d Σ_r L_r(p, d).

    Parameters
    ----------
    left, right : array_like of shape (H, W) or (H, W, 3), uint8
        The rectified pair; colour is turned to grey.
    num_disparities, min_disparity : int
        The candidates: `num_disparities` values from `min_disparity` up.
    cost : {"census+bt", "census", "bt", "sad"}
        The matching cost, see :mod:`stereocal.reconstruction.matching_costs`.
    block_size : int
        Side of the block over which the cost is averaged, odd.
    paths : {8, 5, 4}
        How many paths.
    P1, P2 : int
        Penalties for a step of one disparity and for a jump, where 64 is the greatest matching cost there is.
        P1 < P2 ≤ 191.
    gradient_scale : float, optional
        g, grey levels: a difference of this size halves P2. None keeps P2 the same everywhere.
    subpixel : bool
        Whether the disparity is refined to a fraction of a pixel.
    left_right_check : int, optional
        The largest difference, in pixels, to the right image's own best disparity; None does not check.
    uniqueness_ratio : int
        Percent by which the best sum must undercut all others that are not its neighbours; 0 does not ask.
    speckle_size : int
        Islands of at most so many pixels are removed; 0 keeps them.
    speckle_range : float
        Neighbours that differ by at most so many pixels belong to one island.
    threads : int, optional
        1 or 2 for the paths, as many as given for the costs; the result does not depend on it. None takes all cores.
    backend : {"numba", "numpy"}
        The kernels, or the readable reference (slow: seconds for a small image).

    Returns
    -------
    ndarray of shape (H, W), float32
        Disparity of the left image, pixels; NaN where a check fails, and where the best candidate lies outside
        the right image. There is no blind band at the left border.

    Raises
    ------
    InputError
        If the images are not a pair of equal uint8 images, or a parameter is out of its range.

    Notes
    -----
    Answers to ``cv2.StereoSGBM`` (MODE_HH for 8 paths, MODE_SGBM for 5), which has another cost and other penalties:
    the two are compared by the truth of Middlebury scenes (``benchmarks/study_middlebury.py``), not pixel by pixel.
    The two backends are equal to the bit.
    """
    require_choice(cost, COSTS, "cost")
    require_choice(backend, ("numba", "numpy"), "backend")
    left_gray, right_gray = as_gray_pair(left, right)
    search = Search.checked(num_disparities, min_disparity, subpixel, left_right_check, uniqueness_ratio)
    recipe = RECIPES[cost]
    block_size = require_integer(block_size, "block_size", minimum=1, odd=True)
    matching_costs.require_block_fits(block_size, recipe)
    if paths not in DIRECTIONS:
        raise InputError(f"paths must be 4, 5 or 8, not {paths!r}")
    P1 = require_integer(P1, "P1", minimum=0)
    P2 = require_integer(P2, "P2", minimum=P1 + 1, maximum=255 - COST_MAX)
    penalties = jump_penalties(P1, P2, gradient_scale)
    size = require_integer(speckle_size, "speckle_size", minimum=0)
    if backend == "numpy":
        volume = matching_costs.cost_volume(
            left_gray, right_gray, num_disparities=search.num_disparities, min_disparity=search.min_disparity,
            recipe=recipe, block_size=block_size,
        )  # fmt: skip
        disparity = select(sum_paths(volume, left_gray, P1, penalties, paths), search)
    else:
        disparity = _match_by_kernels(
            left_gray, right_gray, recipe, block_size, search, P1, penalties, paths, thread_count(threads)
        )
    if size:
        disparity = filter_speckles(disparity, max_size=size, max_difference=speckle_range, backend=backend)
    return disparity


def jump_penalties(P1: int, P2: int, gradient_scale: float | None) -> NDArray[np.uint8]:
    """Return P2 for each difference of grey values 0 … 255, max(P1 + 1, P2 / (1 + |ΔI| / g)).

    Parameters
    ----------
    P1, P2 : int
    gradient_scale : float, optional
        g; None makes P2 the same for all.

    Returns
    -------
    ndarray of shape (256,), uint8
    """
    if gradient_scale is None:
        return np.full(256, P2, np.uint8)
    g = require_positive(gradient_scale, "gradient_scale")
    return np.maximum(P1 + 1, P2 / (1 + np.arange(256) / g)).astype(np.uint8)


def path_costs(
    volume: NDArray[np.int64], image: Gray, P1: int, penalties: NDArray[np.uint8], direction: tuple[int, int]
) -> NDArray[np.int64]:
    """Return L_r(p, d) of every pixel: the recursion as it is printed.

    Parameters
    ----------
    volume : ndarray of shape (H, W, D), int64
        C.
    image : ndarray of shape (H, W), uint8
        The left image, by whose differences P2 adapts.
    P1 : int
    penalties : ndarray of shape (256,), uint8
        P2 by the difference of grey values.
    direction : (int, int)
        r = (x, y).

    Returns
    -------
    ndarray of shape (H, W, D), int64
    """
    height, width, _ = volume.shape
    dx, dy = direction
    gray = image.astype(np.int64)
    L = volume.copy()
    for y in range(height)[:: dy or 1]:
        for x in range(width)[:: dx or 1]:
            y_before, x_before = y - dy, x - dx
            if not (0 <= y_before < height and 0 <= x_before < width):
                continue
            before = L[y_before, x_before]
            P2 = int(penalties[abs(gray[y, x] - gray[y_before, x_before])])
            best = np.minimum(before, before.min() + P2)
            best[1:] = np.minimum(best[1:], before[:-1] + P1)
            best[:-1] = np.minimum(best[:-1], before[1:] + P1)
            L[y, x] += best - before.min()
    return L


def sum_paths(
    volume: NDArray[np.int64], image: Gray, P1: int, penalties: NDArray[np.uint8], paths: int
) -> NDArray[np.int64]:
    """Return S(p, d) = Σ_r L_r(p, d) over the paths."""
    return np.sum([path_costs(volume, image, P1, penalties, r) for r in DIRECTIONS[paths]], axis=0)


def _match_by_kernels(
    left: Gray,
    right: Gray,
    recipe: PixelCost,
    block_size: int,
    search: Search,
    P1: int,
    penalties: NDArray[np.uint8],
    paths: int,
    threads: int,
) -> Disparity:
    from stereocal.reconstruction import semiglobal_kernels as kernels
    from stereocal.reconstruction.vector_primitives import lanes_of

    height, width = left.shape
    pair = matching_costs.prepare_pair(
        left, right, num_disparities=search.num_disparities, min_disparity=search.min_disparity, recipe=recipe
    )
    cost = np.empty((height, width, pair.lanes), np.uint8)

    def fill_rows(rows: tuple[int, int]) -> None:
        matching_costs.cost_rows(
            pair, rows, cost[slice(*rows)], num_disparities=search.num_disparities, recipe=recipe, block_size=block_size
        )

    run_together([partial(fill_rows, rows) for rows in bands(height, threads)], threads)

    total = np.empty(cost.size, np.uint16)
    disparity = np.empty((height, width), np.float32)
    states = [np.zeros(3 * (width + 2) * pair.lanes, np.uint8) for _ in range(2)]

    def sweep(rows: tuple[int, int], finishing: bool) -> None:
        downwards = rows[0] < rows[1]
        with_vertical = paths != 5 or downwards
        with_diagonals = with_vertical and paths != 4
        kernels.sweep_rows(
            cost.reshape(-1), left, penalties, P1, rows, with_vertical, with_diagonals, lanes_of(pair.lanes), states[0 if downwards else 1], total, finishing, *RowSelector(pair, search).arguments,
            np.empty(width * pair.lanes, np.uint16), disparity,
        )  # fmt: skip

    middle = height // 2
    top_down, bottom_up = (0, middle), (height - 1, middle - 1)
    run_together([partial(sweep, top_down, False), partial(sweep, bottom_up, False)], min(threads, 2))
    rest_down, rest_up = (middle, height), (middle - 1, -1)
    run_together([partial(sweep, rest_down, True), partial(sweep, rest_up, True)], min(threads, 2))
    return disparity
