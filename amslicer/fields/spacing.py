"""How far apart a field's nodes are: as wanted, or as many as a budget allows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from amslicer.errors import JobError
from amslicer.fields.nodes import MOST_NODES, choose_spacing

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

MOST_ASKED = 20_000_000  # nodes that grid_mm may ask for: half a gigabyte of directions


def count_nodes(size_mm: Floats, spacing_mm: float, varies: tuple[bool, bool, bool]) -> float:
    """About how many nodes a box gets; may be more than any number type holds, infinite then."""
    with np.errstate(over="ignore"):
        along = [1 + np.float64(side) / spacing_mm for side, along in zip(size_mm, varies, strict=True) if along]
        return float(np.prod(along))


def spacing_or_default(size_mm: Floats, grid_mm: float | None, source: str, times: float = 1.0) -> float:
    """A job file's grid_mm, or where it has none so many times as far apart as nodes are by default; raises as below.

    Along all axes.
    """
    if grid_mm is None:
        return times * choose_spacing(size_mm)
    return asked_spacing(size_mm, (True, True, True), grid_mm, source)


def spacing_for(size_mm: Floats, varies: tuple[bool, bool, bool], budget: int) -> float:
    """mm between nodes so that a box has about this many."""
    dimensions = max(sum(varies), 1)
    spacing: float = choose_spacing(size_mm, varies) * (MOST_NODES / budget) ** (1 / dimensions)
    return spacing


def asked_spacing(size_mm: Floats, varies: tuple[bool, bool, bool], grid_mm: float, source: str) -> float:
    """A job file's grid_mm.

    Raises:
        JobError: it makes more nodes than are kept.
    """
    nodes = count_nodes(size_mm, grid_mm, varies)
    if nodes > MOST_ASKED:
        finest = spacing_for(size_mm, varies, MOST_ASKED // 2)
        raise JobError(
            f"a field by {source} with grid_mm: {grid_mm:g} has {nodes:.3g} nodes over the part; at most "
            f"{MOST_ASKED} are made",
            hint=f"try grid_mm: {finest:.2g}, or leave it out",
        )
    return grid_mm
