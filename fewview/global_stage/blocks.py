"""Blocks of scans that could be wrong together: the two sides of the weakest links."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csgraph, csr_array

from fewview.types import Array, BoolArray, IntArray


def tree_blocks(gains: Array) -> BoolArray:
    """One side of every edge of the maximum spanning forest of a gain matrix.

    Args:
        gains: (n, n) symmetric, 0 where a pair adds nothing.

    Returns:
        (k, n) memberships, one row an edge; laminar, so a chain of links gives nested blocks.
    """
    forest = csgraph.minimum_spanning_tree(csr_array(-gains))
    rows: list[BoolArray] = []
    visited = np.zeros(len(gains), dtype=bool)
    for root in range(len(gains)):
        if not visited[root]:
            order, parent = csgraph.breadth_first_order(forest, root, directed=False)
            visited[order] = True
            rows += _descendants(order, parent, len(gains))
    return np.array(rows, dtype=bool).reshape(-1, len(gains))


def _descendants(order: IntArray, parent: IntArray, scans: int) -> list[BoolArray]:
    below = np.eye(scans, dtype=bool)
    for node in order[:0:-1]:
        below[parent[node]] |= below[node]
    return [below[node] for node in order[1:]]


def pieces(gains: Array) -> tuple[int, IntArray]:
    """Number of connected parts of a gain matrix and the part of each scan."""
    count, label = csgraph.connected_components(csr_array(gains), directed=False)
    return int(count), np.asarray(label, dtype=np.int64)
