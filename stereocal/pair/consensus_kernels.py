# mypy: allow-untyped-defs
"""The scores of many models on all matches, compiled: the twin of ``consensus``'s.

A model whose sum is already above the best one's cannot win, and is left after the chunk in which that happens.

Kernels take arrays and write into arrays; nothing is checked here.
"""

from __future__ import annotations

import numpy as np
from numba import njit

CHUNK = 64
SUMS = {"reassoc", "contract", "nsz"}
INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


@njit(cache=True, nogil=True, error_model="numpy", fastmath=SUMS, **INNER)
def capped_sum(F, points, start, stop, cap):
    """Σ min(e, cap), e = c²/w the squared Sampson distance, over the matches from start to stop."""
    a, b, c, d, e, f, g, h, i = F
    total = 0.0
    for k in range(start, stop):
        x, y, u, v = points[0, k], points[1, k], points[2, k], points[3, k]
        n0, n1 = a * x + b * y + c, d * x + e * y + f
        m0, m1 = a * u + d * v + g, b * u + e * v + h
        value = n0 * u + n1 * v + g * x + h * y + i
        error = value * value / max(n0 * n0 + n1 * n1 + m0 * m0 + m1 * m1, 1e-300)
        total += min(error, cap)
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def distinct_indices(uniform, count, samples):
    """Fill each row of `samples` with distinct indices below `count` (Floyd): a repeated one becomes the last."""
    draws, size = uniform.shape
    for n in range(draws):
        for place in range(size):
            last = count - size + place
            drawn = int(uniform[n, place] * (last + 1))
            for before in range(place):
                if samples[n, before] == drawn:
                    drawn = last
                    break
            samples[n, place] = drawn


@njit(cache=True, nogil=True, error_model="numpy")
def best_by_msac(models, preview, points, finalists, cap):
    """Return which model has the least Σ min(e, cap), the first of equals, and that sum.

    Only as many as there are `finalists`, those with the least sums on the matches of `preview`, are scored on all.
    """
    winner, best, count = -1, np.inf, points.shape[1]
    least, index = np.full(finalists, np.inf), np.full(finalists, -1)
    if finalists < len(models):
        for m in range(len(models)):
            total = capped_sum(models[m], preview, 0, preview.shape[1], cap)
            place = finalists  # insertion into the sorted list of the least sums
            while place > 0 and total < least[place - 1]:
                if place < finalists:
                    least[place], index[place] = least[place - 1], index[place - 1]
                place -= 1
            if place < finalists:
                least[place], index[place] = total, m
    else:
        for m in range(len(models)):
            index[m] = m
    for m in index:
        if m < 0:
            continue
        total, start = 0.0, 0
        while start < count and total < best:
            stop = min(start + CHUNK, count)
            total += capped_sum(models[m], points, start, stop, cap)
            start = stop
        if total < best or (total == best and m < winner):
            winner, best = m, total
    return winner, best


@njit(cache=True, nogil=True, error_model="numpy")
def best_by_median(models, points):
    """Return which model has the least median of squared Sampson distances, the first of equals, and that median."""
    winner, best, count = -1, np.inf, points.shape[1]
    errors = np.empty(count)
    for m in range(models.shape[0]):
        below = 0
        for k in range(count):
            errors[k] = capped_sum(models[m], points, k, k + 1, np.inf)
            below += errors[k] < best
        if 2 * below >= count or best == np.inf:  # else the median cannot be below the best one
            middle = np.median(errors)
            if middle < best:
                winner, best = m, middle
    return winner, best
