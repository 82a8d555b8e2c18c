"""One thing that is wrong with a set of pairs: what a diagnosis is made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes
    ----------
    kind : str
        ``corner_order``, ``pairing``, ``knocked``, ``synchronisation``, ``bent_board`` or ``outlier``.
    pairs : tuple of int
        Which pairs it concerns, counted from 0; all for a board.
    message : str
        What it is, how it shows, and what to do.
    strength : float
        The number that told it (degrees, pixels, F statistic or squares, as the message says).
    """

    kind: str
    pairs: tuple[int, ...]
    message: str
    strength: float


def listed_pairs(indices: NDArray[np.int64]) -> str:
    """Return the pairs' numbers as a reader counts them, from 1: ``pair 2, 5``, or ``pairs 2 … 19`` if there are many.

    Parameters
    ----------
    indices : ndarray of shape (n,), int
        From 0.

    Returns
    -------
    str
    """
    names = [str(int(i) + 1) for i in indices]
    return "pair " + ", ".join(names) if len(names) <= 8 else f"pairs {names[0]} … {names[-1]}"
