"""Candidates for the camera matrix, and the poses that go with them.

Each candidate K is judged by what it is for: the poses are taken from the homographies (``seen_boards``), the corners
are projected by an ideal lens, and the candidate with the least distance to the measured corners goes first.

1. Zhang's closed form with the principal point at the middle of the image, fx and fy free;
2. Zhang's closed form without skew;
3. a focal-length search: fx = fy = 0.25 … 8 image widths, in steps of 2^¼, principal point in the middle: all
   local minima;
4. a focal-length search with a lens: at each of 0.25 … 8 widths, in steps of 2^½, K is held while k1, k2 and the poses
   are fitted, and each board is tried tilted the other way (``pose_reversal``); the two lowest minima.

The second is right for good views of an ideal lens. But what a real lens bends, it takes for perspective and puts the
principal point elsewhere, often by a tenth of the image; few cameras are as far off the middle as that, and from there
the iteration needs fewer steps. Noise, small tilts and strong distortion
can throw off both (B is not positive definite, or the principal point lands outside of the image) and the others stand
in: a fixed focal length cannot fail. The third needs no iteration, but an ideal lens is no good judge of what a strong
one has drawn, nor does it tell a tilt from its mirror image; the fourth is and does, at the price of a fit for each
focal length.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from stereocal.base.checks import Float
from stereocal.base.errors import DegenerateGeometryError
from stereocal.camera.bundle import BundleState
from stereocal.camera.bundle_solver import BundleSolution, solve_bundle
from stereocal.camera.lens_starts import state_of, with_polynomial
from stereocal.camera.pose_reversal import solve_with_reversals
from stereocal.camera.seen_boards import SeenBoards
from stereocal.camera.zhang import camera_of_homographies

# Of the search with a lens: steps of each fit, rounds of reversal, and how many minima go on.
_SEARCH_STEPS, _REVERSALS, _BEST = 30, 3, 2


@dataclass
class Start:
    """A start: K and the poses of the views, and, where starts are to be compared, the error of an ideal lens."""

    K: Float
    R: Float
    t: Float
    error: float


def start_from(K: Float, boards: SeenBoards) -> Start:
    """Return the start with a given K and poses from the homographies, and its error (infinite behind the camera)."""
    R, t = boards.poses(K)
    bundle = boards.bundle
    block = np.repeat(np.arange(len(t)), np.diff(bundle.offsets))
    P = np.matmul(K, np.concatenate([R[:, :, :2], t[:, :, None]], axis=2))[block]
    X, Y = bundle.points[:, :1], bundle.points[:, 1:2]
    h = P[:, :, 0] * X + P[:, :, 1] * Y + P[:, :, 2]
    if h[:, 2].min() <= 0:
        return Start(K, R, t, np.inf)
    d = h[:, :2] / h[:, 2:] - bundle.measured
    return Start(K, R, t, float(np.sqrt(np.vdot(d, d) / len(d))))


def closed_form_starts(boards: SeenBoards, image_size: tuple[int, int], aspect_ratio: float | None) -> Iterator[Start]:
    """Yield the starts that Zhang's closed forms give, where they have a plausible answer."""
    width, height = image_size
    for centre in (np.array([(width - 1) / 2, (height - 1) / 2]), None):
        try:
            K = camera_of_homographies(boards.H, skew=False, centre=centre)
        except DegenerateGeometryError:
            continue  # this closed form has no answer here; the next candidate stands in
        if plausible(K[0, 0], K[1, 1], K[0, 2], K[1, 2], image_size):
            if aspect_ratio is not None:
                K[0, 0] = aspect_ratio * K[1, 1]
            yield Start(K, *boards.poses(K), np.nan)


def focal_search(boards: SeenBoards, image_size: tuple[int, int], aspect_ratio: float | None) -> list[Start]:
    """Return the starts with fx = 0.25 … 8 widths that are local minima of the error, best first."""
    starts = [start_from(K, boards) for K in _centred_cameras(image_size, aspect_ratio, 0.25)]
    return [starts[i] for i in _local_minima([start.error for start in starts])]


def lens_search(
    boards: SeenBoards, image_size: tuple[int, int], aspect_ratio: float | None, backend: str
) -> list[BundleState]:
    """Return fits of k1, k2 and the poses before held cameras, fx = 0.25 … 8 widths: the lowest minima, best first."""
    bundle = with_polynomial(boards.bundle, {"fx", "fy", "cx", "cy", "skew"})
    found: list[BundleSolution] = []
    for K in _centred_cameras(image_size, aspect_ratio, 0.5):
        start = state_of(K, *boards.poses(K), np.zeros(2))
        first = solve_bundle(bundle, start, max_iterations=_SEARCH_STEPS, backend=backend)
        found.append(solve_with_reversals(bundle, first, backend, rounds=_REVERSALS, steps=_SEARCH_STEPS))
    return [found[i].state for i in _local_minima([solution.cost for solution in found])[:_BEST]]


def _centred_cameras(image_size: tuple[int, int], aspect_ratio: float | None, step: float) -> list[Float]:
    """Camera matrices with fx = 0.25 … 8 widths, in steps of 2^step, and the principal point in the middle."""
    width, height = image_size
    a = aspect_ratio or 1.0
    focal_lengths = width * 2.0 ** np.arange(-2, 3.01, step)
    return [np.array([[f, 0, (width - 1) / 2], [0, f / a, (height - 1) / 2], [0, 0, 1.0]]) for f in focal_lengths]


def _local_minima(values: list[float]) -> list[int]:
    """Where a sequence has its finite local minima, the lowest first."""
    padded = [np.inf, *values, np.inf]
    least = [i for i, v in enumerate(values) if v <= min(padded[i], padded[i + 2]) and v < np.inf]
    return sorted(least, key=values.__getitem__)


def plausible(fx: float, fy: float, cx: float, cy: float, image_size: tuple[int, int], margin: float = 0.25) -> bool:
    """Whether a camera could be like that: focal length 0.1 to 30 widths, pixels not oblong, centre not far outside."""
    width, height = image_size
    return bool(
        0.1 * width < fx < 30 * width
        and 0.4 < fx / fy < 2.5
        and -margin * width < cx < (1 + margin) * width
        and -margin * height < cy < (1 + margin) * height
    )
