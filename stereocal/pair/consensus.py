"""Consensus: a model from matches of which many are wrong.

Least squares believes every match, and one gross error ruins it. Random sampling believes none: it draws the *fewest*
matches that determine a model, solves, and asks how many of the others agree; when a sample happens to hold no outlier,
many do. Two scores are offered, both of the squared Sampson distances e_i (pixels²):

- **MSAC** (Torr and Zisserman, 2000), Σ min(eᵢ, t²): a robust likelihood for a known noise level, t the threshold.
  Unlike RANSAC's count it prefers the model that fits its inliers *better*.
- **LMedS** (Rousseeuw, 1984), median eᵢ: needs no threshold, because the median of the good half tells the noise,
  σ = 1.4826 (1 + 5/(N − p)) √median; it breaks above 50 % outliers.

**When to stop.** If a share w of the matches is good, a sample of s is good with probability wˢ, and after

    k = log(1 − confidence) / log(1 − wˢ)

draws one was good with the confidence asked for. w is taken from the best model so far, so that k shrinks as it gets
better: the matches within the threshold, and those that the refinement's mixture takes for good within three of it, so
that a threshold below the noise does not make the search endless.

**Local optimisation** (Chum, Matas, Kittler, 2003). A model from the fewest points carries all of their noise, and may
miss half of the true model's inliers, so that the count k comes out far too high. The best model of each stack of
draws, good or bad, is therefore refined by a few steps on all matches (``two_view_refinement``). A stack is small, so
that there are several such starts: the likelihood has several maxima, and what is returned is their mean
(``two_view_modes``). The score and its threshold steer the search only.

**The width of the mixture.** Wrong matches at random places in a picture of w × h pixels have distances that are about
uniform over ±L, L = √(w h) / √8. The refinement is told an eighth of it, as if there were eight times as many near the
model. A match is then doubted from 2.5 σ on instead of 3.3; what little it would have told is lost, but fewer wrong
ones bend the model. On random scenes (``benchmarks/study_two_views.py``) that lowers the error's median and 95th
percentile, and a factor of 4 or 16 does almost as well.

Draws come from a seeded generator in stacks: the same seed gives the same answer, on any machine.

Sources: M. Fischler, R. Bolles, CACM 24 (1981); P. Torr, A. Zisserman, *MLESAC*, CVIU 78 (2000); P. Rousseeuw, JASA 79
(1984); O. Chum, J. Matas, J. Kittler, *Locally optimized RANSAC*, DAGM 2003; R. Floyd, J. Bentley, *A sample of
brilliance*, CACM 30 (1987) (the draws).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.base.errors import DegenerateGeometryError
from stereocal.pair.two_view_models import TwoViewModel
from stereocal.pair.two_view_modes import Answer, mean_of_modes
from stereocal.pair.two_view_options import TwoViewOptions
from stereocal.pair.two_view_refinement import Refined, refine_model, signed_distances

# The least number of stacks, and steps of a local optimisation.
_LEAST_STACKS, _POLISH_ROUNDS = 8, 5
# Samples of good matches among whose solutions another one is looked for, and by how much its entries differ.
_RETRIES, _APART = 8, 0.1
# A match may be this many thresholds off and still be counted as good when the draws to make are reckoned.
_LOOSE = 3.0
# Matches for a first glance at a model, and how many models are then scored on all.
_PREVIEW, _FINALISTS = 64, 12
# What the mixture is told of the width over which wrong matches lie.
_NARROWER = 8.0
Mask = NDArray[np.bool_]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class MinimalProblem:
    """What consensus needs to know of F, or of E.

    Attributes
    ----------
    sample_size : int
        The fewest matches.
    solve : callable
        Samples (B, s) of indices to matrices (M, 9) in the solver's coordinates: of normalised points, or rays.
    to_pixels : ndarray of shape (9, 9)
        Which takes rows of such matrices to rows of F in pixels.
    model : callable
        Such a matrix (3, 3) to a model that can be refined.
    behind : callable
        A model and weights to the number of good matches that it puts behind a camera, if that can be known.
    twofold : bool
        Whether matches of a plane, which have two solutions, are allowed.
    stack : int
        Draws made at once: with 40 % outliers about two of them are good.
    """

    sample_size: int
    solve: Callable[[Indices], Float]
    to_pixels: Float
    model: Callable[[Float], TwoViewModel]
    behind: Callable[[TwoViewModel, Float], int]
    twofold: bool
    stack: int


class Consensus(NamedTuple):
    """The best F by the score, in pixels, which matches agree with it, the refined answer if asked for, and draws."""

    F: Float
    inliers: Mask
    answer: Answer | None
    iterations: int


def sampson_of_models(models: Float, points: Float) -> Float:
    """Return the squared Sampson distances of N pairs for M models at once.

    Parameters
    ----------
    models : ndarray of shape (M, 9)
    points : ndarray of shape (4, N)

    Returns
    -------
    ndarray of shape (M, N)
    """
    ones = np.ones((1, points.shape[1]))
    x, xp = np.vstack([points[:2], ones]), np.vstack([points[2:], ones])
    F = models.reshape(-1, 3, 3)
    right_lines, left_lines = F @ x, F.transpose(0, 2, 1) @ xp
    c = np.sum(xp * right_lines, axis=1)
    weight = np.sum(right_lines[:, :2] ** 2, axis=1) + np.sum(left_lines[:, :2] ** 2, axis=1)
    return np.asarray(c**2 / np.maximum(weight, 1e-300))


def best_model(
    models: Float, points: Float, score: str, threshold: float, *, backend: str = "numba"
) -> tuple[int, float]:
    """Return which model has the best score on all matches, and that score.

    Most models of a search are wrong, and a glance at a few matches shows it: where there are many, MSAC is summed over
    all of them only for the models that are best on an evenly chosen part.

    Parameters
    ----------
    models : ndarray of shape (M, 9)
    points : ndarray of shape (4, N)
    score : {"msac", "lmeds"}
    threshold : float
        t of MSAC, pixels.
    backend : {"numba", "numpy"}

    Returns
    -------
    winner : int
        The first of equals.
    score : float
        Pixels².
    """
    preview = np.ascontiguousarray(points[:, :: max(points.shape[1] // _PREVIEW, 1)])
    finalists = _FINALISTS if points.shape[1] >= 2 * _PREVIEW else len(models)
    if backend == "numpy":
        if score == "lmeds":
            values = np.median(sampson_of_models(models, points), axis=1)
        else:
            glance = np.minimum(sampson_of_models(models, preview), threshold**2).sum(axis=1)
            values = np.minimum(sampson_of_models(models, points), threshold**2).sum(axis=1)
            values[np.argsort(glance, kind="stable")[finalists:]] = np.inf
        winner = int(np.argmin(values))
        return winner, float(values[winner])
    from stereocal.pair.consensus_kernels import best_by_median, best_by_msac

    if score == "lmeds":
        return best_by_median(models, points)
    return best_by_msac(models, preview, points, finalists, threshold**2)


def draw_samples(random: np.random.Generator, draws: int, size: int, count: int, *, backend: str = "numba") -> Indices:
    """Draw samples of distinct indices below `count`, all equally likely (Floyd's algorithm).

    Parameters
    ----------
    random : Generator
    draws, size, count : int
    backend : {"numba", "numpy"}

    Returns
    -------
    ndarray of shape (draws, size), int
    """
    uniform = random.random((draws, size))
    samples = np.full((draws, size), -1, dtype=np.int64)
    if backend == "numba":
        from stereocal.pair.consensus_kernels import distinct_indices

        distinct_indices(uniform, count, samples)
        return samples
    for place, last in enumerate(range(count - size, count)):
        drawn = (uniform[:, place] * (last + 1)).astype(np.int64)
        taken = np.any(samples[:, :place] == drawn[:, None], axis=1)
        samples[:, place] = np.where(taken, last, drawn)
    return samples


def find_consensus(
    points: Float, problem: MinimalProblem, options: TwoViewOptions, *, outliers: bool = True
) -> Consensus:
    """Draw samples until a good one is certain enough, and return the best model.

    Parameters
    ----------
    points : ndarray of shape (4, N)
        Rows x, y of the left and x', y' of the right picture, pixels.
    problem : MinimalProblem
        The solver.
    options : TwoViewOptions
        The score, threshold, confidence, limit on draws, seed and backend, and whether to refine.
    outliers : bool
        Whether there are any.

    Returns
    -------
    Consensus

    Raises
    ------
    DegenerateGeometryError
        If no sample gave a model, or fewer matches agree with the best one than determine it.
    """
    random = np.random.default_rng(options.seed)
    count, size = points.shape[1], problem.sample_size
    extent = float(np.sqrt(np.prod(np.ptp(points[2:], axis=1) + 1e-9) / 8)) / _NARROWER if outliers else 0.0
    best: tuple[float, Float, Mask] | None = None
    starts: list[Refined] = []
    done, needed = 0, options.max_iterations
    while done < needed:
        batch = min(problem.stack, needed - done)
        cores = problem.solve(draw_samples(random, batch, size, count, backend=options.backend))
        done += batch
        if len(cores) == 0:
            continue
        models = cores @ problem.to_pixels
        winner, value = best_model(models, points, options.score, options.reach, backend=options.backend)
        start = problem.model(cores[winner].reshape(3, 3))
        polished = refine_model(
            start,
            points,
            reach=_reach(value, count - size, options) if outliers else 0.0,
            extent=extent,
            rounds=_POLISH_ROUNDS,
            exact=False,
            covariance=False,
            backend=options.backend,
        )
        starts.append(polished)
        models = np.array([models[winner], polished.F.ravel()])
        winner, value = best_model(models, points, options.score, options.reach, backend=options.backend)
        if best is None or value < best[0]:
            F = models[winner].reshape(3, 3)
            off, reach = np.abs(signed_distances(points, F, exact=False)), _reach(value, count - size, options)
            best = value, F, off <= reach
            good = best[2]
            if winner == 1 and outliers:  # the mixture knows the noise, which the threshold may be too narrow for
                good = good | ((polished.weights > 0.5) & (off <= _LOOSE * reach))
            share = min(max(float(good.mean()), 1e-6) ** size, 1 - 1e-12)
            enough = int(np.ceil(np.log(1 - options.confidence) / np.log1p(-share)))
            needed = min(options.max_iterations, max(enough, _LEAST_STACKS * problem.stack))
    if best is None or best[2].sum() < size:
        raise DegenerateGeometryError(
            "no epipolar geometry fits the matches: too few of them agree with any model; check that the pictures "
            "show the same scene, or raise the threshold"
        )
    answer = None
    if options.refines:
        if problem.twofold:
            starts += _other_solutions(points, problem, options, best[2], random, extent)
        answer = mean_of_modes(starts, points, extent, problem.model, problem.behind, backend=options.backend)
    return Consensus(best[1], best[2], answer, done)


def _other_solutions(
    points: Float,
    problem: MinimalProblem,
    options: TwoViewOptions,
    inliers: Mask,
    random: np.random.Generator,
    extent: float,
) -> list[Refined]:
    """Another solution of good samples that explains the matches nearly as well: matches of a plane have two."""
    good = np.flatnonzero(inliers)
    if len(good) < problem.sample_size:
        return []
    samples = draw_samples(random, _RETRIES, problem.sample_size, len(good), backend=options.backend)
    cores = problem.solve(good[samples])
    if len(cores) == 0:
        return []
    cap = max(options.reach, 1e-9) ** 2 if options.score == "msac" else np.inf
    values = np.minimum(sampson_of_models(cores @ problem.to_pixels, points[:, good]), cap).sum(axis=1)
    first = cores[np.argmin(values)]
    apart = np.minimum(np.abs(cores - first).max(axis=1), np.abs(cores + first).max(axis=1)) > _APART
    other = np.flatnonzero(apart & (values <= 2 * values.min() + 1e-9 * cap * len(good)))
    if len(other) == 0:
        return []
    start = problem.model(cores[other[np.argmin(values[other])]].reshape(3, 3))
    weights = inliers.astype(np.float64) if extent > 0 else None
    return [
        refine_model(
            start,
            points,
            weights,
            extent=extent,
            rounds=_POLISH_ROUNDS,
            exact=False,
            covariance=False,
            backend=options.backend,
        )
    ]


def _reach(value: float, freedom: int, options: TwoViewOptions) -> float:
    """The largest error of an inlier, pixels: the threshold, or 2.5 σ of the least median."""
    if options.score == "msac":
        return options.reach
    return float(2.5 * 1.4826 * (1 + 5 / max(freedom, 1)) * np.sqrt(value) + 1e-9)
