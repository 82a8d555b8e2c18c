"""Where the iteration starts, and how an optimum is known to be the lowest.

Candidates for the camera matrix, the poses that go with them and the first lens come from ``camera_starts`` and
``lens_starts``; the search only has to come within the basin of Levenberg–Marquardt. They are taken in the order

1. Zhang's closed forms;
2. the focal lengths at which an ideal lens fits best;
3. the best of these, its lens k1, k2 fitted with the principal point held, before everything is let go;
4. the focal lengths at which a lens k1, k2 and boards free to reverse their tilt fit best;
5. the best focal length of 2 with the principal point away from the middle, towards each corner of the image.

One basin is not always enough. A long lens seen at moderate tilts leaves the principal point open, which p1 and p2
can trade for a turn of every board, and F then has several minima. So the optimum reached is looked at: if it took
many steps, if the principal point is uncertain by more than 1 % of the image, or if it is no plausible camera, the
other starts are tried too and the lowest F wins.
Then, and where one view fits much worse than the others, each board is tilted the other way (``pose_reversal``).

Of many views a few, spread over all, give the camera as well as the iteration needs it, at a fraction of the cost: it
is found from those first, and what remains for everything together are a few steps.

The lens starts from none or, where that is no good start, as ``lens_starts`` has it. A lens of many coefficients
(rational and beyond) has minima of its own and long flat valleys between them: every start gets a limited number of
steps, and only the lowest few go on to the end. A parameter that has come to a bound of its model, where it changes
nothing to first order, is held there and the rest goes on (a field-of-view lens asked to draw a pincushion).

Which of the solutions wins, ``optima`` says. If there is no optimum among those of a rational lens, or the lowest is a
kink (``lens_doubts``), the poles of the lens are searched for (``pole_search``).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from stereocal.base.errors import ConvergenceError, StereocalError
from stereocal.camera.bundle import Bundle, BundleState, normal_equations
from stereocal.camera.bundle_compiled import compile_engine_ahead, has_kernel
from stereocal.camera.bundle_solver import BundleSolution, solve_bundle
from stereocal.camera.camera_starts import Start, closed_form_starts, focal_search, lens_search
from stereocal.camera.distortion import distortion_model
from stereocal.camera.distortion_base import DistortionModel
from stereocal.camera.lens_doubts import MANY_COEFFICIENTS
from stereocal.camera.lens_starts import (
    SMALLER,
    staged_start,
    start_from_smaller,
    start_without_prism,
    state_of,
    with_lens,
)
from stereocal.camera.optima import best_of, beyond_doubt, has_kink, has_outlying_view, is_optimum, polished
from stereocal.camera.parameters import free_columns, intrinsic_names
from stereocal.camera.pole_search import RADIAL, pole_starts
from stereocal.camera.pose_reversal import solve_with_reversals
from stereocal.camera.seen_boards import SeenBoards, seen_boards

# Models that OpenCV has, whose lens may start from zero; the others start from a fit with k1, k2.
_DIRECT_START = ("pinhole", "polynomial", "brown", "rational", "thin_prism", "tilted")
_REVERSALS = 5
# How far from the middle, as a part of the image, the principal point is put where it is in doubt.
_AWAY = 0.2
# From this number of views on, a part of them, about so many, gives the camera to begin with.
_MANY_VIEWS, _FEW_VIEWS = 200, 40
# The starts are good: hardly damped, the first step wins more. Where one is not, the damping grows within a few trials.
# But a lens of many coefficients, which trade with each other, would be sent far along their valley at once.
_START_DAMPING, _WARY_DAMPING = 1e-6, 1e-3
# At a bound itself the derivative vanishes, and with it the normal equations.
_NEXT_TO_BOUND = 1e-6
# Steps of each start, and where they are many and slow: of many coefficients without columns in the kernels.
_TRIAL_STEPS, _COSTLY_TRIAL_STEPS = 200, 60
# Starts that differ by less, in all numbers, are one.
_ONE_PLACE = 1e-3
# Starts that the search for poles gives, and how often it is made; steps that each of them gets, and how many go on.
_POLE_STARTS, _POLE_ROUNDS = 16, 3
_FIRST_STEPS, _GO_ON = 40, 4


def solve_from_starts(
    bundle: Bundle, lens: DistortionModel, held: set[str], image_size: tuple[int, int], *,
    aspect_ratio: float | None, max_iterations: int, backend: str, seek_poles: bool = True,
) -> BundleSolution:  # fmt: skip
    """Solve from one start after another until an optimum is beyond doubt; return the lowest.

    Parameters
    ----------
    bundle : Bundle
        Of one camera.
    lens : DistortionModel
        Its model.
    held : set of str
        Names of parameters that are held.
    image_size : (int, int)
        Width and height.
    aspect_ratio : float, optional
        fx / fy where it is known.
    max_iterations : int
        Limit on steps of each attempt.
    backend : {"numba", "numpy"}
        See ``bundle_solver``.
    seek_poles : bool
        Whether poles are searched for where they are adrift; a start for a larger model does without.

    Returns
    -------
    BundleSolution

    Raises
    ------
    ConvergenceError
        If no start leads anywhere.
    """
    if backend == "numba" and has_kernel(bundle):
        compile_engine_ahead(bundle)
    boards = seen_boards(bundle, backend=backend)
    tried: list[BundleSolution] = []
    best: BundleSolution | None = None
    from_few = _state_from_few(boards, lens, held, image_size, aspect_ratio, backend)
    states = _distinct(_starting_states(boards, lens, held, image_size, aspect_ratio, backend))
    many = lens.parameter_count >= MANY_COEFFICIENTS
    steps = min(max_iterations, _COSTLY_TRIAL_STEPS if many and not has_kernel(bundle) else _TRIAL_STEPS)
    for state in states if from_few is None else chain([from_few], states):
        solution = solve_bundle(
            bundle, state, max_iterations=steps, backend=backend,
            initial_damping=_WARY_DAMPING if many and state is not from_few else _START_DAMPING,
        )  # fmt: skip
        tried.append(_held_where_stuck(bundle, solution, lens, max_iterations, backend))
        if beyond_doubt(bundle, tried[-1], image_size):
            best = min(tried, key=lambda solution: solution.cost)
            if not has_outlying_view(bundle, best):
                return best
            break
    if best is None and seek_poles and _has_poles_adrift(bundle, tried, lens, image_size):
        smooth = _without_poles(boards, lens, held, image_size, aspect_ratio, backend)
        if smooth is not None:
            tried += _with_poles_sought(bundle, smooth, image_size, steps, backend)
    if best is None:
        best = polished(bundle, tried, image_size, max_iterations, backend)
    if best is not None and np.isfinite(best.cost):
        turned = solve_with_reversals(bundle, best, backend, rounds=_REVERSALS, steps=max_iterations)
        best = best_of(bundle, [turned, best], image_size)
    if best is None or not np.isfinite(best.cost):
        raise ConvergenceError(
            "no start leads to a camera: check that corners and board points are in the same order, and the number of "
            "inner corners"
        )
    return best


def _state_from_few(
    boards: SeenBoards, lens: DistortionModel, held: set[str], image_size: tuple[int, int],
    aspect_ratio: float | None, backend: str,
) -> BundleState | None:  # fmt: skip
    """The camera of some of many views, spread over all, and the poses of all for it; None where that fails."""
    bundle = boards.bundle
    if bundle.view_count < _MANY_VIEWS or lens.name not in _DIRECT_START:
        return None
    chosen = np.arange(bundle.view_count) % (bundle.view_count // _FEW_VIEWS) == 0
    counts = np.diff(bundle.offsets)
    rows = np.repeat(chosen, counts)
    some = int(np.count_nonzero(chosen))
    few = replace(
        bundle, points=bundle.points[rows], measured=bundle.measured[rows],
        offsets=np.concatenate([[0], counts[chosen].cumsum()]), camera_of_block=np.zeros(some, dtype=np.int64),
        view_of_block=np.arange(some), view_count=some,
        whitening=None if bundle.whitening is None else bundle.whitening[rows],
    )  # fmt: skip
    try:
        found = solve_from_starts(
            few, lens, held, image_size, aspect_ratio=aspect_ratio, max_iterations=_TRIAL_STEPS, backend=backend
        )
    except StereocalError:
        return None  # these views are degenerate; all of them may not be
    theta = found.state.intrinsics[0]
    K = np.array([[theta[0], theta[4], theta[2]], [0, theta[1], theta[3]], [0, 0, 1]])
    return BundleState([theta], np.eye(3)[None], np.zeros((1, 3)), *boards.poses(K))


def _held_where_stuck(
    bundle: Bundle, solution: BundleSolution, lens: DistortionModel, max_iterations: int, backend: str
) -> BundleSolution:
    """Go on with the parameters held, next to it, that reached a bound of the model (``DistortionModel.stuck``)."""
    stuck = lens.stuck(solution.state.intrinsics[0][5:])
    if solution.converged or not stuck:
        return solution
    rows = [5 + lens.parameter_names.index(name) for name in stuck]
    part = replace(bundle, G=bundle.G[:, ~np.any(bundle.G[rows] != 0, axis=0)])
    theta = solution.state.intrinsics[0].copy()
    theta[rows] = lens.neutral()[[row - 5 for row in rows]] + _NEXT_TO_BOUND
    there = replace(solution.state, intrinsics=[theta])
    further = solve_bundle(part, there, max_iterations=max_iterations, backend=backend)
    equations = normal_equations(bundle, further.state)
    return replace(further, equations=equations, iterations=solution.iterations + further.iterations)


def _distinct(states: Iterable[BundleState]) -> Iterator[BundleState]:
    """The states without those that repeat an earlier one: staged fits from different cameras may end in one place."""
    given: list[BundleState] = []
    for state in states:
        theta, R = state.intrinsics[0], state.R_views
        if not any(
            np.allclose(theta, other.intrinsics[0], rtol=_ONE_PLACE, atol=_ONE_PLACE)
            and np.allclose(R, other.R_views, rtol=0, atol=_ONE_PLACE)
            for other in given
        ):
            given.append(state)
            yield state


def _starting_states(
    boards: SeenBoards, lens: DistortionModel, held: set[str], image_size: tuple[int, int],
    aspect_ratio: float | None, backend: str,
) -> Iterator[BundleState]:  # fmt: skip
    bundle = boards.bundle
    direct = lens.name in _DIRECT_START or set(lens.parameter_names) <= held
    middle = ((image_size[0] - 1) / 2, (image_size[1] - 1) / 2)

    def staged(start: Start, *, hold_centre: bool) -> BundleState:
        camera = (start.K, start.R, start.t)
        return staged_start(bundle, camera, lens, held, backend, hold_centre=hold_centre)

    def begin(start: Start) -> BundleState:
        if "cx" in held:
            start.K[0, 2] = middle[0]
        if "cy" in held:
            start.K[1, 2] = middle[1]
        return state_of(start.K, start.R, start.t, lens.neutral()) if direct else staged(start, hold_centre=False)

    if lens.name in SMALLER and not set(lens.parameter_names) <= held:

        def solve(part: Bundle, smaller: DistortionModel, held: set[str]) -> BundleSolution:
            return solve_from_starts(part, smaller, held, image_size, aspect_ratio=aspect_ratio,
                                     max_iterations=_TRIAL_STEPS, backend=backend, seek_poles=False)  # fmt: skip

        from_smaller = start_from_smaller(bundle, lens, held, aspect_ratio, solve)
        if from_smaller is not None:
            yield from_smaller
            if lens.name == "tilted":
                yield start_without_prism(bundle, lens, from_smaller, held, aspect_ratio, _TRIAL_STEPS)
    for start in closed_form_starts(boards, image_size, aspect_ratio):
        yield begin(start)
        if lens.name == "tilted":
            return  # the two from its smaller models are the better ones
    found = focal_search(boards, image_size, aspect_ratio)
    for start in found:
        yield begin(start)
    for start in found[:1]:
        yield staged(start, hold_centre=True)
    if lens.name not in SMALLER:
        for state in lens_search(boards, image_size, aspect_ratio, backend):
            yield with_lens(bundle, state, lens, held)
    if direct and lens.name not in SMALLER and not {"cx", "cy"} & held:
        for start in found[:1]:
            for x, y in ((-1, -1), (1, -1), (-1, 1), (1, 1)):
                K = start.K.copy()
                K[:2, 2] = middle[0] + x * _AWAY * image_size[0], middle[1] + y * _AWAY * image_size[1]
                yield begin(Start(K, *boards.poses(K), np.nan))


def _without_poles(
    boards: SeenBoards, lens: DistortionModel, held: set[str], image_size: tuple[int, int],
    aspect_ratio: float | None, backend: str,
) -> BundleState | None:  # fmt: skip
    """A state of a rational lens whose k1, k2 alone are not 0: a fit of Brown's without k3."""
    brown = distortion_model("brown")
    names = intrinsic_names(brown)
    hold = (held & set(names)) | {"k3"}
    part = replace(boards.bundle, models=[brown], G=free_columns(names, hold, aspect_ratio))
    try:
        smooth = solve_from_starts(
            part, brown, hold, image_size, aspect_ratio=aspect_ratio, max_iterations=_TRIAL_STEPS, backend=backend
        )
    except ConvergenceError:
        return None
    theta = np.concatenate([smooth.state.intrinsics[0], np.zeros(lens.parameter_count - brown.parameter_count)])
    return replace(smooth.state, intrinsics=[theta])


def _with_poles_sought(
    bundle: Bundle, state: BundleState, image_size: tuple[int, int], steps: int, backend: str
) -> list[BundleSolution]:
    """Solutions from what ``pole_search`` gives at a state, and then at the lowest optimum, while that falls."""
    found: list[BundleSolution] = []
    lowest = np.inf
    for _ in range(_POLE_ROUNDS):
        starts = pole_starts(bundle, state, _POLE_STARTS)
        begun = [
            solve_bundle(bundle, start, max_iterations=min(steps, _FIRST_STEPS), backend=backend) for start in starts
        ]
        begun.sort(key=lambda solution: solution.cost)
        for i, solution in enumerate(begun[:_GO_ON]):
            if solution.reason == "iterations" and steps > _FIRST_STEPS:
                further = solve_bundle(bundle, solution.state, max_iterations=steps - _FIRST_STEPS, backend=backend)
                begun[i] = replace(further, iterations=_FIRST_STEPS + further.iterations)
        found += begun
        optima = [solution for solution in found if is_optimum(bundle, solution, image_size)]
        best = min(optima, key=lambda solution: solution.cost, default=None)
        if best is None or best.cost >= lowest:
            break
        lowest, state = best.cost, best.state
    return found


def _has_poles_adrift(
    bundle: Bundle, tried: list[BundleSolution], lens: DistortionModel, image_size: tuple[int, int]
) -> bool:
    """Whether the lens has poles that are free, and no optimum was found, or the lowest of them is a kink."""
    free = {name for name, row in zip(intrinsic_names(lens), bundle.G, strict=True) if row.any()}
    if not free.issuperset(RADIAL):
        return False
    optima = [solution for solution in tried if is_optimum(bundle, solution, image_size)]
    return not optima or has_kink(bundle, min(optima, key=lambda solution: solution.cost))
