"""Which of several solutions is the camera: what an optimum is, when it is beyond doubt, and how others get there.

The lowest F wins. But F need not have a lowest minimum. A rational lens lets it fall, by a thousandth, for as long as
its coefficients grow: c and q of c/q leave their 1 behind, or a pole and a zero close in on one corner. What such a way
has come to after any number of steps is a low F and no optimum. So of rational lenses the lowest F wins only among
solutions that are optima:

- a test of the iteration ended it (``bundle_solver``);
- the camera is plausible (``camera_starts``);
- its focal length is determined, to a half at least.

Where none is, the lowest F is all there is to return; ``degeneracy`` then says what is missing.

Solutions near to the lowest that were still under way go on, along their valleys (``bundle_geodesic``). With one at
hand that has arrived, they do so only as long as they could still come below it: a rational lens of a camera that is no
longer plausible ran away, and what would not get there with all its steps at the pace of the last ones will not.

An optimum is beyond doubt if it was found in few steps, with a principal point that the views determine, and, of a
rational lens, without a kink (``lens_doubts``).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from stereocal.camera.bundle import Bundle
from stereocal.camera.bundle_solver import BundleSolution, solve_bundle
from stereocal.camera.camera_starts import plausible
from stereocal.camera.covariance import half_of_inverse
from stereocal.camera.lens_doubts import UNDETERMINED, kink_radius, squared_radii

# An optimum found in more steps than this, or with a principal point less sure than this part of the width, is doubted.
_MANY_STEPS = 20
_UNSURE = 0.01
# Times the median RMS of the views, beyond which a view may be in another minimum than the rest.
_OUTLYING = 3.0
# How near to the lowest, as a part of F, a solution must have come to go on, how many do, and how far between looks.
_NEAR = 2e-3
_POLISHED = 3
_LOOK_STEPS = 200
# Solutions of the same F and camera, to these parts of them, are on their way to one place.
_SAME, _SAME_CAMERA = 1e-6, 1e-2


def is_optimum(bundle: Bundle, solution: BundleSolution, image_size: tuple[int, int]) -> bool:
    """Whether a solution has arrived, is a plausible camera, and its focal length is determined.

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    solution : BundleSolution
        Of it.
    image_size : (int, int)
        Width and height.

    Returns
    -------
    bool
    """
    if not solution.converged or not _is_plausible(solution, image_size):
        return False
    freedom = 2 * len(bundle.points) - bundle.G.shape[1] - 6 * bundle.view_count
    if freedom <= 0 or not bundle.G.shape[1]:
        return True
    half = half_of_inverse(solution.equations)
    if half is None:
        return False
    row = bundle.G[1] @ half
    return math.sqrt(float(row @ row) * solution.cost / freedom) < UNDETERMINED * solution.state.intrinsics[0][1]


def beyond_doubt(bundle: Bundle, solution: BundleSolution, image_size: tuple[int, int]) -> bool:
    """Whether an optimum was found quickly, is a plausible camera, and has a centre that the data determine.

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    solution : BundleSolution
        Of it.
    image_size : (int, int)
        Width and height.

    Returns
    -------
    bool
    """
    fx, fy, cx, cy = solution.state.intrinsics[0][:4]
    if not solution.converged or solution.iterations > _MANY_STEPS or not plausible(fx, fy, cx, cy, image_size):
        return False
    if has_kink(bundle, solution):
        return False
    freedom = 2 * len(bundle.points) - bundle.G.shape[1] - 6 * bundle.view_count
    if freedom <= 0 or not bundle.G.shape[1]:
        return True
    half = half_of_inverse(solution.equations)
    if half is None:
        return False  # something is not determined at all: another start may do better
    rows = bundle.G[2:4] @ half
    variance = float((rows * rows).sum(axis=1).max()) * solution.cost / freedom
    return math.sqrt(variance) < _UNSURE * max(image_size)


def has_kink(bundle: Bundle, solution: BundleSolution) -> bool:
    """Whether a pole of a rational lens is next to the corners (``lens_doubts``).

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    solution : BundleSolution
        Of it.

    Returns
    -------
    bool
    """
    if "k6" not in bundle.models[0].parameter_names:
        return False
    s_max = float(squared_radii(bundle, solution.state, 0).max())
    return kink_radius(solution.state.intrinsics[0][5:], s_max) is not None


def has_outlying_view(bundle: Bundle, solution: BundleSolution) -> bool:
    """Whether a view fits much worse than the others do, as one whose board is tilted the wrong way.

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    solution : BundleSolution
        Of it.

    Returns
    -------
    bool
    """
    d = solution.equations.residuals
    squares = np.add.reduceat(d[:, 0] ** 2 + d[:, 1] ** 2, bundle.offsets[:-1]) / np.diff(bundle.offsets)
    middle = len(squares) // 2
    return bool(squares.max() > _OUTLYING**2 * np.partition(squares, middle)[middle])


def polished(
    bundle: Bundle, tried: list[BundleSolution], image_size: tuple[int, int], max_iterations: int, backend: str
) -> BundleSolution | None:
    """Return the lowest optimum among the solutions tried, after those near to it that had not arrived have gone on.

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    tried : list of BundleSolution
        Of it.
    image_size : (int, int)
        Width and height.
    max_iterations : int
        Limit on steps of each, those that it has taken included.
    backend : {"numba", "numpy"}
        See ``bundle_solver``.

    Returns
    -------
    BundleSolution or None
        The lowest F where none is an optimum; None where no F is finite.
    """
    tried = sorted((s for s in tried if np.isfinite(s.cost)), key=lambda solution: solution.cost)
    rational = "k6" in bundle.models[0].parameter_names
    optima = [rational and is_optimum(bundle, solution, image_size) for solution in tried]
    limit = min((s.cost for s, optimum in zip(tried, optima, strict=True) if optimum), default=np.inf)
    done = [solution for solution, optimum in zip(tried, optima, strict=True) if optimum][:1]
    under_way = [
        s for s in tried
        if s.reason == "iterations" and s.cost <= min(tried[0].cost, limit) * (1 + _NEAR)
        and (np.isinf(limit) or _is_plausible(s, image_size))
    ]  # fmt: skip
    for solution in _different(under_way)[:_POLISHED]:
        done.append(_arrived(bundle, solution, limit, image_size, max_iterations, backend))
        limit = min(limit, done[-1].cost if done[-1].converged else np.inf)
    done += tried[:1]
    return best_of(bundle, done, image_size)


def best_of(bundle: Bundle, solutions: list[BundleSolution], image_size: tuple[int, int]) -> BundleSolution | None:
    """Return the solution of the lowest F, of a rational lens the lowest optimum if there is one; None of none.

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    solutions : list of BundleSolution
        Of it.
    image_size : (int, int)
        Width and height.

    Returns
    -------
    BundleSolution or None
    """
    rational = "k6" in bundle.models[0].parameter_names
    return min(solutions, key=lambda s: (rational and not is_optimum(bundle, s, image_size), s.cost), default=None)


def _is_plausible(solution: BundleSolution, image_size: tuple[int, int]) -> bool:
    fx, fy, cx, cy = solution.state.intrinsics[0][:4]
    return plausible(fx, fy, cx, cy, image_size)


def _arrived(
    bundle: Bundle, solution: BundleSolution, to_beat: float, image_size: tuple[int, int], max_iterations: int,
    backend: str,
) -> BundleSolution:  # fmt: skip
    """Go on from a solution along its valley; given an F to beat, only while the camera and the pace leave hope."""
    while solution.reason == "iterations" and (left := max_iterations - solution.iterations) > 0:
        steps = left if np.isinf(to_beat) else min(left, _LOOK_STEPS)
        further = solve_bundle(bundle, solution.state, max_iterations=steps, backend=backend, in_valley=True)
        won = solution.cost - further.cost
        solution = replace(further, iterations=solution.iterations + further.iterations)
        ran_away = "k6" in bundle.models[0].parameter_names and not _is_plausible(solution, image_size)
        if ran_away or solution.cost - won * (left - steps) / steps > to_beat:
            break
    return solution


def _different(solutions: list[BundleSolution]) -> list[BundleSolution]:
    """The solutions without those that have come to the same place as another: of the same F and the same camera."""
    kept: list[BundleSolution] = []
    for s in solutions:
        K = s.state.intrinsics[0][:4]
        if not any(
            s.cost <= k.cost * (1 + _SAME) and np.allclose(K, k.state.intrinsics[0][:4], rtol=_SAME_CAMERA)
            for k in kept
        ):
            kept.append(s)
    return kept
