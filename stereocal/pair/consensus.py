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
better.

**Local optimisation** (Chum, Matas, Kittler, 2003). A model from the fewest points carries all of their noise. Each new
best one is therefore fitted again to its inliers, and kept if its score is better. Without this, the true model's
inliers are missed, and the count k comes out far too high.

Draws come from a seeded generator in stacks: the same seed gives the same answer, on any machine.

Sources: M. Fischler, R. Bolles, CACM 24 (1981); P. Torr, A. Zisserman, *MLESAC*, CVIU 78 (2000); P. Rousseeuw, JASA 79
(1984); O. Chum, J. Matas, J. Kittler, *Locally optimized RANSAC*, DAGM 2003.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from stereocal.base.checks import Float
from stereocal.base.errors import DegenerateGeometryError

_STACK = 100
Mask = NDArray[np.bool_]


class Consensus(NamedTuple):
    """The best model, its score, which matches agree, the largest error of an inlier (pixels), and the draws made."""

    F: Float
    score: float
    inliers: Mask
    threshold: float
    iterations: int


def stacked_sampson(F: Float, left: Float, right: Float) -> Float:
    """Return the squared Sampson distances of N pairs for M models at once.

    Parameters
    ----------
    F : ndarray of shape (M, 3, 3)
    left, right : ndarray of shape (N, 2)

    Returns
    -------
    ndarray of shape (M, N)
    """
    x = np.column_stack([left, np.ones(len(left))]).T
    xp = np.column_stack([right, np.ones(len(right))]).T
    right_lines, left_lines = F @ x, F.transpose(0, 2, 1) @ xp
    c = np.sum(xp * right_lines, axis=1)
    weight = np.sum(right_lines[:, :2] ** 2, axis=1) + np.sum(left_lines[:, :2] ** 2, axis=1)
    return np.asarray(c**2 / np.maximum(weight, 1e-300))


def find_consensus(
    left: Float,
    right: Float,
    *,
    solve: Callable[[NDArray[np.int64]], Float],
    sample_size: int,
    refit: Callable[[Mask, Float], Float | None],
    score: str,
    threshold: float,
    confidence: float,
    max_iterations: int,
    seed: int,
) -> Consensus:
    """Draw samples until a good one is certain enough, and return the best model.

    Parameters
    ----------
    left, right : ndarray of shape (N, 2)
        Matching pixels.
    solve : callable
        Samples (B, s) of indices to models F (M, 3, 3), in pixels.
    sample_size : int
        s.
    refit : callable
        Inliers and the model they are of, to a better model of them all, or None if they do not determine one.
    score : {"msac", "lmeds"}
        What is best.
    threshold : float
        t of MSAC, pixels; ignored by LMedS.
    confidence : float
        Of having drawn a good sample, below 1.
    max_iterations : int
        Limit on draws.
    seed : int
        Of the draws.

    Returns
    -------
    Consensus

    Raises
    ------
    DegenerateGeometryError
        If no sample gave a model, or fewer matches agree with the best one than determine it.
    """
    random = np.random.default_rng(seed)
    count = len(left)
    freedom = max(count - sample_size, 1)

    def judge(F: Float) -> tuple[Float, Float]:
        errors = stacked_sampson(F, left, right)
        if score == "lmeds":
            return np.median(errors, axis=1), errors
        return np.minimum(errors, threshold**2).sum(axis=1), errors

    def limit(value: float) -> float:
        """The largest error of an inlier, pixels."""
        return 2.5 * 1.4826 * (1 + 5 / freedom) * np.sqrt(value) + 1e-9 if score == "lmeds" else threshold

    best: Consensus | None = None
    done, needed = 0, max_iterations
    while done < needed:
        batch = min(_STACK, needed - done)
        samples = np.argsort(random.random((batch, count)), axis=1)[:, :sample_size]
        models = solve(samples)
        done += batch
        if len(models) == 0:
            continue
        values, errors = judge(models)
        winner = int(np.argmin(values))
        if best is not None and values[winner] >= best.score:
            continue
        reach = limit(float(values[winner]))
        best = Consensus(models[winner], float(values[winner]), errors[winner] <= reach**2, reach, done)
        for _ in range(5):
            better = refit(best.inliers, best.F) if best.inliers.sum() >= sample_size else None
            if better is None:
                break
            value, error = judge(better[None])
            if value[0] >= best.score:
                break
            reach = limit(float(value[0]))
            best = Consensus(better, float(value[0]), error[0] <= reach**2, reach, done)
        share = min(max(float(best.inliers.mean()), 1e-6) ** sample_size, 1 - 1e-12)
        needed = min(needed, int(np.ceil(np.log(1 - confidence) / np.log1p(-share))))
    if best is None or best.inliers.sum() < sample_size:
        raise DegenerateGeometryError(
            "no epipolar geometry fits the matches: too few of them agree with any model; check that the pictures "
            "show the same scene, or raise the threshold"
        )
    return best._replace(iterations=done)
