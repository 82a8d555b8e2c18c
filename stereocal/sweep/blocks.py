"""One window size with all speckle sizes: the unit of work of a sweep.

The cells of the grid share almost everything. A window size is matched once, not once for each speckle size; the
islands of its map are labelled once (:func:`~stereocal.reconstruction.speckles.speckle_sizes`), and a speckle size n
then only compares: it removes the pixels whose island has at most n. So the paper's 126 × 16 cells cost 126
matchings.

Three figures stand beside the paper's count, because the count alone misleads (see
:mod:`stereocal.sweep.disparity_sweep`): the number of pixels that *can* have a disparity, the share of the answers that
the right image confirms, and, where the truth is known, the share that is wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stereocal.reconstruction.block_matching import match_bm, valid_region
from stereocal.reconstruction.sad import match_sad, matched_region
from stereocal.reconstruction.speckles import speckle_sizes as island_sizes
from stereocal.report.left_right import confirmed_pixels, mirror

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class SweepSettings:
    """What is the same in every cell.

    Attributes
    ----------
    method : {"bm", "sad"}
        StereoBM's recipe, as the paper's code; or the paper's plain SAD.
    num_disparities, min_disparity : int
    speckle_range : int
        How much neighbours in an island may differ, in sixteenths of a pixel, as StereoBM's speckleRange.
    texture_threshold, uniqueness_ratio : int
        Of ``bm``.
    bad_limit : float
        A disparity is wrong if it is farther than this from the truth, pixels.
    """

    method: str = "bm"
    num_disparities: int = 32
    min_disparity: int = 1
    speckle_range: int = 1
    texture_threshold: int = 10
    uniqueness_ratio: int = 15
    bad_limit: float = 1.0


@dataclass(frozen=True)
class SweepRow:
    """One cell of the grid.

    Attributes
    ----------
    block_size, speckle_size : int
    count : int
        Disparities above 0: what the paper counts.
    computable : int
        Pixels whose window and search lie in the images: no more can have a disparity.
    consistency : float
        Of the pixels with a disparity that the right image can be asked about, the share that it confirms to a pixel;
        NaN without any.
    bad : float
        Of the pixels with a disparity and a truth, the share that is wrong; NaN without truth.
    """

    block_size: int
    speckle_size: int
    count: int
    computable: int
    consistency: float
    bad: float

    @property
    def fill(self) -> float:
        """Share of the computable pixels that have a disparity above 0."""
        return self.count / self.computable if self.computable else 0.0


def sweep_block(
    left: Image,
    right: Image,
    block_size: int,
    speckle_sizes: Sequence[int],
    settings: SweepSettings,
    truth: NDArray[np.float32] | None = None,
) -> list[SweepRow]:
    """Match one window size and filter by all speckle sizes.

    Parameters
    ----------
    left, right : ndarray of shape (H, W), uint8
        The rectified pair.
    block_size : int
    speckle_sizes : sequence of int
        Largest areas to remove; 0 removes none.
    settings : SweepSettings
    truth : ndarray of shape (H, W), optional
        True disparity of the left image, NaN where unknown.

    Returns
    -------
    list of SweepRow
        One a speckle size, in their order.
    """
    disparity = match(left, right, block_size, settings)
    mirrored = match(mirror(right), mirror(left), block_size, settings)
    columns, lines = computable_region(left.shape, block_size, settings)
    confirmed, asked = confirmed_pixels(disparity, mirrored[:, ::-1], columns)
    islands = island_sizes(disparity, settings.speckle_range / 16)
    computable = len(columns) * len(lines)
    positive = disparity > 0
    wrong = known = None
    if truth is not None:
        known = np.isfinite(truth)
        with np.errstate(invalid="ignore"):
            wrong = known & (np.abs(disparity - truth) > settings.bad_limit)
    rows = []
    for size in speckle_sizes:
        kept = positive & (islands > size)
        count = int(np.count_nonzero(kept))
        consistency = _share(kept & confirmed, int(np.count_nonzero(kept & asked)))
        bad = float("nan")
        if wrong is not None and known is not None:
            bad = _share(kept & wrong, int(np.count_nonzero(kept & known)))
        rows.append(SweepRow(int(block_size), int(size), count, computable, consistency, bad))
    return rows


def match(left: Image, right: Image, block_size: int, settings: SweepSettings) -> NDArray[np.float32]:
    """Disparity of one window size, on one thread: the executor shares out the sizes."""
    if settings.method == "sad":
        return match_sad(
            left, right, num_disparities=settings.num_disparities, min_disparity=settings.min_disparity,
            block_size=block_size, threads=1,
        )  # fmt: skip
    return match_bm(
        left, right, num_disparities=settings.num_disparities, min_disparity=settings.min_disparity,
        block_size=block_size, texture_threshold=settings.texture_threshold,
        uniqueness_ratio=settings.uniqueness_ratio, threads=1,
    )  # fmt: skip


def computable_region(shape: tuple[int, ...], block_size: int, settings: SweepSettings) -> tuple[range, range]:
    """Columns and rows of the pixels whose window and search lie in the images."""
    if settings.method == "sad":
        return matched_region(shape, settings.num_disparities, settings.min_disparity, block_size // 2)
    return valid_region(shape, settings.num_disparities, settings.min_disparity, block_size)


def _share(mask: NDArray[np.bool_], total: int) -> float:
    return int(np.count_nonzero(mask)) / total if total else float("nan")
