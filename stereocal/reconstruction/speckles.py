"""The speckle filter: small islands of the disparity map are removed.

A wrong match seldom has company: where the texture misleads the matcher, it finds one disparity here and quite another
a few pixels on. So pixels are joined with those of their four neighbours whose disparity differs by at most
`max_difference`, and an island (a connected component of this graph) of at most `max_size` pixels is taken for
noise and removed:

    p ~ q   ⇔   p, q are 4-neighbours, both have a disparity, and |d_p − d_q| ≤ max_difference
    d_p ← none   ⇔   #{q : q connected to p by ~} ≤ max_size.                                          [alg-speckle]

The disparity may drift within an island by any amount, as long as it does so in small steps: a slanted floor is one
component.

The paper prints the algorithm as pseudo-code which cannot be right as it stands: it never counts an island, so that
the size it speaks of (50 … 200) has nowhere to act, and it compares disparities with the marker for "no disparity" as
if that were a threshold. :func:`filter_speckles_as_printed` runs it to the letter, for the tests to show what it does.

How the fast kernel counts islands is told in :mod:`stereocal.reconstruction.speckles_kernels`.

Sources: the OpenCV function by the same name, in use since 2010, gave the paper its parameters. Components by
union-find: Tarjan (1975); on runs of pixels instead of pixels: Wu, Otoo and Suzuki (2009).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stereocal.base.checks import require_choice, require_integer
from stereocal.base.errors import InputError

DISPARITY_DTYPES = (np.uint8, np.int16, np.int32, np.float32, np.float64)


def filter_speckles(
    disparity: ArrayLike,
    *,
    max_size: int,
    max_difference: float,
    no_disparity: float = np.nan,
    backend: str = "numba",
) -> NDArray[Any]:
    """Remove islands of at most `max_size` pixels from a disparity map [alg-speckle].

    Parameters
    ----------
    disparity : array_like of shape (H, W), float32, float64, uint8, int16 or int32
        The map; `disparity` itself is left as it is.
    max_size : int
        The largest island that is removed, in pixels: an AREA, not the side of a window. 0 removes nothing.
    max_difference : float
        Neighbours that differ by at most this much belong together; in the unit of `disparity` (pixels, or sixteenths
        of a pixel in OpenCV's int16 maps). On integer maps it is rounded to a whole number first, as OpenCV does.
    no_disparity : float
        What marks a pixel without a disparity. An integer map needs it, for it has no NaN.
    backend : {"numba", "numpy"}
        The kernel, or the readable reference.

    Returns
    -------
    ndarray of shape (H, W), dtype of `disparity`
        The map with `no_disparity` in the place of each island.

    Raises
    ------
    InputError
        If the map is not two-dimensional, has another dtype, or is an integer map without a marker.

    Notes
    -----
    Paper: [alg-speckle], whose `minDiff` is `max_difference` and whose `nVal` is `no_disparity`.
    Answers to ``cv2.filterSpeckles(disparity, no_disparity, max_size, max_difference)``: identical on uint8 and int16
    (up to a max_difference of 255 and 32767, from where OpenCV's wraps around); on float maps, which OpenCV does not
    take, identical to OpenCV on the same map in sixteenths of a pixel.

    Examples
    --------
    >>> import numpy as np
    >>> import stereocal as sc
    >>> disparity = np.full((5, 6), 8, np.float32)
    >>> disparity[2, 2:4] = 20  # an island of two pixels
    >>> sc.filter_speckles(disparity, max_size=2, max_difference=1)[2]
    array([ 8.,  8., nan, nan,  8.,  8.], dtype=float32)
    """
    max_size = require_integer(max_size, "max_size", minimum=0)
    array, marker, max_difference = _as_disparity(disparity, no_disparity, max_difference)
    if not _runs_apply(backend):
        sizes = _component_sizes(array, marker, max_difference, backend)
        return np.where((sizes > 0) & (sizes <= max_size), marker, array)
    from stereocal.reconstruction import speckles_kernels as kernels

    filtered = array.copy()
    if max_size > 0:
        out = filtered.reshape(-1)
        runs = _label_runs(array, marker, max_difference, out, alone=marker)
        kernels.erase_small(*runs, max_size, marker, out)
    return filtered


def speckle_sizes(
    disparity: ArrayLike, max_difference: float, *, no_disparity: float = np.nan, backend: str = "numba"
) -> NDArray[np.int32]:
    """Return the size of the island that each pixel belongs to.

    A sweep over the largest size to be removed (the paper's figure 8) labels the map once and then compares:
    ``filter_speckles(…, max_size=n)`` removes the pixels with ``0 < sizes <= n``.

    Parameters
    ----------
    disparity : array_like of shape (H, W), float32, float64, uint8, int16 or int32
    max_difference : float
        Neighbours that differ by at most this much belong together.
    no_disparity : float
        What marks a pixel without a disparity.
    backend : {"numba", "numpy"}
        The kernel, or the readable reference.

    Returns
    -------
    ndarray of shape (H, W), int32
        Pixels in the island; 0 where there is no disparity.
    """
    array, marker, max_difference = _as_disparity(disparity, no_disparity, max_difference)
    if not _runs_apply(backend):
        return _component_sizes(array, marker, max_difference, backend)
    from stereocal.reconstruction import speckles_kernels as kernels

    sizes = np.zeros(array.size, np.int32)
    kernels.write_sizes(*_label_runs(array, marker, max_difference, sizes, alone=np.int32(1)), sizes)
    return sizes.reshape(array.shape)


def _runs_apply(backend: str) -> bool:
    """Whether the kernel on runs is to be used: not under the reference, nor where Numba is switched off."""
    if require_choice(backend, ("numba", "numpy"), "backend") == "numpy":
        return False
    from numba import config

    return not config.DISABLE_JIT


def _component_sizes(array: NDArray[Any], marker: Any, max_difference: float, backend: str) -> NDArray[np.int32]:
    """The sizes by the reference or by the plain kernel."""
    valid = ~np.isnan(array) if marker != marker else array != marker
    if array.dtype.kind == "f":
        valid &= ~np.isnan(array)
    if backend == "numpy":
        return _speckle_sizes_reference(array, valid, max_difference)
    from stereocal.reconstruction import speckles_kernels as kernels

    sizes = np.zeros(array.size, np.int32)
    kernels.component_sizes(array, valid, max_difference, np.empty(array.size, np.int32), sizes)
    return sizes.reshape(array.shape)


def _label_runs(
    array: NDArray[Any], marker: Any, max_difference: float, out: NDArray[Any], alone: Any
) -> tuple[int, NDArray[np.int32], NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Return (count, start, length, root, size) of the runs; write `alone` for pixels joined to nothing."""
    from stereocal.reconstruction import speckles_kernels as kernels

    width = array.shape[1]
    none: np.int16 | None = None
    limit: Any = np.float64(max_difference)
    if array.dtype.kind == "f":
        if marker == marker:
            array = np.where(array == marker, array.dtype.type(np.nan), array)
    elif array.dtype.itemsize <= 2:
        array, none, limit = array.astype(np.int16, copy=False), np.int16(marker), np.uint16(min(max_difference, 65535))
    else:
        array = np.where(array == marker, np.nan, array.astype(np.float64))
    words = -(-width // 64)
    start, length, root = np.empty((3, array.size), np.int32)
    count = kernels.label_runs(
        array, none, limit, alone, np.zeros(64 * words, np.uint8), np.empty((8, words), np.uint64),
        np.empty((2, words), np.int32), start, length, root, out,
    )  # fmt: skip
    size = np.empty(count, np.int32)
    kernels.sum_sizes(count, length, root, size)
    return count, start, length, root, size


def filter_speckles_as_printed(
    disparity: ArrayLike, *, no_disparity: float, min_difference: float, neighbourhood: int = 3
) -> NDArray[Any]:
    """Run the paper's pseudo-code to the letter [alg-speckle]: a warning, not a filter.

    Parameters
    ----------
    disparity : array_like of shape (H, W)
        pi.
    no_disparity : float
        nVal.
    min_difference : float
        minDiff.
    neighbourhood : int
        m, odd: the side of the square that is looked into.

    Returns
    -------
    ndarray of shape (H, W), dtype of `disparity`

    Notes
    -----
    Two readings are forced on us: "n" runs through the square row by row, "n+1" and "n−1" are the pixels after and
    before it; and "n+1 := n" assigns the place, not the value, since otherwise the map would be smeared. What is wrong:
    a pixel that a neighbour has marked is set to nVal only if its value is AT MOST nVal, so that with nVal below all
    disparities (OpenCV's) nothing is ever removed, and with nVal = 0, the paper's zero, only what was none before;
    components are never counted, and the size of 50 … 200 is not in the program at all.
    """
    pixels = np.array(disparity)
    height, width = pixels.shape
    visited = np.zeros((height, width), bool)
    reach = neighbourhood // 2
    for i in range(height):
        for j in range(width):
            if pixels[i, j] == no_disparity:
                continue
            if visited[i, j]:
                if pixels[i, j] <= no_disparity:
                    pixels[i, j] = no_disparity
                continue
            square = [(i + v, j + u) for v in range(-reach, reach + 1) for u in range(-reach, reach + 1)]
            inside = [(y, x) for y, x in square if 0 <= y < height and 0 <= x < width]
            following = list(pairwise(inside))
            for here, there in [*following, *((b, a) for a, b in following)]:
                if not visited[there] and abs(float(pixels[here]) - float(pixels[there])) <= min_difference:
                    visited[there] = True
    return pixels


def _speckle_sizes_reference(
    disparity: NDArray[Any], valid: NDArray[np.bool_], max_difference: float
) -> NDArray[np.int32]:
    """Count the pixels of each component of the graph of ~: the definition."""
    component = components(disparity, valid, max_difference)
    return np.where(valid, np.bincount(component.ravel())[component], 0).astype(np.int32)


def components(disparity: NDArray[Any], valid: NDArray[np.bool_], max_difference: float) -> NDArray[np.int32]:
    """Build the graph of ~ and number its components, by SciPy's graph search; an invalid pixel is one by itself."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    label = np.arange(disparity.size).reshape(disparity.shape)
    exact = disparity.astype(np.float64)
    edges = []
    for here, there in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1, :], np.s_[1:, :])):
        with np.errstate(invalid="ignore"):
            joined = valid[here] & valid[there] & (np.abs(exact[here] - exact[there]) <= max_difference)
        edges.append(np.stack([label[here][joined], label[there][joined]]))
    p, q = np.hstack(edges)
    graph = coo_array((np.ones(len(p), np.int8), (p, q)), shape=(disparity.size, disparity.size))
    return np.asarray(connected_components(graph, directed=False)[1], np.int32).reshape(disparity.shape)


def _as_disparity(disparity: ArrayLike, no_disparity: float, max_difference: float) -> tuple[NDArray[Any], Any, float]:
    """Return the map, contiguous, the marker in its dtype, and the difference, whole where the map is."""
    if not max_difference >= 0:
        raise InputError(f"max_difference must be 0 or more, but is {max_difference!r}")
    array = np.ascontiguousarray(disparity)
    if array.ndim != 2 or array.size == 0:
        raise InputError(f"disparity must have shape (H, W), but has {array.shape}")
    if array.dtype not in DISPARITY_DTYPES:
        raise InputError(f"disparity must be float32, float64, uint8, int16 or int32, not {array.dtype}")
    if array.dtype.kind != "f":
        if np.isnan(no_disparity):
            raise InputError(f"an {array.dtype} map has no NaN: say with no_disparity which value marks 'none'")
        limits = np.iinfo(array.dtype)
        if not (limits.min <= no_disparity <= limits.max and float(no_disparity).is_integer()):
            raise InputError(f"no_disparity is {no_disparity!r}, which {array.dtype} cannot hold")
        max_difference = float(np.rint(max_difference))  # half to even, as OpenCV's cvRound
    return array, array.dtype.type(no_disparity), max_difference
