# mypy: allow-untyped-defs
"""Kernels of the speckle filter."""

from __future__ import annotations

from numba import njit


@njit(cache=True, nogil=True)
def component_sizes(disparity, valid, max_difference, parent, sizes):
    """Write the size of each pixel's component into `sizes`, which enters as zeros. Union-find on pixels."""
    height, width = disparity.shape
    for y in range(height):
        for x in range(width):
            p = y * width + x
            parent[p] = p
            if not valid[y, x]:
                continue
            root = p
            if x > 0 and valid[y, x - 1] and abs(float(disparity[y, x]) - float(disparity[y, x - 1])) <= max_difference:
                root = p - 1
                while parent[root] != root:
                    parent[root] = parent[parent[root]]
                    root = parent[root]
                parent[p] = root
            if y > 0 and valid[y - 1, x] and abs(float(disparity[y, x]) - float(disparity[y - 1, x])) <= max_difference:
                other = p - width
                while parent[other] != other:
                    parent[other] = parent[parent[other]]
                    other = parent[other]
                # the smaller index is the root, so that a root comes before its members
                if other < root:
                    parent[root] = other
                elif root < other:
                    parent[other] = root
    for p in range(height * width):
        parent[p] = parent[parent[p]]
        if valid[p // width, p % width]:
            sizes[parent[p]] += 1
    for p in range(height * width - 1, -1, -1):
        sizes[p] = sizes[parent[p]] if valid[p // width, p % width] else 0
