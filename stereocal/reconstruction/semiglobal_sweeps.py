"""How the sweeps of semi-global matching share memory and threads.

**Two threads.** A path from above needs the row above, so rows cannot simply be shared out. But one thread can go
down while another goes up: they meet in the middle, exchange the state of their paths, and each goes on into the half
that the other has crossed, where it adds the sums that the other has left and takes the winners at once. Each does half
of the work and waits once; the sums are of whole numbers, and the same whoever adds first.

**Memory.** C and S of all pixels at all disparities are the textbook's burden: 3 H·W·D bytes here (C in 8 bits, S in
16), 9 GB for 12 megapixels and D = 256. That is held up to :data:`VOLUME_BYTES`. Above, a sweep keeps its state (3 W·D
bytes, the last row of its paths) at the border of each strip of √H rows, and the sums of the last strip alone. Coming
back, the sums of a strip are made once more from the state kept there (A. Griewank's checkpoints, 1992). That is half
as much work again, but the strips stay in the cache, and memory that is new to a process costs more than that. The
memory is then about 9 √H·W·D bytes, 0.5 GB for those 12 megapixels.

**Five paths.** None comes from below, so one sweep downwards is all there is, a few rows at a time. Two threads take
turns on these strips: while one follows the paths from above and takes the winners, the other computes the next
strip's costs and its paths from the right.
"""

from __future__ import annotations

import math
import threading
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stereocal.reconstruction import matching_costs
from stereocal.reconstruction.matching_costs import Gray, PixelCost, PreparedPair
from stereocal.reconstruction.winner import Disparity, RowSelector, Search, run_together

FOLLOW, STORE, FINISH = 0, 1, 2  # what a sweep does with its sums: see the kernel

VOLUME_BYTES = 2**27
"""The memory for C and S up to which they are held as a whole; and the most that is kept from call to call."""

_KEPT: list[NDArray[np.uint8]] = []
_KEPT_LOCK = threading.Lock()

STREAM_BYTES = 2**22
"""The memory for C and S of a strip where five paths are followed."""


def match_by_sweeps(
    left: Gray,
    right: Gray,
    recipe: PixelCost,
    block_size: int,
    search: Search,
    P1: int,
    penalties: NDArray[np.uint8],
    paths: int,
    threads: int,
    strip_rows: int | None = None,
) -> Disparity:
    """Return the disparity of :func:`stereocal.reconstruction.semiglobal.match_sgm` before its filters."""
    height = len(left)
    pair = matching_costs.prepare_pair(
        left, right, num_disparities=search.num_disparities, min_disparity=search.min_disparity, recipe=recipe
    )
    disparity = np.empty(left.shape, np.float32)
    if paths == 5:
        rows = strip_rows or max(STREAM_BYTES // (3 * left.shape[1] * pair.lanes), 1)
        strips = [(y, min(y + rows, height)) for y in range(0, height, rows)]
        Stream(strips, pair, left, recipe, block_size, search, P1, penalties, disparity).run(threads)
        return disparity
    rows = strip_rows or rows_of_strip(height, left.shape[1] * pair.lanes)
    middle = height // 2
    upper = [(y, min(y + rows, middle)) for y in range(0, middle, rows)]
    lower = [(max(y - rows, middle), y) for y in range(height, middle, -rows)]
    tallest = max(end - first for first, end in upper + lower)
    halves = [
        Half(strips, step, tallest, pair, left, recipe, block_size, search, P1, penalties, paths, disparity)
        for strips, step in ((upper, 1), (lower, -1))
    ]
    run_together([half.arrive for half in halves], min(threads, 2))
    met = [half.state.copy() for half in halves]
    run_together([partial(halves[0].leave, met[1]), partial(halves[1].leave, met[0])], min(threads, 2))
    for half in halves:
        return_memory(half.memory)
    return disparity


def borrow_memory(size: int) -> NDArray[np.uint8]:
    """Return at least `size` bytes of scratch memory, an earlier call's if that is large enough.

    Fresh memory is zeroed by the system, page by page, when it is first written: a fifth of the time of a call at
    640x480. So a call leaves its memory to the next; see :func:`return_memory`.
    """
    with _KEPT_LOCK:
        memory = _KEPT.pop() if _KEPT else None
    return memory if memory is not None and len(memory) >= size else np.empty(size, np.uint8)


def return_memory(memory: NDArray[np.uint8]) -> None:
    """Keep scratch memory for the next call: two pieces at most, :data:`VOLUME_BYTES` together."""
    with _KEPT_LOCK:
        if len(_KEPT) < 2 and len(memory) <= VOLUME_BYTES // 2:
            _KEPT.append(memory)


def rows_of_strip(height: int, cells: int) -> int:
    """Return how many rows a strip has: half of the image if its volumes are small enough, else √H.

    Parameters
    ----------
    height : int
    cells : int
        W · D, with D rounded up to the kernels' lanes.
    """
    return (height + 1) // 2 if 3 * height * cells <= VOLUME_BYTES else math.isqrt(height - 1) + 1


class Sweeper:
    """The costs and sums of a strip, and the kernels that fill them: what both plans below do their sweeps with.

    Parameters
    ----------
    tallest : int
        The greatest number of rows in a strip.
    """

    def __init__(
        self,
        tallest: int,
        pair: PreparedPair,
        guide: Gray,
        recipe: PixelCost,
        block_size: int,
        search: Search,
        P1: int,
        penalties: NDArray[np.uint8],
        paths: int,
        disparity: Disparity,
    ) -> None:
        height, width = guide.shape
        self.pair, self.recipe, self.block_size, self.search = pair, recipe, block_size, search
        self.P1, self.paths, self.disparity = P1, paths, disparity
        margin = np.zeros((height + 2, width + 2), np.uint8)
        margin[1:-1, 1:-1] = guide
        self.guide = margin.reshape(-1)
        self.penalties = np.concatenate((penalties[:0:-1], penalties))
        cells = tallest * width * pair.lanes
        self.memory = borrow_memory(3 * cells)
        self.cost = self.memory[:cells].reshape(tallest, width, pair.lanes)
        self.total = self.memory[cells : 3 * cells].view(np.uint16)
        self.sums = np.empty(width * pair.lanes, np.uint16)
        self.selector = RowSelector(pair, search)

    def fresh_state(self) -> NDArray[np.uint8]:
        """Return the state of the paths at the image's border."""
        return np.zeros(3 * (self.disparity.shape[1] + 2) * self.pair.lanes, np.uint8)

    def fill_costs(self, strip: tuple[int, int]) -> None:
        """Compute C of a strip."""
        matching_costs.cost_rows(
            self.pair, strip, self.cost[: strip[1] - strip[0]], num_disparities=self.search.num_disparities,
            recipe=self.recipe, block_size=self.block_size,
        )  # fmt: skip

    def sweep(self, strip: tuple[int, int], step: int, state: NDArray[np.uint8], mode: int) -> None:
        """Follow the paths that come from above (`step` 1) or from below (-1) through a strip."""
        from stereocal.reconstruction import semiglobal_kernels as kernels
        from stereocal.reconstruction.vector_primitives import lanes_of

        rows = strip if step > 0 else (strip[1] - 1, strip[0] - 1)
        kernels.sweep_rows(
            self.cost.reshape(-1), self.guide, self.penalties, self.P1, strip[0], rows,
            self.paths != 4, lanes_of(self.pair.lanes), state, self.total, mode, self.sums,
            *self.selector.arguments, self.disparity,
        )  # fmt: skip

    def follow_from_right(self, strip: tuple[int, int]) -> None:
        """Follow the path from the right through a strip, and store its L as the sums."""
        from stereocal.reconstruction import semiglobal_kernels as kernels
        from stereocal.reconstruction.vector_primitives import lanes_of

        kernels.follow_from_right(
            self.cost.reshape(-1), self.guide, self.penalties, self.P1, strip, self.disparity.shape[1],
            lanes_of(self.pair.lanes), self.total,
        )  # fmt: skip


class Stream:
    """Five paths: down through the image, strip by strip."""

    def __init__(
        self,
        strips: list[tuple[int, int]],
        pair: PreparedPair,
        guide: Gray,
        recipe: PixelCost,
        block_size: int,
        search: Search,
        P1: int,
        penalties: NDArray[np.uint8],
        disparity: Disparity,
    ) -> None:
        self.strips = strips
        tallest = strips[0][1] - strips[0][0]
        common = tallest, pair, guide, recipe, block_size, search, P1, penalties, 5, disparity
        self.sweepers = [Sweeper(*common) for _ in range(min(2, len(strips)))]
        self.state = self.sweepers[0].fresh_state()

    def run(self, threads: int) -> None:
        """Fill the disparity map."""
        if threads == 1 or len(self.strips) == 1:
            for n in range(len(self.strips)):
                self.prepare(n)
                self.finish(n)
        else:
            self.prepare(0)
            for n in range(len(self.strips)):
                following = [partial(self.prepare, n + 1)] if n + 1 < len(self.strips) else []
                run_together([partial(self.finish, n), *following], threads)
        for sweeper in self.sweepers:
            return_memory(sweeper.memory)

    def prepare(self, n: int) -> None:
        """Compute the costs of strip n, and follow its paths from the right."""
        sweeper = self.sweepers[n % 2]
        sweeper.fill_costs(self.strips[n])
        sweeper.follow_from_right(self.strips[n])

    def finish(self, n: int) -> None:
        """Follow the paths from the left and from above through strip n, and take its winners."""
        self.sweepers[n % 2].sweep(self.strips[n], 1, self.state, FINISH)


class Half(Sweeper):
    """One half of the image, and the sweep that comes from its far border: one thread's work.

    Parameters
    ----------
    strips : list of (first, end)
        The half's rows, in the order in which the sweep meets them.
    step : int
        1 if the sweep goes down, -1 if it goes up.
    """

    def __init__(self, strips: list[tuple[int, int]], step: int, *common: Any) -> None:
        super().__init__(*common)
        self.strips, self.step = strips, step
        self.state = self.fresh_state()
        self.checkpoints: list[NDArray[np.uint8]] = []

    def arrive(self) -> None:
        """Sweep from the border to the middle; the last strip's sums are kept, of the others the state before them."""
        for strip in self.strips:
            self.checkpoints.append(self.state.copy())
            self.fill_costs(strip)
            self.sweep(strip, self.step, self.state, STORE if strip == self.strips[-1] else FOLLOW)

    def leave(self, other: NDArray[np.uint8]) -> None:
        """Take the other half's sweep on from the middle to the border, and with it the disparities."""
        for strip, checkpoint in zip(self.strips[::-1], self.checkpoints[::-1], strict=True):
            if strip != self.strips[-1]:
                self.fill_costs(strip)
                self.sweep(strip, self.step, checkpoint, STORE)
            self.sweep(strip, -self.step, other, FINISH)
