"""Connected components of a graph, without SciPy, whose sparse graphs take long to import."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Ints = NDArray[np.int64]


def connected_components(count: int, a: Ints, b: Ints) -> Ints:
    """(count,) number of the component of each node, in the order of their first nodes.

    Components whose nodes are linked take each other's smallest node until none changes: some ten rounds for millions.

    Args:
        count: how many nodes.
        a, b: (L,) the two nodes of each link.
    """
    first = np.arange(count)  # of the component that each node is known to be in
    while len(a):
        low, high = np.minimum(first[a], first[b]), np.maximum(first[a], first[b])
        apart = np.flatnonzero(low != high)
        a, b = a[apart], b[apart]
        np.minimum.at(first, high[apart], low[apart])
        while not np.array_equal(further := first[first], first):
            first = further
    number = np.cumsum(first == np.arange(count)) - 1
    return np.asarray(number[first], dtype=np.int64)
