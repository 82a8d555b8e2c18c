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

How the sweeps share memory and threads is told in :mod:`stereocal.reconstruction.semiglobal_sweeps`.

Source: H. Hirschmüller, *Stereo processing by semiglobal matching and mutual information* (2008).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import require_choice, require_integer, require_positive
from stereocal.base.errors import InputError
from stereocal.reconstruction import matching_costs
from stereocal.reconstruction.census import runs_compiled
from stereocal.reconstruction.islands import filter_islands
from stereocal.reconstruction.matching_costs import COST_MAX, COSTS, RECIPES, Gray
from stereocal.reconstruction.postprocessing import median_of_nine
from stereocal.reconstruction.sad import as_gray_pair
from stereocal.reconstruction.semiglobal_sweeps import match_by_sweeps
from stereocal.reconstruction.winner import Disparity, Search, select, thread_count

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
    P1: int = 26,
    P2: int = 120,
    gradient_scale: float | None = 40.0,
    subpixel: bool = True,
    left_right_check: int | None = 2,
    uniqueness_ratio: int = 0,
    median: bool = True,
    speckle_size: int = 100,
    speckle_range: float = 2.0,
    texture_threshold: int = 8,
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
        Percent by which the best sum must undercut all others that are not its neighbours; 0 refuses ties alone.
    median : bool
        Whether each disparity is replaced by the median of 3x3 pixels, which closes small holes as well.
    speckle_size : int
        Islands of at most so many pixels are removed; 0 keeps all islands.
    speckle_range : float
        Neighbours that differ by at most so many pixels belong to one island.
    texture_threshold : int
        Larger islands are removed too if the grey value hardly anywhere in them changes by more than this, in grey
        levels, from the left neighbour to the right (:mod:`stereocal.reconstruction.islands`); 0 does not ask.
    threads : int, optional
        1 or 2 (more are no help); the result does not depend on it. None takes all cores.
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
    The two backends are equal to the bit. The penalties lie in a flat optimum over those scenes and the same under
    noise, other exposures, blur and rows that are off (``benchmarks/study_matching_conditions.py``).

    A blank region takes over the disparity of what surrounds it, however far: that is what the smoothness is for. It
    also fills the black margin of a rectified image, so mask that by where the maps point outside the photograph. A
    blank patch that is joined to nothing with texture is not believed.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> scene = np.random.default_rng(0).integers(0, 256, (40, 120), dtype=np.uint8)
    >>> left, right = scene[:, :-4], scene[:, 4:]  # all of it 4 px away
    >>> disparity = sc.match_sgm(left, right, num_disparities=16)
    >>> round(float(np.nanmedian(disparity)), 1)
    4.0
    """
    require_choice(cost, COSTS, "cost")
    require_choice(backend, ("numba", "numpy"), "backend")
    left_gray, right_gray = as_gray_pair(left, right)
    search = Search.checked(num_disparities, min_disparity, subpixel, left_right_check, uniqueness_ratio)
    recipe = RECIPES[cost]
    block_size = require_integer(block_size, "block_size", minimum=1, odd=True)
    matching_costs.require_block_fits(block_size, recipe)
    if paths not in tuple(DIRECTIONS):
        raise InputError(f"paths must be 4, 5 or 8, not {paths!r}")
    P1 = require_integer(P1, "P1", minimum=0)
    P2 = require_integer(P2, "P2", minimum=P1 + 1, maximum=255 - COST_MAX)
    penalties = jump_penalties(P1, P2, gradient_scale)
    size = require_integer(speckle_size, "speckle_size", minimum=0)
    texture_threshold = require_integer(texture_threshold, "texture_threshold", minimum=0, maximum=255)
    if not speckle_range >= 0:
        raise InputError(f"speckle_range must be 0 or more (pixels), but is {speckle_range!r}")
    if not runs_compiled(backend):
        volume = matching_costs.cost_volume(
            left_gray, right_gray, num_disparities=search.num_disparities, min_disparity=search.min_disparity,
            recipe=recipe, block_size=block_size,
        )  # fmt: skip
        disparity = select(sum_paths(volume, left_gray, P1, penalties, paths), search)
    else:
        disparity = match_by_sweeps(
            left_gray, right_gray, recipe, block_size, search, P1, penalties, paths, thread_count(threads)
        )
    if median:
        disparity = median_of_nine(disparity, backend=backend)
    if size:
        disparity = filter_islands(
            disparity, left_gray, max_size=size, max_difference=speckle_range, texture_threshold=texture_threshold,
            backend=backend,
        )  # fmt: skip
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
